"""Aborted runs: the run stops at once, the message reports particle and time, and the last state is
written.

In single precision: `test_precisions`; at walls whose velocity or force is too large: `test_travel`,
`test_wall_dynamics`; causes of overlaps and advice: `test_overlap_causes`.
"""

import re

import meshio
import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane

from granflow.errors import RunError
from granflow.io.log import collected_warnings
from granflow.observers.observer import on_interval
from granflow.simulation import Simulation

FAULTY_ID = 2
"""Id of the particle that exceeds a limit in each scene here (the smaller id of two); all others are
valid."""


def among_valid(*more, **parts):
    """Particles of two materials that move in free flight, and others; most scenes have one structure."""
    good = {"good": particle_group([[0.3, 0, 0], [0.3, 0.1, 0]], material="steel", velocity=[1.0, 0, 0])}
    groups = good | {f"bad_{number}": group for number, group in enumerate(more)}
    return build_scene(groups, **({"numerics": NUMERICS, "run": {"duration": 0.01}} | parts))


NUMERICS = {"chunk_size": 16}
SCENES = {
    "overlaps with": lambda: among_valid(
        particle_group([[0.0, 0.0, 0.0]], velocity=[40.0, 0, 0]), particle_group([[0.012, 0.0, 0.0]]),
        run={"duration": 0.01, "velocity_max": 40.0},
    ),
    "above the limit": lambda: among_valid(
        particle_group([[0.0, 0.0, 0.0]], velocity=[199.0, 0, 0]), gravity=[1e6, 0.0, 0.0],
        run={"duration": 0.01, "velocity_max": 1.0, "time_step": 5e-6}, numerics=NUMERICS | {"skin": 1e-3},
    ),
    "is not a number": lambda: among_valid(particle_group([[0.0, 0.0, 0.0]])),
}  # fmt: skip


@pytest.mark.parametrize("reason", SCENES)
def test_abort_reports_particle_and_time_and_writes_a_frame(taichi_f64, tmp_path, reason):
    def inject_nan(snapshot):
        if reason == "is not a number" and snapshot.time > 0.0:
            particles = simulation.engine.state.particles
            faulty = np.flatnonzero(particles.id.to_numpy() == FAULTY_ID)[0]
            particles.velocity[int(faulty)] = [float("nan")] * 3

    simulation = Simulation(SCENES[reason](), out=tmp_path, observers=[on_interval(1e-4, inject_nan)])
    with pytest.raises(RunError) as stopped:
        simulation.run()
    message = str(stopped.value)
    assert reason in message
    assert f"particle {FAULTY_ID} " in message
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
    """Checks that all numbers in frames and rows are finite."""
    for frame in folder.glob("*.vtu"):
        mesh = meshio.read(frame)
        for values in [mesh.points, *mesh.point_data.values()]:
            assert np.isfinite(np.asarray(values, float)).all(), frame
    series = folder / "timeseries.csv"
    rows = series.read_text(encoding="utf-8").splitlines()[1:] if series.exists() else []
    for row in rows:
        assert all(np.isfinite(float(value)) for value in row.split(",")[2:] if value), row


@pytest.mark.parametrize(("distance", "frames"), [(0.0, 0), (0.006, 1)])
def test_abort_before_the_first_step_writes_the_initial_state_if_finite(
    taichi_f64, tmp_path, distance, frames
):
    """Two particles at the same point have no contact normal: forces are not finite, so no frame is
    written."""
    pair = particle_group([[0.0, 0, 0], [distance, 0, 0]], velocity=[0.0, 3.0, 0.0])
    simulation = Simulation(among_valid(pair), out=tmp_path)
    with pytest.raises(RunError, match="They overlap initially") as stopped:
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


def test_the_limit_of_displacement_is_that_of_the_smallest_particle(taichi_f64):
    """0 to 500 m/s at 1e6 m/s2: from 80 m/s on, 0.4 mm per step of 5 us, 0.2 radii of the small particle."""
    message = abort_message(
        among_valid(
            particle_group([[-0.3, 0, 0]], 0.01), particle_group([[0, 0, 0]], 0.004), gravity=[1e6, 0, 0],
            run={"duration": 5e-4, "velocity_max": 1.0, "time_step": 5e-6}, numerics=NUMERICS | {"skin": 1e-2},
        )
    )  # fmt: skip
    assert number_after("at", message) == pytest.approx(8e-5, abs=1e-5)


BULLET = particle_group([[0.0, 0.0, 0.0]], velocity=[40.0, 0, 0])
TARGET = particle_group([[0.012, 0.0, 0.0]], material="steel")
MASS = 2500.0 * np.pi / 6 * 0.01**3
HERTZ = 4 / 3 * (1e8 / (2 * (1 - 0.25**2))) * np.sqrt(0.0025)
"""Hertz stiffness [N/m^1.5] of two equal particles of 10 mm of the material `SOFT`."""


def test_overlap_message_names_both_particles_with_material_and_speed(taichi_f64):
    numerics = NUMERICS | {"max_overlap": 0.1}
    run = {"duration": 0.01, "velocity_max": 40.0}
    message = abort_message(among_valid(BULLET, TARGET, run=run, numerics=numerics))
    assert re.search(r"particle 2 \(glass, 39\.\d m/s\) .* with particle 3 \(steel, 0\.\d+ m/s\)", message)
    assert 0.1 < number_after(") by", message) < 0.2
    assert 39.0 < number_after("approach at", message) < 40.0
    assert "results from an impact at 40 m/s" in message
    assert re.search(
        r"set materials\.glass\.young_modulus to .* and materials\.steel\.young_modulus to", message
    )
    numerics |= {"skin": 5e-3}
    faster = abort_message(among_valid(BULLET, TARGET, run=run | {"velocity_max": 1.0}, numerics=numerics))
    assert "above the planned 1 m/s" in faster
    assert 40.0 <= number_after("set run.velocity_max to", faster) < 60.0


def colliding(numerics):
    """Two spheres of 10 mm collide at 20 m/s, without losses."""
    places = ([0.0, 0, 0], 20.0), ([0.0105, 0, 0], 0.0)
    groups = {f"ball{k}": particle_group([at], velocity=[v, 0, 0]) for k, (at, v) in enumerate(places)}
    return build_scene(
        groups, pair={"restitution": 1.0}, normal="hertz", numerics=NUMERICS | numerics,
        run={"duration": 1e-3, "velocity_max": 20.0},
    )  # fmt: skip


def end_of(scene):
    """Steps, velocities and warnings of a run."""
    with collected_warnings() as warnings, Simulation(scene) as simulation:
        simulation.run()
        return (
            simulation.engine.step_count,
            simulation.snapshot().particles["velocity"][:, 0].tolist(),
            warnings,
        )


def test_without_a_limit_an_overlap_is_reported_and_the_run_goes_on(taichi_f64):
    """Hertz (1882): d = (5 M v^2 / (4 k))^(2/5), 0.31 of the radius; the report bounds it to a quarter."""
    largest = (5.0 * 0.5 * MASS * 20.0**2 / (4.0 * HERTZ)) ** 0.4 / 0.005
    steps, velocity, warnings = end_of(colliding({}))
    forecast, first, last = warnings
    assert forecast.startswith("particles of ball0 and ball1: an impact at 20 m/s")
    assert 0.1 < float(first.partition(") by ")[2].split()[0]) < 0.13
    low, high = (number_after(words, last) for words in ("between", "and"))
    assert low < largest < high and high == pytest.approx(1.25 * low, rel=0.02)
    assert "results from an impact at 20 m/s" in first and "stops above 0.5" in first
    limited = end_of(colliding({"max_overlap": 0.5}))  # forces are rounded to another unit
    assert limited[0] == steps and limited[1] == pytest.approx(velocity, rel=1e-9, abs=1e-10)
    assert limited[2] == []
    assert velocity == pytest.approx([0.0, 20.0], abs=0.02)


def test_overlap_in_the_first_step_is_diagnosed_as_an_impact(taichi_f64):
    near = particle_group([[0.0105, 0.0, 0.0]], material="steel")
    parts = {
        "run": {"duration": 0.01, "velocity_max": 40.0},
        "numerics": NUMERICS | {"max_overlap": 1e-3, "skin": 5e-3},
    }
    for x, cause, other in (
        (4.995e-4, "They approach at", "initially"),
        (5.2e-4, "They overlap initially", "impact"),
    ):
        bullet = particle_group([[x, 0, 0]], velocity=[40.0, 0, 0])
        message = abort_message(among_valid(bullet, near, **parts))
        assert cause in message and other not in message


def test_step_above_the_stable_step_of_the_pair_is_diagnosed(taichi_f64):
    """The stable step is 2 sqrt(M/K), with the tangent stiffness K at the maximum overlap d of an impact at 5
    m/s:

        K = 1.5 k sqrt(d),    d = (5 M v^2 / (4 k))^0.4

    It is proportional to v^-0.2. The fifth step overlaps by 0.075 mm; half a step more changes v by
    k d^1.5 / M * dt / 2, 6 %.
    """
    speed = 5.0
    step = 1.8e-4
    bullet = particle_group([[0, 0, 0]], velocity=[speed, 0, 0])
    target = particle_group([[0.014425, 0, 0]], material="steel")
    numerics = NUMERICS | {"skin": 5e-3, "max_overlap": 0.01}
    run = {"duration": 0.01, "velocity_max": 1.0, "time_step": step}
    message = abort_message(build_scene({"bullet": bullet, "target": target}, numerics=numerics, run=run))
    mass_eff = MASS / 2
    largest = (5 * mass_eff * speed**2 / (4 * HERTZ)) ** 0.4
    stable = 2 * np.sqrt(mass_eff / (1.5 * HERTZ * np.sqrt(largest)))
    assert number_after("time step", message) == step
    assert number_after("exceeds the stable step", message) == pytest.approx(stable, rel=0.2 * 0.12)
    assert "lower run.time_step" in message


@pytest.mark.parametrize(
    ("distance", "advice"),
    [
        (0.006, "move them apart."),  # 0.8 is the largest numerics.max_overlap
        (0.008, "move them apart, or set numerics.max_overlap to 0.41 if this is intended."),
    ],
)
def test_initial_overlap_is_diagnosed(taichi_f64, distance, advice):
    message = abort_message(among_valid(particle_group([[0.0, 0, 0], [distance, 0, 0]])))
    assert "particle 2 (glass, at rest) at 0 s" in message
    assert number_after(") by", message) == pytest.approx((0.01 - distance) / 0.005, rel=1e-3)
    assert message.endswith(f"They overlap initially: {advice}")


@pytest.mark.parametrize("moves", [False, True])
def test_overlap_message_names_the_wall_with_its_velocity(taichi_f64, moves):
    motion = {"motion": {"kind": "translation", "velocity": [0, 0, 50.0]}} if moves else {}
    ball = particle_group([[0.0, 0.0, 0.0072]], velocity=[0.0, 0.0, 0.0 if moves else -50.0])
    far = {"kind": "translation", "velocity": [0, 0, -1e-9]}
    walls = {
        "piston": plane([0, 0, 0], [0, 0, 1], "steel") | motion,
        "far": plane([0, 0, 0.9], [0, 0, -1], motion=far),
    }
    run = {"duration": 0.01, "velocity_max": 1.0, "time_step": 1e-5}
    numerics = {"skin": 5e-3, "max_overlap": 0.1}
    message = abort_message(build_scene({"ball": ball}, walls, run=run, numerics=numerics))
    assert f"with wall piston (steel, {'50 m/s' if moves else 'at rest'})" in message
    assert 0.1 < number_after(") by", message) < 0.2
    assert 48.0 < number_after("approach at", message) < 50.1


def test_displacement_message_names_the_overlapping_partner(taichi_f64):
    """The displacement in the first step from rest under F = k d^1.5 is F dt^2 / (2 m)."""
    step = 6e-5
    overlap = 0.0039
    message = abort_message(
        among_valid(
            particle_group([[0.0, 0, 0], [0.0061, 0, 0]]), numerics=NUMERICS | {"max_overlap": 0.8, "skin": 5e-4},
            run={"duration": 0.01, "velocity_max": 20.0, "time_step": step},
        )
    )  # fmt: skip
    assert "particle 2 (glass, " in message
    assert "and particle 3 (glass, " in message
    assert number_after("overlapped by", message) == pytest.approx(overlap / 0.005, rel=1e-3)
    assert number_after("moves", message) == pytest.approx(
        HERTZ * overlap**1.5 * step**2 / (2 * MASS), rel=1e-2
    )


@pytest.mark.parametrize(
    ("presence", "stage", "key"),
    [
        ({"stages": ["hold"]}, "hold", "walls.gate.stages"),
        ({"appears_at": 5e-4}, "fill", "walls.gate.appears_at"),
    ],
)
def test_wall_that_appears_inside_of_a_particle_is_named_with_its_stage(taichi_f64, presence, stage, key):
    """The gate cuts one of two particles that touch, 1 mm below its center: an overlap of 0.8 radii."""
    pair = particle_group([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]])
    walls = {"floor": plane([0, 0, -0.02], [0, 0, 1]), "gate": plane([0, 0, -0.001], [0, 0, 1], **presence)}
    stages = [{"name": "fill", "duration": 1e-3}, {"name": "hold", "duration": 1e-3}]
    message = abort_message(build_scene({"pair": pair}, walls=walls, stages=stages))
    assert "overlaps with wall gate (glass, at rest) by 0.8 times the smaller radius" in message
    assert (
        f"Wall gate appears at this time, in stage {stage}, where the particle is. Change {key}, or let it"
        in message
    )


def test_message_of_a_particle_outside_the_domain_has_its_position(taichi_f64):
    domain = {"min": [-0.01] * 3, "max": [0.01] * 3, "on_exit": "error"}
    fast = particle_group([[0.0, 0, 0]], velocity=[3.0, 0, 0])
    groups = {"slow": particle_group([[0, 0.008, 0]], 0.004, "steel"), "fast": fast}
    message = abort_message(build_scene(groups, domain=domain, run={"duration": 0.1}, numerics=NUMERICS))
    assert re.search(r"particle 1 at 0\.003\d+ s is outside the domain", message)
    assert re.search(r"it is at \[0\.01\d+, 0, 0\] m \(glass, 3 m/s\)", message)


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
            with pytest.raises(RunError, match="particle 5 .* is outside the domain"):
                simulation.run()
        else:
            simulation.run(until=found[0].time)
        found.append(simulation.snapshot())
        simulation.free()
    assert found[0].time == found[1].time
    assert found[0].particles["id"].tolist() == [0, 1, 2, 3, 4]
    for name, values in found[0].particles.items():
        np.testing.assert_array_equal(values, found[1].particles[name], err_msg=name)
