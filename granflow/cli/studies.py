"""The verbs that carry out studies: one collision or many runs, and what follows from them.

Each verb calls a function of `granflow.studies`, prints a table and writes files to a directory. Long studies
(accuracy of a scene, compare, sweep, calibrate) keep the runs that have ended: after a stop signal, the same
command continues. Equation numbers are those of Y. H. Zhou, Theor. Appl. Mech. Lett. 1, 041006 (2011).
"""

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granflow.cli.arguments import (
    ARCHITECTURES,
    add_kernels,
    add_machine,
    add_out,
    add_overrides,
    add_scene_verb,
    add_verb,
    count,
    load,
    load_runnable,
    print_error,
    quantity,
    say,
    say_progress,
    show_table,
    simulated_time,
    thread_count,
)
from granflow.cli.process import deferred_to_event, exit_code_of
from granflow.cli.run import prepare_output
from granflow.errors import GranflowError
from granflow.visible_text import numbered, readable

if TYPE_CHECKING:
    from granflow.studies.calibration.calibrate import CalibrationFile
    from granflow.studies.calibration.results import CalibrationResult
    from granflow.studies.run_pool import Progress, Workers
    from granflow.studies.sweep import SweepFile


def made(out: Path) -> Path:
    """The output directory of a study, created before its runs, which can take minutes. Raises OSError."""
    out.mkdir(parents=True, exist_ok=True)
    return out


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


# collide


def collide(options: argparse.Namespace) -> int:
    """`granflow collide`: simulate one head-on collision and compare it with closed-form results.

    Prints a table, or JSON in SI units. Raises GranflowError for an unknown material, contact model or
    option.
    """
    from granflow.studies.collide import collide as collide_once

    names = ("law", "material", "diameter", "velocity", "diameter2", "material2", "wall", "restitution")
    numerics = ("settings", "steps_per_contact", "precision", "arch")
    numbers = collide_once(**{name: getattr(options, name) for name in (*names, *numerics)})
    if options.json:
        say(json.dumps(numbers, indent=2))
    else:
        show_comparison(numbers)
    return 0


def add_collide(verbs: Any) -> None:
    """Add `granflow collide` and its arguments.

    Quantities are in SI units or have a unit, such as 25.4mm; --diameter2 and --wall exclude each other.
    """
    parser = add_verb(
        verbs, collide, "simulate one head-on collision and compare it with closed-form results"
    )
    add = parser.add_argument
    length = quantity("length")
    velocity = quantity("velocity")
    add("--law", default="zhou", help="normal contact model (default: zhou)")
    add(
        "--set",
        dest="settings",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="option of the contact model, such as --law thornton --set yield_ratio=2.8; repeatable",
    )
    add("--material", required=True, metavar="PRESET", help="material, such as stainless_316")
    add("--diameter", required=True, type=length, help="diameter of the sphere, such as 25.4mm")
    add("--velocity", required=True, type=velocity, help="impact velocity, such as 0.5 (m/s)")
    add(
        "--material2",
        metavar="PRESET",
        help="material of the other sphere or of the wall (default: the same)",
    )
    partner = parser.add_mutually_exclusive_group()
    partner.add_argument("--diameter2", type=length, help="diameter of the other sphere (default: the same)")
    partner.add_argument("--wall", action="store_true", help="collide with a wall instead of a sphere")
    add(
        "--restitution",
        type=quantity("number"),
        help="requested restitution, 0 to 1 (default: from the material)",
    )
    add(
        "--steps-per-contact",
        metavar="N",
        type=float,
        help="time steps per expected contact duration (default: from the automatic time step)",
    )
    add("--json", action="store_true", help="print JSON in SI units")
    add_machine(parser, "f64")


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


def as_text(value: Any) -> str:
    """Return a number with seven digits, and the text of any other value."""
    return f"{value:.7g}" if isinstance(value, float) else str(value)


# restitution


def restitution(options: argparse.Namespace) -> int:
    """`granflow restitution`: requested and simulated restitution of each pair of materials at the time step.

    The impact velocities [m/s] are below the maximum expected one. Writes CSV and PNG files.
    """
    from granflow.studies.restitution import measure, restitution_rows, write_restitution

    scene = load(options)
    out = made(options.out or Path("out") / scene.path.stem)
    found, step = measure(scene, options.arch)
    heads = ("pair of materials", "velocity m/s", "requested", "simulated", "difference %")
    show_table(scene.title, heads, restitution_rows(found))
    say(f"Time step {step:.4g} s, precision {scene.run.precision}; * marks a difference of more than 1 %.")
    write_study(out, write_restitution, found, scene.title)
    return 0


def add_restitution(verbs: Any) -> None:
    """Add `granflow restitution` and its arguments."""
    summary = (
        "print requested and simulated restitution for each pair of materials at the time step of the scene"
    )
    parser = add_scene_verb(verbs, restitution, summary)
    add_out(parser, "out/SCENE", "CSV and PNG")
    add_machine(parser)


# fit


def fit(options: argparse.Namespace) -> int:
    """`granflow fit`: fit sigma and psi of Eq. 12 (Zhou 2011) to measured impact velocities and restitutions.

    The limit velocity [m/s] is given, from the material (Eq. 11), or fitted. Raises GranflowError if the
    result would overwrite the data, or if the data are invalid.
    """
    from granflow.studies.fit import fit as fitted
    from granflow.studies.fit import fit_rows, limit_from_materials, read_measurements, write_fit

    out = options.out or Path("out") / options.data.stem
    if options.data.resolve() == (out / "fit.csv").resolve():
        raise GranflowError(f"{options.data} would be overwritten by the result fit.csv: give another --out.")
    data = read_measurements(options.data)
    limit = (
        limit_from_materials(options.material, options.material2)
        if options.material
        else options.limit_velocity
    )
    found = fitted(data, limit)
    title = f"Zhou (2011), Eq. 12, fitted to {len(data)} rows of {options.data}"
    show_table(title, ("", "value", "error", "unit"), fit_rows(found))
    say(f"For a pair in a scene:\n  {found.snippet()}")
    write_study(out, write_fit, data, found)
    return 0


def add_fit(verbs: Any) -> None:
    """Add `granflow fit` and its arguments.

    Exactly one of --material, --limit-velocity and --fit-limit determines the limit velocity.
    """
    parser = add_verb(
        verbs, fit, "fit sigma and psi of the restitution curve (Zhou 2011, Eq. 12) to measurements"
    )
    columns = "table with the columns velocity [m/s] and restitution, optionally deviation or weight"
    parser.add_argument("data", metavar="DATA.csv", type=Path, help=columns)
    known = parser.add_mutually_exclusive_group(required=True)
    add = known.add_argument
    add(
        "--material", metavar="PRESET", help="compute the limit velocity of this material (Zhou 2011, Eq. 11)"
    )
    add("--limit-velocity", type=quantity("velocity"), help="limit velocity, such as 340 m/s")
    add("--fit-limit", action="store_true", help="also fit the limit velocity")
    second = "with --material: material of the second body (default: the same)"
    parser.add_argument("--material2", metavar="PRESET", help=second)
    add_out(parser, "out/DATA", "CSV and PNG")


# paper


def paper(options: argparse.Namespace) -> int:
    """`granflow paper`: reproduce the figures and tables of Zhou (2011) and compare all contact models.

    Writes one page with its figures (PNG) and their data (CSV).
    """
    from granflow.studies.paper.report import write_paper

    page = write_paper(made(options.out or Path("out/paper")), say_progress)
    say(f"Open {page} in a browser; the same directory contains the figures as PNG and CSV.")
    return 0


def add_paper(verbs: Any) -> None:
    """Add `granflow paper` and its arguments."""
    summary = "reproduce the figures and tables of Zhou (2011) and compare all contact models, on one page"
    add_out(add_verb(verbs, paper, summary), "out/paper")


# accuracy


def accuracy(options: argparse.Namespace) -> int:
    """`granflow accuracy`: measure error against run time, for binary collisions or for a scene.

    Writes a page, CSV files and figures, prints a recommendation and returns 0. Raises GranflowError for a
    target outside (0, 1), or for options that require a scene.
    """
    if not 0.0 < options.target < 1.0:
        raise GranflowError(f"--target is {options.target:g}, but must be between 0 and 1, such as 0.01.")
    return _binary_collisions(options) if options.scene is None else _scene(options)


def _binary_collisions(options: argparse.Namespace) -> int:
    """Measure head-on collisions of two spheres with all contact models, precisions and time steps.

    Raises GranflowError for options that require a scene.
    """
    for given, name in (
        (options.overrides, "--set"),
        (options.until, "--until"),
        (options.all_particles, "--all-particles"),
    ):
        if given:
            raise GranflowError(f"{name} requires a SCENE, which is missing.")
    from granflow.studies.accuracy.report import (
        default_sentence,
        measure_two_bodies,
        table_heads,
        table_rows,
        write_two_bodies,
    )

    out = made(options.out or Path("out/accuracy"))
    study = measure_two_bodies(options.target, options.full, say_progress)
    show_table("error against run time", table_heads(options.target), table_rows(study.lines, options.target))
    say(default_sentence(study.lines, options.target))
    write_study(out, write_two_bodies, study)
    say(study.recommendation)
    return 0


def _scene(options: argparse.Namespace) -> int:
    """Measure a scene; it is reduced to a run time of minutes unless --all-particles is given."""
    from granflow.studies.accuracy.scene import (
        KeptRuns,
        SceneTask,
        measure_scene,
        noise_sentence,
        reduced_counts,
        scene_heads,
        scene_recommendation,
        scene_rows,
        write_scene,
    )

    task = SceneTask(options.scene, tuple(options.overrides), options.until)
    reductions = [] if options.all_particles else reduced_counts(task.scene())
    if reductions:
        say(
            f"Reduced scene for a run time of minutes: {', '.join(reductions)}; --all-particles runs the "
            "full scene."
        )
    out = made(options.out or Path("out") / f"accuracy_{options.scene.stem}")
    kept = out / "accuracy_runs.json"
    try:
        study = measure_scene(
            task.with_overrides(*reductions), options.target, options.full, say_progress, kept=KeptRuns(kept)
        )
    except KeyboardInterrupt as stop:
        remedy = "repeat the command to continue"
        return print_error(f"stopped; the runs that have ended are in {kept}, {remedy}.", exit_code_of(stop))
    show_table(study.title, scene_heads(study), scene_rows(study))
    say(noise_sentence(study))
    write_study(out, write_scene, study)
    say(scene_recommendation(study))
    return 0


def add_accuracy(verbs: Any) -> None:
    """Add `granflow accuracy` and its arguments."""
    parser = add_verb(
        verbs, accuracy, "measure error against run time for every contact model, precision and time step"
    )
    add = parser.add_argument
    add("scene", metavar="SCENE", nargs="?", type=Path, help="scene to measure (default: binary collisions)")
    add_out(parser, "out/accuracy or out/accuracy_SCENE")
    add("--target", metavar="ERROR", type=float, default=0.01, help="target relative error (default: 0.01)")
    add("--full", action="store_true", help="more time steps, repetitions and seeds, and a finer reference")
    add(
        "--all-particles",
        action="store_true",
        help="run the scene with all its particles, which may take hours",
    )
    add("--until", metavar="T", type=simulated_time, help="stop the scene at this simulated time")
    add_overrides(parser, "override a value of the scene")


# compare


def compare(options: argparse.Namespace) -> int:
    """`granflow compare`: run the scene with each contact model; print the table and assess linear springs.
    With directories of runs, compare these instead.

    One subdirectory of the output directory per run, one page for all. Runs of the same comparison that have
    ended are not repeated, unless --overwrite is given. Raises GranflowError if the directory contains other
    runs, unless --overwrite is given. Returns 130 or 143 after a stop signal; the same command then continues
    the comparison.
    """
    runs = [path for path in options.paths if path.is_dir()]
    if runs:
        return compare_existing(options, runs)
    if len(options.paths) > 1:
        raise GranflowError(
            f"{options.paths[1]} is no directory of a run: give one scene file, or the directories of runs."
        )
    options.scene = options.paths[0]
    from granflow.studies.compare.runs import law_names

    laws = law_names(options.laws)
    scene = load_runnable(options)
    out = options.out or Path("out") / f"{scene.path.stem}_compare"
    from granflow.studies.compare.report import (
        PAGE,
        as_text,
        compare,
        differences_table,
        heads,
        notes_on,
        scatter_note,
        stage_note,
    )

    def prepare(directory: Path) -> None:
        prepare_output(directory, scene, options.overwrite)

    try:
        found = compare(
            scene,
            laws,
            out,
            options.arch,
            options.reference_velocity,
            options.until,
            options.full,
            say_progress,
            prepare,
            options.overwrite,
            options.seeds,
        )
    except KeyboardInterrupt as stop:
        remedy = "repeat the command to continue"
        return print_error(
            f"stopped; the runs that have ended are kept in {out}, {remedy}.", exit_code_of(stop)
        )
    show_table(scene.title, heads(found.runs, is_short=True), as_text(found.rows))
    for note in (stage_note(found), *notes_on(found)):
        say(note)
    if found.differences:
        table = differences_table(found.differences)
        show_table(f"Differences to {found.differences[0].first}", table.heads, table.rows)
    say(scatter_note(found))
    for assessment in found.assessments:
        say(f"{assessment.part} {assessment.conclusion.capitalize()}. {assessment.why}")
    say(f"Open {out / PAGE} in a browser, and {out / 'side_by_side.py'} in ParaView (File > Load State).")
    return 0


def compare_existing(options: argparse.Namespace, runs: Sequence[Path]) -> int:
    """Print the keys of scenes and the numbers of runs that differ; with --out, write all as CSV files."""
    from granflow.runs.comparison import compare_runs

    files = [path for path in options.paths if path not in runs]
    if files:
        raise GranflowError(
            f"{files[0]} is no directory of a run: give one scene file, or the directories of runs."
        )
    found = compare_runs(runs)
    if found.keys:
        show_table("Scene", ("key", *found.names), [(key, *values) for key, values in found.keys])
    else:
        say("The scenes are equal.")
    differing = [row for row in found.numbers if row.differs]
    shown = [row for row in differing if row.name not in found.of_stages]
    rows = []
    for row in shown:
        cells = [readable(value) if value == value else "–" for value in row.values]
        for index in range(1, len(cells)):
            share = row.relative(index)
            if share == share:
                cells[index] += f" ({100.0 * share:+.3g} %)"
        rows.append((row.name, row.unit, *cells))
    if rows:
        show_table(f"Differences to {found.names[0]}", ("quantity", "unit", *found.names), rows)
    equal = len(found.numbers) - len(differing)
    hidden = len(differing) - len(shown)
    means = f"; {numbered(hidden, 'number')} of single stages differ (all: --out DIR)" if hidden else ""
    say(f"{numbered(equal, 'number')} of {len(found.numbers)} are equal in all runs{means}.")
    for remark in found.remarks:
        say(remark)
    if options.out:
        say(f"Written to {' and '.join(map(str, found.write(options.out)))}.")
    return 0


def add_compare(verbs: Any) -> None:
    """Add `granflow compare` and its arguments."""
    summary = "run a scene with several contact models and compare the results, or compare runs that exist"
    parser = add_verb(verbs, compare, summary)
    add = parser.add_argument
    scene_or_runs = "scene file (YAML), or directories of at least two runs"
    add("paths", metavar="SCENE_OR_RUN", type=Path, nargs="+", help=scene_or_runs)
    add_overrides(parser, "override a value of the scene, such as --set particles.beads.count=500")
    add("--laws", default="zhou,linear,hertz", help=LAWS)
    add_out(parser, "out/SCENE_compare")
    add("--reference-velocity", metavar="V", type=quantity("velocity"), help=REFERENCE_VELOCITY)
    add("--until", metavar="T", type=simulated_time, help="stop each run at this simulated time")
    add("--full", action="store_true", help="use all particles (default: at most 4000)")
    add(
        "--seeds",
        metavar="N",
        type=count,
        default=1,
        help="runs of each contact model, with the seed of the scene and those after it: differences then "
        "have 95 %% confidence intervals (default: 1)",
    )
    add(
        "--overwrite",
        action="store_true",
        help="replace other runs in the same directory, and repeat those that have ended",
    )
    add_machine(parser)


LAWS = (
    "contact models, separated by commas (default: zhou,linear,hertz); linear is run twice: with a spring "
    "stiffness computed from the impact velocity of each contact, and from --reference-velocity"
)
REFERENCE_VELOCITY = (
    "impact velocity for which constant parameters are computed, such as the spring stiffness of the second "
    "linear run (default: a tenth of the largest expected impact velocity)"
)
"""Help texts of --laws and --reference-velocity."""

# stability


def stability(options: argparse.Namespace) -> int:
    """`granflow stability`: run all cases; return 1 if any of them is a defect.

    Writes a page, `stability.csv` and a heat map to the output directory.
    """
    from granflow.studies.stability.report import HEADS, PAGE, defects, headline, summary_rows
    from granflow.studies.stability.report import stability as study

    out = made(options.out or Path("out/stability"))
    outcomes, missing = study(
        out, options.full, lambda each: say(f"{each.row}, {each.column}: {each.assessment}", flush=True)
    )
    show_table("Stiff and extreme cases", HEADS, summary_rows(outcomes))
    defects_found = defects(outcomes)
    for line in filter(None, (headline(outcomes), *defects_found, missing)):
        say(line)
    say(f"Open {out / PAGE} in a browser; each case is a row of stability.csv in the same directory.")
    return 1 if defects_found else 0


def add_stability(verbs: Any) -> None:
    """Add `granflow stability` and its arguments."""
    summary = "run stiff and extreme cases, assess each, and measure the stability limit of the time step"
    parser = add_verb(verbs, stability, summary)
    add_out(parser, "out/stability")
    parser.add_argument(
        "--full",
        action="store_true",
        help="run all Young's moduli, particle radii and radius ratios (default: about half of them)",
    )


# sweep


def sweep(options: argparse.Namespace) -> int:
    """`granflow sweep`: carry out the runs of a sweep that have not ended, and write tables and a page.

    Returns 0 if all runs are done and meet their expectations, and all yield loci of the key `evaluate`
    exist, 1 otherwise, and 130 or 143 after a stop signal; the same command then continues the sweep.
    """
    from granflow.studies.run_process import from_working_directory
    from granflow.studies.sweep import SweepStopped, read_sweep, run_sweep
    from granflow.studies.sweep_table import warning_sentence
    from granflow.studies.yield_locus import remarks_of, shown_table

    study = read_sweep(options.file)
    out = options.out or Path("out") / study.name
    if options.dry_run:
        return show_points(study, out, options)
    if options.part is not None:
        return run_one_part(study, out, options)
    with deferred_to_event() as (stop, signals):
        try:
            table = run_sweep(study, out, workers_of(options), options.arch, stop, say_run, say_progress)
        except SweepStopped as error:
            return print_error(str(error), exit_code_of(signals[0]))
    if signals:
        remedy = "repeating the command continues it"
        return print_error(
            f"stopped; {out / 'sweep.csv'} has the completed runs, and {remedy}.", exit_code_of(signals[0])
        )
    statuses = [row.outcome.status for row in table.rows]
    show_table(
        numbered(len(statuses), "point"),
        ("status", "points"),
        [(s, str(statuses.count(s))) for s in dict.fromkeys(statuses)],
    )
    for reason in dict.fromkeys(row.outcome.reason for row in table.rows if row.outcome.reason):
        say(from_working_directory(reason, out))
    if warned := warning_sentence(table.rows):
        say(warned)
    if table.loci:
        heads, rows, _ = shown_table(table.loci)
        show_table("yield loci", heads, rows)
        for remark in remarks_of(table.loci):
            say(remark)
    say(f"Written to {out / 'sweep.csv'}; open {out / 'sweep.html'} in a browser.")
    return 0 if table.is_complete else 1


def run_one_part(study: "SweepFile", out: Path, options: argparse.Namespace) -> int:
    """Carry out one part of the runs of a sweep, which writes no tables; exit codes as of `sweep`."""
    from granflow.studies.run_process import DONE, from_working_directory
    from granflow.studies.sweep import Part, SweepStopped, run_part

    part = Part(*options.part)
    with deferred_to_event() as (stop, signals):
        try:
            outcomes = run_part(
                study, out, workers_of(options), part, options.arch, stop, say_run, say_progress
            )
        except SweepStopped as error:
            return print_error(str(error), exit_code_of(signals[0]))
    if signals:
        return print_error("stopped; repeating the command continues this part.", exit_code_of(signals[0]))
    for each in outcomes.values():
        if each.reason:
            say(from_working_directory(each.reason, out))
    done = sum(each.status == DONE for each in outcomes.values())
    say(
        f"Part {part.number} of {part.count}: {done} of {len(outcomes)} runs are done. When all parts have "
        f"ended, granflow sweep {options.file} --out {out} writes the tables and the page."
    )
    return 0 if done == len(outcomes) else 1


def show_points(study: "SweepFile", out: Path, options: argparse.Namespace) -> int:
    """Print the points of a sweep with the state and the estimated time of their runs, without a run."""
    from granflow.plan.explain import duration
    from granflow.studies.checked_run import RunSettings
    from granflow.studies.run_process import final_outcome
    from granflow.studies.sweep import STOP_FILE, Part, checked_points, runs_of, texts_of

    common = RunSettings(out / "runs", options.threads, options.arch, out / STOP_FILE)
    points = checked_points(study, common, announce=say_progress)
    texts = texts_of(study, points)
    runs = Part(*(options.part or (1, 1))).of(runs_of(points))
    rows = []
    left = []
    for run in runs:
        ended = final_outcome(run.directory)
        if ended is None:
            left.append(run.seconds)
        state = "to do" if ended is None else ended.status
        rows.append((texts[run.request.directory], state, duration(run.seconds)))
    show_table(f"{len(rows)} runs", ("run", "status", "estimated time"), rows)
    refused = [run for _, each in points for run in each if isinstance(run, str)]
    for reason in dict.fromkeys(refused):
        say(f"refused: {reason}")
    say(
        f"{len(left)} runs are to do, {len(runs) - len(left)} have ended, {len(refused)} are refused. "
        f"Estimated computing time of those to do: {duration(sum(left))}, without compilation, output "
        "and the start of processes (about 1 s for each run), with one thread of a usual processor; divide "
        "it by the number of simultaneous runs."
    )
    return 1 if refused else 0


def part_of_runs(text: str) -> tuple[int, int]:
    """The numbers I and N of --part I/N. Raises ArgumentTypeError unless 1 <= I <= N."""
    number, slash, total = text.partition("/")
    if slash and number.isdecimal() and total.isdecimal() and 1 <= int(number) <= int(total):
        return int(number), int(total)
    raise argparse.ArgumentTypeError(
        f"{text} is not a part; give the number of the part and the number of parts, such as 2/10"
    )


def say_run(progress: "Progress", event: str) -> None:
    """Print the progress, and the parameter values and status of a run that has ended."""
    say(f"{progress}{event and '; '}{event}", flush=True)


BATCH_SYSTEMS = ("slurm", "pbs", "lsf", "sge")
"""Batch systems that can run the workers."""


def workers_of(options: argparse.Namespace) -> "Workers":
    """The workers that the options select."""
    from granflow.studies.run_pool import Workers

    batch = next(((name, getattr(options, name)) for name in BATCH_SYSTEMS if getattr(options, name)), None)
    return Workers(options.jobs, options.threads, options.scheduler, options.scheduler_file, batch)


def add_sweep(verbs: Any) -> None:
    """Add `granflow sweep` and its arguments."""
    parser = add_verb(verbs, sweep, "run a scene for many parameter values; repeat the command to continue")
    parser.add_argument("file", metavar="SWEEP.yaml", type=Path, help="sweep file")
    add_out(parser, "out/SWEEP")
    add = parser.add_argument
    add(
        "--jobs",
        metavar="N",
        type=count,
        help="simultaneous runs (default: cores / threads, or those of the workers)",
    )
    add("--threads", metavar="T", type=thread_count, default=1, help="CPU threads of each run (default: 1)")
    add("--arch", choices=ARCHITECTURES, default="cpu", help="compute device or backend (default: cpu)")
    add_kernels(parser)
    add(
        "--part",
        metavar="I/N",
        type=part_of_runs,
        help="carry out part I of N of the runs, such as 2/10, for an array of jobs; the command without "
        "--part writes the tables when all parts have ended",
    )
    add("--dry-run", action="store_true", help="print the runs with their estimated times, and run none")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler, such as tcp://10.0.0.1:8786")
    where.add_argument(
        "--scheduler-file", metavar="FILE", type=Path, help="file with the address of a Dask scheduler"
    )
    for name in BATCH_SYSTEMS:
        text = f"start workers as {name.upper()} jobs with this profile"
        where.add_argument(f"--{name}", metavar="PROFILE.yaml", type=Path, help=text)


# calibrate


def calibrate(options: argparse.Namespace) -> int:
    """`granflow calibrate`: carry out the trials that have not ended; write best values, scenes and a page.

    Returns 0 if the best trial meets all targets within their tolerances, 1 otherwise, and 130 or 143 after a
    stop signal; the same command then continues the calibration.
    """
    from granflow.studies.calibration.calibrate import read_calibration, run_calibration

    study = read_calibration(options.file)
    out = options.out or Path("out") / study.name
    if options.dry_run:
        return show_trials(study, out, options.threads)
    with deferred_to_event() as (stop, signals):
        result = run_calibration(
            study, out, options.jobs, options.threads, stop, lambda line: say(line, flush=True)
        )
    if signals and isinstance(signals[0], KeyboardInterrupt):
        return print_error(
            "stopped; repeat the command to continue the calibration.", exit_code_of(signals[0])
        )
    if result is None:
        return print_error("no trial was completed, so there are no best values; see trials.csv.", 1)
    show_calibration(result)
    say(f"Written to {out / 'best.csv'}; open {out / 'calibration.html'} in a browser.")
    return 0 if result.is_met else 1


def show_trials(study: "CalibrationFile", out: Path, threads: int) -> int:
    """Print the estimated times of the scenes of a calibration and of all trials, without a run."""
    from granflow.plan.explain import duration
    from granflow.studies.calibration.calibrate import estimate_trials
    from granflow.studies.calibration.response import fewest_trials, sufficient_trials

    found = estimate_trials(study, out, threads)
    rows = [(name, *map(duration, seconds)) for name, seconds in found.scenes.items()]
    show_table("One trial", ("scene", "estimated time", "shortest", "longest"), rows)
    count = study.content.search.trials
    left = max(count - found.ended, 0)
    seconds = left * sum(middle for middle, _, _ in found.scenes.values())
    say(
        f"{left} of {count} trials are to do. Estimated computing time: {duration(seconds)}, without "
        "compilation and output, with one thread of a usual processor; divide it by the number of "
        "simultaneous trials. Trials that are stopped early take less."
    )
    parameters = len(study.content.parameters)
    enough = sufficient_trials(parameters)
    trials = "1 trial is" if count == 1 else f"{count} trials are"
    if count < fewest_trials(parameters):
        say(f"{trials} too few to identify any parameter: set search.trials to {enough} or more.")
    elif count < enough:
        say(f"{trials} few to identify the parameters: set search.trials to {enough} or more.")
    return 0


def show_calibration(result: "CalibrationResult") -> None:
    """Print best values, targets, and remarks on parameters, noise and conflicts of targets."""
    rows = [(each.name, *each.shown) for each in result.parameters]
    show_table(
        f"Best values, loss {result.loss:.4g}",
        ("", "best trial", "optimum of the fit", "standard deviation"),
        rows,
    )
    targets = [(each.name, *each.shown, f"{each.deviation:.2g}") for each in result.targets]
    show_table("Targets", ("", "measured", "simulated", "deviation / tolerance"), targets)
    for sentence in result.remarks:
        say(sentence)


def add_calibrate(verbs: Any) -> None:
    """Add `granflow calibrate` and its arguments."""
    summary = "determine parameters of scenes from measured targets; repeat the command to continue"
    parser = add_verb(verbs, calibrate, summary)
    parser.add_argument("file", metavar="CALIBRATION.yaml", type=Path, help="calibration file")
    add_out(parser, "out/CALIBRATION")
    jobs = "simultaneous trials (default: cores / threads)"
    parser.add_argument("--jobs", metavar="N", type=count, help=jobs)
    threads = "CPU threads of each run (default: 1)"
    parser.add_argument("--threads", metavar="T", type=thread_count, default=1, help=threads)
    dry_run = "check the scenes at the ends of the parameters, print their estimated times, and run none"
    parser.add_argument("--dry-run", action="store_true", help=dry_run)
