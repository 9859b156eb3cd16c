"""The verb `resume`: go on with a run that was stopped, killed, or is to be longer than it was."""

import argparse
import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granflow.cli.arguments import add_allow_long, add_machine, quantity, thread_count
from granflow.cli.messages import Terminated, complain, exit_code_of, show_result, sigterm_as_exception, warn
from granflow.errors import GranflowError

if TYPE_CHECKING:
    from granflow.observe import Checkpoint
    from granflow.scene import Scene
    from granflow.simulation import Simulation

EXIT_UNMET = 1
SCENE = "scene_as_run.yaml"
CHANGES = """\
These may change with --set, or in scene_as_run.yaml; anything else is refused by name:
  output.interval, .timeseries_interval, .particles, .contacts, .walls, .checkpoint
  run.duration; duration, kinetic_energy_below and at_most of stages that are not over; stages added at the end
  stages, appears_at and vanishes_at of walls: opening a gate
  motion of walls, if no wall jumps: end the one with end: and add another with start:
  friction and rolling_friction of pairs, where there was some and stays some
  numerics.overlap_limit, title, description, expect
"""


def resume(options: argparse.Namespace) -> int:
    """`granflow resume`: go on from the newest checkpoint that is whole, to the bits of a run never stopped."""
    out: Path = options.directory
    if not out.is_dir():
        raise GranflowError(f"{out}: there is no such directory; name one that granflow run has written.")
    from granflow.observe import locked, newest_checkpoint
    from granflow.simulation import Simulation

    with locked(out):
        checkpoint, passed_over = newest_checkpoint(out)
    warn(passed_over)
    scene = scene_to_go_on_with(options, checkpoint)
    warn([] if checkpoint else [f"{out} holds no checkpoint that can be used: the run begins anew."])
    with sigterm_as_exception():
        simulation = Simulation(
            scene, arch=options.arch, threads=options.threads, out=out, progress=True, resume=checkpoint,
            anyway=options.anyway, allow_long=options.allow_long,
        )  # fmt: skip
    if not (simulation.rows_are_there or options.anyway):
        raise GranflowError(
            f"{out / 'timeseries.csv'} lacks rows that had been written when the checkpoint was: put the file back, or "
            "go on with what is left of it with --anyway."
        )
    if checkpoint:
        print(f"Goes on from {checkpoint.path} at {checkpoint.time:.6g} s.")
    return run_to_the_end(simulation, scene, out, options.until)


def scene_to_go_on_with(options: argparse.Namespace, checkpoint: "Checkpoint | None") -> "Scene":
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


def run_to_the_end(simulation: "Simulation", scene: "Scene", out: Path, until: float | None) -> int:
    """Run with signals heard, show the numbers and give the exit code."""
    try:
        with told_to_stop(simulation), warnings_shown():
            result = simulation.run(until=until)
    except KeyboardInterrupt as stop:
        at = f"stopped at {simulation.time:.6g} s"
        return complain(f"{at}; granflow resume {out} goes on. {out} holds the run up to there.", exit_code_of(stop))
    show_result(scene.title, result, out)
    if scene.expect and not result.expectations:
        print(f"Expectations are left out: --until ended the run at {simulation.time:.6g} s.")
    return 0 if all(met for _, met in result.expectations) else EXIT_UNMET


@contextmanager
def told_to_stop(simulation: "Simulation") -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end the run after its present step, with a checkpoint; the second one ends it at once."""

    def stop(number: int, *_: Any) -> None:
        error = Terminated() if number == signal.SIGTERM else KeyboardInterrupt()
        for each in before:
            signal.signal(each, at_once)
        simulation.ask_to_stop(error)

    def at_once(number: int, *_: Any) -> None:
        raise Terminated if number == signal.SIGTERM else KeyboardInterrupt

    heard = [each for each in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(each) != signal.SIG_IGN]
    before = {each: signal.signal(each, stop) for each in heard}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


@contextmanager
def warnings_shown() -> Iterator[None]:
    """Show on stderr what the log says of checkpoints that could not be written."""
    logger, handler = logging.getLogger("granflow.checkpoint"), logging.StreamHandler()
    handler.setFormatter(logging.Formatter("granflow: warning: %(message)s"))
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
    parser.add_argument("--anyway", action="store_true", help="go on though the scene, or the time series, is another")
    parser.add_argument("--until", metavar="T", type=quantity("time"), help="stop at this simulated time, such as 0.2s")
    parser.add_argument("--threads", metavar="N", type=thread_count, help="CPU threads (all)")
    add_allow_long(parser)
    add_machine(parser)
    parser.set_defaults(verb=resume)
