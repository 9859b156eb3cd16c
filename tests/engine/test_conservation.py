"""Momentum, angular momentum and energy of closed systems; Newton's third law to the last bit."""

import numpy as np
import pytest
from scene_builders import box, build_scene, column, particle_group, run_and_sample, run_to_end

EPS = np.finfo(float).eps
FAR = {name: wall | {"point": [-0.9 * n for n in wall["normal"]]} for name, wall in box(1.0).items()}
DEPENDS_ON_IMPACT = {"sigma": 0.6, "psi": 0.6, "limit_velocity": 20.0}
AS_IN_A_BOX = {"walls": FAR, "output": {"interval": 1.0, "energy_budget": True}}
"""Walls that no particle reaches: the structure of `bouncing_box`."""
MATERIALS = {
    "glass": {"young_modulus": 2e8, "poisson_ratio": 0.25, "density": 2500.0},
    "steel": {"young_modulus": 6e8, "poisson_ratio": 0.30, "density": 7800.0},
}


def cloud(count, seed=1):
    """Particles of two materials on a loose lattice that fly to the center with random angular velocities."""
    rng = np.random.default_rng(seed)
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
        materials=MATERIALS, numerics={"chunk_size": 128}, run={"duration": 0.006, "velocity_max": 5.0}, **AS_IN_A_BOX,
    )  # fmt: skip
    snapshots = run_and_sample(scene, 0.002)
    collided = np.any(snapshots[-1].particles["velocity"] != snapshots[0].particles["velocity"], axis=1)
    assert collided.sum() > 900
    linear, angular, *_ = momenta(snapshots[0])
    for snapshot in snapshots[1:]:
        now = momenta(snapshot)
        assert np.linalg.norm(now[0] - linear) <= 6.0 * 0.5 * EPS * np.sqrt(snapshot.step) * now[2]
        assert np.linalg.norm(now[1] - angular) <= 6.0 * 0.5 * EPS * snapshot.step * now[3]


def colliding_pairs(count=40):
    """Distant pairs of unequal radius and material that collide obliquely with random angular velocities."""
    rng = np.random.default_rng(3)
    middle = 0.04 * np.argwhere(np.ones((4, 4, 4)))[:count] - 0.08
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    radius = rng.uniform(0.003, 0.006, (count, 2))
    velocity = 0.4 * normal + rng.normal(0.0, 0.2, (count, 3))
    groups = {}
    for k, (name, sign) in enumerate((("glass", 1.0), ("steel", -1.0))):
        positions = middle - sign * radius[:, [k]] * normal
        angular_velocity = rng.normal(0.0, 60.0, (count, 3))
        groups[name] = particle_group(
            positions, 2.0 * radius[:, k], name, velocity=sign * velocity, angular_velocity=angular_velocity
        )
    return groups


def pair_forces(chunk_size, rolling):
    """Forces on the first and on the second partners, torques and velocities, each (times, particles, 3)."""
    pair = {
        "restitution": {"sigma": 1.0, "psi": 0.5, "limit_velocity": 3.0},
        "friction": 0.3,
        "rolling_friction": 0.1,
    }
    scene = build_scene(
        colliding_pairs(), pair=pair, rolling=rolling, materials=MATERIALS,
        numerics={"chunk_size": chunk_size}, run={"duration": 0.0008, "velocity_max": 2.0}, **AS_IN_A_BOX,
    )  # fmt: skip
    snapshots = run_and_sample(scene, 0.0001)
    half = snapshots[0].particles["id"].size // 2
    force = column(snapshots, "force")
    return force[:, :half], force[:, half:], column(snapshots, "torque"), column(snapshots, "velocity")


@pytest.mark.parametrize("rolling", ["epsd", pytest.param("cdt", marks=pytest.mark.slow)])
def test_forces_on_both_partners_are_exactly_opposite(taichi_f64, rolling):
    """A pair within one chunk is computed once; a pair across two chunks of one particle is computed
    twice."""
    computed_twice = pair_forces(1, rolling)
    computed_once = pair_forces(512, rolling)
    assert np.count_nonzero(computed_twice[0].any(axis=2).any(axis=0)) >= 35
    np.testing.assert_array_equal(computed_twice[0], -computed_twice[1])
    np.testing.assert_array_equal(computed_once[0], -computed_once[1])
    for from_both_sides, from_one_side in zip(computed_twice, computed_once, strict=True):
        np.testing.assert_array_equal(from_both_sides, from_one_side)


def bouncing_box(time_step, normal="zhou", rolling="epsd"):
    rng = np.random.default_rng(5)
    positions = 0.012 * (np.argwhere(np.ones((3, 3, 4))) + 0.55)
    diameter, velocity = rng.uniform(0.009, 0.0105, len(positions)), rng.normal(0.0, 0.7, positions.shape)
    groups = {
        material: particle_group(positions[rows], diameter[rows], material, velocity=velocity[rows])
        for material, rows in (("glass", slice(18)), ("steel", slice(18, 36)))
    }
    restitution = 0.7 if normal != "zhou" else DEPENDS_ON_IMPACT
    return build_scene(
        groups, walls=box(0.05), normal=normal, rolling=rolling, gravity=[0.0, 0.0, -9.81],
        pair={"restitution": restitution, "friction": 0.4, "rolling_friction": 0.1},
        run={"duration": 0.03, "time_step": time_step, "velocity_max": 4.0},
        numerics={"chunk_size": 16}, output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("normal", "rolling"),
    [("zhou", "epsd"), pytest.param("zhou", "cdt", marks=pytest.mark.slow), ("hertz", "epsd")],
)
def test_energy_error_is_of_first_order_in_the_time_step(taichi_f64, normal, rolling):
    """The error is of first order in the time step: an eighth of the step leaves an eighth of the error or
    less."""
    coarse, fine = (run_to_end(bouncing_box(step, normal, rolling))[0].totals for step in (4e-6, 5e-7))
    dissipated = "plastic_dissipation" if normal == "zhou" else "damping_dissipation"
    for part in ("friction_dissipation", "rolling_dissipation", dissipated):
        assert fine[part] > 0.01 * fine["kinetic_energy"], part
    assert abs(fine["energy_error"]) < 5e-5
    assert abs(coarse["energy_error"] / fine["energy_error"]) > 5.0
