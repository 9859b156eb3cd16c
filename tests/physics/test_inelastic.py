"""Contacts of the restitution 0: impacts without rebound, and the completely inelastic bouncing ball.

The flights of the ball on a vibrating plate follow the map of `granflow.studies.validation.vibrated`.
"""

import numpy as np
import pytest
from scene_builders import build_scene, column, particle_group, plane, run_and_sample, run_to_end, times

from granflow.studies.validation.vibrated import GRAVITY, RADIUS, SOLID, flights_of_map, flights_of_run

BOX = {"min": [-0.1] * 3, "max": [0.1] * 3, "on_exit": "error"}


def inelastic_scene(groups, walls, duration, **parts):
    """A scene of restitution 0 under gravity."""
    return build_scene(
        groups, walls=walls, materials={"glass": SOLID}, pair={"restitution": 0.0}, domain=BOX,
        run={"duration": duration, "velocity_max": 0.5}, **({"gravity": [0.0, 0.0, -GRAVITY]} | parts),
    )  # fmt: skip


def check_flights(gammas, samples):
    """The contact forms one overlap, 30 micrometers, above the plane that supports the ball: 0.4 % of a period.

    The flights of the run end earlier by this time; they are sampled to one sample at each end.
    """
    for gamma, found in zip(gammas, flights_of_run(gammas, samples), strict=True):
        if gamma < 1.0:
            assert len(found) == 0
            continue
        expected = flights_of_map(gamma)
        assert abs(len(found) - len(expected)) <= 1, gamma
        for extreme in (np.min, np.max):
            np.testing.assert_allclose(extreme(found), extreme(expected), rtol=0.0, atol=0.005 + 1.0 / samples)


def test_inelastic_ball_doubles_its_period(taichi_f64):
    """A flight lasts a period from sqrt(1 + pi^2) = 3.297 on; two durations alternate from sqrt(4 + pi^2) = 3.724 on.

    A flight of a period has the phase cos p = pi / gamma. A landing that is late by q makes the next one late by
    (1 - gamma sin p) q, which grows in magnitude if gamma sin p > 2. Flights converge slowly near this value: the map
    and the run have 100 periods before the flights that count.
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
    scene = inelastic_scene({"balls": group}, {}, 0.005, output={"interval": 1.0, "energy_budget": True}, **parts)
    last, _ = run_to_end(scene)
    mass = last.particles["mass"]
    common = mass @ velocities / mass.sum()
    np.testing.assert_allclose(last.particles["velocity"], [common, common], rtol=0.0, atol=1e-12)
    loss = 0.5 * mass @ np.sum(velocities**2, axis=1) - 0.5 * mass.sum() * common @ common
    assert last.totals["plastic_dissipation"] == pytest.approx(loss, rel=2e-3 if fraction < 0.1 else 0.1)


def test_ball_that_hits_a_ceiling_falls_from_rest(taichi_f64):
    """No rebound and no tension: gravity separates the contact at once."""
    ceiling = {"ceiling": plane([0, 0, 0.01], [0, 0, -1])}
    ball = particle_group([[0.0, 0.0, 0.01 - RADIUS - 1e-4]], 2.0 * RADIUS, velocity=[0.0, 0.0, 0.4])
    snapshots = run_and_sample(inelastic_scene({"ball": ball}, ceiling, 0.05), 0.001)
    time, velocity = times(snapshots), column(snapshots, "velocity")[:, 0, 2]
    falling = time > 0.0015
    release = time[falling] + velocity[falling] / GRAVITY
    np.testing.assert_allclose(release, release[0], rtol=0.0, atol=1e-12)
    assert 0.00025 < release[0] < 0.0005  # after 0.25 ms of flight and the impact


def test_ball_comes_to_rest_on_a_floor(taichi_f64):
    """The floor carries the weight without oscillation; the ball sinks by less than a picometer in 10 ms."""
    ball = particle_group([[0.0, 0.0, RADIUS + 1e-3]], 2.0 * RADIUS)
    scene = inelastic_scene({"ball": ball}, {"floor": plane([0, 0, 0], [0, 0, 1])}, 0.05)
    snapshots = run_and_sample(scene, 0.01)
    height, speed = column(snapshots, "position")[:, 0, 2], column(snapshots, "velocity")[:, 0, 2]
    assert abs(height[-1] - height[-2]) < 1e-12
    assert abs(speed[-1]) < 1e-9
    weight = snapshots[-1].particles["mass"][0] * GRAVITY
    np.testing.assert_allclose(snapshots[-1].particles["force"][0], 0.0, atol=1e-6 * weight)
