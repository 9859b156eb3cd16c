"""Stability monitor: warns during a run of steps too long for the velocities and of energy errors."""

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group, plane

from granflow.engine.totals import Accounting, StabilityMonitor, energy_input
from granflow.observers.observer import on_interval
from granflow.plan.build import plan_for
from granflow.simulation import Simulation

MASS = 2500.0 * np.pi / 6 * 0.01**3


def warnings_of(scene, change=None):
    """Warnings of a run by kind, with a check every 0.1 ms; `change` is called with simulation and snapshot."""

    def observe(snapshot):
        if change:
            change(simulation, snapshot)

    with Simulation(scene, observers=[on_interval(1e-4, observe)]) as simulation:
        simulation.run()
        return simulation.engine.stability_monitor.warnings


def in_box(positions, velocity=(0.0, 0.0, 0.0), **parts):
    """Elastic particles with friction in a box with an energy budget; one structure."""
    numerics = {"chunk_size": 16} | parts.pop("numerics", {})
    run = {"duration": 0.01, "velocity_max": 4.0} | parts.pop("run", {})
    parts |= {"pair": {"restitution": 1.0, "friction": 0.3}, "run": run, "numerics": numerics}
    parts |= {"output": {"interval": 1.0, "energy_budget": True}}
    return build_scene({"beads": particle_group(positions, velocity=velocity)}, box(0.045), **parts)


def gas(**parts):
    positions = 0.015 * (np.argwhere(np.ones((3, 3, 3))) + 0.5)
    return in_box(positions, velocity=np.random.default_rng(8).normal(0.0, 1.0, positions.shape), **parts)


def double_velocities_once(simulation, snapshot):
    """Injects energy: doubles all velocities at the first check after 2 ms; checks are 0.1 ms apart.

    Unlike changes of `simulation.particles`, those of the state are not accounted for.
    """
    if 0.002 < snapshot.time <= 0.0021 and not simulation.engine.stability_monitor.warnings:
        particles = simulation.engine.state.particles
        for field in (particles.velocity, particles.angular_velocity):
            field.from_numpy(2.0 * field.to_numpy())


def test_injected_energy_causes_a_warning_and_a_valid_run_none(taichi_f64):
    """Doubled velocities quadruple the kinetic energy: an error of 300 %, less the elastic energy."""
    assert not warnings_of(gas(gravity=[0, 0, -9.81]))
    warnings = warnings_of(gas(numerics={"max_overlap": 0.8}), double_velocities_once)
    share = float(warnings["energy"].partition("energy error is ")[2].partition("%")[0])
    assert 260.0 < share < 300.1
    assert "Lower run.time_step" in warnings["energy"]


@pytest.mark.parametrize(("errors", "warns"), [
    ((-0.0051, -0.0051), True), ((0.0049, 0.0049), False), ((0.0051, 0.0049, 0.0051), False),
])  # fmt: skip
def test_energy_error_above_half_a_percent_in_two_rows_causes_a_warning(errors, warns):
    output = {"interval": 1.0, "energy_budget": True}
    ball = {"ball": particle_group([[0.0, 0.0, 0.0]])}
    monitor = StabilityMonitor(plan_for(build_scene(ball, output=output)))
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
    run = {"duration": 2.0 * np.sqrt(2.0 * height / gravity)}
    scene = in_box([[0.02, 0.02, 0.005 + height]], gravity=[0, 0, -gravity], run=run)
    with Simulation(scene, observers=[on_interval(1e-3, lambda snapshot: None)]) as simulation:
        simulation.run()
        last = simulation.snapshot()
        assert last.particles["position"][0, 2] > 0.005 + 0.99 * height
        assert simulation.engine.accounting.energy_put_in == pytest.approx(MASS * gravity * height, rel=0.02)
        assert abs(last.totals["energy_error"]) < 1e-4


def test_the_error_of_attracted_spheres_refers_to_the_energy_of_attraction(taichi_f64):
    """Two spheres at rest at the distance s0 fall together and stick: their attraction supplies

        A R (1 / s0 - 1 / (2 s0)) / 6 + (1 - 2/5) F d        F = A R / (6 s0^2) = k d^1.5

    until they rest at the overlap d of Hertz. They have no other energy, and that of their contact at the
    start is negative.
    """
    hamaker, separation, radius_eff = 1.6e-9, 1e-5, 0.0025
    pair = {"restitution": 0.5, "hamaker_constant": hamaker, "separation": separation}
    contact = {"normal": "hertz", "tangential": "none", "rolling": "none", "cohesion": "van_der_waals"}
    scene = build_scene(
        {"balls": particle_group([[0.0] * 3, [0.01 + separation, 0.0, 0.0]])}, pair=pair, contact=contact,
        output={"interval": 1.0, "energy_budget": True}, run={"duration": 0.05, "velocity_max": 0.02},
    )  # fmt: skip
    with Simulation(scene, observers=[on_interval(1e-3, lambda snapshot: None)]) as simulation:
        simulation.run()
        force = hamaker * radius_eff / (6.0 * separation**2)
        k = 4 / 3 * 1e8 / (2 * (1 - 0.25**2)) * np.sqrt(radius_eff)
        supplied = 0.5 * force * separation + 0.6 * force * (force / k) ** (2 / 3)
        assert simulation.engine.accounting.energy_put_in == pytest.approx(supplied, rel=1e-3)
        assert abs(simulation.snapshot().totals["energy_error"]) < 2e-3
        assert not simulation.engine.stability_monitor.warnings


def test_velocity_too_high_for_the_step_causes_a_warning_with_the_required_step(taichi_f64):
    """A particle exceeds the planned velocity; required: 2 sqrt(M/K) for an impact on an equal particle."""
    step = 4e-4
    scene = build_scene(
        {"ball": particle_group([[0.0, 0.0, 0.9]])}, {"floor": plane([0, 0, -1], [0, 0, 1])}, gravity=[0.0, 0.0, -100.0],
        run={"duration": 0.02, "velocity_max": 0.01, "time_step": step}, numerics={"skin": 0.05},
    )  # fmt: skip
    message = warnings_of(scene)["speed"]
    speed = float(message.partition("moves at ")[2].split()[0])
    required = float(message.partition("below ")[2].split()[0])
    k = 4 / 3 * 1e8 / (2 * (1 - 0.25**2)) * np.sqrt(0.0025)
    mass = MASS / 2
    stable = 2 * np.sqrt(mass / (1.5 * k * np.sqrt((5 * mass * speed**2 / (4 * k)) ** 0.4)))
    assert required == pytest.approx(stable, rel=0.02)
    assert required < step
