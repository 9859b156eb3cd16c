"""Runs a scene of `rank_scenes` and writes its last state as npz: alone, or on the ranks of mpirun.

python rank_runs.py SCENE FILE alone|small|failing|failing_root|refused

small: with arrays that must grow; failing: with a fault in all ranks but the root; failing_root: in the root;
refused: an error of the root outside of a command, while the files of its run in the folder FILE are open
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
from granflow.parallel import rank_engine, rank_stepper  # noqa: E402
from granflow.parallel.communicator import Communicator  # noqa: E402
from granflow.parallel.rank_engine import RankEngine, controlling, serve  # noqa: E402
from granflow.plan import build, plan  # noqa: E402
from granflow.plan.build import plan_for  # noqa: E402
from granflow.simulation import Simulation  # noqa: E402


def main(name, path, kind):
    scene = SCENES[name]()
    if kind == "alone":
        return save(path, Simulation(scene, threads=1))
    if kind == "small":
        plan.MIN_PARTICLES = plan.MIN_LIST_ENTRIES = 64
        plan.neighbors_per_particle = lambda _count, _skin: 0.5
        build.BALANCE = 0.1
        build.GHOST_LAYERS = 0.0
    rank_stepper.MIGRATION_INTERVAL = 2  # every other rebuild keeps the particles
    communicator = Communicator()
    FaultyEngine.in_root = kind == "failing_root"
    rank_engine.RankEngine = engine = FaultyEngine if kind.startswith("failing") else RankEngine
    if not communicator.is_root:
        return serve(
            communicator,
            lambda: engine(plan_for(scene), start("cpu", scene.run.precision, 1), communicator),
        )
    with controlling(communicator):
        if kind == "refused":
            simulation = Simulation(scene, threads=1, out=path, communicator=communicator)
            simulation.step(10)
            simulation.particles.velocity = 0.0
        save(path, Simulation(scene, threads=1, communicator=communicator))


def save(path, simulation):
    """Run to the end and write its state, and on ranks how often arrays have grown."""
    simulation.run()
    engine = simulation.engine
    growths = {"growths": np.array(engine.timing.growth_count)} if isinstance(engine, RankEngine) else {}
    np.savez(path, **arrays_of(simulation), **growths)
    simulation.free()


class FaultyEngine(RankEngine):
    """An engine with a fault within a command, in the root or in all other ranks."""

    def advance(self, steps):
        with self.communicator.commanding("advance", (steps,)):
            if self.communicator.is_root == self.in_root:
                raise ArithmeticError(f"a fault of this test at {time.time()} s")  # since 1970
            return Engine.advance(self, steps)


if __name__ == "__main__":
    main(*sys.argv[1:])
