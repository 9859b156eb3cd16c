"""What a snapshot shows is wrong is said while the run goes on: steps too long for the speeds, energy from nowhere."""

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group, plane
from subprocess_runner import in_subprocess

from granflow.device.accounting import Accounting, energy_input
from granflow.device.stability_monitor import StabilityMonitor
from granflow.observe import every
from granflow.plan import plan_for
from granflow.simulation import Simulation

MASS = 2500.0 * np.pi / 6 * 0.01**3


def warned(scene, change=None):
    """What was warned of, by kind, with a look every tenth of a millisecond."""
    simulation = Simulation(scene, observers=[every(1e-4, lambda snapshot: change and change(simulation, snapshot))])
    simulation.run()
    simulation.free()
    return simulation.engine.stability_monitor.warnings


def gas(**parts):
    rng = np.random.default_rng(8)
    positions = 0.015 * (np.argwhere(np.ones((3, 3, 3))) + 0.5)
    velocity = rng.normal(0.0, 1.0, positions.shape)
    run = {"duration": 0.01, "velocity_max": 4.0} | parts.pop("run", {})
    return build_scene({"gas": particle_group(positions, velocity=velocity)}, walls=box(0.045), run=run, **parts)


@pytest.mark.parametrize("energy", [False, True])
def test_a_good_run_is_not_warned_of(taichi_f64, energy):
    output = {"interval": 1.0, "energy_budget": energy}
    assert not warned(gas(pair={"restitution": 1.0, "friction": 0.3}, gravity=[0, 0, -9.81], output=output))


def doubled_speeds(simulation, snapshot):
    """Energy from nowhere: all velocities twice as large, once."""
    if (
        snapshot.time > 0.002
        and not simulation.engine.stability_monitor.warnings
        and not hasattr(simulation, "doubled")
    ):
        simulation.doubled = True
        field = simulation.engine.state.particles.velocity
        field.from_numpy(2.0 * field.to_numpy())


@pytest.mark.parametrize("energy", [False, True])
def test_energy_from_nowhere_is_warned_of(taichi_f64, energy):
    """Four times the kinetic energy is three times the energy put in more, less what is in contacts."""
    output = {"interval": 1.0, "energy_budget": energy}
    scene = gas(pair={"restitution": 1.0}, numerics={"max_overlap": 0.8}, output=output)
    warnings = warned(scene, doubled_speeds)
    share = float(warnings["energy"].partition("energy error is ")[2].partition("%")[0])
    assert 260.0 < share < 300.1
    assert "Lower run.time_step" in warnings["energy"]


@pytest.mark.parametrize(("errors", "warns"), [
    ((0.0051, 0.0051), True), ((-0.0051, -0.0051), True), ((0.0049, 0.0049), False), ((0.0051, 0.0049, 0.0051), False),
])  # fmt: skip
def test_an_energy_error_above_half_a_percent_in_two_rows_is_warned_of(errors, warns):
    monitor = StabilityMonitor(
        plan_for(
            build_scene({"ball": particle_group([[0.0, 0.0, 0.0]])}, output={"interval": 1.0, "energy_budget": True})
        )
    )
    for number, error in enumerate(errors):
        totals = {"energy_error": error, "contact_count": 0.0}
        for _ in range(2):  # a frame and a row of one moment count once
            monitor.check(0.1 * number, (1.0, 0.0, 0.0), Accounting(), totals, 0.0)
    assert ("energy" in monitor.warnings) == warns


@pytest.mark.parametrize(("height", "put"), [(0.0, 5.0), (-3.0, 8.0), (4.0, 5.0)])
def test_energy_put_in_is_the_largest_supply_whatever_the_origin(height, put):
    """A sphere of 2 kg in a field of 1 m/s2 starts with 5 J, and falls or rises: 1.5 m down add 3 J, up none."""
    for origin in (0.0, 1e3):
        accounting = Accounting(inserted_energy=5.0 + 2.0 * origin)
        largest = max(energy_input(accounting, 2.0 * origin), energy_input(accounting, 2.0 * origin + height))
        assert largest == pytest.approx(put)
        assert energy_input(accounting, 2.0 * origin + 5.0, (2.0, -7.0)) == pytest.approx(2.0)


def test_speeds_too_high_for_the_step_are_noticed_with_the_step_they_need(taichi_f64):
    """A sphere that falls past the planned speed; needed: the leapfrog's 2 sqrt(M/K) against its like at that speed."""
    step = 4e-4
    scene = build_scene(
        {"ball": particle_group([[0.0, 0.0, 0.9]])},
        walls={"floor": plane([0, 0, -1], [0, 0, 1])},
        gravity=[0.0, 0.0, -100.0],
        run={"duration": 0.02, "velocity_max": 0.01, "time_step": step},
        numerics={"skin": 0.05},
    )
    sentence = warned(scene)["speed"]
    speed = float(sentence.partition("moves at ")[2].split()[0])
    needed = float(sentence.partition("below ")[2].split()[0])
    k = 4 / 3 * 1e8 / (2 * (1 - 0.25**2)) * np.sqrt(0.0025)
    mass = MASS / 2
    stable = 2 * np.sqrt(mass / (1.5 * k * np.sqrt((5 * mass * speed**2 / (4 * k)) ** 0.4)))
    assert needed == pytest.approx(stable, rel=0.02)
    assert needed < step


def test_walls_that_move_are_not_taken_for_energy_from_nowhere(taichi_f64):
    walls = box(0.0305)
    walls["low_z"] |= {"motion": {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-3, "frequency": 300.0}}
    scene = build_scene(
        {"gas": particle_group([[0.015, 0.015, 0.00501]])}, walls=walls, run={"duration": 0.01, "velocity_max": 4.0}
    )
    assert not warned(scene)


def warned_at_the_start(precision):
    """Beads let go high up: no motion yet, and potential energies with the rounding of the masses."""
    positions = [[0.0137 * k, 0.0, 0.731] for k in range(5)]
    scene = build_scene(
        {"beads": particle_group(positions, 0.0093)}, gravity=[0.0, 0.0, -9.81],
        run={"duration": 1e-3, "velocity_max": 1.0, "precision": precision},
    )  # fmt: skip
    return list(warned(scene))


@pytest.mark.parametrize("precision", ["f64", "mixed", "f32"])
def test_rounding_is_not_taken_for_energy_from_nowhere(precision):
    assert in_subprocess(warned_at_the_start, precision) == []
