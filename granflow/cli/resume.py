"""`granflow resume`: continues a run that was stopped or killed, or extends a completed one."""

import argparse
import logging
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granflow.cli.arguments import add_allow_long, add_machine, add_mpi, simulated_time, thread_count
from granflow.cli.messages import exit_code_of, print_error, say, say_checked, show_result, warned
from granflow.cli.signals import deferred_to
from granflow.errors import GranflowError
from granflow.visible_text import VisibleFormatter

if TYPE_CHECKING:
    from granflow.io.checkpoint import Checkpoint
    from granflow.load import Scene
    from granflow.parallel.communicator import Communicator
    from granflow.plan.plan import Plan
    from granflow.simulation import Simulation

EXIT_EXPECTATIONS_FAILED = 1
"""Exit code of a complete run with an expectation that is not satisfied."""

RESULT_SUFFIXES = (".vtu", ".pvtu", ".csv", ".npz")
"""File types of results that take computing time."""
SCENE = "scene_as_run.yaml"
"""Name of the resolved scene in the output directory."""

CHANGES = """\
These keys may change, with --set or in scene_as_run.yaml; a change of any other key is an error:
  output.interval, .timeseries_interval, .particles, .frames_per_rank, .contacts, .walls, .checkpoint
  run.duration; duration, kinetic_energy_below, until, min_duration and max_duration of the current stage and later
    ones, or of the last stage of a completed run; stages added at the end
  stages, appears_at and vanishes_at of walls: opening a gate
  motion of walls, if the position remains continuous: end a motion with end: and add another with start:
  friction and rolling_friction of pairs, if both the old and the new value are above 0
  numerics.max_overlap, title, description, expect
"""
"""End of the help text; `granflow.scene.differences.ALLOWED_CHANGES` defines the keys."""


def resume(options: argparse.Namespace) -> int:
    """`granflow resume`: continue from the newest intact checkpoint, bit-identical to an uninterrupted run.

    Raises GranflowError if the directory does not exist, is locked by another run, contains no usable checkpoint, or if
    the scene has changes that are not permitted.
    """
    out: Path = options.directory
    if not out.is_dir():
        raise GranflowError(f"{out}: no such directory; give the directory of a run.")
    from granflow.cli.ranks import on_ranks
    from granflow.parallel.launch import refuse_without_mpi_flag

    if options.mpi:
        return on_ranks(options, partial(_resume, options, out), partial(_resumed_plan, options))
    refuse_without_mpi_flag()
    return _resume(options, out)


def _resume(options: argparse.Namespace, out: Path, communicator: "Communicator | None" = None) -> int:
    """Resume in the locked directory: no other process can continue or replace the run at the same time."""
    from granflow.io.lock import locked

    with locked(out):
        return _resume_locked(options, out, communicator)


def _resume_locked(options: argparse.Namespace, out: Path, communicator: "Communicator | None") -> int:
    """Resume, on the ranks of the communicator if there is one.

    Raises GranflowError if rows of the time series are missing, unless --allow-changes is given.
    """
    from granflow.simulation import Simulation

    printed: list[str] = []
    checkpoint = checkpoint_to_resume(out, options.from_start, printed, communicator is not None)
    scene = scene_to_resume(options, checkpoint)
    simulation = Simulation(
        scene, arch=options.arch, threads=options.threads, out=out, progress=True, resume=checkpoint,
        allow_changes=options.allow_changes, allow_long=options.allow_long, overwrite=True, communicator=communicator,
    )  # fmt: skip
    if not (simulation.observers.rows_intact or options.allow_changes):
        raise GranflowError(
            f"{out / 'timeseries.csv'} lacks rows that were written before the checkpoint: restore the file, or "
            "continue with the remaining rows with --allow-changes."
        )
    if checkpoint:
        say_start(simulation, scene, checkpoint, options.until)
    return run_to_end(simulation, scene, out, options.until, printed)


def say_start(simulation: "Simulation", scene: "Scene", checkpoint: "Checkpoint", until: float | None) -> None:
    """Print the checkpoint and its time, and whether no step is left; `until`: end of the run [s] or None.

    Raises GranflowError if `until` is before the checkpoint, or after the end of a complete run.
    """
    time, step = simulation.time, simulation.time_step
    if until is not None and until < time - step:
        raise GranflowError(
            f"--until is {until:.6g} s, but {checkpoint.path} is at {time:.6g} s: give a later time, or omit --until."
        )
    if until is not None and until > time + step and simulation.is_complete:
        raise GranflowError(
            f"--until is {until:.6g} s, but the run is complete at {time:.6g} s: {extension(scene, checkpoint, until)}."
        )
    say(f"Continues from {checkpoint.path} at {time:.6g} s.")
    if simulation.is_complete:
        longer = extension(scene, checkpoint, float(f"{2.0 * time:.2g}"))
        say(f"The run is complete, so no step is taken. To continue it, {longer}.")
    elif until is not None and until <= time + 0.5 * step:
        say(f"The run is at --until {until:.6g} s, so no step is taken.")


def extension(scene: "Scene", checkpoint: "Checkpoint", until: float) -> str:
    """Instruction that extends a complete run to the time `until` [s]."""
    if not scene.stages:
        return f"extend it with --set run.duration={until:.6g}s"
    index, stage = len(scene.stages) - 1, scene.stages[-1]
    if stage.duration is None:  # one of its conditions is satisfied
        return f"add a stage after {stage.name} in {checkpoint.path.with_name(SCENE)}"
    began = checkpoint.saved["stage_progress"]["stage_times"][stage.name][0]
    return f"extend it with --set stages.{index}.duration={until - began:.6g}s"


def checkpoint_to_resume(
    out: Path, from_start: bool, printed: list[str], on_ranks: bool = False
) -> "Checkpoint | None":
    """Return the newest intact checkpoint, or None to run from the start.

    Without `from_start`, a run without a checkpoint starts from the beginning only if the directory has no results;
    otherwise raises GranflowError. `on_ranks`: each rank reads its part of the particles later. Damaged checkpoints
    and a restored previous run cause warnings on stderr, which are added to `printed`.
    """
    from granflow.io.checkpoint import newest_checkpoint
    from granflow.runs.previous import restore_previous_run, results_in

    printed += warned(restore_previous_run(out))
    if from_start:
        return None
    checkpoint, skipped = newest_checkpoint(out, "root" if on_ranks else "all")
    printed += warned(skipped)
    results = [path for path in results_in(out) if path.suffix in RESULT_SUFFIXES]
    if checkpoint is None and results and (out / SCENE).exists():
        raise GranflowError(
            f"{out} contains no usable checkpoint, but {len(results)} result files: to replace them and run the scene "
            f"from the start, use granflow resume {out} --from-start."
        )
    if checkpoint is None and (out / SCENE).exists():
        printed += warned([f"{out} contains neither a checkpoint nor results: the run begins from the start."])
    return checkpoint


def _resumed_plan(options: argparse.Namespace) -> "tuple[Scene, Plan]":
    """The scene and the plan of the run that the root resumes, on another rank."""
    from granflow.io.checkpoint import newest_checkpoint
    from granflow.plan.build import plan_for
    from granflow.runs.python_changes import changed_plan

    checkpoint = None if options.from_start else newest_checkpoint(options.directory, "header")[0]
    scene = scene_to_resume(options, checkpoint)
    return scene, plan_for(scene) if checkpoint is None else changed_plan(plan_for(scene), checkpoint)


def scene_to_resume(options: argparse.Namespace, checkpoint: "Checkpoint | None") -> "Scene":
    """Return the resolved scene, or that of the checkpoint if the file is missing, with the overrides applied.

    Raises GranflowError if neither exists.
    """
    from granflow.load import load, scene_of

    path = options.directory / SCENE
    precision = [f"run.precision={options.precision}"] if options.precision else []
    if path.exists():
        return load(path, [*options.overrides, *precision])
    if checkpoint is None:
        raise GranflowError(f"{options.directory} contains no run: neither a usable checkpoint nor {SCENE}.")
    return scene_of(checkpoint.scene, str(checkpoint.path), [*options.overrides, *precision])


def run_to_end(
    simulation: "Simulation", scene: "Scene", out: Path, until: float | None, printed: Sequence[str] = ()
) -> int:
    """Print the number of warnings and the warnings, run with signal handling, print numbers; return the exit code.

    `until`: simulated time at which the run ends [s], or None. `printed`: warnings on stderr so far, which run.log and
    result.json contain too. Returns 1 if an expectation is not satisfied, 130 or 143
    after a stop signal.
    """
    say_checked(scene.path, simulation.warnings)
    simulation.warnings.extend(printed)
    try:
        with deferred_to(simulation.request_stop), warnings_shown(simulation.warnings):
            result = simulation.run(until=until, within_stages=True)
            result = simulation.close() or result
    except KeyboardInterrupt as stop:
        return print_error(stopped_where(simulation, out), exit_code_of(stop))
    show_result(scene.title, result, out)
    if until is not None and simulation.is_complete and simulation.time < until - simulation.time_step:
        say(f"The last stage ended at {simulation.time:.6g} s, before --until {until:.6g} s.")
    if scene.expect and not result.expectations:
        say(f"Expectations are not evaluated: --until ended the run at {simulation.time:.6g} s.")
    return 0 if all(met for _, met in result.expectations) else EXIT_EXPECTATIONS_FAILED


def stopped_where(simulation: "Simulation", out: Path) -> str:
    """Return a sentence with the time [s] at which a run stopped and that of its last checkpoint."""
    at, saved = f"stopped at {simulation.time:.6g} s", simulation.files.checkpoint_time
    if saved == simulation.time:
        return f"{at}; granflow resume {out} continues. {out} contains the run up to this time."
    if saved is None:
        return f"{at}, before the first checkpoint."
    return f"{at}; the last checkpoint is at {saved:.6g} s, and granflow resume {out} continues from there."


@contextmanager
def warnings_shown(shown: Collection[str]) -> Iterator[None]:
    """In the block, print the warnings of the log to stderr, except those in `shown`."""
    logger, handler = logging.getLogger("granflow"), logging.StreamHandler()
    handler.setLevel(logging.WARNING)
    handler.addFilter(lambda record: record.levelno == logging.WARNING and record.getMessage() not in shown)
    handler.setFormatter(VisibleFormatter("granflow: warning: %(message)s"))
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


def add_resume(verbs: Any) -> None:
    """Add `granflow resume` and its arguments; the help text ends with the keys that may change."""
    summary = "continue a stopped or killed run, bit-identical to an uninterrupted one, or extend a completed run"
    parser = verbs.add_parser(
        "resume", help=summary, description=summary[0].upper() + summary[1:] + ".", epilog=CHANGES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("directory", metavar="DIR", type=Path, help="directory of the run")
    parser.add_argument(
        "--set", dest="overrides", metavar="KEY.PATH=VALUE", action="append", default=[],
        help="override a value that may change, such as --set walls.gate.vanishes_at=1.2s; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--allow-changes", action="store_true", help="continue even if the scene or the time series has changed"
    )
    parser.add_argument(
        "--from-start", action="store_true",
        help="run the scene from the start, without a checkpoint; replaces the results",
    )  # fmt: skip
    parser.add_argument(
        "--until", metavar="T", type=simulated_time,
        help="stop at this simulated time, such as 0.2s, not before that of the checkpoint",
    )  # fmt: skip
    parser.add_argument(
        "--threads", metavar="N", type=thread_count, help="CPU threads (default: cores available to this process)"
    )
    add_mpi(parser)
    add_allow_long(parser)
    add_machine(parser)
    parser.set_defaults(verb=resume)
