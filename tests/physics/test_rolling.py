"""A sphere on a plane: from slipping to rolling, rolling on, sticking and sliding on a slope, rolling to rest."""

import numpy as np
import pytest
from scene_builders import SOFT, build_scene, column, particle_group, plane, run_and_sample, times

from granflow.laws import theory

GRAVITY = 9.81
RADIUS = 5e-4
BODY = {"young_modulus": 1e7, "poisson_ratio": 0.3, "density": 1e4}
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * BODY["density"]


def resting_overlap(pull):
    """Overlap [m] at which a Hertz contact with the floor, of the same material, carries the ball."""
    modulus = BODY["young_modulus"] / (2.0 * (1.0 - BODY["poisson_ratio"] ** 2))
    return float((MASS * pull / theory.hertz_stiffness(modulus, RADIUS)) ** (2.0 / 3.0))


def on_a_floor(pairs, velocity, angular_velocity, gravity=(0.0, 0.0, -GRAVITY), duration=1.0, **parts):
    """One ball for each pair of coefficients, side by side in y, each of its own material; spins about y."""
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
        groups, walls={"floor": plane([0, 0, 0], [0, 0, 1], "floor")}, materials=dict.fromkeys([*names, "floor"], BODY),
        pairs={f"{name}-floor": {"restitution": 0.5, "rolling_friction": 0.0} | pair
               for name, pair in zip(names, pairs, strict=True)},
        gravity=list(gravity), run={"duration": duration, "velocity_max": 0.2}, **parts,
    )  # fmt: skip


def test_slipping_ends_in_rolling(taichi_f64):
    """Slip stops at mu g t / u0 = 2/7, and then u / u0 = w R / u0 = 5/7 (MFiX verification manual)."""
    frictions, speed = np.array([0.2, 0.4, 0.6, 0.8, 1.0]), 0.1
    stop = 2.0 / 7.0 * speed / (frictions * GRAVITY)
    seen = run_and_sample(
        on_a_floor([{"friction": mu} for mu in frictions], speed, 0.0, duration=1.3 * stop[0]), stop[-1] / 60
    )
    u, turning = column(seen, "velocity")[:, :, 0], RADIUS * column(seen, "angular_velocity")[:, :, 1]
    t = times(seen)
    np.testing.assert_allclose(u + 0.4 * turning, speed, rtol=1e-3)  # angular momentum about the line of contact
    for n, mu in enumerate(frictions):
        sliding, rolling = t < 0.98 * stop[n], t > 1.05 * stop[n]
        np.testing.assert_allclose(u[sliding, n], speed - mu * GRAVITY * t[sliding], rtol=0.0, atol=2e-3 * speed)
        assert np.mean(u[rolling, n]) == pytest.approx(5.0 / 7.0 * speed, rel=1e-3)
        assert np.mean(turning[rolling, n]) == pytest.approx(5.0 / 7.0 * speed, rel=1e-3)
        slip = u[:, n] - turning[:, n]
        ends = np.interp(0.0, -slip[t < 1.02 * stop[n]], t[t < 1.02 * stop[n]])
        assert mu * GRAVITY * ends / speed == pytest.approx(2.0 / 7.0, rel=0.01)


@pytest.mark.parametrize("rolling", ["epsd", "cdt"])
def test_rolling_friction_stops_a_ball_after_its_distance(taichi_f64, rolling):
    """Torque mu_r R N on a rolling ball slows it by 5/7 mu_r g: it comes 7 v^2 / (10 mu_r g) far; else on it rolls."""
    resistances, speed = np.array([0.05, 0.1, 0.2, 0.0]), 0.05
    pairs = [{"friction": 0.6, "rolling_friction": each} for each in resistances]
    slowest = speed / (5.0 / 7.0 * resistances[0] * GRAVITY)
    seen = run_and_sample(
        on_a_floor(pairs, speed, speed / RADIUS, duration=1.2 * slowest, rolling=rolling), slowest / 20
    )
    path, u = column(seen, "position")[-1, :, 0], column(seen, "velocity")[:, :, 0]
    np.testing.assert_allclose(path[:3], 0.7 * speed**2 / (resistances[:3] * GRAVITY), rtol=0.01)
    np.testing.assert_allclose(u[:, 3], speed, rtol=1e-3)
    assert np.all(np.abs(u[-1, :3]) < 0.02 * speed)
    early = times(seen) < 0.2 * slowest
    np.testing.assert_allclose(
        u[early, 0], speed - 5.0 / 7.0 * resistances[0] * GRAVITY * times(seen)[early], atol=0.01 * speed
    )


def test_on_a_slope_a_ball_that_cannot_roll_sticks_below_the_friction_angle_and_slides_above(taichi_f64):
    slope, frictions, duration = 0.4, np.array([0.2, 0.3, 0.5, 3.0]), 0.05
    angle = np.arctan(slope)
    down, into = GRAVITY * np.sin(angle), GRAVITY * np.cos(angle)
    pairs = [{"friction": mu, "rolling_friction": 4.0} for mu in frictions]
    scene = on_a_floor(pairs, 0.0, 0.0, (down, 0.0, -into), duration, rolling="epsd")
    seen = run_and_sample(scene, duration / 50)
    path, t = column(seen, "position")[:, :, 0], times(seen)
    late = t > 0.2 * duration  # what is gained while the springs give at first is constant by then
    for n in (0, 1):
        gained = column(seen, "velocity")[late, n, 0] - (down - frictions[n] * into) * t[late]
        np.testing.assert_allclose(gained, gained.mean(), rtol=0.0, atol=2e-3 * down * duration)
        assert 0.0 < gained.mean() < 2e-3
    # each spring gives by what carries the pull, the rolling one by as much again at the center; from rest the ball
    # swings to twice that at first, and creeps by no more than as much while its normal contact still trembles
    overlap = resting_overlap(into)
    shear = BODY["young_modulus"] / (2.0 * (1.0 + BODY["poisson_ratio"])) / (2.0 * (2.0 - BODY["poisson_ratio"]))
    give = MASS * down / (8.0 * shear * np.sqrt(RADIUS * overlap))
    first = path[t < 0.2 * duration, 3]
    assert 2.0 * give < first.max() < 1.01 * 4.0 * give
    assert np.abs(path[:, 2:]).max() < 8.0 * give < 1e-3 * path[-1, 1]


def test_the_same_ball_free_to_roll_runs_down_the_slope(taichi_f64):
    """Rolling without slip, which 2/7 tan(angle) of friction suffices for: acceleration 5/7 g sin(angle)."""
    angle, duration = np.arctan(0.4), 0.05
    down, into = GRAVITY * np.sin(angle), GRAVITY * np.cos(angle)
    seen = run_and_sample(on_a_floor([{"friction": 0.5}], 0.0, 0.0, (down, 0.0, -into), duration), duration / 20)
    path, t = column(seen, "position")[:, 0, 0], times(seen)
    np.testing.assert_allclose(path, 5.0 / 14.0 * down * t**2, rtol=0.0, atol=5e-3 * path[-1])
    angular_velocity = column(seen, "angular_velocity")[-1, 0, 1]
    assert angular_velocity * RADIUS == pytest.approx(5.0 / 7.0 * down * t[-1], rel=5e-3)


def test_a_wall_is_the_limit_of_a_growing_partner(taichi_f64):
    """An oblique impact on a sphere 100 and 1000 times as large: the difference falls in proportion to 1 / size."""
    sizes = np.array([1.0, 10.0])
    radius, velocity, angular_velocity = 0.005, [0.3, 0.0, -1.0], [0.0, 40.0, 0.0]
    ball = particle_group([[0.0, 0.0, radius]], 2 * radius, velocity=velocity, angular_velocity=angular_velocity)
    ends = []
    for size in (*sizes, None):
        groups, walls = {"ball": ball}, {}
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
