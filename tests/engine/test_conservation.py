"""Momentum, angular momentum and energy of closed systems."""

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group, run_and_sample, run_to_end

EPS = np.finfo(float).eps
FAR = {name: wall | {"point": [-0.9 * n for n in wall["normal"]]} for name, wall in box(1.0).items()}
"""Walls that no particle reaches: the structure of `bouncing_box`."""
DEPENDS_ON_IMPACT = {"sigma": 0.6, "psi": 0.6, "limit_velocity": 20.0}
MATERIALS = {
    "glass": {"young_modulus": 2e8, "poisson_ratio": 0.25, "density": 2500.0},
    "steel": {"young_modulus": 6e8, "poisson_ratio": 0.30, "density": 7800.0},
}


def cloud(count):
    """Particles of two materials on a loose lattice that fly to the center with random angular velocities."""
    rng = np.random.default_rng(1)
    side = int(np.ceil(count ** (1.0 / 3.0)))
    positions = 0.011 * (np.argwhere(np.ones((side, side, side)))[:count] - 0.5 * (side - 1))
    positions = rng.permutation(positions)
    velocity = -20.0 * positions + rng.normal(0.0, 0.5, positions.shape)
    angular_velocity = rng.normal(0.0, 100.0, positions.shape)
    diameter = rng.uniform(0.006, 0.0108, count)
    half = count // 2
    parts = {"glass": slice(0, half), "steel": slice(half, count)}
    return {
        name: particle_group(
            positions[cut],
            diameter[cut],
            name,
            velocity=velocity[cut],
            angular_velocity=angular_velocity[cut],
        )
        for name, cut in parts.items()
    }


def momenta(snapshot):
    """Momentum and angular momentum about the origin, each (3,), and the norms of their terms."""
    p = snapshot.particles
    linear = p["mass"][:, None] * p["velocity"]
    inertia = 0.4 * p["mass"] * p["radius"] ** 2
    angular = np.cross(p["position"], linear) + inertia[:, None] * p["angular_velocity"]
    return linear.sum(axis=0), angular.sum(axis=0), np.linalg.norm(linear), np.linalg.norm(angular)


def test_momentum_of_a_closed_system_is_conserved_to_rounding(taichi_f64):
    """Forces and torques cancel exactly, so each step adds rounding errors of half an ulp only.

    Velocities are rounded randomly during contact: six standard deviations grow with the square root of the
    number of steps. In free flight, the rounding error of a position is the same in each step and random
    between particles.
    """
    scene = build_scene(
        cloud(1000), pair={"restitution": DEPENDS_ON_IMPACT, "friction": 0.5, "rolling_friction": 0.2}, rolling="epsd",
        materials=MATERIALS, numerics={"chunk_size": 128}, run={"duration": 0.006, "velocity_max": 5.0}, walls=FAR,
        output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 0.002)
    collided = np.any(snapshots[-1].particles["velocity"] != snapshots[0].particles["velocity"], axis=1)
    assert collided.sum() > 900
    linear, angular, *_ = momenta(snapshots[0])
    for snapshot in snapshots[1:]:
        now = momenta(snapshot)
        assert np.linalg.norm(now[0] - linear) <= 6.0 * 0.5 * EPS * np.sqrt(snapshot.step) * now[2]
        assert np.linalg.norm(now[1] - angular) <= 6.0 * 0.5 * EPS * snapshot.step * now[3]


def bouncing_box(time_step, normal):
    rng = np.random.default_rng(5)
    positions = 0.012 * (np.argwhere(np.ones((3, 3, 4))) + 0.55)
    diameter, velocity = rng.uniform(0.009, 0.0105, len(positions)), rng.normal(0.0, 0.7, positions.shape)
    groups = {
        material: particle_group(positions[rows], diameter[rows], material, velocity=velocity[rows])
        for material, rows in (("glass", slice(18)), ("steel", slice(18, 36)))
    }
    restitution = 0.7 if normal != "zhou" else DEPENDS_ON_IMPACT
    return build_scene(
        groups, walls=box(0.05), normal=normal, rolling="epsd", gravity=[0.0, 0.0, -9.81],
        pair={"restitution": restitution, "friction": 0.4, "rolling_friction": 0.1},
        run={"duration": 0.03, "time_step": time_step, "velocity_max": 4.0},
        numerics={"chunk_size": 16}, output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip


@pytest.mark.parametrize("normal", ["zhou", "hertz"])
def test_energy_error_is_of_first_order_in_the_time_step(taichi_f64, normal):
    """An eighth of the step leaves an eighth of the error or less."""
    coarse, fine = (run_to_end(bouncing_box(step, normal))[0].totals for step in (4e-6, 5e-7))
    dissipated = "plastic_dissipation" if normal == "zhou" else "damping_dissipation"
    for part in ("friction_dissipation", "rolling_dissipation", dissipated):
        assert fine[part] > 0.01 * fine["kinetic_energy"], part
    assert abs(fine["energy_error"]) < 5e-5
    assert abs(coarse["energy_error"] / fine["energy_error"]) > 5.0
