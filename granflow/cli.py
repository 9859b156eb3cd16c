"""The command line: `granflow run | check | explain | schema | collide | restitution | fit | paper | cache`.

Only what a verb needs is imported, inside it: `--help` starts at once and `schema` never loads Taichi.
"""

import argparse
import json
import math
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granflow.errors import FileError, GranflowError

if TYPE_CHECKING:
    from granflow.observe import Result
    from granflow.scene import Scene

ARCHITECTURES = ("cpu", "gpu", "cuda", "vulkan", "metal")
PRECISIONS = ("f64", "f32", "mixed")
RESULT_FILES = (
    *("particles.pvd", "contacts.pvd", "walls.pvd", "particles_*.vtu", "contacts_*.vtu", "walls_*.vtu"),
    *("timeseries.csv", "result.json", "scene_as_run.yaml", "run.log"),
)
"""What a run writes into its directory, as patterns: tells an earlier run from other files."""
COLLIDE_UNITS = {
    "duration": "s",
    "overlap_max": "m",
    "overlap_residual": "m",
    "force_max": "N",
    "spring_equation19": "N/m",
    "time_step": "s",
    "velocity": "m/s",
}
EXIT_UNMET = 1
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143


class Terminated(KeyboardInterrupt):
    """SIGTERM came: ends a run in the same orderly way as Ctrl-C."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    0 done; 1 done, but an expectation of the scene is not met; 2 refused (scene, command line, files); 3 stopped
    by a guard; 130 interrupted (Ctrl-C); 143 terminated (SIGTERM).
    """
    options = build_parser().parse_args(arguments)
    try:
        return options.verb(options)
    except GranflowError as error:
        return refuse(error)
    except OSError as error:
        if error.filename is None:
            raise
        return complain(f"{error.filename}: {error.strerror}.")
    except KeyboardInterrupt as stop:
        return complain("interrupted.", exit_code_of(stop))


def refuse(error: GranflowError) -> int:
    """Show an error of ours without a traceback and give its exit code; problems of a file are counted."""
    problems = error.problems if isinstance(error, FileError) else ()
    if not problems:
        return complain(str(error), error.exit_code)
    for problem in problems:
        print(problem, file=sys.stderr)
    print(f"{len(problems)} problem{'s' if len(problems) > 1 else ''} found.", file=sys.stderr)
    return error.exit_code


def complain(sentence: str, exit_code: int = GranflowError.exit_code) -> int:
    """Say one sentence on stderr and give the exit code."""
    print(f"granflow: {sentence}", file=sys.stderr)
    return exit_code


def warn(sentences: Iterable[str]) -> None:
    """Say on stderr what does not keep a scene from running but should be known."""
    for sentence in sentences:
        print(f"granflow: warning: {sentence}", file=sys.stderr)


@contextmanager
def sigterm_as_exception() -> Iterator[None]:
    """Let SIGTERM end what runs inside as Ctrl-C does, so that files are closed."""

    def terminate(*_: Any) -> None:
        raise Terminated

    before = signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def exit_code_of(stop: KeyboardInterrupt) -> int:
    """The exit code that shells give to a process ended by that signal."""
    return EXIT_TERMINATED if isinstance(stop, Terminated) else EXIT_INTERRUPTED


# ---------------------------------------------------------------- verbs


def run(options: argparse.Namespace) -> int:
    """`granflow run`: simulate a scene into a directory, then show the numbers and the expectations."""
    scene = load(options)
    out = options.out or Path("out") / scene.path.stem
    make_room(out, options.force)
    from granflow.simulation import Simulation
    from granflow.study.restitution import warnings as restitution_warnings

    with sigterm_as_exception():
        simulation = Simulation(scene, arch=options.arch, threads=options.threads, out=out, progress=True)
        warn([*simulation.plan.step.warnings, *restitution_warnings(simulation.plan)])
        try:
            result = simulation.run(until=options.until)
        except KeyboardInterrupt as stop:
            return complain(f"stopped at {simulation.time:.6g} s, {out} holds the run up to there.", exit_code_of(stop))
    show_result(scene.title, result, out)
    if scene.expect and not result.expectations:
        print(f"Expectations are left out: --until ended the run at {simulation.time:.6g} s.")
    return 0 if all(met for _, met in result.expectations) else EXIT_UNMET


def check(options: argparse.Namespace) -> int:
    """`granflow check`: find every problem of a scene without running it: also too large a step, too little room."""
    scene = load(options)
    from granflow.plan import plan_for
    from granflow.scene.generate import initial_grains, rains

    warn(plan_for(scene).step.warnings)
    initial_grains(scene)
    rains(scene)
    print(f"{options.scene}: no problems found.")
    return 0


def explain(options: argparse.Namespace) -> int:
    """`granflow explain`: what will be run and why: features, defaults, time step, memory, run time."""
    scene = load(options)
    from granflow.plan import explain as explained
    from granflow.plan import plan_for

    print(explained(plan_for(scene, on_gpu=options.arch != "cpu")))
    return 0


def schema(options: argparse.Namespace) -> int:
    """`granflow schema`: the JSON Schema of scene files, for editors."""
    from granflow.scene import json_schema

    print(json.dumps(json_schema(), indent=2, ensure_ascii=False))
    return 0


def collide(options: argparse.Namespace) -> int:
    """`granflow collide`: one head-on collision against its closed forms."""
    from granflow.study.collide import collide as collide_once

    names = ("law", "material", "diameter", "velocity", "diameter2", "material2", "wall", "restitution")
    numerics = ("settings", "steps_per_contact", "precision", "arch")
    numbers = collide_once(**{name: getattr(options, name) for name in (*names, *numerics)})
    if options.json:
        print(json.dumps(numbers, indent=2))
    else:
        show_comparison(numbers)
    return 0


def restitution(options: argparse.Namespace) -> int:
    """`granflow restitution`: what every pair of materials is asked and reaches at the scene's own time step."""
    from granflow.study.restitution import measure, restitution_rows, write_restitution

    scene = load(options)
    found, step = measure(scene, options.arch)
    heads = ("pair of materials", "velocity m/s", "asked", "reached", "difference %")
    show_table(scene.title, heads, restitution_rows(found))
    print(f"With steps of {step:.4g} s in {scene.run.precision}; * differs by more than 1 %.")
    write_study(options.out or Path("out") / scene.path.stem, write_restitution, found, scene.title)
    return 0


def fit(options: argparse.Namespace) -> int:
    """`granflow fit`: sigma and psi of Eq. 12 from measured velocities and restitutions."""
    from granflow.study.fit import fit as fitted
    from granflow.study.fit import fit_rows, limit_from_materials, write_fit
    from granflow.study.measurements import read_measurements

    data = read_measurements(options.data)
    limit = limit_from_materials(options.material, options.material2) if options.material else options.limit_velocity
    found = fitted(data, limit)
    show_table(f"Eq. 12 fitted to {len(data)} rows of {options.data}", ("", "value", "error", "unit"), fit_rows(found))
    print(f"For a pair in a scene:\n  {found.snippet()}")
    write_study(options.out or Path("out") / options.data.stem, write_fit, data, found)
    return 0


def paper(options: argparse.Namespace) -> int:
    """`granflow paper`: the figures and tables of Zhou (2011) from simulated collisions, and all laws compared."""
    from granflow.study.paper import write_paper

    page = write_paper(options.out, lambda words: print(f"{words} ...", flush=True))
    print(f"Open {page} in a browser; the figures lie beside it as PNG and CSV.")
    return 0


def cache(options: argparse.Namespace) -> int:
    """`granflow cache`: where compiled kernels are kept between runs, and how many; --clear deletes them."""
    from granflow.device.cache import VARIABLE, cache_folder, clear, contents

    held = clear() if options.clear else contents()
    done = "deleted" if options.clear else "kept"
    print(f"{cache_folder()}: {held.kernel_count} compiled kernels, {held.size / 1e6:.1f} MB {done}.")
    print(f"{VARIABLE} names another folder.")
    return 0


def write_study(out: Path, write: Callable[..., None], *numbers: Any) -> None:
    """Write the files of a study; without matplotlib those that need none, and say so."""
    try:
        write(out, *numbers)
    except GranflowError as error:
        print(error)
    print(f"Written to {out}")


def load(options: argparse.Namespace) -> "Scene":
    """Read the scene with the overrides of the command line; --precision is one of them."""
    from granflow.scene import load as load_scene

    precision = getattr(options, "precision", None)
    return load_scene(options.scene, [*options.overrides, *([f"run.precision={precision}"] if precision else [])])


def make_room(out: Path, force: bool) -> None:
    """Refuse a directory that holds an earlier run, or with `force` remove that run's files and no others."""
    earlier = [path for pattern in RESULT_FILES for path in out.glob(pattern)]
    if earlier and not force:
        raise GranflowError(f"{out} holds an earlier run: name another with --out, or replace it with --force.")
    for path in earlier:
        path.unlink()


# ---------------------------------------------------------------- tables


def show_result(title: str, result: "Result", out: Path) -> None:
    """Print the closing table, the expectations, and what to open."""
    from rich.console import Console

    from granflow.observe import closing_table

    Console().print(closing_table(result, title))
    for sentence, met in result.expectations:
        print(sentence if met else f"NOT AS EXPECTED: {sentence}")
    series = sorted(str(path) for path in out.glob("*.pvd"))
    if series:
        print(f"For ParaView: {', '.join(series)}")
    print(f"Numbers: {out / 'timeseries.csv'}, {out / 'result.json'}")


def show_comparison(numbers: Mapping[str, Any]) -> None:
    """Print what a collision reached beside what was asked of it or what theory promises."""
    promises = ("_asked", "_theory")
    rows = []
    for name in (name for name in numbers if not name.endswith(promises)):
        promised = [as_text(numbers[name + end]) for end in promises if name + end in numbers]
        unit = COLLIDE_UNITS.get(name, "")
        rows.append(
            (
                name.replace("_", " ").replace("equation19", "of Eq. 19"),
                as_text(numbers[name]),
                *(promised or [""]),
                unit,
            )
        )
    show_table("head-on collision", ("", "reached", "asked or closed form", "unit"), rows)


def show_table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table with right-aligned figures to the terminal, or plain to a file."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left", show_header=any(heads), box=None, pad_edge=False)
    for column, head in enumerate(heads):
        table.add_column(head, justify="left" if column == 0 else "right")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    Console().print(table)


def as_text(value: Any) -> str:
    """A number with seven digits, anything else as it is."""
    return f"{value:.7g}" if isinstance(value, float) else str(value)


# ---------------------------------------------------------------- arguments


def build_parser() -> argparse.ArgumentParser:
    """All verbs and their arguments."""
    parser = argparse.ArgumentParser(prog="granflow", description="Discrete element simulation of granular flow.")
    parser.add_argument("--version", action=ShowVersion, nargs=0, help="print the version and leave")
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    add_run(verbs)
    add_scene_verb(verbs, check, "find every problem of a scene without running it")
    explained = add_scene_verb(verbs, explain, "show what would be run and why: features, defaults, time step, memory")
    add_machine(explained)
    verbs.add_parser("schema", help="print the JSON Schema of scene files").set_defaults(verb=schema)
    add_collide(verbs)
    add_restitution(verbs)
    add_fit(verbs)
    add_paper(verbs)
    add_cache(verbs)
    return parser


class ShowVersion(argparse.Action):
    """Looks the version up only when asked, as that reads files."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        import granflow

        print(f"granflow {granflow.__version__}")
        parser.exit()


def add_scene_verb(verbs: Any, verb: Callable[..., int], summary: str) -> argparse.ArgumentParser:
    """A verb that reads a scene: SCENE and --set."""
    parser = verbs.add_parser(verb.__name__, help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.add_argument("scene", metavar="SCENE", type=Path, help="the YAML file of the scene")
    parser.add_argument(
        "--set",
        dest="overrides",
        metavar="KEY.PATH=VALUE",
        action="append",
        default=[],
        help="put a value in place of the scene's, such as --set particles.beads.count=500; may be repeated",
    )
    parser.set_defaults(verb=verb)
    return parser


def add_run(verbs: Any) -> None:
    """`granflow run` and its arguments."""
    parser = add_scene_verb(verbs, run, "simulate a scene and write what ParaView opens")
    parser.add_argument("--out", metavar="DIR", type=Path, help="where results go (out/ and the scene's name)")
    parser.add_argument("--until", metavar="T", type=quantity("time"), help="stop at this simulated time, such as 0.2s")
    parser.add_argument("--threads", metavar="N", type=thread_count, help="CPU threads (all)")
    parser.add_argument("--force", action="store_true", help="replace an earlier run in the same directory")
    add_machine(parser)


def add_machine(parser: argparse.ArgumentParser) -> None:
    """--arch and --precision."""
    parser.add_argument("--arch", choices=ARCHITECTURES, default="cpu", help="where to compute (cpu)")
    parser.add_argument("--precision", choices=PRECISIONS, help="width of the numbers (as the scene says)")


def add_collide(verbs: Any) -> None:
    """`granflow collide` and its arguments."""
    summary = "run one head-on collision and compare it with the closed forms"
    parser = verbs.add_parser("collide", help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.add_argument("--law", default="zhou", help="contact law (zhou)")
    parser.add_argument(
        "--set",
        dest="settings",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="a setting of the law, such as --law thornton --set yield_ratio=2.8; may be repeated",
    )
    parser.add_argument("--material", required=True, metavar="PRESET", help="material, such as stainless_316")
    parser.add_argument("--diameter", required=True, type=quantity("length"), help="of the sphere, such as 25.4mm")
    parser.add_argument("--velocity", required=True, type=quantity("velocity"), help="of approach, such as 0.5")
    parser.add_argument("--material2", metavar="PRESET", help="of the other sphere or the wall (the same)")
    partner = parser.add_mutually_exclusive_group()
    partner.add_argument("--diameter2", type=quantity("length"), help="of the other sphere (the same)")
    partner.add_argument("--wall", action="store_true", help="collide with a wall instead of a sphere")
    parser.add_argument("--restitution", type=quantity("number"), help="asked for, 0 to 1 (from the material)")
    parser.add_argument("--steps-per-contact", metavar="N", type=float, help="duration over time step")
    parser.add_argument("--json", action="store_true", help="print JSON in SI units")
    add_machine(parser)
    parser.set_defaults(verb=collide)


def add_restitution(verbs: Any) -> None:
    """`granflow restitution` and its arguments."""
    parser = add_scene_verb(verbs, restitution, "show the restitution that a scene asks for and that it reaches")
    parser.add_argument("--out", metavar="DIR", type=Path, help="where CSV and PNG go (out/ and the scene's name)")
    add_machine(parser)


def add_fit(verbs: Any) -> None:
    """`granflow fit` and its arguments."""
    summary = "fit sigma and psi of Eq. 12 to measured restitutions"
    parser = verbs.add_parser("fit", help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.add_argument(
        "data", metavar="DATA.csv", type=Path, help="columns velocity [m/s] and restitution, maybe deviation or weight"
    )
    known = parser.add_mutually_exclusive_group(required=True)
    known.add_argument("--material", metavar="PRESET", help="limit velocity from Eq. 11 for this material")
    known.add_argument("--limit-velocity", type=quantity("velocity"), help="limit velocity, such as 340 m/s")
    known.add_argument("--fit-limit", action="store_true", help="fit the limit velocity, too")
    parser.add_argument("--material2", metavar="PRESET", help="of the partner, with --material (the same)")
    parser.add_argument("--out", metavar="DIR", type=Path, help="where CSV and PNG go (out/ and the data's name)")
    parser.set_defaults(verb=fit)


def add_paper(verbs: Any) -> None:
    """`granflow paper` and its arguments."""
    summary = "reproduce the figures and tables of Zhou (2011), and compare all laws, on one page"
    parser = verbs.add_parser("paper", help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.add_argument("--out", metavar="DIR", type=Path, default=Path("out/paper"), help="where it goes (out/paper)")
    parser.set_defaults(verb=paper)


def add_cache(verbs: Any) -> None:
    """`granflow cache` and its argument."""
    summary = "show where compiled kernels are kept between runs"
    parser = verbs.add_parser("cache", help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.add_argument("--clear", action="store_true", help="delete them; the next run compiles anew")
    parser.set_defaults(verb=cache)


def quantity(dimension: str) -> Callable[[str], float]:
    """A reader of arguments such as 25.4mm, for argparse: to SI, with the reader's own message if it is not one."""

    def read(text: str) -> float:
        from granflow.scene.units import UnitError, to_si

        try:
            value = to_si(text, dimension)
        except UnitError as error:
            raise argparse.ArgumentTypeError(f"{text} is given, but {error}") from None
        if not math.isfinite(value):
            raise argparse.ArgumentTypeError(f"{text} is given, but a finite value is asked here")
        return value

    return read


def thread_count(text: str) -> int:
    """A reader of --threads, for argparse."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is given, but a whole number from 1 is asked here")
    return int(text)
