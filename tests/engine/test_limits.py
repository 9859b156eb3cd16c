"""Aborted runs: the run stops at once, the message has particle, time, cause and remedy, and the last state is
written.

In single precision: `test_precisions`; walls that are too fast: `test_travel`, `test_wall_dynamics`.
"""

import re

import meshio
import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane

from granflow.engine.abort import Body, ContactPair, overlap_cause
from granflow.errors import RunError
from granflow.io.log import collected_warnings
from granflow.observers.observer import on_interval
from granflow.plan.build import plan_for
from granflow.simulation import Simulation

FAULTY_ID = 2
"""Id of the particle that exceeds a limit in each scene here (the smaller id of two); all others are valid."""

NUMERICS = {"chunk_size": 16}
MASS = 2500.0 * np.pi / 6 * 0.01**3
HERTZ = 4 / 3 * (1e8 / (2 * (1 - 0.25**2))) * np.sqrt(0.0025)
"""Hertz stiffness [N/m^1.5] of two equal particles of 10 mm of the material `SOFT`."""


def among_valid(*more, **parts):
    """Particles of two materials that move in free flight, and others; most scenes have one structure."""
    good = {"good": particle_group([[0.3, 0, 0], [0.3, 0.1, 0]], material="steel", velocity=[1.0, 0, 0])}
    groups = good | {f"bad_{number}": group for number, group in enumerate(more)}
    return build_scene(groups, **({"numerics": NUMERICS, "run": {"duration": 0.01}} | parts))


BULLET = particle_group([[0.0, 0.0, 0.0]], velocity=[40.0, 0, 0])
TARGET = particle_group([[0.012, 0.0, 0.0]], material="steel")
SCENES = {
    "overlaps with": (
        (BULLET, TARGET),
        {
            "run": {"duration": 0.01, "velocity_max": 1.0},
            "numerics": NUMERICS | {"max_overlap": 0.1, "skin": 5e-3},
        },
    ),
    "above the limit": (
        (particle_group([[0.0, 0.0, 0.0]], velocity=[199.0, 0, 0]),),
        {
            "gravity": [1e6, 0.0, 0.0],
            "run": {"duration": 0.01, "velocity_max": 1.0, "time_step": 5e-6},
            "numerics": NUMERICS | {"skin": 1e-3},
        },
    ),
    "is not a number": ((particle_group([[0.0, 0.0, 0.0]]),), {}),
}


@pytest.mark.parametrize("reason", SCENES)
def test_abort_reports_particle_and_time_and_writes_a_frame(taichi_f64, tmp_path, reason):
    def inject_nan(snapshot):
        if reason == "is not a number" and snapshot.time > 0.0:
            particles = simulation.engine.state.particles
            faulty = np.flatnonzero(particles.id.to_numpy() == FAULTY_ID)[0]
            particles.velocity[int(faulty)] = [float("nan")] * 3

    groups, parts = SCENES[reason]
    scene = among_valid(*groups, **parts)
    simulation = Simulation(scene, out=tmp_path, observers=[on_interval(1e-4, inject_nan)])
    with pytest.raises(RunError) as stopped:
        simulation.run()
    message = str(stopped.value)
    assert reason in message and f"particle {FAULTY_ID} " in message and str(tmp_path) in message
    time = float(re.search(r"at ([\d.e+-]+) s", message).group(1))
    assert time == pytest.approx(simulation.time, rel=1e-5)
    assert time < 0.001
    assert ("is not written" in message) == (reason == "is not a number")
    assert any("particles" in frame.name for frame in sorted(tmp_path.rglob("*.vtu"))[-2:])
    assert_finite(tmp_path)
    simulation.free()
    if reason == "overlaps with":
        assert_names_both_particles(message)


def assert_names_both_particles(message):
    """With material and speed; the impact is faster than planned."""
    assert re.search(r"particle 2 \(glass, 39\.\d m/s\) .* with particle 3 \(steel, 0\.\d+ m/s\)", message)
    assert 0.1 < number_after(") by", message) < 0.2
    assert 39.0 < number_after("approach at", message) < 40.0
    assert "results from an impact at 40 m/s" in message and "above the planned 1 m/s" in message
    assert 40.0 <= number_after("set run.velocity_max to", message) < 60.0


def assert_finite(folder):
    """Checks that all numbers in frames and rows are finite."""
    for frame in folder.glob("*.vtu"):
        mesh = meshio.read(frame)
        for values in [mesh.points, *mesh.point_data.values()]:
            assert np.isfinite(np.asarray(values, float)).all(), frame
    series = folder / "timeseries.csv"
    rows = series.read_text(encoding="utf-8").splitlines()[1:] if series.exists() else []
    for row in rows:
        assert all(np.isfinite(float(value)) for value in row.split(",")[2:] if value), row


@pytest.mark.parametrize(
    ("distance", "frames", "advice"),
    [(0.0, 0, "move them apart."), (0.008, 1, "apart, or set numerics.max_overlap to 0.41 if this is")],
)
def test_abort_before_the_first_step_writes_the_initial_state_if_finite(
    taichi_f64, tmp_path, distance, frames, advice
):
    """Two particles at the same point have no contact normal: forces are not finite, so no frame is written."""
    pair = particle_group([[0.0, 0, 0], [distance, 0, 0]], velocity=[0.0, 3.0, 0.0])
    simulation = Simulation(among_valid(pair), out=tmp_path)
    with pytest.raises(RunError, match=f"They overlap initially: .*{advice}") as stopped:
        simulation.run()
    found = sorted(tmp_path.glob("particles_*.vtu"))
    assert len(found) == frames and (tmp_path / "timeseries.csv").exists() == bool(frames)
    assert ("is not written" in str(stopped.value)) == (not frames)
    assert_finite(tmp_path)
    if frames:
        velocity = [[1.0, 0.0, 0.0]] * 2 + [[0.0, 3.0, 0.0]] * 2
        assert np.array_equal(meshio.read(found[0]).point_data["velocity"], velocity)
    simulation.free()


def abort_message(scene):
    """Message of a run that aborts."""
    with Simulation(scene) as simulation, pytest.raises(RunError) as stopped:
        simulation.run()
    return str(stopped.value)


def number_after(words, message):
    return float(message.partition(words)[2].split()[0].rstrip(".,:"))


def end_of_collision(numerics):
    """Steps, velocities and warnings of two spheres of 10 mm that collide at 20 m/s, without losses."""
    places = ([0.0, 0, 0], 20.0), ([0.0105, 0, 0], 0.0)
    groups = {f"ball{k}": particle_group([at], velocity=[v, 0, 0]) for k, (at, v) in enumerate(places)}
    scene = build_scene(
        groups, pair={"restitution": 1.0}, normal="hertz", numerics=NUMERICS | numerics,
        run={"duration": 1e-3, "velocity_max": 20.0},
    )  # fmt: skip
    with collected_warnings() as warnings, Simulation(scene) as simulation:
        simulation.run()
        velocity = simulation.snapshot().particles["velocity"][:, 0]
        return simulation.engine.step_count, velocity, warnings


def test_without_a_limit_an_overlap_is_reported_and_the_run_goes_on(taichi_f64):
    """Hertz (1882): d = (5 M v^2 / (4 k))^(2/5), 0.31 of the radius; the report bounds it to a quarter."""
    largest = (5.0 * 0.5 * MASS * 20.0**2 / (4.0 * HERTZ)) ** 0.4 / 0.005
    steps, velocity, (forecast, first, last) = end_of_collision({})
    assert forecast.startswith("particles of ball0 and ball1: an impact at 20 m/s")
    assert 0.1 < number_after(") by", first) < 0.13 and "stops above 0.5" in first
    low, high = (number_after(words, last) for words in ("between", "and"))
    assert low < largest < high and high == pytest.approx(1.25 * low, rel=0.02)
    limited = end_of_collision({"max_overlap": 0.5})  # forces are rounded to another unit
    assert limited[0] == steps and limited[1] == pytest.approx(velocity, rel=1e-9, abs=1e-10)
    assert limited[2] == [] and velocity == pytest.approx([0.0, 20.0], abs=0.02)


def test_displacement_message_names_the_overlapping_partner(taichi_f64):
    """The displacement in the first step from rest under F = k d^1.5 is F dt^2 / (2 m)."""
    step, overlap = 6e-5, 0.0039
    numerics = NUMERICS | {"max_overlap": 0.8, "skin": 5e-4}
    run = {"duration": 0.01, "velocity_max": 20.0, "time_step": step}
    pair = particle_group([[0.0, 0, 0], [0.0061, 0, 0]])
    message = abort_message(among_valid(pair, numerics=numerics, run=run))
    assert "particle 2 (glass, " in message and "and particle 3 (glass, " in message
    assert number_after("overlapped by", message) == pytest.approx(overlap / 0.005, rel=1e-3)
    moves = HERTZ * overlap**1.5 * step**2 / (2 * MASS)
    assert number_after("moves", message) == pytest.approx(moves, rel=1e-2)


def test_message_names_the_wall_that_appears_inside_of_a_particle_with_its_stage(taichi_f64):
    """The gate cuts one of two particles that touch, 1 mm below its center: an overlap of 0.8 radii."""
    gate = plane([0, 0, -0.001], [0, 0, 1], stages=["hold"])
    pair = particle_group([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]])
    stages = [{"name": name, "duration": 1e-4} for name in ("fill", "hold")]
    message = abort_message(among_valid(pair, walls={"gate": gate}, stages=stages, run={"velocity_max": 1.0}))
    assert "overlaps with wall gate (glass, at rest) by 0.8 times the smaller radius" in message
    assert (
        "Wall gate appears at this time, in stage hold, where the particle is. Change walls.gate.stages"
        in message
    )


def test_state_at_the_exit_of_a_particle_is_that_of_the_others_after_this_step(taichi_f64):
    """As if the particle were deleted. The rebuild that finds it sorts the others, whose weights differ."""
    light = particle_group([[0.0, 0.004 * k, 0.004] for k in (2, 0, -2)], 0.002)
    heavy = particle_group([[0.0, 0.004 * k, 0.004] for k in (-1, 1)], 0.003, "steel", velocity=[1.0, 0, 0])
    fast = particle_group([[0.0, 0, -0.004]], 0.002, velocity=[3.0, 0, 0])
    found = []
    for on_exit in ("error", "delete"):
        domain = {"min": [-0.01] * 3, "max": [0.01] * 3, "on_exit": on_exit}
        scene = build_scene(
            {"light": light, "heavy": heavy, "fast": fast},
            domain=domain, gravity=[0.0, 0.0, -100.0], run={"duration": 0.01, "time_step": 1e-5},
            numerics=NUMERICS,
        )  # fmt: skip
        simulation = Simulation(scene)
        if on_exit == "error":
            where = r"particle 5 at 0\.003\d+ s is outside the domain.* it is at \[0\.01\d*, 0, -0\.00\d+\] m"
            with pytest.raises(RunError, match=where):
                simulation.run()
        else:
            simulation.run(until=found[0].time)
        found.append(simulation.snapshot())
        simulation.free()
    assert found[0].time == found[1].time
    assert found[0].particles["id"].tolist() == [0, 1, 2, 3, 4]
    for name, values in found[0].particles.items():
        np.testing.assert_array_equal(values, found[1].particles[name], err_msg=name)


def soft(groups, modulus, walls=None, **parts):
    """A scene with one material of a given modulus [Pa] and an overlap limit of 0.1; one compiled structure."""
    corner = {"floor": plane([0, 0, 0], [0, 0, 1]), "far": plane([-0.9, 0, 0], [1, 0, 0])}
    material = {"young_modulus": modulus, "poisson_ratio": 0.25, "density": 2500.0}
    models = {"normal": "hertz", "tangential": "mindlin", "rolling": "none"} | parts.pop("contact", {})
    pair = {"restitution": 0.3, "friction": 0.3} | parts.pop("pair", {})
    return build_scene(
        groups, corner | (walls or {}), materials={"glass": material}, contact=models, pair=pair,
        numerics=NUMERICS | {"max_overlap": 0.1}, **parts,
    )  # fmt: skip


def impact(modulus):
    """A sphere hits a floor at 2 m/s, which is above the planned velocity."""
    ball = particle_group([[0.0, 0.0, 0.0051]], velocity=[0.0, 0.0, -2.0])
    return soft(
        {"ball": ball}, modulus, pair={"restitution": 0.8}, run={"duration": 0.02, "velocity_max": 0.5}
    )


def tower(modulus):
    """40 spheres on top of each other, of which the lowest contact carries the weight of all."""
    spheres = particle_group([[0.0, 0.0, (k + 0.5) * 0.004] for k in range(40)], 0.004)
    run = {"duration": 0.4, "velocity_max": 0.5}
    return soft({"tower": spheres}, modulus, gravity=[0.0, 0.0, -9.81], run=run)


def advised_modulus(message):
    value, unit = re.search(r"materials\.glass\.young_modulus to ([\d.e+]+) (\w+)", message).groups()
    return float(value) * {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9}[unit]


@pytest.mark.parametrize(
    ("build", "modulus", "cause"),
    [(impact, 1e6, "results from an impact at"), (tower, 1e4, "a static load, such as the weight")],
)
def test_abort_names_its_cause_and_a_run_with_the_advised_modulus_passes(taichi_f64, build, modulus, cause):
    message = abort_message(build(modulus))
    assert cause in message, message
    assert ("set run.velocity_max to 2." in message) == (build is impact)
    advised = advised_modulus(message)
    assert modulus < advised < 1e4 * modulus
    with Simulation(build(advised)) as simulation:
        simulation.run()
        assert build is impact or 0.0 < simulation.snapshot().totals["overlap_largest"] < 0.1


LID = {
    "shape": "rectangle",
    "corner": [0, 0, 0.036],
    "sides": [[0.016, 0, 0], [0, 0.016, 0]],
    "material": "glass",
    "motion": {"kind": "servo", "direction": [0, 0, -1], "pressure": 2e4, "velocity_max": 0.1},
}
CAUSES = {
    "other particles or a moving wall press on it": (10.0, {}),
    "its cause is a static load, such as": (1e4, {}),
    "the static pressure of walls.lid": (10.0, {"walls": {"lid": LID}}),
    "because a contact that begins slowly gets a soft spring": (
        10.0,
        {"contact": {"normal": {"law": "linear", "stiffness": "onset"}}},
    ),
    "Its cause is cohesion": (
        10.0,
        {"contact": {"cohesion": "sjkr"}, "pair": {"cohesion_energy_density": 4.1e4}},
    ),
}


@pytest.mark.parametrize("cause", CAUSES)
def test_cause_of_an_overlap_almost_at_rest(cause):
    """0.1 m/s of 1.1 m/s at an overlap of 0.11, as in a drum while particles land on the bed.

    Under 10 Pa, spheres of 4 mm and 1 MPa overlap by 0.01 of the radius, under 10 kPa by more than 0.1. Attraction
    and repulsion balance at an overlap of half of (3 pi w / (2 E*))^2, 0.13 for 1 MPa.
    """
    weight, parts = CAUSES[cause]
    beads = particle_group(0.004 * (np.argwhere(np.ones((4, 4, 8))) + 0.5), 0.004)
    run = {"duration": 0.3, "velocity_max": 0.7}
    plan = plan_for(soft({"beads": beads}, 1e6, gravity=[0.0, 0.0, -9.81], run=run, **parts))
    first = Body("particle 1", "glass", (0.0, 0.0, 0.1), (0.0, 0.0, 0.01))
    second = Body("particle 2", "glass", (0.0, 0.0, 0.0), (0.0, 0.0, 0.014))
    message = overlap_cause(
        ContactPair(first, second, 0.11, 0.1, 1.1, 1e-5, plan.pair_cases[0], weight), plan
    )
    assert cause in message, message
    assert advised_modulus(message) > 1e6
    if weight == 10.0 and not parts:
        explained = float(re.search(r"explain only an overlap of ([\d.]+) of the radius", message).group(1))
        assert 0.001 < explained < 0.055
