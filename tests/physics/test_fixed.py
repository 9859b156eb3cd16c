"""Fixed particles, and particles that move with a wall: contacts as with a wall of their shape, and forces."""

from math import pi, sqrt

import numpy as np
import pytest
from scene_builders import SOFT, build_scene, column, few_spheres, particle_group, run_and_sample, times

from granflow.errors import GranflowError, RunError
from granflow.plan.build import plan_for
from granflow.scene.blocks.motions import Translation
from granflow.simulation import Simulation

RADIUS, FIXED_RADIUS, SPEED = 0.005, 0.008, 0.7
MASS = 4.0 / 3.0 * pi * RADIUS**3 * SOFT["density"]
HERTZ = 4.0 / 3.0 * SOFT["young_modulus"] / (2.0 * (1.0 - SOFT["poisson_ratio"] ** 2))
"""4/3 E* [Pa]: the Hertz stiffness without the square root of the effective radius."""
MOBILE = particle_group([[RADIUS + FIXED_RADIUS + 1e-4, 0, 0]], 2 * RADIUS, velocity=[[-SPEED, 0, 0]])
ROUGH = particle_group([[0, 0, 0], [-0.003, 0, 0]], 2 * FIXED_RADIUS) | {"fixed": True}
RUN = {"duration": 2e-3, "time_step": 1e-6, "velocity_max": 1.0}


def test_fixed_particle_acts_as_an_infinite_mass(taichi_f64):
    """A particle hits a fixed one of another size, which overlaps a second fixed particle behind it.

    Elastic impact: m v^2 / 2 = 2/5 k d^2.5 with the mass m of the mobile particle and 1/R = 1/R1 + 1/R2.
    """
    k = HERTZ * sqrt(RADIUS * FIXED_RADIUS / (RADIUS + FIXED_RADIUS))
    overlap_max = (5.0 * MASS * SPEED**2 / (4.0 * k)) ** 0.4
    snapshots = run_and_sample(
        few_spheres({"mobile": MOBILE, "rough": ROUGH}, pair={"restitution": 1.0}, run=RUN), 1e-6
    )
    position, velocity = (column(snapshots, name) for name in ("position", "velocity"))
    assert (RADIUS + FIXED_RADIUS - position[:, 0, 0]).max() == pytest.approx(overlap_max, rel=1e-4)
    assert velocity[-1, 0, 0] == pytest.approx(SPEED, rel=1e-6)
    assert np.all(position[:, 1:] == position[0, 1:]) and not velocity[:, 1:].any()
    assert snapshots[0].totals["contact_count"] == 0.0, "overlapping fixed particles form no contact"
    assert snapshots[0].totals["kinetic_energy"] == pytest.approx(0.5 * MASS * SPEED**2)
    assert max(abs(each.totals["energy_error"]) for each in snapshots) < 1e-4


def test_pair_cases_of_fixed_particles_use_the_mobile_mass():
    """The time step uses the mass of the mobile particle and both radii; fixed particles form no pair case."""
    plan = plan_for(few_spheres({"rough": ROUGH, "mobile": MOBILE}))
    cases = {frozenset(pair.name.split("-")): pair for pair in plan.pair_cases}
    assert frozenset({"rough"}) not in cases and frozenset({"mobile"}) in cases
    found = cases[frozenset({"mobile", "rough"})]
    assert found.mass_eff == pytest.approx(MASS)
    assert found.radius_eff == pytest.approx(RADIUS * FIXED_RADIUS / (RADIUS + FIXED_RADIUS))


R, TARGET, SPIN = 0.004, 0.4, 40.0
CONTACT = {
    "normal": {"law": "linear", "stiffness": {"value": 2e3}},
    "tangential": {"law": "linear_history", "stiffness": 1e3},
    "rolling": "none",
}
"""Models with springs of given stiffness, whose forces do not depend on the radius of the partner."""
OTHER = np.array([0.1, 0.0, 0.0])
"""Distance of the spherical wall from the attached sphere that moves alike."""


def rocking(point):
    """A wall shakes, and turns about an axis next to its point."""
    shaken = {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-3, "frequency": 80.0, "phase": 1.0}
    turned = {"kind": "rotation", "point": point.tolist(), "axis": [0, 1, 0], "angular_velocity": SPIN}
    return [shaken, turned]


def plate(corner, size, **more):
    sides = [[size, 0, 0], [0, size, 0]]
    return {"shape": "rectangle", "corner": corner, "sides": sides, "material": "glass"} | more


def yard(duration=0.02):
    """A ball on a sphere that is attached to a moving plate, another one on a spherical wall that moves
    alike, and four balls below a servo lid with spheres below its surface."""
    axis = np.array([0.003, 0.0, 0.0])
    square = np.array([[x, y, 0.0] for x in (-0.01, 0.01) for y in (-0.01, 0.01)]) + [0.2, 0.0, R]
    servo = {"kind": "servo", "direction": [0, 0, -1], "force": TARGET, "velocity_max": 0.2}
    walls = {
        "plate": plate([-R / 2, -R / 2, -0.01], R, motion=rocking(axis), torque_point=axis.tolist()),
        "sphere": {
            "shape": "sphere", "center": OTHER.tolist(), "radius": R, "material": "glass",
            "motion": rocking(axis + OTHER), "torque_point": (axis + OTHER).tolist(),
        },
        "floor": plate([0.16, -0.04, 0.0], 0.08),
        "lid": plate([0.18, -0.02, 4 * R + 1e-4], 0.04, motion=servo),
    }  # fmt: skip
    above = [[5e-4, 2e-4, 2 * R + 1.5e-3], [5e-4, 2e-4, 2 * R + 1.5e-3] + OTHER]
    groups = {
        "balls": particle_group(np.concatenate([above, square]), 2 * R),
        "hub": particle_group([[0, 0, 0]], 2 * R) | {"fixed": {"to": "plate"}},
        "rough": particle_group(square + [0, 0, 2 * R + 2e-4], 2 * R) | {"fixed": {"to": "lid"}},
    }
    return build_scene(
        groups, walls, {"restitution": 0.4, "friction": 0.3}, contact=CONTACT, gravity=[0.0, 0.0, -9.81],
        run={"duration": duration, "velocity_max": 1.0, "time_step": 2e-6},
        output={"interval": 1e-3, "energy_budget": True, "wall_forces": True},
        domain={"min": [-0.05, -0.05, -0.05], "max": [0.25, 0.05, 0.1], "on_exit": "delete"},
    )  # fmt: skip


@pytest.fixture(scope="module")
def snapshots(taichi_f64):
    """The particles of a run every 0.2 ms; the last snapshot is that of its end."""
    return run_and_sample(yard(), 2e-4)


def test_attached_particle_has_the_pose_of_its_wall(snapshots):
    """Position, velocity and spin of the sphere follow from z(t) = A (sin(wt + p) - sin(p)) and the angle
    SPIN t about the axis: x = c + R (x0 - c)."""
    t = times(snapshots)
    omega = 2 * np.pi * 80.0
    height = 1e-3 * np.sin(omega * t + 1.0)
    # (x0 - c) = (-0.003, 0, 0), rotated about y: (-0.003 cos, 0, 0.003 sin)
    arm = 0.003 * np.stack([-np.cos(SPIN * t), 0 * t, np.sin(SPIN * t)], axis=1)
    start = np.array([0, 0, 1e-3 * np.sin(1.0)])
    center = np.array([0.003, 0.0, 0.0]) - start + np.stack([0 * t, 0 * t, height], axis=1)
    hub = len(snapshots[0].particles["id"]) - 5
    assert np.abs(column(snapshots, "position")[:, hub] - center - arm).max() < 1e-12
    spin = np.array([0.0, SPIN, 0.0])
    rate = np.stack([0 * t, 0 * t, 1e-3 * omega * np.cos(omega * t + 1.0)], axis=1) + np.cross(spin, arm)
    assert np.abs(column(snapshots, "velocity")[:, hub] - rate).max() < 1e-9
    assert np.all(column(snapshots, "angular_velocity")[:, hub] == spin)


def test_attached_sphere_acts_as_a_moving_spherical_wall(snapshots):
    """The balls on both follow the same path; force and torque on both walls agree.

    Contacts with a wall integrate the normal on the wall, those of spheres that of the branch vector: they
    differ by the order of the square of the time step.
    """
    position, force = (column(snapshots, name) for name in ("position", "force"))
    assert (np.linalg.norm(force[:, 1], axis=1) > 0.1).sum() > 5
    assert np.abs(position[:, 1] - OTHER - position[:, 0]).max() < 1e-7
    last = snapshots[-1].impulses
    assert np.linalg.norm(last["sphere"][:3]) > 3e-4 and np.abs(last["sphere"][3:6]).max() > 1e-6
    assert last["plate"][:6] == pytest.approx(last["sphere"][:6], rel=1e-3, abs=1e-9)


def test_servo_lid_feels_its_attached_particles(taichi_f64):
    """The mean force on its particles reaches the target along the normal of the lid."""
    with Simulation(yard(0.06)) as simulation:
        simulation.run(until=0.02)
        before = simulation.snapshot()
        simulation.run()
        after = simulation.snapshot()
    assert after.particles["attached_to"].tolist() == 6 * [-1] + [0] + 4 * [3]
    impulse = (after.impulses["lid"] - before.impulses["lid"]) / (after.time - before.time)
    assert impulse[2] == pytest.approx(TARGET, rel=0.02)
    assert impulse[6] == pytest.approx(impulse[2], rel=1e-9)
    assert after.particles["force"][-4:, 2].sum() == pytest.approx(TARGET, rel=0.02)
    assert abs(after.totals["energy_error"]) < 1e-4


def test_motion_from_a_program_moves_the_particles_which_cannot_leave_the_domain(taichi_f64):
    """From the pose that the wall has reached; the domain deletes particles, but not those of a wall, which
    cannot be removed either."""
    with Simulation(yard()) as simulation:
        simulation.run(until=0.002)
        with pytest.raises(GranflowError, match="cannot be removed: the particles of hub move"):
            simulation.walls["plate"].remove()
        before = simulation.snapshot()
        simulation.walls["plate"].motion = Translation(velocity=[0.0, -0.5, 0.0])
        simulation.particles.velocity[:2] = [0.0, 0.0, 0.1]
        with pytest.raises(GranflowError, match="do not move particles of a fixed group"):
            simulation.particles.velocity[6] = 0.0
        simulation.run(until=0.004)
        after = simulation.snapshot()
        moved = after.particles["position"][6] - before.particles["position"][6]
        assert moved == pytest.approx([0.0, -0.5 * (after.time - before.time), 0.0], abs=1e-12)
        simulation.walls["plate"].motion = Translation(velocity=[0.0, -10.0, 0.0])
        with pytest.raises(RunError, match="outside the domain, and it moves with a wall .* Enlarge"):
            simulation.run()
