"""Walls that are removed and moved from Python."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from api.scenes import beads
from geometry.motions import rotation, translation, vibration
from scene_builders import plane

import granflow as gf
from granflow.engine.checkpoint import renumbered
from granflow.plan.build import plan_for
from granflow.plan.wall_changes import with_motions
from granflow.plan.walls import geometry_speed
from granflow.scene.blocks.motions import placement_at, poses_at
from granflow.scene.blocks.walls.rectangle import rectangle

GRAVITY = 9.81


def resting(motion=(), **more):
    """A particle at rest on a floor, and a side wall."""
    walls = {
        "floor": plane([0.0] * 3, [0.0, 0.0, 1.0], **({"motion": motion} if motion else {})),
        "side": plane([0.5, 0.0, 0.0], [-1.0, 0.0, 0.0]),
    }
    return beads([[0.0, 0.0, 0.005 - 1e-6]], walls=walls, run={"duration": 1.0, "velocity_max": 1.0}, **more)


def test_particle_falls_after_its_wall_is_removed(taichi_f64):
    with gf.Simulation(resting()) as simulation:
        simulation.run(until=0.01)
        height = simulation.particles.position[0, 2]
        speed = simulation.particles.velocity[0, 2]
        simulation.walls["floor"].remove()
        assert not simulation.walls["floor"].is_present and simulation.walls["side"].is_present
        with pytest.raises(
            gf.GranflowError, match=r"walls\['floor'\] was removed at 0.01\d* s: it cannot move"
        ):
            simulation.walls["floor"].motion = gf.Translation(velocity=[0, 0, 1])
        simulation.run(duration=0.02)
        fallen = height + speed * 0.02 - 0.5 * GRAVITY * 0.02**2
        assert simulation.particles.position[0, 2] == pytest.approx(fallen, abs=1e-5)
        totals = simulation.snapshot().totals
        assert totals["contact_count"] == 0 and abs(totals["energy_error"]) < 5e-3
        assert not simulation.snapshot().walls["floor"].present


@pytest.mark.parametrize("moves_before", [False, True])
def test_a_motion_starts_from_the_present_pose_at_the_present_time(moves_before, taichi_f64):
    """The floor rises at 0.1 m/s from 5 ms on, and the side wall turns about a point on it at 1, then 3 and 2 rad/s:
    the angle is the sum. In the first case no wall moves before, so that kernels are compiled."""
    motion = [{"kind": "translation", "velocity": [0.2, 0.0, 0.0]}] if moves_before else ()
    with gf.Simulation(resting(motion)) as simulation:
        floor, side = simulation.walls["floor"], simulation.walls["side"]
        simulation.run(until=5e-3)
        start = simulation.time
        before = floor.pose.offset
        floor.motion = gf.Translation(velocity=[0.0, 0.0, "10 cm/s"])
        angle = 0.0
        for rate in (1.0, 3.0, 2.0):
            began = simulation.time
            side.motion = gf.Rotation(point=[0.5, 0, 0], axis=[0, 0, 2], angular_velocity=rate)
            simulation.run(duration=6e-3)
            angle += rate * (simulation.time - began)
        risen = [0.0, 0.0, 0.1 * (simulation.time - start)]
        np.testing.assert_allclose(floor.pose.offset, before + risen, atol=1e-12)
        assert simulation.particles.position[0, 2] > 0.004 + risen[2]
        assert simulation.snapshot().totals["wall_work"] > 0.0
        turned = [[0.5, 0.0, 0.0], [0.5 - math.sin(angle), math.cos(angle), 0.0]]
        points = np.array([[0.5, 0.0, 0.0], [0.5, 1.0, 0.0]])
        np.testing.assert_allclose(side.pose.moved(points), turned, atol=1e-12)
        floor.motion = None
        simulation.run(duration=1e-3)
        np.testing.assert_allclose(floor.pose.offset, before + risen, atol=1e-12)


def test_placement_continues_any_motion():
    """The pose is continuous, and a rotation about another axis turns the placed wall as a rigid body: its
    largest speed is that of the corner that is farthest from the axis."""
    earlier = (
        rotation((0.1, 0.2, 0.0), (0.0, 0.0, 1.0), 2.0),
        translation((0.3, 0.0, 0.1)),
        vibration((0.0, 1.0, 0.0), 0.01, 50.0),
    )
    points = np.random.default_rng(1).normal(size=(5, 3))
    time = 0.4

    def moved(motions, at, points=points):
        found = poses_at(motions, np.array([at]))
        return (points - found.pivot) @ found.rotation[0].T + found.pivot + found.offset[0]

    placed = placement_at(earlier, time)
    rate = 1.5
    turning = rotation((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), rate, start=time)
    later = (placed, translation((0.0, 0.0, 0.2), start=time), turning)
    before = moved(earlier, time)
    np.testing.assert_allclose(moved(later, time), before, atol=1e-12)
    cosine = math.cos(rate * 0.3)
    sine = math.sin(rate * 0.3)
    about_y = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    expected = (before - [1.0, 0.0, 0.0]) @ about_y.T + [1.0, 0.0, 0.06]
    np.testing.assert_allclose(moved(later, time + 0.3), expected, atol=1e-12)
    plate = rectangle([0.3, 0.2, 0.1], [0.4, 0.0, 0.0], [0.0, 0.0, 0.5])
    corners = moved((placed,), time, plate.triangles((0, 0, 0), 1.0)[0]) - [1.0, 0.0, 0.0]
    speed = geometry_speed(plate, (placed, turning), SimpleNamespace(on_exit="expand"), 1.0)
    assert speed == pytest.approx(rate * np.hypot(corners[:, 0], corners[:, 2]).max())


def test_changes_that_are_not_possible_are_refused(taichi_f64):
    with gf.Simulation(resting()) as simulation:
        with pytest.raises(
            gf.GranflowError, match="'flor' is not a wall of the scene; its walls are floor, side"
        ):
            simulation.walls["flor"].remove()
        for motion, message in (
            (gf.Translation(velocity=[1e4, 0.0, 0.0]), "at up to 1e.04 m/s, but at most"),
            ("fast", "must be a Vibration, Translation, Rotation, Oscillation, SurfaceVelocity"),
        ):
            with pytest.raises(gf.GranflowError, match=message):
                simulation.walls["side"].motion = motion
    servo = [{"kind": "servo", "direction": [0, 0, -1], "force": 1.0, "velocity_max": 0.1}]
    with pytest.raises(gf.GranflowError, match="is force-controlled"):
        with_motions(plan_for(resting(servo)), "floor", [], 0.0, [])


def test_an_added_wall_moves_the_numbers_of_triangles_only():
    """Wall w is partner -1 - w, triangle t of n walls is partner -1 - n - t, particles are at least 0."""
    before, now = SimpleNamespace(walls=[0, 1]), SimpleNamespace(walls=[0, 1, 2])
    assert renumbered(np.array([0, 7, -1, -2, -3, -4]), before, now).tolist() == [0, 7, -1, -2, -4, -5]
