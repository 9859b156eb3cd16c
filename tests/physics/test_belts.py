"""Walls with a surface velocity (belts), and motions with a ramp, against the mechanics of one sphere."""

import numpy as np
import pytest
from scene_builders import SOFT, build_scene, particle_group, plane, run_and_sample

from granflow.contact import theory
from granflow.io.frames import read_mesh

RADIUS, GRAVITY, FRICTION, SPEED = 0.005, 9.81, 0.2, 0.1
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * 2500.0
STIFF = SOFT | {"young_modulus": 1e10}
STIFFNESS = theory.hertz_stiffness(STIFF["young_modulus"] / (2 * (1 - STIFF["poisson_ratio"] ** 2)), RADIUS)
HEIGHT = RADIUS - (MASS * GRAVITY / STIFFNESS) ** (2 / 3)
"""Height of the center of a sphere at rest on a floor [m]."""
LOW = -0.1
"""Height [m] of the half space below the other walls."""

ROLLING = 2 / 7 * SPEED / (FRICTION * GRAVITY)
"""Time [s] at which a sphere placed on a belt rolls: u = mu g t and w R = -(5/2) mu g t reach u - w R = U."""

MODULUS = STIFF["young_modulus"] / (4 * (1 + STIFF["poisson_ratio"]) * (2 - STIFF["poisson_ratio"]))
OMEGA = np.sqrt(3.5 * 8 * MODULUS * np.sqrt(RADIUS * (RADIUS - HEIGHT)) / MASS)
"""Angular frequency [rad/s] of a sphere that sticks, w^2 = (7/2) Kt/m with Kt = 8 G sqrt(R d) (Mindlin,
undamped)."""

RINGING = FRICTION * GRAVITY / OMEGA
"""Amplitude mu g / w [m/s] of the velocity of a sphere that begins to stick with a fully loaded spring."""
PARTS = {
    "pair": {"friction": FRICTION, "restitution": 0.8}, "gravity": [0.0, 0.0, -GRAVITY],
    "materials": {"glass": STIFF, "smooth": STIFF}, "pairs": {"glass-smooth": {"friction": 0.0, "restitution": 1.0}},
    "output": {"interval": 1.0, "energy_budget": True, "wall_forces": True},
}  # fmt: skip


def belt(velocity=(SPEED, 0.0, 0.0), **more):
    return {"kind": "surface_velocity", "velocity": list(velocity), **more}


def rectangle(motion, y=0.0, length=0.06, material="glass"):
    """A rectangle whose corner is 2 cm from the place (0, y, 0)."""
    return {
        "shape": "rectangle", "corner": [-0.02, y - 0.02, 0.0], "sides": [[length, 0.0, 0.0], [0.0, 0.04, 0.0]],
        "material": material, "motion": motion,
    }  # fmt: skip


def scene_on(positions, walls=None, **parts):
    """Spheres at rest on belts, which have components of their velocity across the surface, without an effect.

    All these scenes have the same kinds of walls and share their compiled kernels. Belts of meshes are those of
    test_mesh_walls.py.
    """
    motion = belt((SPEED, 0.0, 3.0))
    disc = {"shape": "disc", "center": [0, 0.1, 0], "normal": [0, 0, 1], "radius": 0.03, "material": "glass"}
    all_kinds = {
        "rectangle": rectangle(motion),
        "disc": disc | {"motion": motion},
        "plane": plane([0, 0, LOW], [0, 0, 1], motion=motion),
        "carrier": rectangle({"kind": "translation", "velocity": [SPEED, 0.0, 0.0]}, -0.1),
    }
    return build_scene({"balls": particle_group(positions)}, all_kinds | (walls or {}), **(PARTS | parts))


def test_spheres_on_belts_slip_and_then_roll(tmp_path, taichi_f64):
    """Until ROLLING they accelerate at mu g and spin at (5/2) mu g / R; then u = (2/7) U and w R = -(5/7) U.

    The belt exerts mu m g, and its work is the transferred momentum times U, (2/7) m U^2. A wall that moves
    acts as a belt, and a belt that a stage stops decelerates the sphere: 7 u = 5 u0 + 2 R w0 = 0 conserves the
    angular momentum about the contact. The frames contain the velocity along the faces, and no pressure on a half
    space, which has no area.
    """
    walls = {"stopped": rectangle(belt(stages=["run"]), -0.2)}
    stages = [{"name": "run", "duration": 0.5 * ROLLING}, {"name": "stop", "duration": ROLLING}]
    places = {"rectangle": 0.0, "disc": 0.1, "carrier": -0.1, "plane": 0.0, "stopped": -0.2}
    positions = [(0.3 * (n == "plane"), y, HEIGHT + LOW * (n == "plane")) for n, y in places.items()]
    scene = scene_on(positions, walls, stages=stages, run={"velocity_max": 0.3})
    _, slipping, _, rolling = run_and_sample(scene, 0.5 * ROLLING, out=tmp_path / "out")
    for name in places:
        force = slipping.impulses[name][:3] / slipping.time
        np.testing.assert_allclose(
            force, [-FRICTION * MASS * GRAVITY, 0.0, -MASS * GRAVITY], rtol=0.01, atol=1e-9
        )
        power = slipping.impulses[name][7] / slipping.time
        assert power == pytest.approx(FRICTION * MASS * GRAVITY * SPEED, rel=0.01)
        if name != "carrier":
            np.testing.assert_array_equal(rolling.walls[name].offset, 0.0)
    np.testing.assert_allclose(
        slipping.particles["velocity"][:, 0], FRICTION * GRAVITY * slipping.time, rtol=0.01
    )
    end = SPEED * (np.array(list(places)) != "stopped")
    np.testing.assert_allclose(rolling.particles["velocity"][:, 0], 2 / 7 * end, rtol=0.0, atol=RINGING)
    rotation = RADIUS * rolling.particles["angular_velocity"]
    np.testing.assert_allclose(rotation[:, 1], -5 / 7 * end, rtol=0.0, atol=2.5 * RINGING)
    np.testing.assert_array_equal(rolling.walls["stopped"].surface_velocity, 0.0)
    # the belt that stops has transferred half of the momentum of the others
    work = 4.5 * 2 / 7 * MASS * SPEED**2
    assert rolling.totals["wall_work"] == pytest.approx(work, abs=5 * MASS * SPEED * RINGING)
    assert abs(rolling.totals["energy_error"]) < 1e-3
    frame = read_mesh(tmp_path / "out" / "walls_0000.vtu").cell_data
    on = {name: frame["wall"][0] == index for index, name in enumerate(scene.walls)}
    for name, speed in (("rectangle", SPEED), ("carrier", 0.0), ("plane", SPEED)):
        velocity = frame["surface_velocity"][0][on[name]]
        np.testing.assert_allclose(velocity, [[speed, 0, 0]] * on[name].sum(), atol=1e-7)
    assert (
        np.isnan(frame["pressure"][0][on["plane"]]).all()
        and frame["pressure"][0][on["rectangle"]].min() > 0.0
    )


def test_a_sphere_rolls_on_a_belt_that_starts_slowly(taichi_f64):
    """A belt with the acceleration a = U/T below (7/2) mu g moves a sphere at u = (2/7) a t without slip.

    The spring is loaded by the jumps of the acceleration, two in the ramp: u oscillates with (2/7) a / w
    after each.
    """
    ramp = 0.03
    walls = {"rectangle": rectangle(belt(ramp_duration=ramp))}
    scene = scene_on((0.0, 0.0, HEIGHT), walls, run={"duration": 1.5 * ramp, "velocity_max": 0.3})
    for snapshot in run_and_sample(scene, 0.25 * ramp)[1:]:
        expected = 2 / 7 * SPEED * min(snapshot.time / ramp, 1.0)
        ringing = 2 / 7 * SPEED / ramp / OMEGA * (1 if snapshot.time < ramp else 2)
        assert snapshot.particles["velocity"][0, 0] == pytest.approx(expected, abs=ringing + 1e-7)
    assert snapshot.totals["friction_dissipation"] < 1e-3 * snapshot.totals["wall_work"]


def test_the_surface_velocity_turns_with_the_wall(taichi_f64):
    """A turntable with a belt from its axis outward: the force on a slipping sphere turns with it by a right
    angle."""
    turning = {
        "kind": "rotation",
        "point": [0, 0, 0],
        "axis": [0, 0, 1],
        "angular_velocity": np.pi / 2 / 0.01,
    }
    walls = {"rectangle": rectangle([turning, belt((1000.0, 0.0, 0.0))])}
    scene = scene_on((0.0, 0.0, HEIGHT), walls, run={"duration": 0.0101, "velocity_max": 1.0})
    snapshots = run_and_sample(scene, 1e-4)
    impulses = np.array([each.impulses["rectangle"][:2] for each in snapshots])
    first, last = impulses[1] - impulses[0], impulses[-1] - impulses[-2]
    np.testing.assert_allclose(first / np.linalg.norm(first), [-1.0, 0.0], atol=0.02)
    np.testing.assert_allclose(last / np.linalg.norm(last), [0.0, -1.0], atol=0.02)


def test_the_edge_of_a_belt_does_no_work_without_friction(taichi_f64):
    """At the edge the normal is inclined; the surface velocity is in the plane of the contact, across the
    normal."""
    walls = {"rectangle": rectangle(belt(), length=0.02, material="smooth")}
    scene = scene_on((0.003, 0.0, HEIGHT), walls, run={"duration": 0.05, "velocity_max": 1.0})
    last = run_and_sample(scene, 0.05)[-1]
    assert last.particles["velocity"][0, 0] > 0.1, "the sphere has slid off the edge"
    assert abs(last.totals["wall_work"]) < 1e-12 * MASS * GRAVITY * RADIUS
    assert abs(last.totals["energy_error"]) < 1e-3
