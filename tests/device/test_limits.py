"""Runs that go wrong stop at once, say where and when, and leave the last state to look at."""

import re

import meshio
import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane
from subprocess_runner import in_subprocess

from granflow.errors import RunError
from granflow.observe import every
from granflow.simulation import Simulation

BAD = 2
"""Every scene here has spheres that are alright, and this one that is not (or the smaller of two)."""


def bystanders(*more):
    return {
        "good": particle_group([[0.3, 0.0, 0.0], [0.3, 0.1, 0.0]]),
        **{f"bad_{number}": group for number, group in enumerate(more)},
    }


SCENES = {
    "overlaps by more than": lambda: build_scene(
        bystanders(particle_group([[0.0, 0.0, 0.0]], velocity=[40.0, 0, 0]), particle_group([[0.012, 0.0, 0.0]])),
        run={"duration": 0.01, "velocity_max": 40.0},
    ),
    "above the limit": lambda: build_scene(
        bystanders(particle_group([[0.0, 0.0, 0.0]], velocity=[199.0, 0, 0])), gravity=[1e6, 0.0, 0.0],
        run={"duration": 0.01, "velocity_max": 1.0, "time_step": 5e-6}, numerics={"skin": 1e-3},
    ),
    "is not a number": lambda: build_scene(bystanders(particle_group([[0.0, 0.0, 0.0]])), run={"duration": 0.01}),
}  # fmt: skip


@pytest.mark.parametrize("reason", SCENES)
def test_guard_stops_the_run_names_particle_and_time_and_leaves_a_frame(taichi_f64, tmp_path, reason):
    def spoil(snapshot):
        if reason == "is not a number" and snapshot.time > 0.0:
            particles = simulation.engine.state.particles
            particles.velocity[int(np.flatnonzero(particles.id.to_numpy() == BAD)[0])] = [float("nan")] * 3

    simulation = Simulation(SCENES[reason](), out=tmp_path, observers=[every(1e-4, spoil)])
    with pytest.raises(RunError) as stopped:
        simulation.run()
    message = str(stopped.value)
    assert reason in message
    assert f"particle {BAD} " in message
    time = float(re.search(r"at ([\d.e+-]+) s", message).group(1))
    assert time == pytest.approx(simulation.time, rel=1e-5)
    assert time < 0.001
    assert str(tmp_path) in message
    assert ("is not written" in message) == (reason == "is not a number")
    frames = sorted(tmp_path.rglob("*.vtu"))
    assert any("particles" in frame.name for frame in frames[-2:]), frames
    assert_finite(tmp_path)
    simulation.free()


def assert_finite(folder):
    """No number in any frame or row is NaN or infinite."""
    for frame in folder.glob("*.vtu"):
        mesh = meshio.read(frame)
        for values in [mesh.points, *mesh.point_data.values()]:
            assert np.isfinite(np.asarray(values, float)).all(), frame
    series = folder / "timeseries.csv"
    rows = series.read_text(encoding="utf-8").splitlines()[1:] if series.exists() else []
    for row in rows:
        assert all(np.isfinite(float(value)) for value in row.split(",")[2:] if value), row


@pytest.mark.parametrize(("distance", "frames"), [(0.0, 0), (0.006, 1)])
def test_an_abort_before_the_first_step_writes_the_start_or_nothing(taichi_f64, tmp_path, distance, frames):
    """Two spheres at the same point have no contact normal: forces are not finite, so nothing is written."""
    group = particle_group([[0.0, 0, 0], [distance, 0, 0]], velocity=[0.0, 3.0, 0.0])
    simulation = Simulation(build_scene(groups(group), run={"duration": 0.01}), out=tmp_path)
    with pytest.raises(RunError, match="They overlap initially") as stopped:
        simulation.run()
    found = sorted(tmp_path.glob("particles_*.vtu"))
    assert len(found) == frames and (tmp_path / "timeseries.csv").exists() == bool(frames)
    assert ("is not written" in str(stopped.value)) == (not frames)
    assert_finite(tmp_path)
    if frames:
        assert np.array_equal(meshio.read(found[0]).point_data["velocity"], [[0.0, 3.0, 0.0]] * 2)
    simulation.free()


def test_f32_stops_where_it_no_longer_resolves_positions():
    assert in_subprocess(flight, 8186.0) == ""
    message = in_subprocess(flight, 8191.0)
    assert "particle 0 (glass, 400 m/s)" in message
    assert (
        "where f32 resolves positions only to 0.000977 m; the required resolution is 0.1 of the smallest radius 0.005 m"
        in message
    )
    assert "Use --precision mixed" in message


def flight(height):
    """The message, or none, of a sphere that flies 4 m from a height [m] and leaves the domain, which grows.

    In f32 the spacing is 2^(12 - 23) = 0.49 mm up to 2^13 = 8192 m and 0.98 mm beyond; allowed is 0.5 mm.
    """
    ball = particle_group([[0.0, 0.0, height]], velocity=[0.0, 0.0, 400.0])
    domain = {"min": [-1.0, -1.0, 0.0], "max": [1.0, 1.0, height + 0.1], "on_exit": "expand"}
    run = {"duration": 0.01, "time_step": 2e-6, "precision": "f32"}
    simulation = Simulation(build_scene({"ball": ball}, domain=domain, run=run))
    try:
        simulation.run()
    except RunError as error:
        return str(error)
    return ""


def test_good_runs_diagnosis_no_guard(taichi_f64):
    simulation = Simulation(
        build_scene(bystanders(particle_group([[0.0, 0.0, 0.0]], velocity=[1.0, 0, 0])), run={"duration": 0.01})
    )
    simulation.run()
    assert simulation.engine.diagnosis is None
    assert np.isfinite(simulation.snapshot().particles["position"]).all()
    simulation.free()


def groups(*given):
    return {f"group_{number}": group for number, group in enumerate(given)}


def reported(scene):
    """What a run says that trips a guard."""
    simulation = Simulation(scene)
    with pytest.raises(RunError) as stopped:
        simulation.run()
    simulation.free()
    return str(stopped.value)


def number_after(words, message):
    return float(message.partition(words)[2].split()[0].rstrip(".,:"))


BULLET = particle_group([[0.0, 0.0, 0.0]], velocity=[40.0, 0, 0])
TARGET = particle_group([[0.012, 0.0, 0.0]], material="steel")
MASS = 2500.0 * np.pi / 6 * 0.01**3
HERTZ = 4 / 3 * (1e8 / (2 * (1 - 0.25**2))) * np.sqrt(0.0025)
"""Stiffness [N/m^1.5] of two equal spheres of 10 mm of the trial's materials."""


def test_an_overlap_names_both_with_materials_and_speeds_and_what_they_do(taichi_f64):
    message = reported(build_scene(groups(BULLET, TARGET), run={"duration": 0.01, "velocity_max": 40.0}))
    assert re.search(r"particle 0 \(glass, 39\.\d m/s\) .* with particle 1 \(steel, 0\.\d+ m/s\)", message)
    assert 0.1 < number_after("smaller radius: by", message) < 0.2
    assert 39.0 < number_after("approach at", message) < 40.0
    assert "Raise young_modulus of glass and steel, or raise numerics.max_overlap" in message


def test_an_overlap_in_the_first_step_is_an_impact_and_not_how_they_begin(taichi_f64):
    near = particle_group([[0.0105, 0.0, 0.0]], material="steel")
    given = {"run": {"duration": 0.01, "velocity_max": 40.0}, "numerics": {"max_overlap": 1e-3, "skin": 5e-3}}
    message = reported(
        build_scene(groups(particle_group([[0.0004995, 0.0, 0.0]], velocity=[40.0, 0, 0]), near), **given)
    )
    assert "They approach at" in message and "They overlap initially" not in message
    overlapping = reported(
        build_scene(groups(particle_group([[0.00052, 0.0, 0.0]], velocity=[40.0, 0, 0]), near), **given)
    )
    assert "They overlap initially" in overlapping


def test_an_impact_faster_than_planned_says_what_to_plan_for(taichi_f64):
    scene = build_scene(groups(BULLET, TARGET), run={"duration": 0.01, "velocity_max": 1.0}, numerics={"skin": 5e-3})
    message = reported(scene)
    assert "above the planned 1 m/s" in message
    assert 40.0 <= number_after("set run.velocity_max to", message) < 60.0


def test_a_step_above_the_stable_one_of_the_pair_is_found_out(taichi_f64):
    """Stable: 2 sqrt(M/K), where the leapfrog of two bodies ends, on the tangent at the largest overlap d at 5 m/s:

    K = 1.5 k sqrt(d), d = (5 M v^2 / (4 k))^0.4. It goes with v^-0.2. The fifth step overlaps by 0.075 mm; half a step
    more changes v by k d^1.5 / M * dt / 2, 6 %.
    """
    speed, step = 5.0, 1.8e-4
    bullet, target = (
        particle_group([[0, 0, 0]], velocity=[speed, 0, 0]),
        particle_group([[0.014425, 0, 0]], material="steel"),
    )
    numerics, run = {"skin": 5e-3, "max_overlap": 0.01}, {"duration": 0.01, "velocity_max": 1.0, "time_step": step}
    message = reported(build_scene(groups(bullet, target), numerics=numerics, run=run))
    mass_eff = MASS / 2
    largest = (5 * mass_eff * speed**2 / (4 * HERTZ)) ** 0.4
    stable = 2 * np.sqrt(mass_eff / (1.5 * HERTZ * np.sqrt(largest)))
    assert number_after("time step", message) == step
    assert number_after("exceeds the stable step", message) == pytest.approx(stable, rel=0.2 * 0.12)
    assert "lower run.time_step" in message


def test_spheres_that_begin_in_each_other_are_said_to(taichi_f64):
    message = reported(build_scene(groups(particle_group([[0.0, 0, 0], [0.006, 0, 0]])), run={"duration": 0.01}))
    assert "particle 0 (glass, at rest) at 0 s" in message
    assert number_after("smaller radius: by", message) == pytest.approx(0.004 / 0.005, rel=1e-3)
    assert "They overlap initially: move them apart" in message


@pytest.mark.parametrize("moves", [False, True])
def test_a_wall_is_named_with_its_velocity(taichi_f64, moves):
    motion = {"motion": {"kind": "translation", "velocity": [0, 0, 50.0]}} if moves else {}
    ball = particle_group([[0.0, 0.0, 0.0072]], velocity=[0.0, 0.0, 0.0 if moves else -50.0])
    message = reported(
        build_scene(
            groups(ball), walls={"piston": plane([0, 0, 0], [0, 0, 1], "steel") | motion},
            run={"duration": 0.01, "velocity_max": 1.0, "time_step": 1e-5}, numerics={"skin": 5e-3},
        )
    )  # fmt: skip
    assert f"with wall piston (steel, {'50 m/s' if moves else 'at rest'})" in message
    assert 0.1 < number_after("smaller radius: by", message) < 0.2
    assert 48.0 < number_after("approach at", message) < 50.1


def test_a_sphere_shot_out_of_an_overlap_names_whom_it_left(taichi_f64):
    """The first step from rest under F = k d^1.5 goes F dt^2 / (2 m)."""
    step, overlap = 6e-5, 0.0039
    message = reported(
        build_scene(
            groups(particle_group([[0.0, 0, 0], [0.0061, 0, 0]])), numerics={"max_overlap": 0.8, "skin": 5e-4},
            run={"duration": 0.01, "velocity_max": 20.0, "time_step": step},
        )
    )  # fmt: skip
    assert "particle 0 (glass, " in message
    assert "and particle 1 (glass, " in message
    assert number_after("overlapped by", message) == pytest.approx(overlap / 0.005, rel=1e-3)
    assert number_after("moves", message) == pytest.approx(HERTZ * overlap**1.5 * step**2 / (2 * MASS), rel=1e-2)


def test_a_sphere_that_leaves_says_where_it_is(taichi_f64):
    domain = {"min": [-0.01] * 3, "max": [0.01] * 3, "on_exit": "error"}
    fast = particle_group([[0.0, 0, 0]], velocity=[3.0, 0, 0])
    message = reported(
        build_scene(groups(particle_group([[0, 0.008, 0]], 0.001), fast), domain=domain, run={"duration": 0.1})
    )
    assert re.search(r"particle 1 at 0\.003\d+ s is outside the domain", message)
    assert re.search(r"it is at \[0\.01\d+, 0, 0\] m \(glass, 3 m/s\)", message)
