"""`--mpi` of `granflow run` and `resume`: the root runs the scene, the others compute their part of each step."""

import argparse
import logging
import os
from collections.abc import Callable
from typing import TYPE_CHECKING

from granflow.cli.signals import pass_stops_to
from granflow.io.machine import allowed_cores

if TYPE_CHECKING:
    from granflow.load import Scene
    from granflow.parallel.communicator import Communicator
    from granflow.parallel.rank_engine import RankEngine
    from granflow.plan.plan import Plan


def on_ranks(
    options: argparse.Namespace,
    run: "Callable[[Communicator], int]",
    scene_and_plan: "Callable[[], tuple[Scene, Plan]]",
) -> int:
    """Run a scene on all ranks and return the exit code; 0 on all but the root.

    run:             what the root does, with the communicator
    scene_and_plan:  what the others read when the root has a plan

    Raises GranflowError without mpi4py, and on the root the exceptions of `run`.
    """
    from granflow.parallel.communicator import Communicator
    from granflow.parallel.serve import controlling, serve

    communicator = Communicator()
    options.threads = options.threads or threads_per_rank(communicator)
    if communicator.is_root:
        with controlling(communicator):
            return run(communicator)
    stop = RankStop()
    pass_stops_to(stop.request)
    logging.getLogger("granflow").setLevel(logging.CRITICAL)
    serve(communicator, lambda: stop.applied_to(_rank_engine(options, communicator, *scene_and_plan())))
    return 0


class RankStop:
    """A stop signal that a rank other than the root has received; in the next step all ranks agree on it."""

    def __init__(self) -> None:
        self._number = 0
        self._engine: RankEngine | None = None

    def request(self, number: int) -> None:
        """Request the stop of the run; `number`: of the signal."""
        self._number = number
        if self._engine is not None:
            self._engine.stepper.interrupted = number

    def applied_to(self, engine: "RankEngine") -> "RankEngine":
        """The engine of this rank, with the request that came before it."""
        self._engine, engine.stepper.interrupted = engine, self._number
        return engine


def threads_per_rank(communicator: "Communicator") -> int:
    """CPU threads of each rank: its cores if mpirun has bound it to some, otherwise a part of those of the machine."""
    cores, ranks = allowed_cores(), communicator.local_size()
    return max(cores // ranks if cores == os.cpu_count() else cores, 1)


def _rank_engine(
    options: argparse.Namespace, communicator: "Communicator", scene: "Scene", plan: "Plan"
) -> "RankEngine":
    """The engine of a rank that is not the root."""
    from granflow.engine.state_cache import start
    from granflow.parallel.rank_engine import RankEngine

    return RankEngine(plan, start("cpu", scene.run.precision, options.threads), communicator, scene)
