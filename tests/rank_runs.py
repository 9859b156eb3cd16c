"""Runs the scene of two particles of `rank_scenes` on the ranks of mpirun until it fails.

python rank_runs.py failing|failing_root|refused FOLDER

failing: a fault in all ranks but the root; failing_root: in the root; refused: an error of the root outside of a
command, while the files of its run in the folder are open
"""

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from rank_scenes import pair  # noqa: E402

from granflow.engine.backend import start  # noqa: E402
from granflow.engine.engine import Engine  # noqa: E402
from granflow.parallel import rank_engine  # noqa: E402
from granflow.parallel.communicator import Communicator  # noqa: E402
from granflow.parallel.rank_engine import RankEngine, controlling, serve  # noqa: E402
from granflow.plan.build import plan_for  # noqa: E402
from granflow.simulation import Simulation  # noqa: E402


class FaultyEngine(RankEngine):
    """An engine with a fault within its first command, before kernels are compiled, in the root or in all other
    ranks."""

    def insert(self, *arguments):
        with self.communicator.commanding("insert", arguments):
            if self.communicator.is_root == self.in_root:
                raise ArithmeticError(f"a fault of this test at {time.time()} s")  # since 1970
            return Engine.insert(self, *arguments)


def main(kind, folder):
    scene = pair()
    communicator = Communicator()
    FaultyEngine.in_root = kind == "failing_root"
    rank_engine.RankEngine = engine = RankEngine if kind == "refused" else FaultyEngine
    if not communicator.is_root:
        return serve(
            communicator,
            lambda: engine(plan_for(scene), start("cpu", scene.run.precision, 1), communicator),
        )
    with controlling(communicator):
        simulation = Simulation(scene, threads=1, out=folder, communicator=communicator)
        simulation.step(10)
        simulation.particles.velocity = 0.0


if __name__ == "__main__":
    main(*sys.argv[1:])
