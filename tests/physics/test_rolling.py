"""A particle on a plane: transition from slip to rolling, rolling friction, sticking and sliding on a
slope."""

import numpy as np
import pytest
from scene_builders import SOFT, build_scene, column, particle_group, plane, run_and_sample, times

from granflow.contact import theory

GRAVITY = 9.81
RADIUS = 5e-4
MATERIAL = {"young_modulus": 1e7, "poisson_ratio": 0.3, "density": 1e4}
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * MATERIAL["density"]


def resting_overlap(acceleration):
    """Overlap [m] at which a Hertz contact with a floor of the same material balances the weight of the
    particle."""
    modulus = MATERIAL["young_modulus"] / (2.0 * (1.0 - MATERIAL["poisson_ratio"] ** 2))
    return float((MASS * acceleration / theory.hertz_stiffness(modulus, RADIUS)) ** (2.0 / 3.0))


def on_a_floor(pairs, velocity, angular_velocity, gravity=(0.0, 0.0, -GRAVITY), duration=1.0, **parts):
    """One particle per pair of coefficients, in a row along y, each of a separate material; rotation about
    y."""
    names = [f"ball_{number}" for number in range(len(pairs))]
    height = RADIUS - resting_overlap(-gravity[2])
    groups = {
        name: particle_group(
            [[0.0, 0.005 * n, height]],
            2.0 * RADIUS,
            name,
            velocity=[velocity, 0, 0],
            angular_velocity=[0, angular_velocity, 0],
        )
        for n, name in enumerate(names)
    }
    return build_scene(
        groups, walls={"floor": plane([0, 0, 0], [0, 0, 1], "floor")},
        materials=dict.fromkeys([*names, "floor"], MATERIAL),
        pairs={f"{name}-floor": {"restitution": 0.5, "rolling_friction": 0.0} | pair
               for name, pair in zip(names, pairs, strict=True)},
        gravity=list(gravity), run={"duration": duration, "velocity_max": 0.2}, **parts,
    )  # fmt: skip


def test_sliding_ball_starts_to_roll_after_two_sevenths(taichi_f64):
    """Slip ends at mu g t / u0 = 2/7; then u / u0 = w R / u0 = 5/7 (MFiX verification manual)."""
    frictions = np.array([0.2, 0.4, 0.6, 0.8, 1.0])
    speed = 0.1
    stop = 2.0 / 7.0 * speed / (frictions * GRAVITY)
    snapshots = run_and_sample(
        on_a_floor([{"friction": mu} for mu in frictions], speed, 0.0, duration=1.3 * stop[0]), stop[-1] / 60
    )
    u = column(snapshots, "velocity")[:, :, 0]
    rotation = RADIUS * column(snapshots, "angular_velocity")[:, :, 1]
    t = times(snapshots)
    np.testing.assert_allclose(
        u + 0.4 * rotation, speed, rtol=1e-3
    )  # angular momentum about the line of contact
    for n, mu in enumerate(frictions):
        sliding = t < 0.98 * stop[n]
        rolling = t > 1.05 * stop[n]
        np.testing.assert_allclose(
            u[sliding, n], speed - mu * GRAVITY * t[sliding], rtol=0.0, atol=2e-3 * speed
        )
        assert np.mean(u[rolling, n]) == pytest.approx(5.0 / 7.0 * speed, rel=1e-3)
        assert np.mean(rotation[rolling, n]) == pytest.approx(5.0 / 7.0 * speed, rel=1e-3)
        slip = u[:, n] - rotation[:, n]
        slip_end = np.interp(0.0, -slip[t < 1.02 * stop[n]], t[t < 1.02 * stop[n]])
        assert mu * GRAVITY * slip_end / speed == pytest.approx(2.0 / 7.0, rel=0.01)


@pytest.mark.parametrize("rolling", ["epsd", pytest.param("cdt", marks=pytest.mark.slow)])
def test_rolling_friction_stops_a_ball_after_the_theoretical_distance(taichi_f64, rolling):
    """The torque mu_r R N decelerates it by 5/7 mu_r g: distance 7 v^2 / (10 mu_r g); mu_r = 0 keeps the
    velocity."""
    rolling_frictions = np.array([0.05, 0.1, 0.2, 0.0])
    speed = 0.05
    pairs = [{"friction": 0.6, "rolling_friction": each} for each in rolling_frictions]
    stopping_time = speed / (5.0 / 7.0 * rolling_frictions[0] * GRAVITY)
    snapshots = run_and_sample(
        on_a_floor(pairs, speed, speed / RADIUS, duration=1.2 * stopping_time, rolling=rolling),
        stopping_time / 20,
    )
    path = column(snapshots, "position")[-1, :, 0]
    u = column(snapshots, "velocity")[:, :, 0]
    np.testing.assert_allclose(path[:3], 0.7 * speed**2 / (rolling_frictions[:3] * GRAVITY), rtol=0.01)
    np.testing.assert_allclose(u[:, 3], speed, rtol=1e-3)
    assert np.all(np.abs(u[-1, :3]) < 0.02 * speed)
    early = times(snapshots) < 0.2 * stopping_time
    np.testing.assert_allclose(
        u[early, 0],
        speed - 5.0 / 7.0 * rolling_frictions[0] * GRAVITY * times(snapshots)[early],
        atol=0.01 * speed,
    )


def test_ball_without_rolling_sticks_below_the_friction_angle_and_slides_above_it(taichi_f64):
    slope = 0.4
    frictions = np.array([0.2, 0.3, 0.5, 3.0])
    duration = 0.05
    angle = np.arctan(slope)
    down = GRAVITY * np.sin(angle)
    into = GRAVITY * np.cos(angle)
    pairs = [{"friction": mu, "rolling_friction": 4.0} for mu in frictions]
    scene = on_a_floor(pairs, 0.0, 0.0, (down, 0.0, -into), duration, rolling="epsd")
    snapshots = run_and_sample(scene, duration / 50)
    path = column(snapshots, "position")[:, :, 0]
    t = times(snapshots)
    late = (
        t > 0.2 * duration
    )  # the velocity gained during the initial deflection of the springs is constant then
    for n in (0, 1):
        gained = column(snapshots, "velocity")[late, n, 0] - (down - frictions[n] * into) * t[late]
        np.testing.assert_allclose(gained, gained.mean(), rtol=0.0, atol=2e-3 * down * duration)
        assert 0.0 < gained.mean() < 2e-3
    # the tangential spring deflects until it carries the load, and the rolling spring adds the same
    # displacement at the center; from rest the first oscillation doubles the sum, and creep adds at most the
    # same amount again while the normal contact vibrates
    overlap = resting_overlap(into)
    nu = MATERIAL["poisson_ratio"]
    shear = MATERIAL["young_modulus"] / (2.0 * (1.0 + nu)) / (2.0 * (2.0 - nu))
    deflection = MASS * down / (8.0 * shear * np.sqrt(RADIUS * overlap))
    first = path[t < 0.2 * duration, 3]
    assert 2.0 * deflection < first.max() < 1.01 * 4.0 * deflection
    assert np.abs(path[:, 2:]).max() < 8.0 * deflection < 1e-3 * path[-1, 1]


def test_ball_rolls_down_a_slope_with_the_theoretical_acceleration(taichi_f64):
    """Rolling without slip requires friction above 2/7 tan(angle); the acceleration is 5/7 g sin(angle)."""
    angle = np.arctan(0.4)
    duration = 0.05
    down = GRAVITY * np.sin(angle)
    into = GRAVITY * np.cos(angle)
    snapshots = run_and_sample(
        on_a_floor([{"friction": 0.5}], 0.0, 0.0, (down, 0.0, -into), duration), duration / 20
    )
    path = column(snapshots, "position")[:, 0, 0]
    t = times(snapshots)
    np.testing.assert_allclose(path, 5.0 / 14.0 * down * t**2, rtol=0.0, atol=5e-3 * path[-1])
    angular_velocity = column(snapshots, "angular_velocity")[-1, 0, 1]
    assert angular_velocity * RADIUS == pytest.approx(5.0 / 7.0 * down * t[-1], rel=5e-3)


def test_wall_is_the_limit_of_a_growing_partner(taichi_f64):
    """An oblique impact on a particle 100 and 1000 times as large: the difference decreases as 1 / size."""
    sizes = np.array([1.0, 10.0])
    radius = 0.005
    velocity = [0.3, 0.0, -1.0]
    angular_velocity = [0.0, 40.0, 0.0]
    ball = particle_group(
        [[0.0, 0.0, radius]], 2 * radius, velocity=velocity, angular_velocity=angular_velocity
    )
    ends = []
    for size in (*sizes, None):
        groups = {"ball": ball}
        walls = {}
        if size is None:
            walls = {"floor": plane([0, 0, 0], [0, 0, 1])}
        else:
            groups["partner"] = particle_group([[0.0, 0.0, -0.5 * size]], size)
        scene = build_scene(
            groups, walls=walls, pair={"friction": 0.3, "restitution": 0.7}, materials={"glass": SOFT},
            domain={"min": [-20.0] * 3, "max": [20.0] * 3, "on_exit": "error"},
            run={"duration": 1e-3, "velocity_max": 1.0, "time_step": 5e-7},
        )  # fmt: skip
        last = run_and_sample(scene, 1.0)[-1].particles
        ends.append(np.concatenate([last["velocity"][0], radius * last["angular_velocity"][0]]))
    hundred, thousand = (np.linalg.norm(end - ends[2]) for end in ends[:2])
    assert ends[2][2] == pytest.approx(0.7, rel=2e-3)
    assert hundred < 0.02
    assert hundred / thousand == pytest.approx(10.0, rel=0.2)
