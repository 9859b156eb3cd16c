"""Runs a scene of `rank_scenes` and writes its last state as npz: alone, or on the ranks of mpirun.

python rank_runs.py SCENE FILE alone|ranks|small|failing|failing_root|failing_start|refused

small: with arrays that must grow; failing: with a fault in all ranks but the root; failing_root: in the root;
failing_start: at the start of all ranks but the root; refused: an error of the root outside of a command, while
the files of its run in the folder FILE are open
"""

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from rank_scenes import SCENES  # noqa: E402
from run_arrays import arrays_of  # noqa: E402

from granflow.engine.backend import start  # noqa: E402
from granflow.engine.engine import Engine  # noqa: E402
from granflow.parallel import exchange, rank_engine  # noqa: E402
from granflow.parallel import rank_stepper as rank_rebuild
from granflow.parallel.communicator import Communicator  # noqa: E402
from granflow.parallel.exchange import Decomposition  # noqa: E402
from granflow.parallel.rank_engine import (  # noqa: E402
    RankEngine,  # noqa: E402
    controlling,
    serve,
)
from granflow.plan import build as ranks  # noqa: E402
from granflow.plan import plan as plan_module  # noqa: E402
from granflow.plan.build import plan_for  # noqa: E402
from granflow.simulation import Simulation  # noqa: E402

FAULT = "a fault of this test at {} s"
"""Message of a fault, with its time since 1970."""


def main(name, path, kind):
    scene = SCENES[name]()
    if kind == "alone":
        return save(path, Simulation(scene, threads=1))
    if kind == "small":
        plan_module.MIN_PARTICLES = plan_module.MIN_LIST_ENTRIES = 64
        plan_module.neighbors_per_particle = lambda _count, _skin: 0.5
        ranks.BALANCE = 0.1
        ranks.GHOST_LAYERS = 0.0
    rank_rebuild.MIGRATION_INTERVAL = 2  # every other rebuild keeps the particles
    communicator = Communicator()
    Recorded.rank_here = communicator.rank
    exchange.Decomposition = Recorded
    rank_engine.RankEngine = engine = faulty_engine(kind) if kind.startswith("failing") else ObservedEngine
    if communicator.is_root:
        with controlling(communicator):
            if kind == "refused":
                simulation = Simulation(scene, threads=1, out=path, communicator=communicator)
                simulation.step(10)
                simulation.particles.velocity = 0.0
            save(path, Simulation(scene, threads=1, communicator=communicator))
    else:
        serve(
            communicator,
            lambda: engine(plan_for(scene), start("cpu", scene.run.precision, 1), communicator),
        )


def faulty_engine(kind):
    """The class of an engine with a fault at the start or within a command, in the root or in all other
    ranks."""

    class FaultyEngine(RankEngine):
        def __init__(self, plan, backend, communicator):
            if kind == "failing_start" and not communicator.is_root:
                raise ArithmeticError(FAULT.format(time.time()))
            super().__init__(plan, backend, communicator)

        def advance(self, steps):
            with self.communicator.commanding("advance", (steps,)):
                if self.communicator.is_root == (kind == "failing_root"):
                    raise ArithmeticError(FAULT.format(time.time()))
                return Engine.advance(self, steps)

    return FaultyEngine


def save(path, simulation):
    """Run to the end and write its state, and on observed ranks what they have exchanged."""
    simulation.run()
    engine = simulation.engine
    arrays = arrays_of(simulation)
    if isinstance(engine, ObservedEngine):
        arrays |= {
            "growths": np.array(engine.timing.growth_count),
            "migrations": engine.migrations(),
        }
    np.savez(path, **arrays)
    simulation.free()


class ObservedEngine(RankEngine):
    """An engine whose root also returns the numbers of migrations."""

    def migrations(self):
        with self.communicator.commanding("migrations"):
            return np.array(self.communicator.to_root(sum(Recorded.sent[1:])))


class Recorded(Decomposition):
    """A decomposition that records how many particles each rebuild sends to each rank, 0 for the own rank."""

    sent = []

    def owners(self, position):
        found = super().owners(position)
        counts = np.bincount(found, minlength=self.rank.max() + 1)
        counts[Recorded.rank_here] = 0
        Recorded.sent.append(counts)
        return found


if __name__ == "__main__":
    main(*sys.argv[1:])
