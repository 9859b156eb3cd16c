"""Walls with a surface velocity (belts), and motions with a ramp, against the mechanics of one sphere."""

import numpy as np
import pytest
from geometry.meshes import sheet, write
from resume.runs import files_of, states_of
from resume.test_bit_identity import resume_copy, run_to_end
from scene_builders import SOFT, build_scene, particle_group, plane, run_and_sample

from granflow.contact import theory
from granflow.io.frames import read_mesh
from granflow.scene.blocks.motions import SurfaceVelocity
from granflow.simulation import Simulation

RADIUS, GRAVITY, FRICTION, SPEED = 0.005, 9.81, 0.2, 0.1
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * 2500.0
STIFF = SOFT | {"young_modulus": 1e10}
STIFFNESS = theory.hertz_stiffness(STIFF["young_modulus"] / (2 * (1 - STIFF["poisson_ratio"] ** 2)), RADIUS)
HEIGHT = RADIUS - (MASS * GRAVITY / STIFFNESS) ** (2 / 3)
"""Height of the center of a sphere at rest on a floor [m]."""

ROLLING = 2 / 7 * SPEED / (FRICTION * GRAVITY)
"""Time [s] at which a sphere placed on a belt rolls: u = mu g t and w R = -(5/2) mu g t reach u - w R = U."""

MODULUS = STIFF["young_modulus"] / (4 * (1 + STIFF["poisson_ratio"]) * (2 - STIFF["poisson_ratio"]))
OMEGA = np.sqrt(3.5 * 8 * MODULUS * np.sqrt(RADIUS * (RADIUS - HEIGHT)) / MASS)
"""Angular frequency [rad/s] of a sphere that sticks, w^2 = (7/2) Kt/m with Kt = 8 G sqrt(R d) (Mindlin,
undamped)."""

RINGING = FRICTION * GRAVITY / OMEGA
"""Amplitude mu g / w [m/s] of the velocity of a sphere that begins to stick with a fully loaded spring."""


def belt(velocity=(SPEED, 0.0, 0.0), **more):
    return {"kind": "surface_velocity", "velocity": list(velocity), **more}


def rectangle(motion, corner=(-0.02, -0.02, 0.0), sides=((0.06, 0.0, 0.0), (0.0, 0.04, 0.0))):
    return {
        "shape": "rectangle", "corner": list(corner), "sides": [list(side) for side in sides], "material": "glass",
        "motion": motion,
    }  # fmt: skip


def scene_on(wall, position=(0.0, 0.0, HEIGHT), **parts):
    """A sphere at rest on a wall."""
    return scene_of({"belt": wall}, [position], **parts)


def scene_of(walls, positions, **parts):
    """Spheres at rest on walls."""
    defaults = {
        "pair": {"friction": FRICTION, "restitution": 0.8}, "gravity": [0.0, 0.0, -GRAVITY],
        "run": {"duration": 1.5 * ROLLING, "velocity_max": 0.3},
        "output": {"interval": 1.0, "energy_budget": True, "wall_forces": True}, "materials": {"glass": STIFF},
    }  # fmt: skip
    return build_scene({"balls": particle_group(positions)}, walls=walls, **(defaults | parts))


@pytest.fixture
def walls(tmp_path, monkeypatch):
    """Belts of one plane, of three shapes side by side, and a moving plane, with a place on each.

    The component of their velocity across the surface has no effect.
    """
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "sheet.stl", *sheet(16, 0.05))
    motion = belt((SPEED, 0.0, 3.0))
    rest = {"material": "glass", "motion": motion}
    disc = {"shape": "disc", "center": [0, 0.1, 0], "normal": [0, 0, 1], "radius": 0.03} | rest
    mesh = {"shape": "mesh", "file": "sheet.stl", "translate": [0.0, 0.2, 0.0]} | rest
    return {
        "plane": ({"plane": plane([0, 0, 0], [0, 0, 1], motion=motion)}, [0.0]),
        "shapes": (
            {"rectangle": rectangle(motion), "disc": disc, "mesh": mesh},
            [0.0, 0.1, 0.2],
        ),
        "translation": (
            {"plane": plane([0, 0, 0], [0, 0, 1], motion={"kind": "translation", "velocity": [SPEED, 0.0, 0.0]})},
            [0.0],
        ),
    }  # fmt: skip


@pytest.mark.parametrize("kind", ["plane", "shapes", "translation"])
def test_spheres_on_belts_slip_and_then_roll(walls, kind, taichi_f64):
    """Until ROLLING they accelerate at mu g and spin at (5/2) mu g / R; then u = (2/7) U and w R = -(5/7) U.

    The belt exerts mu m g, and its work is the transferred momentum times U, (2/7) m U^2. The mesh of 3 mm
    triangles is crossed along their edges.
    """
    belts, places = walls[kind]
    snapshots = run_and_sample(scene_of(belts, [(0.0, y, HEIGHT) for y in places]), 0.5 * ROLLING)
    slipping = snapshots[1]
    rolling = snapshots[-1]
    count = len(belts)
    for name in belts:
        force = slipping.impulses[name][:3] / slipping.time
        np.testing.assert_allclose(
            force, [-FRICTION * MASS * GRAVITY, 0.0, -MASS * GRAVITY], rtol=0.01, atol=1e-9
        )
        if kind != "translation":
            np.testing.assert_array_equal(rolling.walls[name].offset, 0.0)
    velocity, angular_velocity = (rolling.particles[name] for name in ("velocity", "angular_velocity"))
    np.testing.assert_allclose(velocity, [[2 / 7 * SPEED, 0.0, 0.0]] * count, rtol=0.0, atol=RINGING)
    expected = [[0.0, -5 / 7 * SPEED, 0.0]] * count
    np.testing.assert_allclose(RADIUS * angular_velocity, expected, rtol=0.0, atol=2.5 * RINGING)
    work = count * 2 / 7 * MASS * SPEED**2
    assert rolling.totals["wall_work"] == pytest.approx(work, abs=count * MASS * SPEED * RINGING)
    assert abs(rolling.totals["energy_error"]) < 1e-3


def test_a_sphere_rolls_on_a_belt_that_starts_slowly(taichi_f64):
    """A belt with the acceleration a = U/T below (7/2) mu g moves a sphere at u = (2/7) a t without slip.

    The spring is loaded by the jumps of the acceleration, two in the ramp: u oscillates with (2/7) a / w
    after each.
    """
    ramp = 0.1
    scene = scene_on(rectangle(belt(ramp_duration=ramp)), run={"duration": 1.5 * ramp, "velocity_max": 0.3})
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
    wall = plane([0, 0, 0], [0, 0, 1], motion=[turning, belt((1000.0, 0.0, 0.0))])
    snapshots = run_and_sample(scene_on(wall, run={"duration": 0.0101, "velocity_max": 1.0}), 1e-4)
    impulses = np.array([each.impulses["belt"][:2] for each in snapshots])
    first, last = impulses[1] - impulses[0], impulses[-1] - impulses[-2]
    np.testing.assert_allclose(first / np.linalg.norm(first), [-1.0, 0.0], atol=0.02)
    np.testing.assert_allclose(last / np.linalg.norm(last), [0.0, -1.0], atol=0.02)


def test_the_edge_of_a_belt_does_no_work_without_friction(taichi_f64):
    """At the edge the normal is inclined; the surface velocity is in the plane of the contact, across the
    normal."""
    wall = rectangle(belt(), sides=((0.02, 0.0, 0.0), (0.0, 0.04, 0.0)))
    frictionless = {"friction": 0.0, "restitution": 1.0}
    snapshots = run_and_sample(
        scene_on(
            wall,
            position=(0.003, 0.0, HEIGHT),
            pair=frictionless,
            run={"duration": 0.05, "velocity_max": 1.0},
        ),
        0.05,
    )
    assert snapshots[-1].particles["velocity"][0, 0] > 0.1, "the sphere has slid off the edge"
    total = snapshots[-1].totals
    assert abs(total["wall_work"]) < 1e-12 * MASS * GRAVITY * RADIUS
    assert abs(total["energy_error"]) < 1e-3


def test_a_stage_stops_the_belt(taichi_f64):
    """The belt is at rest after its stage: friction decelerates a slipping sphere, to 5/7 of its speed at
    last."""
    stages = [{"name": "run", "duration": 0.5 * ROLLING}, {"name": "stop", "duration": ROLLING}]
    motion = belt(stages=["run"])
    scene = scene_on(rectangle(motion), run={"velocity_max": 0.3}, stages=stages)
    snapshots = run_and_sample(scene, 0.5 * ROLLING)
    speed = FRICTION * GRAVITY * 0.5 * ROLLING
    spin = -2.5 * FRICTION * GRAVITY * 0.5 * ROLLING
    assert snapshots[1].particles["velocity"][0, 0] == pytest.approx(speed, rel=5e-3)
    # 7 u = 5 u0 + 2 R w0 conserves the angular momentum about the contact.
    expected = (5 * speed + 2 * spin) / 7
    assert expected == pytest.approx(0.0, abs=1e-15)
    assert snapshots[-1].particles["velocity"][0, 0] == pytest.approx(expected, abs=RINGING)
    np.testing.assert_array_equal(snapshots[-1].walls["belt"].surface_velocity, 0.0)


def test_frames_contain_the_velocity_along_the_faces(tmp_path, taichi_f64):
    walls = {
        "belt": rectangle(belt((SPEED, 0.0, 1.0))),
        "chute": rectangle([], corner=(-0.02, -0.02, -0.01)) | {"motion": []},
    }
    scene = build_scene(
        {"ball": particle_group([[0.0, 0.0, 0.02]])}, walls=walls, run={"duration": 1e-3, "velocity_max": 1.0},
        output={"interval": 1e-3},
    )  # fmt: skip
    simulation = Simulation(scene, out=tmp_path / "out")
    simulation.run()
    simulation.free()
    found = read_mesh(tmp_path / "out" / "walls_0000.vtu").cell_data["surface_velocity"][0]
    np.testing.assert_allclose(found, [[SPEED, 0, 0]] * 2 + [[0, 0, 0]] * 2, atol=1e-7)


def test_restart_on_a_ramping_belt_is_bit_identical(tmp_path, taichi_f64):
    output = {
        "interval": 2e-3,
        "energy_budget": True,
        "wall_forces": True,
        "checkpoint": {"interval": 1e-3, "keep": 100},
    }
    stages = [{"name": "first", "duration": 4e-3}, {"name": "second", "duration": 8e-3}]
    motion = belt(ramp_duration=5e-3, initial_velocity=[0.0, 0.05, 0.0], stages=["second"])
    scene = scene_on(rectangle(motion), output=output, stages=stages, run={"velocity_max": 0.3})
    checkpoints = run_to_end(scene, tmp_path / "whole")
    resume_copy(scene, tmp_path / "whole", tmp_path / "parts", checkpoints[6])
    assert files_of(tmp_path / "parts") == files_of(tmp_path / "whole")
    assert states_of(tmp_path / "parts") == states_of(tmp_path / "whole")


def test_a_wall_becomes_a_belt_while_the_simulation_runs(taichi_f64):
    """From then on a sphere at rest accelerates at mu g; before, the scene has no moving wall."""
    scene = scene_on({name: value for name, value in rectangle([]).items() if name != "motion"})
    with Simulation(scene) as simulation:
        simulation.run(until=2e-3)
        began = simulation.time
        assert abs(simulation.particles.velocity[0, 0]) < 1e-12
        simulation.walls["belt"].motion = SurfaceVelocity(velocity=[SPEED, 0, 0])
        simulation.run(until=2e-3 + 0.5 * ROLLING)
        expected = FRICTION * GRAVITY * (simulation.time - began)
        assert simulation.particles.velocity[0, 0] == pytest.approx(expected, rel=0.01)
        np.testing.assert_array_equal(simulation.walls["belt"].pose.offset, 0.0)
