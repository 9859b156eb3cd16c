"""Limit of the displacement per step: no center crosses a thin wall, on any code path and in any
precision."""

import re
from pathlib import Path

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane
from subprocess_runner import in_subprocess

from granflow.engine.fields import write_padded
from granflow.errors import RunError, SceneError
from granflow.plan.build import plan_for
from granflow.plan.time_step import STEP_SHARE
from granflow.simulation import Simulation

RADIUS, SHARE = 0.005, 0.2
STEP = 1e-5
FASTEST = SHARE * RADIUS / STEP
"""Speed [m/s] at which a particle moves a fifth of its radius in one step: 100 m/s."""

FAST = {"run": {"duration": 2.4e-3, "velocity_max": 1.0, "time_step": STEP}, "numerics": {"skin": 0.003}}
STIFF = {"young_modulus": 1e10, "poisson_ratio": 0.25, "density": 2500.0}
"""An impact of 100 m/s on a wall overlaps by d = (15 M v^2 / (16 E* sqrt(R)))^0.4 = 0.2 R."""

THIN_WALL = {
    "shape": "rectangle",
    "corner": [-0.5, -0.5, 0.0],
    "sides": [[1, 0, 0], [0, 1, 0]],
    "material": "glass",
}


def launched(velocity, group=None, walls=None, **parts):
    """A simulation that sets the velocity of its first particle after planning, so that the plan does not
    check it."""
    simulation = Simulation(
        build_scene({"fast": group or particle_group([[0.0, 0.0, 0.0]])}, walls=walls, **(FAST | parts))
    )
    simulation.engine.state.particles.velocity.fill(0.0)
    simulation.engine.state.particles.velocity[0] = list(velocity)
    return simulation


def abort_message(simulation):
    """Message of the abort, or an empty string."""
    try:
        simulation.run()
    except RunError as error:
        return str(error)
    finally:
        simulation.free()
    return ""


def messages_of(precision, on_gpu, few):
    """Messages just below and just above the limit, for one particle (`few`) or for 80 in chunks of
    several."""
    from granflow.engine import backend

    if on_gpu:
        backend.Backend.on_cpu = property(lambda self: False)
    positions = [[0.03 * (k % 9) - 0.12, 0.03 * (k // 9) - 0.12, 0.5] for k in range(1 if few else 80)]
    group = particle_group(positions)
    run = FAST["run"] | {"precision": precision}
    return [abort_message(launched((0.0, 0.0, -share * FASTEST), group, run=run)) for share in (0.999, 1.001)]


@pytest.mark.parametrize(("precision", "on_gpu", "few"), [("f32", False, False), ("mixed", False, False),
                                                          ("f64", True, True)])  # fmt: skip
def test_displacement_limit_in_each_precision_and_on_the_gpu_code_path(precision, on_gpu, few):
    below, above = in_subprocess(messages_of, precision, on_gpu, few)
    assert below == "" and "moves 0.001 m in one step" in above


def test_displacement_limit_and_its_message(taichi_f64):
    below, above = messages_of("f64", False, False)
    assert below == ""
    sentence = (
        "particle 0 (glass, 100 m/s) at 0 s moves 0.001 m in one step of 1e-05 s, above the limit of 0.001 m "
    )
    assert sentence + "(0.2 of the smallest radius 0.005 m): beyond it contacts can be missed." in above
    assert "numerics.skin" not in above
    suggested = float(above.partition("Lower run.time_step to ")[2].split()[0])
    assert suggested * 1.001 * FASTEST < SHARE * RADIUS


def thin_walls():
    """A rectangle, a disc and a mesh of two triangles in the plane z = 0, side by side along y."""
    Path("sheet.obj").write_text("v -0.5 0.2 0\nv 0.5 0.2 0\nv 0.5 0.4 0\nv -0.5 0.4 0\nf 1 2 3\nf 1 3 4\n")
    return {
        "rectangle": {"shape": "rectangle", "corner": [-0.5, -0.4, 0.0], "sides": [[1, 0, 0], [0, 0.2, 0]]},
        "disc": {"shape": "disc", "center": [0, 0, 0], "normal": [0, 0, 1], "radius": 0.1},
        "mesh": {"shape": "mesh", "file": "sheet.obj"},
    }


def test_fast_particles_do_not_cross_thin_walls(taichi_f64, tmp_path, monkeypatch):
    """Particles on both sides, at heights that differ by fractions of the displacement per step."""
    monkeypatch.chdir(tmp_path)
    speed = 0.9 * FASTEST
    xs, ys, sides = np.meshgrid(0.03 * np.arange(5) - 0.06, [-0.3, 0.0, 0.3], [-1.0, 1.0], indexing="ij")
    heights = 0.02 + speed * STEP * (np.arange(xs.size) / xs.size)
    positions = np.stack([(xs + 0.0075 * sides).ravel(), ys.ravel(), sides.ravel() * heights], axis=1)
    walls = {name: wall | {"material": "glass"} for name, wall in thin_walls().items()}
    numerics = FAST["numerics"] | {"max_overlap": 0.5}
    materials = {"glass": STIFF}
    simulation = launched(
        (0, 0, 0),
        particle_group(positions),
        walls,
        materials=materials,
        numerics=numerics,
        pair={"restitution": 0.5},
    )
    velocity = np.zeros(positions.shape)
    velocity[:, 2] = -speed * np.sign(positions[:, 2])
    write_padded(simulation.engine.state.particles.velocity, velocity)
    simulation.run(until=6e-4)
    last = simulation.snapshot().particles
    simulation.free()
    assert np.all(np.sign(positions[:, 2]) * last["position"][:, 2] > RADIUS)
    assert np.all(np.sign(positions[:, 2]) * last["velocity"][:, 2] > 0.0)


def test_velocity_that_would_cross_a_wall_aborts_the_run_for_any_skin(taichi_f64):
    """2500 m/s is 25 mm in a step of 10 us: from 12 mm above a wall to 13 mm below it."""
    walls = {"sheet": THIN_WALL}
    message = abort_message(
        launched((0, 0, -2500.0), particle_group([[0, 0, 0.012]]), walls, numerics={"skin": 0.03})
    )
    assert "moves 0.025 m in one step" in message


def test_initial_velocity_above_the_limit_is_rejected():
    for share, message in (
        (0.999, ""),
        (1.001, "particles.fast starts with 100 m/s, which is 0.001 m per step"),
    ):
        scene = build_scene(
            {"fast": particle_group([[0, 0, 0.1]], velocity=[0, 0, -share * FASTEST])}, **FAST
        )
        if message:
            with pytest.raises(SceneError, match=message):
                plan_for(scene)
        else:
            plan_for(scene)


def test_rotation_above_the_limit_per_step_is_rejected():
    """The surface moves w R dt per step: 0.2 R at w = 0.2 / 10 us = 20 000 rad/s."""
    for rate, message in (
        (19_990.0, ""),
        (20_010.0, "starts with 2e.04 rad/s, which is 0.2 rad per step of 1e-05 s"),
    ):
        group = particle_group([[0, 0, 0.1]], angular_velocity=[0, rate, 0])
        scene = build_scene({"spun": group}, run={"duration": 1.0, "velocity_max": 1.0, "time_step": 1e-5})
        if message:
            with pytest.raises(SceneError, match=message):
                plan_for(scene)
        else:
            plan_for(scene)


def moving(kind, speed, **parts):
    motion = {
        "translation": {"kind": "translation", "velocity": [0, 0, speed]},
        "vibration": {
            "kind": "vibration",
            "direction": [0, 0, 1],
            "amplitude": speed / 628.3,
            "frequency": 100.0,
        },
        "rotation": {
            "kind": "rotation",
            "point": [0, 0, 0],
            "axis": [1, 0, 0],
            "angular_velocity": speed / 0.5,
        },
    }
    walls = {"paddle": THIN_WALL | {"motion": [motion[kind]]}}
    return build_scene(
        {"ball": particle_group([[0, 0, 0.1]])},
        walls=walls,
        **(FAST | {"numerics": {"skin": 0.003}}),
        **parts,
    )


@pytest.mark.parametrize("kind", ["translation", "vibration", "rotation"])
def test_wall_velocity_above_the_limit_is_rejected(kind):
    """A paddle that rotates about its center reaches 0.5 m; half of the skin is larger than a fifth of the
    radius."""
    plan_for(moving(kind, 0.999 * FASTEST))
    with pytest.raises(
        SceneError, match=r"walls.paddle moves at up to 100 m/s, which is 0.001 m per step of 1e-05 s"
    ):
        plan_for(moving(kind, 1.001 * FASTEST))


def test_wall_displacement_above_half_a_skin_is_rejected():
    """Half of a 1 mm skin is 0.5 mm: above it, neighbors are missing in the first step after a rebuild."""
    thin = {"skin": 0.001}
    for share, refused in ((0.499, False), (0.501, True)):
        scene = moving("translation", share * FASTEST).model_copy(deep=True)
        scene = scene.model_copy(update={"numerics": scene.numerics.model_copy(update=thin)})
        if refused:
            with pytest.raises(SceneError, match="above the limit of 0.0005 m"):
                plan_for(scene)
        else:
            plan_for(scene)


@pytest.mark.parametrize(("share", "refused"), [(0.999, False), (1.001, True)])
def test_lees_edwards_image_velocity_above_the_limit_is_rejected(share, refused):
    rate = share * FASTEST / 0.1
    shear = {"flow": "x", "gradient": "y", "rate": rate}
    domain = {
        "min": [0] * 3,
        "max": [0.1] * 3,
        "periodic": ["x", "y"],
        "on_exit": "error",
        "lees_edwards": shear,
    }
    scene = build_scene({"ball": particle_group([[0.05] * 3])}, domain=domain, **FAST)
    if refused:
        with pytest.raises(
            SceneError, match="domain.lees_edwards moves the images at 100 m/s, which is 0.001 m per step"
        ):
            plan_for(scene)
    else:
        plan_for(scene)


@pytest.mark.parametrize(("share", "stops"), [(0.999, False), (1.001, True)])
def test_free_wall_above_the_limit_aborts_the_run(taichi_f64, share, stops):
    """A force F moves a wall of mass M from rest by F/M dt^2 (k - 1/2) in step k."""
    steps = 40
    mass = 1.0
    force = share * SHARE * RADIUS * mass / (STEP**2 * (steps - 0.5))
    motion = [{"kind": "free", "direction": [0, 0, 1], "mass": mass, "force": force}]
    walls = {"lid": plane([0, 0, -0.5], [0, 0, 1], motion=motion)}
    simulation = Simulation(build_scene({"ball": particle_group([[0, 0, 0.5]])}, walls=walls, **FAST))
    error = None
    try:
        simulation.run(until=steps * STEP)
    except RunError as stop:
        error = str(stop)
    simulation.free()
    assert bool(error) == stops
    if stops:
        assert re.search(r"wall lid \(glass, 100 m/s\) .* moves 0.001 m in one step", error)


def test_the_chosen_step_respects_the_limit_at_the_planned_velocity():
    """A soft particle: its contacts at 100 m/s allow a displacement of 6 mm per step."""
    soft = {"materials": {"glass": {"young_modulus": 1e3, "poisson_ratio": 0.25, "density": 2500.0}}}
    plan = plan_for(
        build_scene(
            {"ball": particle_group([[0.0] * 3])}, run={"duration": 1.0, "velocity_max": 100.0}, **soft
        )
    )
    assert plan.time_step == pytest.approx(SHARE * RADIUS / 100.0, rel=1e-12)
    assert "0.2 of the smallest radius" in plan.step.limited_by


def test_the_overlap_limit_stays_below_one_minus_the_limit_per_step():
    assert STEP_SHARE == pytest.approx(SHARE)
    build_scene({"ball": particle_group([[0.0] * 3])}, numerics={"max_overlap": 1.0 - SHARE})
    with pytest.raises(ValueError, match="an overlap limit must be above 0 and at most 0.8"):
        build_scene({"ball": particle_group([[0.0] * 3])}, numerics={"max_overlap": 0.801})
