"""The tangential and rolling slots by themselves: device against twin, the cap, and that no spring makes energy."""

import numpy as np
import pytest
import taichi as ti

from granflow.laws import mindlin
from granflow.laws.rolling import STOPPED_SHARE, directional_torque

VECTORS = ti.types.ndarray(ti.f64, 2)
NUMBERS = ti.types.ndarray(ti.f64, 1)


@ti.kernel
def stretch(
    stiffness: NUMBERS, share: NUMBERS, cap: NUMBERS, carried: VECTORS, step: VECTORS,
    force: VECTORS, spring_history: VECTORS, lost: NUMBERS
):  # fmt: skip
    for i in range(cap.shape[0]):
        before = ti.Vector([carried[i, 0], carried[i, 1], carried[i, 2]])
        slide = ti.Vector([step[i, 0], step[i, 1], step[i, 2]])
        pull, after = mindlin.elastic_plastic_spring(stiffness[i], share[i], cap[i], before, slide)
        lost[i] = mindlin.spring_loss(stiffness[i], share[i], before, slide, pull, after)
        for k in ti.static(range(3)):
            force[i, k], spring_history[i, k] = pull[k], after[k]


@ti.kernel
def turn(displacement: VECTORS, normal: VECTORS, middle: VECTORS, turned: VECTORS):
    for i in range(displacement.shape[0]):
        s = ti.Vector([displacement[i, 0], displacement[i, 1], displacement[i, 2]])
        n = ti.Vector([normal[i, 0], normal[i, 1], normal[i, 2]])
        m = ti.Vector([middle[i, 0], middle[i, 1], middle[i, 2]])
        result = mindlin.rotated_displacement(s, n, m)
        for k in ti.static(range(3)):
            turned[i, k] = result[k]


@ti.kernel
def brake(
    radius: ti.f64, friction: ti.f64, normal_force: NUMBERS, rate: VECTORS, inertia: ti.f64, dt: ti.f64, torque: VECTORS
):
    for i in range(normal_force.shape[0]):
        omega = ti.Vector([rate[i, 0], rate[i, 1], rate[i, 2]])
        result = directional_torque(radius, friction, normal_force[i], omega, inertia, dt)
        for k in ti.static(range(3)):
            torque[i, k] = result[k]


def random_springs(count=4000, seed=1):
    rng = np.random.default_rng(seed)
    stiffness, share = rng.uniform(1e3, 1e5, count), rng.uniform(0.2, 1.8, count)
    cap = rng.uniform(0.0, 2.0, count)
    carried, step = rng.normal(0.0, 2e-5, (count, 3)), rng.normal(0.0, 1e-5, (count, 3))
    # no spring starts above the cap of the step before, which the contact force of that step set
    carried *= np.minimum(1.0, cap / (share * stiffness) / np.linalg.norm(carried, axis=1))[:, None]
    return stiffness, share, cap, carried, step


def stretched(stiffness, share, cap, carried, step):
    force, spring_history, lost = np.zeros_like(carried), np.zeros_like(carried), np.zeros_like(cap)
    stretch(stiffness, share, cap, carried, step, force, spring_history, lost)
    return force, spring_history, lost


def test_spring_on_the_device_equals_its_reference_within_4_ulps(taichi_f64):
    springs = random_springs()
    force, spring_history, _ = stretched(*springs)
    for i, numbers in enumerate(zip(*springs, strict=True)):
        expected = mindlin.reference_spring(*numbers)
        for found, given in zip((force[i], spring_history[i]), expected, strict=True):
            assert np.abs(found - given).max() <= 4.0 * np.finfo(float).eps * np.linalg.norm(given)


def test_spring_holds_at_the_cap_and_never_above(taichi_f64):
    stiffness, share, cap, carried, step = random_springs(seed=2)
    force, spring_history, _ = stretched(stiffness, share, cap, carried, step)
    size = np.linalg.norm(force, axis=1)
    assert np.all(size <= cap * (1.0 + 1e-15 * 4))
    sliding = stiffness * np.linalg.norm(np.minimum(share, 1.0)[:, None] * carried + step, axis=1) > cap
    assert 100 < sliding.sum() < len(cap) - 100
    np.testing.assert_allclose(size[sliding], cap[sliding], rtol=1e-14)
    np.testing.assert_allclose(-stiffness[:, None] * spring_history, force, rtol=1e-13, atol=1e-16)


def test_spring_never_makes_energy(taichi_f64):
    """Also where the contact grows or shrinks under it: the loss of a step is never below 0, beyond rounding.

    For steps shorter than the displacement: one that reverses it within a step is beyond the trapezoid rule.
    """
    stiffness, share, cap, carried, step = random_springs(seed=3)
    step *= (0.5 * np.linalg.norm(carried, axis=1) / np.linalg.norm(step, axis=1))[:, None]
    _, _, lost = stretched(stiffness, share, cap, carried, step)
    scale = stiffness * (np.linalg.norm(carried, axis=1) + np.linalg.norm(step, axis=1)) ** 2
    assert np.all(lost >= -1e-14 * scale)
    assert np.count_nonzero(lost > 1e-3 * scale) > 1000


def test_spring_of_a_steady_contact_that_sticks_loses_nothing(taichi_f64):
    stiffness, _, cap, carried, step = random_springs(seed=4)
    _, _, lost = stretched(stiffness, np.ones_like(cap), cap + 100.0, carried, step)
    scale = stiffness * (np.linalg.norm(carried, axis=1) + np.linalg.norm(step, axis=1)) ** 2
    assert np.all(np.abs(lost) <= 1e-14 * scale)


def turned_by_a_quarter(steps):
    """A displacement carried along while its contact plane turns by a quarter circle about y."""
    slide = np.array([[1.0, 0.5, 0.0]])
    angles = np.linspace(0.0, 0.5 * np.pi, steps + 1)
    normals = np.stack([np.sin(angles), np.zeros(steps + 1), np.cos(angles)], axis=1)
    for before, now in zip(normals[:-1], normals[1:], strict=True):
        turned = np.zeros((1, 3))
        turn(slide, now[None, :], 0.5 * (before + now)[None, :], turned)
        slide = turned
    return slide[0]


def test_displacement_turns_with_the_contact_plane(taichi_f64):
    """Fourth order in the angle of a step, so third order over a whole turn: an eighth where it halves."""
    errors = [np.linalg.norm(turned_by_a_quarter(steps) - [0.0, 0.5, -1.0]) for steps in (20, 40)]
    assert errors[0] < 1e-3
    assert errors[0] / errors[1] > 7.5
    assert turned_by_a_quarter(20)[1] == 0.5, "the part along the axis of the turn stays"


def test_directional_torque_opposes_rolling_and_never_reverses_it(taichi_f64):
    rng = np.random.default_rng(6)
    radius, friction, inertia, dt = 0.01, 0.1, 4e-7, 3e-4
    normal_force, rate = rng.uniform(0.0, 1.0, 500), rng.normal(0.0, 1.0, (500, 3))
    rate[0] = 0.0
    torque = np.zeros((500, 3))
    brake(radius, friction, normal_force, rate, inertia, dt, torque)
    assert not torque[0].any()
    after = rate + dt / inertia * torque
    size = np.linalg.norm(torque, axis=1)
    np.testing.assert_allclose(np.cross(torque, rate), 0.0, atol=1e-18)
    assert np.all(np.sum(after * rate, axis=1)[1:] > 0.0)
    full = friction * radius * normal_force
    share_of_stop = STOPPED_SHARE * inertia * np.linalg.norm(rate, axis=1) / dt
    np.testing.assert_allclose(size, np.minimum(full, share_of_stop), rtol=1e-13)
    assert 50 < np.count_nonzero(full < share_of_stop) < 450


def test_no_set_of_neighbors_reverses_a_rotation_in_one_step():
    """Neighbor j removes the share I_j / (I_i + I_j) = 1 / (1 + x^-5), x = R_j / R_i, of `STOPPED_SHARE`.

    n spheres that touch sphere i and not each other are seen from it at angles of at least t: x / (1 + x) = sin(t / 2).
    The largest t for n points on a sphere: problem of Tammes (Musin & Tarasov 2015, Exp. Math. 24:460).
    """
    angles = {
        3: 120.0, 4: 109.4712, 5: 90.0, 6: 90.0, 7: 77.8695, 8: 74.8585, 9: 70.5288, 10: 66.1468, 11: 63.4349,
        12: 63.4349, 13: 57.1367, 14: 55.6706
    }  # fmt: skip
    count, sine = np.array(list(angles)), np.sin(0.5 * np.radians(list(angles.values())))
    ratio = sine / (1.0 - sine)
    total = count / (1.0 + ratio**-5)
    assert total.max() == pytest.approx(7.51, abs=0.01)
    assert STOPPED_SHARE * total.max() < 1.0
