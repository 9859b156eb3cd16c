"""Changes from Python in checkpoints: a resumed run equals an uninterrupted one."""

import shutil

import numpy as np
import pytest
from api.scenes import beads

import granflow as gf
from granflow.io.checkpoint import newest_checkpoint


def scene():
    """Particles above a floor, and a wall at their side."""
    parts = {"interval": 2e-3, "timeseries_interval": 1e-3, "energy_budget": True}
    positions = [[0.02 * k, 0.0, 0.0055] for k in range(3)]
    return beads(positions, [0.0, 0.0, -0.1], run={"duration": 0.01, "velocity_max": 1.0}, output=parts)


def drag(position, velocity, radius, mass, time, parameters):
    return -parameters.coefficient * velocity


def force(**more):
    return gf.ParticleForce(drag, {"coefficient": 1e-3} | more)


def change(simulation):
    """Changes of everything that a checkpoint contains."""
    simulation.run(until=2e-3)
    simulation.particles.velocity[0] = [0.1, 0.0, 0.0]
    simulation.particles.add([[0.1, 0.0, 0.05]], diameter=0.01)
    simulation.particles.remove([1])
    simulation.walls["side"].remove()
    simulation.walls["floor"].motion = gf.Translation(velocity=[0.0, 0.0, 0.02])
    simulation.forces[0].parameters["coefficient"] = 5e-3
    simulation.observers.remove(simulation.observers[1])
    simulation.run(until=4e-3)


@pytest.fixture(scope="module")
def runs(tmp_path_factory, taichi_f64):
    """Directories of an uninterrupted run and of one that ended at 4 ms."""
    folder = tmp_path_factory.mktemp("runs")
    for name in ("whole", "part"):
        with gf.Simulation(scene(), out=folder / name, forces=[force()]) as simulation:
            change(simulation)
            if name == "whole":
                simulation.run()
    return folder


def test_resumed_run_equals_the_uninterrupted_one(runs, tmp_path):
    out = tmp_path / "part"
    shutil.copytree(runs / "part", out)
    checkpoint, _ = newest_checkpoint(out)
    with gf.Simulation(scene(), out=out, resume=checkpoint, forces=[force()]) as simulation:
        assert not simulation.walls["side"].is_present
        assert simulation.forces[0].parameters["coefficient"] == 5e-3
        np.testing.assert_array_equal(simulation.particles.id, [0, 2, 3])
        simulation.run()
    (last, _), (expected, _) = newest_checkpoint(out), newest_checkpoint(runs / "whole")
    for name, values in expected.saved["engine"]["particles"].items():
        np.testing.assert_array_equal(last.saved["engine"]["particles"][name], values)
    assert last.saved["changes"] == expected.saved["changes"]
    assert (out / "timeseries.csv").read_bytes() == (runs / "whole" / "timeseries.csv").read_bytes()
    assert not list(out.glob("particles_*2.vtu")), "the removed observer writes no more frames"


def other(position, velocity, radius, mass, time, parameters):
    return 0.0 * velocity


@pytest.mark.parametrize(("forces", "message"), [
    ([], "forces from Python that this program does not register: drag"),
    ([force(), gf.ParticleForce(other)], "the run has no force other"),
    ([force(more=1.0)], "the force drag had the parameters coefficient and has coefficient, more"),
])  # fmt: skip
def test_functions_must_be_registered_again_unless_changes_are_allowed(runs, forces, message):
    checkpoint, _ = newest_checkpoint(runs / "part")
    with pytest.raises(gf.GranflowError, match=message):
        gf.Simulation(scene(), resume=checkpoint, forces=forces)
    if not forces:
        with gf.Simulation(scene(), resume=checkpoint, allow_changes=True) as simulation:
            simulation.run(duration=1e-3)
            assert "external_work" in simulation.snapshot().totals
