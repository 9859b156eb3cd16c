"""Walls with a surface velocity (belts) against the mechanics of one sphere."""

import numpy as np
import pytest
from geometry.meshes import sheet, write
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


def belt(velocity=(SPEED, 0.0, 3.0), **more):
    """The component of the velocity across the surface has no effect."""
    return {"kind": "surface_velocity", "velocity": list(velocity), **more}


def rectangle(y, motion):
    """A rectangle whose corner is 2 cm from the place (0, y, 0)."""
    return {
        "shape": "rectangle", "corner": [-0.02, y - 0.02, 0.0], "sides": [[0.06, 0.0, 0.0], [0.0, 0.04, 0.0]],
        "material": "glass", "motion": motion,
    }  # fmt: skip


def test_spheres_on_belts_slip_and_then_roll(tmp_path, monkeypatch, taichi_f64):
    """Until ROLLING they accelerate at mu g and spin at (5/2) mu g / R; then u = (2/7) U and w R = -(5/7) U.

    The belt exerts mu m g, and its work is the transferred momentum times U, (2/7) m U^2. A wall that moves acts as
    a belt, and a belt that a stage stops decelerates the sphere: 7 u = 5 u0 + 2 R w0 = 0 conserves the angular
    momentum about the contact. A belt with the acceleration a = U/T below (7/2) mu g moves a sphere at u = (2/7) a t
    without slip; u oscillates with (2/7) a / w after each jump of the acceleration.

    The frames contain the velocity along the faces, the weight of a sphere over the area of its triangle, and no
    pressure on a half space, which has no area.
    """
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "two.stl", *sheet(1, 0.04))
    ramp = 1.2 * ROLLING
    walls = {
        "rectangle": rectangle(0.0, belt()),
        "disc": {"shape": "disc", "center": [0, 0.1, 0], "normal": [0, 0, 1], "radius": 0.03, "material": "glass", "motion": belt()},
        "plane": plane([0, 0, LOW], [0, 0, 1], motion=belt()),
        "mesh": {"shape": "mesh", "file": "two.stl", "translate": [-0.01, 0.2, 0], "material": "glass", "motion": belt()},
        "carrier": rectangle(-0.1, {"kind": "translation", "velocity": [SPEED, 0.0, 0.0]}),
        "stopped": rectangle(-0.2, belt(stages=["run"])),
        "slow": rectangle(-0.3, belt(ramp_duration=ramp)),
    }  # fmt: skip
    height = np.array([HEIGHT + LOW * (name == "plane") for name in walls])
    positions = np.stack(
        [[0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0], [0.0, 0.1, 0.0, 0.2, -0.1, -0.2, -0.3], height], axis=1
    )
    scene = build_scene(
        {"balls": particle_group(positions)}, walls, {"friction": FRICTION, "restitution": 0.8},
        materials={"glass": STIFF}, gravity=[0.0, 0.0, -GRAVITY], run={"velocity_max": 0.3},
        stages=[{"name": "run", "duration": 0.5 * ROLLING}, {"name": "stop", "duration": ROLLING}],
        output={"interval": 1.0, "energy_budget": True, "wall_forces": True},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 0.5 * ROLLING, out=tmp_path / "out")
    _, slipping, _, rolling = snapshots
    for name in [name for name in walls if name != "slow"]:
        force = slipping.impulses[name][:3] / slipping.time
        expected = [-FRICTION * MASS * GRAVITY, 0.0, -MASS * GRAVITY]
        np.testing.assert_allclose(force, expected, rtol=0.01, atol=1e-9)
        power = slipping.impulses[name][7] / slipping.time
        assert power == pytest.approx(FRICTION * MASS * GRAVITY * SPEED, rel=0.01)
        if name != "carrier":
            np.testing.assert_array_equal(rolling.walls[name].offset, 0.0)
    velocity = slipping.particles["velocity"][:-1, 0]
    np.testing.assert_allclose(velocity, FRICTION * GRAVITY * slipping.time, rtol=0.01)
    end = SPEED * (np.array(list(walls)) != "stopped")
    np.testing.assert_allclose(rolling.particles["velocity"][:, 0], 2 / 7 * end, rtol=0.0, atol=RINGING)
    rotation = RADIUS * rolling.particles["angular_velocity"]
    np.testing.assert_allclose(rotation[:, 1], -5 / 7 * end, rtol=0.0, atol=2.5 * RINGING)
    np.testing.assert_array_equal(rolling.walls["stopped"].surface_velocity, 0.0)
    for snapshot in snapshots[1:]:
        expected = 2 / 7 * SPEED * min(snapshot.time / ramp, 1.0)
        ringing = 2 / 7 * SPEED / ramp / OMEGA * (1 if snapshot.time < ramp else 2)
        assert snapshot.particles["velocity"][-1, 0] == pytest.approx(expected, abs=ringing + 1e-7)
    # the belts that stop and that start slowly transfer half of the momentum of the others, and at half of the speed
    work = 6 * 2 / 7 * MASS * SPEED**2
    assert rolling.totals["wall_work"] == pytest.approx(work, abs=7 * MASS * SPEED * RINGING)
    assert abs(rolling.totals["energy_error"]) < 1e-3
    frame = read_mesh(tmp_path / "out" / "walls_0000.vtu").cell_data
    on = {name: frame["wall"][0] == index for index, name in enumerate(walls)}
    for name, speed in (("rectangle", SPEED), ("mesh", SPEED), ("carrier", 0.0), ("plane", SPEED)):
        velocity = frame["surface_velocity"][0][on[name]]
        np.testing.assert_allclose(velocity, [[speed, 0, 0]] * on[name].sum(), atol=1e-7)
    pressure, traction = (frame[name][0] for name in ("pressure", "traction"))
    assert np.isnan(pressure[on["plane"]]).all() and pressure[on["rectangle"]].min() > 0.0
    np.testing.assert_allclose(sorted(pressure[on["mesh"]]), [0.0, MASS * GRAVITY / 0.0008], rtol=1e-5)
    np.testing.assert_allclose(traction[on["mesh"]][:, 2], -pressure[on["mesh"]], rtol=1e-6)
