"""Contacts of the restitution 0: impacts without rebound, static loads, and the completely inelastic bouncing
ball.

The flights of the ball on a vibrating plate follow the map of `validation.vibrated`.
"""

import numpy as np
import pytest
from scene_builders import build_scene, column, particle_group, plane, run_and_sample, run_to_end, times
from validation.vibrated import GRAVITY, RADIUS, SOLID, flights_of_map, flights_of_run

BOX = {"min": [-0.1] * 3, "max": [0.1] * 3, "on_exit": "error"}


def inelastic_scene(groups, walls, duration, **parts):
    """A scene of restitution 0 under gravity."""
    given = {
        "materials": {"glass": SOLID},
        "pair": {"restitution": 0.0},
        "gravity": [0.0, 0.0, -GRAVITY],
    } | parts
    return build_scene(
        groups, walls=walls, domain=BOX, run={"duration": duration, "velocity_max": 0.5}, **given,
    )  # fmt: skip


def check_flights(gammas, samples):
    """The contact forms one overlap, 30 micrometers, above the plane that supports the ball: 0.4 % of a
    period.

    The flights of the run end earlier by this time; they are sampled to one sample at each end.
    """
    for gamma, found in zip(gammas, flights_of_run(gammas, samples), strict=True):
        if gamma < 1.0:
            assert len(found) == 0
            continue
        expected = flights_of_map(gamma)
        assert abs(len(found) - len(expected)) <= 1, gamma
        for extreme in (np.min, np.max):
            np.testing.assert_allclose(
                extreme(found), extreme(expected), rtol=0.0, atol=0.005 + 1.0 / samples
            )


def test_inelastic_ball_doubles_its_period(taichi_f64):
    """A flight lasts a period from sqrt(1 + pi^2) = 3.297 on; two durations alternate from sqrt(4 + pi^2) =
    3.724 on.

    A flight of a period has the phase cos p = pi / gamma. A landing that is late by q makes the next one late
    by (1 - gamma sin p) q, which grows in magnitude if gamma sin p > 2. Flights converge slowly near this
    value: the map and the run have 100 periods before the flights that count.
    """
    assert flights_of_map(np.sqrt(1.0 + np.pi**2))[0] == pytest.approx(1.0, abs=1e-9)
    assert np.ptp(flights_of_map(np.sqrt(4.0 + np.pi**2) - 0.08)) < 1e-6
    assert np.ptp(flights_of_map(np.sqrt(4.0 + np.pi**2) + 0.04)) > 0.1
    check_flights((0.95, 3.6, 3.8), 500)


@pytest.mark.slow
def test_inelastic_ball_follows_the_event_driven_map(taichi_f64):
    check_flights((0.95, 1.05, 1.5, 2.5, 3.2, 3.4, 3.6, 3.8, 4.2, 4.8), 400)


@pytest.mark.parametrize("diameters", [(0.005, 0.005), (0.005, 0.008)])
@pytest.mark.parametrize("fraction", [0.05, 0.5])
def test_two_particles_have_a_common_velocity_after_an_inelastic_impact(taichi_f64, diameters, fraction):
    """v = (m1 v1 + m2 v2) / (m1 + m2), whatever the time step; the energy budget closes."""
    velocities = np.array([[0.3, 0.0, 0.0], [-0.1, 0.0, 0.0]])
    distance = 0.5 * sum(diameters) + 1e-4
    group = particle_group([[0.0, 0.0, 0.0], [distance, 0.0, 0.0]], list(diameters), velocity=velocities)
    parts = {"gravity": [0.0, 0.0, 0.0], "numerics": {"time_step_fraction": fraction}}
    scene = inelastic_scene(
        {"balls": group}, {}, 0.005, output={"interval": 1.0, "energy_budget": True}, **parts
    )
    last, _ = run_to_end(scene)
    mass = last.particles["mass"]
    common = mass @ velocities / mass.sum()
    np.testing.assert_allclose(last.particles["velocity"], [common, common], rtol=0.0, atol=1e-12)
    loss = 0.5 * mass @ np.sum(velocities**2, axis=1) - 0.5 * mass.sum() * common @ common
    assert last.totals["plastic_dissipation"] == pytest.approx(loss, rel=1e-9)


def test_ball_that_hits_a_ceiling_falls_from_rest(taichi_f64):
    """No rebound and no tension: gravity separates the contact at once."""
    ceiling = {"ceiling": plane([0, 0, 0.01], [0, 0, -1])}
    ball = particle_group([[0.0, 0.0, 0.01 - RADIUS - 1e-4]], 2.0 * RADIUS, velocity=[0.0, 0.0, 0.4])
    snapshots = run_and_sample(inelastic_scene({"ball": ball}, ceiling, 0.05), 0.001)
    time = times(snapshots)
    velocity = column(snapshots, "velocity")[:, 0, 2]
    falling = time > 0.0015
    release = time[falling] + velocity[falling] / GRAVITY
    np.testing.assert_allclose(release, release[0], rtol=0.0, atol=1e-12)
    assert 0.00025 < release[0] < 0.0005  # after 0.25 ms of flight and the impact


def test_ball_comes_to_rest_on_a_floor(taichi_f64):
    """The floor carries the weight without oscillation; the ball sinks by less than a picometer in 10 ms."""
    ball = particle_group([[0.0, 0.0, RADIUS + 1e-3]], 2.0 * RADIUS)
    scene = inelastic_scene({"ball": ball}, {"floor": plane([0, 0, 0], [0, 0, 1])}, 0.05)
    snapshots = run_and_sample(scene, 0.01)
    height = column(snapshots, "position")[:, 0, 2]
    speed = column(snapshots, "velocity")[:, 0, 2]
    assert abs(height[-1] - height[-2]) < 1e-12
    assert abs(speed[-1]) < 1e-9
    weight = snapshots[-1].particles["mass"][0] * GRAVITY
    np.testing.assert_allclose(snapshots[-1].particles["force"][0], 0.0, atol=1e-6 * weight)


COLUMN_RESTITUTIONS = (0.0, 0.05, 0.3, 1.0)


def columns_scene(count, drag):
    """Columns of `count` spheres of 4 mm and 2 MPa that just touch, one per restitution, let down by a drag
    [1/s]."""
    names = [f"solid_{number}" for number in range(len(COLUMN_RESTITUTIONS))]
    radius = 0.002
    soft = {"young_modulus": 2e6, "poisson_ratio": 0.25, "density": 2500.0}
    groups = {}
    walls = {}
    pairs = {}
    for number, (name, restitution) in enumerate(zip(names, COLUMN_RESTITUTIONS, strict=True)):
        x = 0.01 * number
        positions = [[x, 0.0, radius * (2 * row + 1)] for row in range(count)]
        groups[name] = particle_group(positions, 2.0 * radius, name)
        walls[name] = {
            "shape": "rectangle", "material": name, "corner": [x - 0.004, -0.004, 0.0],
            "sides": [[0.008, 0.0, 0.0], [0.0, 0.008, 0.0]],
        }  # fmt: skip
        pairs[f"{name}-{name}"] = {"restitution": restitution, "friction": 0.0}
    return build_scene(
        groups, walls=walls, materials=dict.fromkeys(names, soft), pairs=pairs, gravity=[0.0, 0.0, -GRAVITY],
        damping={"drag": drag}, domain={"min": [-0.1] * 3, "max": [0.3] * 3, "on_exit": "error"},
        run={"duration": 0.5, "velocity_max": 0.3}, output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip


def overlaps_of_columns(count, drag):
    """Overlaps at rest over those of Hertz (restitutions, count), from the floor up, and the last snapshot.

    d = (n m g / k)^(2/3) below n spheres, k = (4/3) E sqrt(R), E = E_material / (2 (1 - nu^2)), R = radius at
    the floor and half of it between spheres.
    """
    last, _ = run_to_end(columns_scene(count, drag))
    radius = 0.002
    height = last.particles["position"][:, 2].reshape(len(COLUMN_RESTITUTIONS), count)
    radius_eff = np.where(np.arange(count) == 0, radius, radius / 2)
    stiffness = 4.0 / 3.0 * 2e6 / (2.0 * (1.0 - 0.25**2)) * np.sqrt(radius_eff)
    weight = 2500.0 * 4.0 / 3.0 * np.pi * radius**3 * GRAVITY
    hertz = (weight * (count - np.arange(count)) / stiffness) ** (2 / 3)
    overlap = np.concatenate([radius - height[:, :1], 2.0 * radius - np.diff(height, axis=1)], axis=1)
    return overlap / hertz, last


def test_column_rests_with_the_overlaps_of_hertz_at_every_restitution(taichi_f64):
    """A contact that is loaded slowly is on the loading curve, and carries its load there; the energy budget
    closes."""
    overlap, last = overlaps_of_columns(12, 4000.0)
    np.testing.assert_allclose(overlap, 1.0, rtol=2e-3)
    assert abs(last.totals["energy_error"]) < 1e-4


@pytest.mark.slow
def test_long_column_rests_with_the_overlaps_of_hertz_at_every_restitution(taichi_f64):
    """A drag that does not suppress the waves of the column: contacts stop and are loaded again many
    times."""
    overlap, last = overlaps_of_columns(50, 300.0)
    np.testing.assert_allclose(overlap[:, 0], 1.0, rtol=1e-3)
    np.testing.assert_allclose(overlap.mean(axis=1), 1.0, rtol=1e-2)
    assert abs(last.totals["energy_error"]) < 1e-4


@pytest.mark.parametrize("time_step", [13e-6, 3e-6])
def test_work_on_a_sphere_compressed_by_two_walls_is_that_of_hertz(taichi_f64, time_step):
    """Two contacts of the overlap d take the work 2 (2/5) k d^2.5 in slow compression, and store none of
    it."""
    lid = {
        "shape": "rectangle", "material": "glass", "corner": [-0.004, -0.004, 0.004],
        "sides": [[0.008, 0.0, 0.0], [0.0, 0.008, 0.0]],
        "motion": {"kind": "translation", "velocity": [0.0, 0.0, -0.005]},
    }  # fmt: skip
    last, _ = run_to_end(build_scene(
        {"ball": particle_group([[0.0, 0.0, 0.002]], 0.004)}, {"floor": plane([0, 0, 0], [0, 0, 1]), "lid": lid},
        materials={"glass": SOLID | {"young_modulus": 1e7}}, pair={"restitution": 0.0}, domain=BOX,
        run={"duration": 0.04, "time_step": time_step}, output={"interval": 1.0, "energy_budget": True},
    ))  # fmt: skip
    overlap = 0.5 * 0.005 * last.time
    work = 0.8 * 4.0 / 3.0 * 1e7 / (2.0 * (1.0 - 0.25**2)) * np.sqrt(0.002) * overlap**2.5
    assert last.totals["plastic_dissipation"] == pytest.approx(work, rel=1e-3)
    assert last.totals["elastic_energy"] == 0.0
    assert abs(last.totals["energy_error"]) < 1e-3


def test_particles_that_hit_one_from_both_sides_stop_together(taichi_f64):
    """The contacts load each other: both stop at the same time, and none rebounds by the load of the
    other."""
    positions = [[-0.0101, 0, 0], [0, 0, 0], [0.0101, 0, 0]]
    velocities = [[0.3, 0, 0], [0, 0, 0], [-0.3, 0, 0]]
    last, _ = run_to_end(inelastic_scene(
        {"balls": particle_group(positions, velocity=velocities)}, {}, 0.005, gravity=[0.0, 0.0, 0.0],
        numerics={"time_step_fraction": 0.1}, output={"interval": 1.0, "energy_budget": True},
    ))  # fmt: skip
    np.testing.assert_allclose(last.particles["velocity"], 0.0, rtol=0.0, atol=1e-12)
    energy = 0.5 * last.particles["mass"][[0, 2]].sum() * 0.3**2
    assert last.totals["plastic_dissipation"] == pytest.approx(energy, rel=1e-9)


def test_energy_budget_of_an_inelastic_bed_closes(taichi_f64):
    """63 spheres with friction fall into a box and come to rest; the support of their contacts does not
    change this."""
    rng = np.random.default_rng(3)
    positions = 0.0045 * (np.argwhere(np.ones((3, 3, 7))) + 0.6) + rng.uniform(-1e-4, 1e-4, (63, 3))
    walls = {
        "floor": plane([0, 0, 0], [0, 0, 1]),
        **{f"low_{n}": plane([0, 0, 0], axis) for n, axis in (("x", [1, 0, 0]), ("y", [0, 1, 0]))},
        **{f"high_{n}": plane([0.0145] * 3, axis) for n, axis in (("x", [-1, 0, 0]), ("y", [0, -1, 0]))},
    }
    scene = inelastic_scene(
        {"bed": particle_group(positions, 0.004)}, walls, 0.15, pair={"restitution": 0.0, "friction": 0.4},
        materials={"glass": SOLID | {"young_modulus": 5e6}}, output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip
    last, _ = run_to_end(scene)
    assert abs(last.totals["energy_error"]) < 5e-4
