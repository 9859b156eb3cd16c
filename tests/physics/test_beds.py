"""Beds of rotating particles in a box: energy budget, rolling dissipation, and a floor of fixed particles.

Both scenes are equal in structure. No external work is done on the beds, so that their energy only decreases, the
dissipation equals the decrease, and rolling dissipates at most that energy.
"""

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group, plane, run_and_sample

from granflow.simulation import Simulation

DIAMETER, SIDE = 0.01, 5
DISSIPATED = tuple(f"{name}_dissipation" for name in ("plastic", "friction", "rolling", "damping"))
STORED = tuple(f"{name}_energy" for name in ("kinetic", "rotational", "gravitational", "elastic"))


def bed(moving, fixed, size, duration, modulus, **numerics):
    """Two groups of particles in a box that is open at the top."""
    walls = box(size) | {"high_z": plane([0.0, 0.0, 0.2], [0.0, 0.0, -1.0])}
    pair = {"restitution": 0.5, "friction": 0.5, "rolling_friction": 0.1}
    return build_scene(
        {"spheres": moving, "rough": fixed | {"fixed": True}}, walls, pair, rolling="cdt", gravity=[0.0, 0.0, -9.81],
        materials={"glass": {"young_modulus": modulus, "poisson_ratio": 0.25, "density": 2500.0}},
        run={"duration": duration, "velocity_max": 1.0}, output={"interval": 1.0, "energy_budget": True},
        numerics={"chunk_size": 32} | numerics,
    )  # fmt: skip


def layers(count=5):
    """Centers [m] of square layers, alternately of SIDE and SIDE - 1 rows, in the hollows of the layer below."""
    positions = []
    for layer in range(count):
        inset = layer % 2
        grid = np.argwhere(np.ones((SIDE - inset, SIDE - inset, 1))) + 0.5 * (1 + inset)
        positions.append(DIAMETER * (grid * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.5 + layer / np.sqrt(2.0)]))
    return np.concatenate(positions)


def budget(snapshot):
    """Stored energy, dissipated energy, and the residual of the energy budget [J]."""
    totals = snapshot.totals
    stored, dissipated = (sum(totals[name] for name in names) for names in (STORED, DISSIPATED))
    return stored, dissipated, stored + dissipated + totals["removed_energy"] - totals["wall_work"]


def test_bed_at_rest_closes_its_energy_budget_and_stops_rotating(taichi_f64):
    """Layers of twelve neighbors each, from random angular velocities of 17 rad/s, after 30 and 60 ms."""
    positions = layers()
    spin = np.random.default_rng(4).normal(0.0, 10.0, positions.shape)
    spheres = particle_group(positions, DIAMETER, angular_velocity=spin)
    far = particle_group([[0.5 * SIDE * DIAMETER] * 2 + [0.15]], DIAMETER)
    with Simulation(bed(spheres, far, SIDE * DIAMETER, 0.06, 1e7, time_step_fraction=0.2)) as simulation:
        snapshots = [simulation.snapshot()]
        for until in (0.03, 0.06):
            simulation.run(until=until)
            snapshots.append(simulation.snapshot(contacts=True))
        simulation.step(1)
        torque_next = simulation.snapshot().particles["torque"]
    (stored, dissipated, residual), (stored_late, dissipated_late, residual_late) = map(budget, snapshots[1:])
    start, early, late = (np.linalg.norm(each.particles["angular_velocity"]) for each in snapshots)
    early_totals, late_totals = (each.totals for each in snapshots[1:])
    loss = stored - stored_late
    # the residual vibration is far below the elastic energy that carries the weight of the bed
    assert 0.0 < loss < 0.25 * late_totals["elastic_energy"]
    assert 0.0 <= late_totals["rolling_dissipation"] - early_totals["rolling_dissipation"] < loss
    assert abs(residual_late - residual) < 0.02 * (dissipated_late - dissipated)
    assert abs(residual_late) < 1e-3 * dissipated_late
    assert late < early < 0.05 * start
    # vibration periods are at least 20 steps: torques that alternate from step to step are an artifact of the
    # time step
    torque = snapshots[-1].particles["torque"]
    assert np.sum(torque * torque_next) > 0.5 * np.sum(torque * torque)


def test_rough_floor_carries_particles_and_the_energy_budget_closes(taichi_f64):
    """Rotating particles fall onto overlapping fixed particles, which extend through the walls of the box."""
    rng = np.random.default_rng(2)
    positions = 0.0065 * (np.argwhere(np.ones((5, 5, 3))) + [0.6, 0.6, 1.5])
    spin = rng.normal(0.0, 50.0, positions.shape)
    rain = particle_group(positions, rng.uniform(0.004, 0.006, len(positions)), angular_velocity=spin)
    floor = 0.004 * np.argwhere(np.ones((10, 10, 1))) + [-0.001, -0.001, 0.0]
    scene = bed(rain, particle_group(floor, 0.006), 0.034, 0.1, 1e8)
    first, last = run_and_sample(scene, 0.1)
    rough = first.particles["fixed"] == 1
    assert rough.sum() == len(floor)
    assert np.all(last.particles["position"][rough] == first.particles["position"][rough])
    assert not last.particles["velocity"][rough].any() and not last.particles["angular_velocity"][rough].any()
    assert last.particles["position"][~rough, 2].min() > 0.0
    assert last.totals["contact_count"] > 30.0
    assert last.totals["friction_dissipation"] > 0.0 and last.totals["rolling_dissipation"] > 0.0
    assert abs(last.totals["energy_error"]) < 2e-3
    potential = 9.81 * last.particles["mass"][~rough] @ last.particles["position"][~rough, 2]
    assert last.totals["gravitational_energy"] == pytest.approx(potential)
    mean = last.particles["coordination_number"][~rough].mean()
    assert last.totals["coordination_number"] == pytest.approx(mean)
