"""Stability monitor: warns during a run of steps too long for the velocities and of energy errors."""

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group, plane
from subprocess_runner import in_subprocess

from granflow.engine.totals import Accounting, StabilityMonitor, energy_input
from granflow.observers.observer import on_interval
from granflow.plan.build import plan_for
from granflow.simulation import Simulation

MASS = 2500.0 * np.pi / 6 * 0.01**3


def warnings_of(scene, change=None):
    """Warnings of a run by kind, with a check every 0.1 ms; `change` is called with simulation and
    snapshot."""
    simulation = Simulation(
        scene, observers=[on_interval(1e-4, lambda snapshot: change and change(simulation, snapshot))]
    )
    simulation.run()
    simulation.free()
    return simulation.engine.stability_monitor.warnings


def gas(**parts):
    rng = np.random.default_rng(8)
    positions = 0.015 * (np.argwhere(np.ones((3, 3, 3))) + 0.5)
    velocity = rng.normal(0.0, 1.0, positions.shape)
    run = {"duration": 0.01, "velocity_max": 4.0} | parts.pop("run", {})
    return build_scene(
        {"gas": particle_group(positions, velocity=velocity)}, walls=box(0.045), run=run, **parts
    )


@pytest.mark.parametrize("energy", [False, True])
def test_valid_run_has_no_warnings(taichi_f64, energy):
    output = {"interval": 1.0, "energy_budget": energy}
    assert not warnings_of(
        gas(pair={"restitution": 1.0, "friction": 0.3}, gravity=[0, 0, -9.81], output=output)
    )


def double_velocities_once(simulation, snapshot):
    """Injects energy: doubles all velocities at the first check after 2 ms; checks are 0.1 ms apart."""
    if (
        snapshot.time > 0.002
        and not simulation.engine.stability_monitor.warnings
        and snapshot.time - 1e-4 <= 0.002
    ):
        field = simulation.engine.state.particles.velocity
        field.from_numpy(2.0 * field.to_numpy())


@pytest.mark.parametrize("energy", [False, True])
def test_injected_energy_causes_a_warning(taichi_f64, energy):
    """Doubled velocities quadruple the kinetic energy: an error of 300 %, less the elastic energy."""
    output = {"interval": 1.0, "energy_budget": energy}
    scene = gas(pair={"restitution": 1.0}, numerics={"max_overlap": 0.8}, output=output)
    warnings = warnings_of(scene, double_velocities_once)
    share = float(warnings["energy"].partition("energy error is ")[2].partition("%")[0])
    assert 260.0 < share < 300.1
    assert "Lower run.time_step" in warnings["energy"]


@pytest.mark.parametrize(("errors", "warns"), [
    ((0.0051, 0.0051), True), ((-0.0051, -0.0051), True), ((0.0049, 0.0049), False), ((0.0051, 0.0049, 0.0051), False),
])  # fmt: skip
def test_energy_error_above_half_a_percent_in_two_rows_causes_a_warning(errors, warns):
    monitor = StabilityMonitor(
        plan_for(
            build_scene(
                {"ball": particle_group([[0.0, 0.0, 0.0]])}, output={"interval": 1.0, "energy_budget": True}
            )
        )
    )
    for number, error in enumerate(errors):
        totals = {"energy_error": error, "contact_count": 0.0}
        for _ in range(2):  # a frame and a row at the same time count once
            monitor.check(0.1 * number, (1.0, 0.0, 0.0), Accounting(), totals, 0.0)
    assert ("energy" in monitor.warnings) == warns


@pytest.mark.parametrize(("height", "put"), [(0.0, 5.0), (-3.0, 8.0), (4.0, 5.0)])
def test_supplied_energy_does_not_depend_on_the_origin(height, put):
    """A particle of 2 kg in a field of 1 m/s2 starts with 5 J: a fall of 1.5 m adds 3 J, a rise adds none."""
    for origin in (0.0, 1e3):
        accounting = Accounting(inserted_energy=5.0 + 2.0 * origin)
        largest = max(energy_input(accounting, 2.0 * origin), energy_input(accounting, 2.0 * origin + height))
        assert largest == pytest.approx(put)
        assert energy_input(accounting, 2.0 * origin + 5.0, (2.0, -7.0)) == pytest.approx(2.0)


def test_the_error_of_a_bounce_refers_to_the_largest_energy_input(taichi_f64):
    """An elastic sphere is back at its height of 5 mm after two falls: gravity has put in m g h on the way,
    and nothing in sum."""
    height, gravity = 0.005, 9.81
    scene = build_scene(
        {"ball": particle_group([[0.0, 0.0, 0.005 + height]])}, walls={"floor": plane([0, 0, 0], [0, 0, 1])},
        gravity=[0, 0, -gravity], pair={"restitution": 1.0}, run={"duration": 2.0 * np.sqrt(2.0 * height / gravity)},
        output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip
    simulation = Simulation(scene, observers=[on_interval(1e-3, lambda snapshot: None)])
    simulation.run()
    last = simulation.snapshot()
    assert last.particles["position"][0, 2] > 0.005 + 0.99 * height
    assert simulation.engine.accounting.energy_put_in == pytest.approx(MASS * gravity * height, rel=0.02)
    assert abs(last.totals["energy_error"]) < 1e-4
    simulation.free()


def test_velocity_too_high_for_the_step_causes_a_warning_with_the_required_step(taichi_f64):
    """A particle exceeds the planned velocity; required: 2 sqrt(M/K) for an impact on an equal particle."""
    step = 4e-4
    scene = build_scene(
        {"ball": particle_group([[0.0, 0.0, 0.9]])},
        walls={"floor": plane([0, 0, -1], [0, 0, 1])},
        gravity=[0.0, 0.0, -100.0],
        run={"duration": 0.02, "velocity_max": 0.01, "time_step": step},
        numerics={"skin": 0.05},
    )
    message = warnings_of(scene)["speed"]
    speed = float(message.partition("moves at ")[2].split()[0])
    required = float(message.partition("below ")[2].split()[0])
    k = 4 / 3 * 1e8 / (2 * (1 - 0.25**2)) * np.sqrt(0.0025)
    mass = MASS / 2
    stable = 2 * np.sqrt(mass / (1.5 * k * np.sqrt((5 * mass * speed**2 / (4 * k)) ** 0.4)))
    assert required == pytest.approx(stable, rel=0.02)
    assert required < step


def test_work_of_moving_walls_causes_no_warning(taichi_f64):
    walls = box(0.0305)
    walls["low_z"] |= {
        "motion": {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-3, "frequency": 300.0}
    }
    scene = build_scene(
        {"gas": particle_group([[0.015, 0.015, 0.00501]])},
        walls=walls,
        run={"duration": 0.01, "velocity_max": 4.0},
    )
    assert not warnings_of(scene)


def warnings_at_the_start(precision):
    """Kinds of warnings for particles released at height: no motion yet, potential energies with rounding
    errors."""
    positions = [[0.0137 * k, 0.0, 0.731] for k in range(5)]
    scene = build_scene(
        {"beads": particle_group(positions, 0.0093)}, gravity=[0.0, 0.0, -9.81],
        run={"duration": 1e-3, "velocity_max": 1.0, "precision": precision},
    )  # fmt: skip
    return list(warnings_of(scene))


@pytest.mark.parametrize("precision", ["f64", "mixed", "f32"])
def test_rounding_causes_no_warning(precision):
    assert in_subprocess(warnings_at_the_start, precision) == []
