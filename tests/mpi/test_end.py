"""A program on ranks that fails outside of a command ends, although the files of its run are still open."""

import pytest
import rank_launcher

pytestmark = pytest.mark.skipif(
    bool(rank_launcher.MISSING), reason=rank_launcher.MISSING or "ranks can be started"
)

PROGRAM = """
import sys

sys.path.insert(0, sys.argv[1])
from scene_builders import box, build_scene, moving_lattice

import granflow as gf
from granflow.parallel.communicator import Communicator
from granflow.parallel.rank_engine import RankEngine, controlling, serve

output = {"interval": 1e-4, "checkpoint": {"interval": 1e-4}}
run = {"duration": 1e-3, "time_step": 2e-6, "velocity_max": 2.0}
scene = build_scene({"balls": moving_lattice((3, 3, 3), 0.006, 0.5)}, box(0.03), run=run, output=output)
communicator = Communicator()
if communicator.is_root:
    with controlling(communicator):
        simulation = gf.Simulation(scene, threads=1, out=sys.argv[2], communicator=communicator)
        simulation.step(10)
        simulation.particles.velocity = 0.0  # refused on ranks
else:
    serve(communicator, lambda: RankEngine(gf.plan_for(scene), gf.start("cpu", "f64", 1), communicator))
"""


def test_an_error_of_the_root_outside_of_a_command_ends_the_program(tmp_path):
    folder = rank_launcher.ROOT / "tests"
    done = rank_launcher.on_ranks(2, "-c", PROGRAM, folder, tmp_path / "out", seconds=120)
    assert done.returncode != 0
    assert "Changes from Python do not work on MPI ranks" in done.stderr
    assert "The other ranks have ended" in done.stderr
