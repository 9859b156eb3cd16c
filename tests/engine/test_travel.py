"""Limit of the displacement per step: no center crosses a thin wall; the plan refuses faster motions.

Aborts of runs above the limit: `test_limit_bounds`, `test_precisions`.
"""

from pathlib import Path

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane, run_to_end

from granflow.errors import RunError, SceneError
from granflow.plan.build import plan_for
from granflow.simulation import Simulation

RADIUS, SHARE = 0.005, 0.2
STEP = 1e-5
FASTEST = SHARE * RADIUS / STEP
"""Speed [m/s] at which a particle moves a fifth of its radius in one step: 100 m/s."""

FAST = {
    "run": {"duration": 2.4e-3, "velocity_max": 1.0, "time_step": STEP},
    "numerics": {"skin": 0.003, "chunk_size": 16},
}
STIFF = {"young_modulus": 1e10, "poisson_ratio": 0.25, "density": 2500.0}
"""An impact of 100 m/s on a wall overlaps by d = (15 M v^2 / (16 E* sqrt(R)))^0.4 = 0.2 R."""

THIN_WALL = {
    "shape": "rectangle",
    "corner": [-0.5, -0.5, 0.0],
    "sides": [[1, 0, 0], [0, 1, 0]],
    "material": "glass",
}


@pytest.fixture
def thin_walls(tmp_path, monkeypatch):
    """A rectangle, a disc and a mesh of two triangles in the plane z = 0, side by side along y."""
    monkeypatch.chdir(tmp_path)
    Path("sheet.obj").write_text("v -0.5 0.2 0\nv 0.5 0.2 0\nv 0.5 0.4 0\nv -0.5 0.4 0\nf 1 2 3\nf 1 3 4\n")
    walls = {
        "rectangle": {"shape": "rectangle", "corner": [-0.5, -0.4, 0.0], "sides": [[1, 0, 0], [0, 0.2, 0]]},
        "disc": {"shape": "disc", "center": [0, 0, 0], "normal": [0, 0, 1], "radius": 0.1},
        "mesh": {"shape": "mesh", "file": "sheet.obj"},
    }
    return {name: wall | {"material": "glass"} for name, wall in walls.items()}


def test_fast_particles_do_not_cross_thin_walls(taichi_f64, thin_walls):
    """Particles on both sides, at heights that differ by fractions of the displacement per step."""
    speed = 0.9 * FASTEST
    xs, ys, sides = np.meshgrid(0.03 * np.arange(5) - 0.06, [-0.3, 0.0, 0.3], [-1.0, 1.0], indexing="ij")
    heights = 0.02 + speed * STEP * (np.arange(xs.size) / xs.size)
    positions = np.stack([(xs + 0.0075 * sides).ravel(), ys.ravel(), sides.ravel() * heights], axis=1)
    numerics = FAST["numerics"] | {"max_overlap": 0.5}
    toward = np.outer(-speed * np.sign(positions[:, 2]), [0.0, 0.0, 1.0])
    parts = FAST | {"numerics": numerics, "materials": {"glass": STIFF}, "pair": {"restitution": 0.5}}
    scene = build_scene({"fast": particle_group(positions)}, thin_walls, **parts)
    with Simulation(scene) as simulation:
        simulation.particles.velocity[:] = toward  # after planning, so that the plan does not refuse them
        simulation.run(until=6e-4)
        last = simulation.snapshot().particles
    assert np.all(np.sign(positions[:, 2]) * last["position"][:, 2] > RADIUS)
    assert np.all(np.sign(positions[:, 2]) * last["velocity"][:, 2] > 0.0)
    with Simulation(scene) as simulation:  # the message considers the contacts with all walls
        simulation.particles.velocity[:] = 1.12 * toward
        with pytest.raises(RunError, match="m in one step of 1e-05 s, above the limit of 0.001 m"):
            simulation.run(until=6e-4)


ROTATION = {"kind": "rotation", "point": [0, 0, 0], "axis": [1, 0, 0]}
TRANSLATION = {"kind": "translation"}
PADDLE = r"walls.paddle moves at up to 100 m/s, which is 0.001 m per step of 1e-05 s"
LIMITS = {
    "particle": (
        None,
        "velocity",
        [0, 0, -FASTEST],
        "particles.ball starts with 100 m/s, which is 0.001 m per",
    ),
    # the surface moves w R dt per step: 0.2 R at w = 0.2 / 10 us = 20 000 rad/s
    "spinning particle": (
        None,
        "angular_velocity",
        [0, 20_000.0, 0],
        "2e.04 rad/s, which is 0.2 rad per step of",
    ),
    "translation": (TRANSLATION, "velocity", [0, 0, FASTEST], PADDLE),
    "rotating paddle, which reaches 0.5 m": (ROTATION, "angular_velocity", 2.0 * FASTEST, PADDLE),
    "half of a thin skin": (TRANSLATION, "velocity", [0, 0, 0.5 * FASTEST], "above the limit of 0.0005 m"),
}
"""Motion of a wall (None: of a particle), the key that sets its speed, its value at the limit, and the message."""


@pytest.mark.parametrize("name", LIMITS)
def test_motion_above_the_limit_per_step_is_refused_by_the_plan(name):
    """With a thin skin, neighbors are missing in the first step after a rebuild."""
    motion, key, value, message = LIMITS[name]

    def plan_at(share):
        moving = {key: (share * np.array(value)).tolist()}
        ball = particle_group([[0.05] * 3], **({} if motion else moving))
        walls = {"paddle": THIN_WALL | {"motion": [motion | moving]}} if motion else None
        skin = {"numerics": {"skin": 0.001, "chunk_size": 16}} if "skin" in name else {}
        return plan_for(build_scene({"ball": ball}, walls, **(FAST | skin)))

    plan_at(0.999)
    with pytest.raises(SceneError, match=message):
        plan_at(1.001)


def test_the_chosen_step_respects_the_limit_at_the_planned_velocity():
    """A soft particle: its contacts at 100 m/s allow a displacement of 6 mm per step."""
    soft = {"young_modulus": 1e3, "poisson_ratio": 0.25, "density": 2500.0}
    ball, run = particle_group([[0.0] * 3]), {"duration": 1.0, "velocity_max": 100.0}
    plan = plan_for(build_scene({"ball": ball}, materials={"glass": soft}, run=run))
    assert plan.time_step == pytest.approx(SHARE * RADIUS / 100.0, rel=1e-12)
    assert "0.2 of the smallest radius" in plan.step.limited_by


def test_images_of_a_sheared_box_that_move_too_far_per_step_are_refused():
    shear = {"flow": "x", "gradient": "y", "rate": 1.001 * FASTEST / 0.1}
    domain = {
        "min": [0] * 3,
        "max": [0.1] * 3,
        "periodic": ["x", "y"],
        "on_exit": "error",
        "lees_edwards": shear,
    }
    with pytest.raises(
        SceneError, match="domain.lees_edwards moves the images at 100 m/s, which is 0.001 m per"
    ):
        plan_for(build_scene({"ball": particle_group([[0.05] * 3])}, domain=domain, **FAST))


def test_wall_that_moves_far_between_rebuilds_hits_a_particle_at_rest(taichi_f64):
    """No particle moves, so that the wall alone requests the rebuilds; v = (1 + e) V. A free wall is out of reach:
    the structure of `test_limit_bounds`."""
    motion = {"kind": "translation", "velocity": [1, 0, 0]}
    walls = {
        "wall": plane([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], motion=[motion]),
        "free": plane([0.9, 0.0, 0.0], [-1.0, 0.0, 0.0], motion={"kind": "free", "direction": [1, 0, 0], "mass": 1.0}),
    }  # fmt: skip
    run = {"duration": 0.06, "velocity_max": 2.0}
    ball = {"ball": particle_group([[0.05, 0.0, 0.0]])}
    last, _ = run_to_end(build_scene(ball, walls, run=run, numerics={"skin": 5e-4}))
    assert last.particles["velocity"][0, 0] == pytest.approx(1.8, rel=1e-3)
