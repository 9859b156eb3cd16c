"""Arguments shared by several verbs, and converters of their values."""

import argparse
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from granflow.errors import FileError, GranflowError
from granflow.runs.interrupts import Terminated
from granflow.visible_text import visible, visible_line

if TYPE_CHECKING:
    from granflow.load import Scene
    from granflow.runs.result import Result

ARCHITECTURES = ("cpu", "gpu", "cuda", "vulkan")
"""Values of --arch; gpu selects the first available GPU backend."""
PRECISIONS = ("f64", "f32", "mixed")
"""Values of --precision: f64, f32, or mixed (positions in f64, all else in f32)."""


def add_verb(verbs: Any, verb: Callable[..., int], summary: str) -> argparse.ArgumentParser:
    """Add a verb and return its parser.

    `verbs`: subparsers of argparse; `verb`: function (options) -> exit code, which names the verb; `summary`:
    help text in lowercase without a period.
    """
    parser = verbs.add_parser(verb.__name__, help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.set_defaults(verb=verb)
    return parser


def add_scene_verb(verbs: Any, verb: Callable[..., int], summary: str) -> argparse.ArgumentParser:
    """Add a verb that reads a scene, with the arguments SCENE and --set; return its parser."""
    parser = add_verb(verbs, verb, summary)
    parser.add_argument("scene", metavar="SCENE", type=Path, help="scene file (YAML)")
    add_overrides(parser, "override a value of the scene, such as --set particles.beads.count=500")
    return parser


def check_output_file(path: Path | None, types: Sequence[str], directory: Path) -> None:
    """Refuse an output file that is of another type, a directory, or an input file of the run in a directory.

    path:       value of --out, None if it is not given
    types:      possible ends of its name, such as .png
    directory:  of the run, which need not be one
    Raises:     GranflowError
    """
    if path is None:
        return
    if path.is_dir():
        raise GranflowError(
            f"--out {path} is a directory; give a file, such as {path / f'picture{types[0]}'}."
        )
    if path.suffix not in types:
        raise GranflowError(
            f"--out {path} is not of a supported type; the name must end in {' or '.join(types)}."
        )
    if not path.exists():
        return
    from granflow.runs.read_run import SCENE, Run
    from granflow.runs.run_directory import input_files

    run = Run(directory)
    inputs = [] if not (directory / SCENE).exists() or run.scene_problem else [*input_files(run.scene)]
    for key, name in inputs:
        if name.exists() and path.samefile(name):
            raise GranflowError(
                f"--out {path} is {key} of the run, which must not be replaced; give another file."
            )


def add_overrides(parser: argparse.ArgumentParser, text: str) -> None:
    """Add --set, which can be repeated; `text`: its effect."""
    parser.add_argument(
        "--set",
        dest="overrides",
        metavar="KEY.PATH=VALUE",
        action="append",
        default=[],
        help=f"{text}; repeatable",
    )


def add_out(parser: argparse.ArgumentParser, default: str, content: str = "") -> None:
    """Add --out, a directory; `default`: text on the default; `content`: what the directory contains."""
    text = f"output directory{content and f' for {content}'} (default: {default})"
    parser.add_argument("--out", metavar="DIR", type=Path, help=text)


def add_machine(
    parser: argparse.ArgumentParser, default_precision: str = "the precision of the scene"
) -> None:
    """Add --arch and --precision; `default_precision`: text on the default of --precision."""
    parser.add_argument(
        "--arch",
        choices=ARCHITECTURES,
        default="cpu",
        help="compute device or backend; gpu selects the first available GPU backend (default: cpu)",
    )
    parser.add_argument(
        "--precision", choices=PRECISIONS, help=f"floating-point precision (default: {default_precision})"
    )


def add_allow_long(parser: argparse.ArgumentParser) -> None:
    """Add --allow-long."""
    parser.add_argument(
        "--allow-long", action="store_true", help="accept a run estimated to take more than a year"
    )


def add_mpi(parser: argparse.ArgumentParser) -> None:
    """Add --mpi."""
    parser.add_argument(
        "--mpi", action="store_true", help="distribute the particles over the ranks of mpirun; needs mpi4py"
    )


def quantity(dimension: str) -> Callable[[str], float]:
    """Return a converter for argparse from text such as 25.4mm to SI.

    `dimension`: name in `granflow.units`. The converter raises ArgumentTypeError for an invalid unit and
    for a value that is not finite.
    """

    def read(text: str) -> float:
        from granflow.units import UnitError, to_si

        try:
            value = to_si(text, dimension)
        except UnitError as error:
            raise argparse.ArgumentTypeError(f"{text}: {error}") from None
        if not math.isfinite(value):
            raise argparse.ArgumentTypeError(f"{text} is not finite; give a finite value")
        return value

    return read


def simulated_time(text: str) -> float:
    """Convert --until for argparse: a simulated time [s], at least 0. Raises ArgumentTypeError."""
    value = quantity("time")(text)
    if value < 0.0:
        raise argparse.ArgumentTypeError(f"{text} is negative; give a time of at least 0, such as 0.2s")
    return value


def thread_count(text: str) -> int:
    """Convert --threads for argparse: a whole number, at least 1. Raises ArgumentTypeError."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(
            f"{text} is not a number of threads; give a whole number of at least 1"
        )
    return int(text)


def count(text: str) -> int:
    """Convert a number of jobs or trials for argparse: a whole number, at least 1. Raises
    ArgumentTypeError."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a valid number; give a whole number of at least 1")
    return int(text)


def load(options: argparse.Namespace) -> "Scene":
    """Read the scene with the overrides of the command line, --precision included.

    --precision has priority over --set. Raises SceneError with all problems of the scene.
    """
    from granflow.load import load as load_scene

    precision = getattr(options, "precision", None)
    return load_scene(
        options.scene, [*options.overrides, *([f"run.precision={precision}"] if precision else [])]
    )


def load_runnable(options: argparse.Namespace) -> "Scene":
    """Read the scene of a run, as `load`. Raises SceneError also for a group whose particles a program
    adds."""
    scene = load(options)
    scene.refuse_program()
    return scene


# Output of the verbs: messages on stderr, exit codes, tables.
#
# Results go to stdout, errors and warnings to stderr.

COLLIDE_UNITS = {
    "duration": "s",
    "overlap_max": "m",
    "overlap_residual": "m",
    "force_max": "N",
    "spring_equation19": "N/m",
    "time_step": "s",
    "velocity": "m/s",
}
"""Units of the numbers of `granflow collide`; all others are dimensionless."""
WIDE = 160
"""Width of a table that is written to a file [characters]: wide enough for complete numbers."""
EXIT_INTERRUPTED = 130
"""128 + SIGINT: the exit code after Ctrl-C."""
EXIT_TERMINATED = 143
"""128 + SIGTERM: the exit code after a termination request."""


def say(*parts: object, sep: str = " ", file: TextIO | None = None, flush: bool = False) -> None:
    """Print text; control characters in titles, names and file headers become visible. The only `print` of
    the CLI.

    `file`: stdout by default; `flush`: write at once.
    """
    print(visible(sep.join(map(str, parts))), file=file, flush=flush)


def say_progress(message: str) -> None:
    """Print a progress message at once, also if stdout is a file."""
    say(f"{message} ...", flush=True)


def print_refusal(error: GranflowError) -> int:
    """Print an error without a traceback and return its exit code.

    The problems of a file are printed one per line, followed by their number.
    """
    problems = error.problems if isinstance(error, FileError) else ()
    if not problems:
        return print_error(str(error), error.exit_code)
    for problem in problems:
        say(visible_line(problem), file=sys.stderr)
    say(f"{len(problems)} problem{'s' if len(problems) > 1 else ''} found.", file=sys.stderr)
    return error.exit_code


def print_error(sentence: str, exit_code: int = GranflowError.exit_code) -> int:
    """Print one sentence to stderr and return the exit code."""
    say(visible_line(f"granflow: {sentence}"), file=sys.stderr)
    return exit_code


def warn(sentences: Iterable[str]) -> None:
    """Print warnings to stderr, each with the prefix "granflow: warning:"."""
    for sentence in sentences:
        say(visible_line(f"granflow: warning: {sentence}"), file=sys.stderr)


def say_checked(path: Path, warnings: Sequence[str], remark: str = "") -> int:
    """Print that the scene at `path` has no errors and how many warnings, then the warnings; return the exit
    code 0."""
    count = (
        f"no errors, {len(warnings)} warning{'s' * (len(warnings) > 1)}" if warnings else "no problems found"
    )
    say(f"{path}: {count}{remark}.", flush=True)
    warn(warnings)
    return 0


def warned(sentences: Iterable[str]) -> list[str]:
    """Print warnings as `warn` does, and return them."""
    found = list(sentences)
    warn(found)
    return found


def exit_code_of(stop: KeyboardInterrupt) -> int:
    """Return the exit code that shells report for a process ended by that signal: 128 plus the signal
    number."""
    return EXIT_TERMINATED if isinstance(stop, Terminated) else EXIT_INTERRUPTED


def write_study(out: Path, write: Callable[..., None], *numbers: Any) -> None:
    """Write the files of a study; without matplotlib, write only those that do not need it, with a message.

    `write`: function (directory, *numbers), which may raise GranflowError after it has written the other
    files.
    """
    try:
        write(out, *numbers)
    except GranflowError as error:
        say(error)
    say(f"Written to {out}")


def show_result(title: str, result: "Result", out: Path) -> None:
    """Print the table of results, the expectations, and the files to open.

    `out`: output directory of the run. Expectations that are not satisfied begin with NOT AS EXPECTED.
    """
    from rich.console import Console

    from granflow.runs.result import closing_table

    Console().print(closing_table(result, visible(title)))
    for sentence, met in result.expectations:
        say(sentence if met else f"NOT AS EXPECTED: {sentence}")
    series = sorted(str(path) for path in out.glob("*.pvd"))
    if series:
        say(f"For ParaView: {', '.join(series)}")
    say(f"Numbers: {out / 'timeseries.csv'}, {out / 'result.json'}")


def show_comparison(numbers: Mapping[str, Any]) -> None:
    """Print the simulated numbers of a collision beside the requested or closed-form ones.

    `numbers`: as from `granflow.studies.collide.collide`; units are those of COLLIDE_UNITS.
    """
    references = ("_asked", "_theory")
    rows = []
    for name in (name for name in numbers if not name.endswith(references)):
        reference = [as_text(numbers[name + end]) for end in references if name + end in numbers]
        unit = COLLIDE_UNITS.get(name, "")
        rows.append(
            (
                name.replace("_", " ").replace("equation19", "of Eq. 19"),
                as_text(numbers[name]),
                *(reference or [""]),
                unit,
            )
        )
    show_table("head-on collision", ("", "simulated", "requested or closed form", "unit"), rows)


def show_table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table with right-aligned numbers to the terminal, or as plain text to a file.

    `heads` and each row have one text per column; the first column is left-aligned.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=Text(visible(title)), title_justify="left", show_header=any(heads), box=None, pad_edge=False
    )
    for column, head in enumerate(heads):
        table.add_column(visible(head), justify="left" if column == 0 else "right", no_wrap=column > 0)
    for row in rows:
        table.add_row(*(Text(visible(cell)) for cell in row))
    Console(width=None if sys.stdout.isatty() else WIDE).print(table)


def as_text(value: Any) -> str:
    """Return a number with seven digits, and the text of any other value."""
    return f"{value:.7g}" if isinstance(value, float) else str(value)
