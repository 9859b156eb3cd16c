"""The verb `resume`: go on with a run that was stopped, killed, or is to be longer than it was."""

import argparse
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granflow.cli.arguments import add_allow_long, add_machine, simulated_time, thread_count
from granflow.cli.messages import exit_code_of, print_error, say, show_result, warn
from granflow.cli.signals import deferred_to
from granflow.errors import GranflowError
from granflow.visible_text import VisibleFormatter

if TYPE_CHECKING:
    from granflow.observe import Checkpoint
    from granflow.scene import Scene
    from granflow.simulation import Simulation

EXIT_EXPECTATIONS_FAILED = 1
RESULT_SUFFIXES = (".vtu", ".csv", ".npz")
"""Of results that take computing time."""
SCENE = "scene_as_run.yaml"
CHANGES = """\
These may change with --set, or in scene_as_run.yaml; anything else is refused by name:
  output.interval, .timeseries_interval, .particles, .contacts, .walls, .checkpoint
  run.duration; duration, kinetic_energy_below and max_duration of stages that are not over; stages added at the end
  stages, appears_at and vanishes_at of walls: opening a gate
  motion of walls, if no wall jumps: end the one with end: and add another with start:
  friction and rolling_friction of pairs, where there was some and stays some
  numerics.max_overlap, title, description, expect
"""


def resume(options: argparse.Namespace) -> int:
    """`granflow resume`: go on from the newest checkpoint that is whole, to the bits of a run never stopped."""
    out: Path = options.directory
    if not out.is_dir():
        raise GranflowError(f"{out}: there is no such directory; name one that granflow run has written.")
    from granflow.observe import locked

    with locked(out):
        return _resume(options, out)


def _resume(options: argparse.Namespace, out: Path) -> int:
    """Resume in a directory that stays locked: no other process can continue or replace the run meanwhile."""
    from granflow.simulation import Simulation

    checkpoint = checkpoint_to_resume(out, options.from_start)
    scene = scene_to_resume(options, checkpoint)
    simulation = Simulation(
        scene, arch=options.arch, threads=options.threads, out=out, progress=True, resume=checkpoint,
        allow_changes=options.allow_changes, allow_long=options.allow_long,
    )  # fmt: skip
    if not (simulation.rows_intact or options.allow_changes):
        raise GranflowError(
            f"{out / 'timeseries.csv'} lacks rows that had been written when the checkpoint was: put the file back, or "
            "go on with what is left of it with --allow-changes."
        )
    if checkpoint:
        say(f"Goes on from {checkpoint.path} at {checkpoint.time:.6g} s.")
    return run_to_end(simulation, scene, out, options.until)


def checkpoint_to_resume(out: Path, from_start: bool) -> "Checkpoint | None":
    """The newest checkpoint that is whole; None to begin from the start.

    Without `from_start` the run begins from the start only where there are no results yet. Raises GranflowError where
    there are.
    """
    from granflow.observe import newest_checkpoint, restore_previous_run, results_in

    warn(restore_previous_run(out))
    if from_start:
        return None
    checkpoint, skipped = newest_checkpoint(out)
    warn(skipped)
    results = [path for path in results_in(out) if path.suffix in RESULT_SUFFIXES]
    if checkpoint is None and results and (out / SCENE).exists():
        raise GranflowError(
            f"{out} holds no checkpoint that can be used, but {len(results)} files of results: to replace them and "
            f"run the scene from the start, granflow resume {out} --from-start."
        )
    if checkpoint is None and (out / SCENE).exists():
        warn([f"{out} holds neither a checkpoint nor results: the run begins from the start."])
    return checkpoint


def scene_to_resume(options: argparse.Namespace, checkpoint: "Checkpoint | None") -> "Scene":
    """The scene as run, or that of the checkpoint where it is gone, with the changes of the command line."""
    from granflow.scene import load
    from granflow.scene.reader import scene_of

    path = options.directory / SCENE
    precision = [f"run.precision={options.precision}"] if options.precision else []
    if path.exists():
        return load(path, [*options.overrides, *precision])
    if checkpoint is None:
        raise GranflowError(f"{options.directory} holds no run: neither a checkpoint that can be used nor {SCENE}.")
    return scene_of(checkpoint.scene, str(checkpoint.path), [*options.overrides, *precision])


def run_to_end(simulation: "Simulation", scene: "Scene", out: Path, until: float | None) -> int:
    """Run with signals heard, show the numbers and give the exit code."""
    try:
        with deferred_to(simulation.request_stop), warnings_shown():
            result = simulation.run(until=until)
    except KeyboardInterrupt as stop:
        return print_error(stopped_where(simulation, out), exit_code_of(stop))
    show_result(scene.title, result, out)
    if scene.expect and not result.expectations:
        say(f"Expectations are left out: --until ended the run at {simulation.time:.6g} s.")
    return 0 if all(met for _, met in result.expectations) else EXIT_EXPECTATIONS_FAILED


def stopped_where(simulation: "Simulation", out: Path) -> str:
    """Where a run stopped, and from which checkpoint it can be resumed."""
    at, saved = f"stopped at {simulation.time:.6g} s", simulation.checkpoint_time
    if saved == simulation.time:
        return f"{at}; granflow resume {out} goes on. {out} holds the run up to there."
    if saved is None:
        return f"{at}, before the first checkpoint."
    return f"{at}; the last checkpoint is at {saved:.6g} s, and granflow resume {out} continues from there."


@contextmanager
def warnings_shown() -> Iterator[None]:
    """Show on stderr what the log says of checkpoints that could not be written."""
    logger, handler = logging.getLogger("granflow.checkpoint"), logging.StreamHandler()
    handler.setFormatter(VisibleFormatter("granflow: warning: %(message)s"))
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


def add_resume(verbs: Any) -> None:
    """`granflow resume` and its arguments."""
    summary = "go on with a run that was stopped or killed, or is to be longer"
    parser = verbs.add_parser(
        "resume", help=summary, description=summary[0].upper() + summary[1:] + ".", epilog=CHANGES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("directory", metavar="DIR", type=Path, help="the directory of the run")
    parser.add_argument(
        "--set", dest="overrides", metavar="KEY.PATH=VALUE", action="append", default=[],
        help="change what may change, such as --set walls.gate.vanishes_at=1.2s; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--allow-changes", action="store_true", help="go on though the scene, or the time series, is another"
    )
    parser.add_argument(
        "--from-start", action="store_true",
        help="run the scene from the start, without a checkpoint; the results so far are replaced",
    )  # fmt: skip
    parser.add_argument("--until", metavar="T", type=simulated_time, help="stop at this simulated time, such as 0.2s")
    parser.add_argument(
        "--threads", metavar="N", type=thread_count, help="CPU threads (cores that this process may use)"
    )
    add_allow_long(parser)
    add_machine(parser)
    parser.set_defaults(verb=resume)
