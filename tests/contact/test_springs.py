"""Tangential springs and rolling torques: Coulomb limit, losses, rotation with the contact plane."""

import numpy as np
import pytest

from granflow.contact.law import in_contact_plane
from granflow.contact.rolling.bounded_torque import STOPPED_SHARE, bounded_torque
from granflow.contact.tangential import spring
from granflow.kernel_language import ti

VECTORS = ti.types.ndarray(ti.f64, 2)
NUMBERS = ti.types.ndarray(ti.f64, 1)


@ti.kernel
def stretch(
    stiffness: NUMBERS, share: NUMBERS, force_max: NUMBERS, displacement_before: VECTORS, step: VECTORS,
    force: VECTORS, spring_history: VECTORS, lost: NUMBERS
):  # fmt: skip
    for i in range(force_max.shape[0]):
        before = ti.Vector([displacement_before[i, 0], displacement_before[i, 1], displacement_before[i, 2]])
        increment = ti.Vector([step[i, 0], step[i, 1], step[i, 2]])
        spring_force, after = spring.elastic_plastic_spring(
            stiffness[i], ti.min(share[i], 1.0), force_max[i], before, increment
        )
        lost[i] = spring.spring_loss(stiffness[i], share[i], before, increment, spring_force, after)
        for k in ti.static(range(3)):
            force[i, k], spring_history[i, k] = spring_force[k], after[k]


@ti.kernel
def rotate(displacement: VECTORS, normal: VECTORS, middle: VECTORS, rotated: VECTORS):
    for i in range(displacement.shape[0]):
        s = ti.Vector([displacement[i, 0], displacement[i, 1], displacement[i, 2]])
        n = ti.Vector([normal[i, 0], normal[i, 1], normal[i, 2]])
        m = ti.Vector([middle[i, 0], middle[i, 1], middle[i, 2]])
        result = in_contact_plane(s, n, m)
        for k in ti.static(range(3)):
            rotated[i, k] = result[k]


@ti.kernel
def apply_torque(
    radius: ti.f64,
    friction: ti.f64,
    normal_force: NUMBERS,
    rate: VECTORS,
    inertia: ti.f64,
    dt: ti.f64,
    torque: VECTORS,
):
    for i in range(normal_force.shape[0]):
        omega = ti.Vector([rate[i, 0], rate[i, 1], rate[i, 2]])
        result = bounded_torque(friction * radius * normal_force[i], omega, omega.norm(), inertia, dt)
        for k in ti.static(range(3)):
            torque[i, k] = result[k]


def random_springs(count=4000, seed=1):
    """Stiffness [N/m], contact radius ratio, force limit [N], displacement [m] and increment [m] of random
    springs."""
    rng = np.random.default_rng(seed)
    stiffness = rng.uniform(1e3, 1e5, count)
    share = rng.uniform(0.2, 1.8, count)
    force_max = rng.uniform(0.0, 2.0, count)
    displacement_before = rng.normal(0.0, 2e-5, (count, 3))
    step = rng.normal(0.0, 1e-5, (count, 3))
    # no spring starts above the force limit of the previous step, which the contact force of that step
    # determines
    displacement_before *= np.minimum(
        1.0, force_max / (share * stiffness) / np.linalg.norm(displacement_before, axis=1)
    )[:, None]
    return stiffness, share, force_max, displacement_before, step


def stretched(stiffness, share, force_max, displacement_before, step):
    """Force [N], displacement [m] and loss [J] of springs after an increment."""
    force = np.zeros_like(displacement_before)
    spring_history = np.zeros_like(displacement_before)
    lost = np.zeros_like(force_max)
    stretch(stiffness, share, force_max, displacement_before, step, force, spring_history, lost)
    return force, spring_history, lost


def test_spring_force_is_limited_to_the_friction_limit(taichi_f64):
    stiffness, share, force_max, displacement_before, step = random_springs(seed=2)
    force, spring_history, _ = stretched(stiffness, share, force_max, displacement_before, step)
    size = np.linalg.norm(force, axis=1)
    assert np.all(size <= force_max * (1.0 + 1e-15 * 4))
    sliding = (
        stiffness * np.linalg.norm(np.minimum(share, 1.0)[:, None] * displacement_before + step, axis=1)
        > force_max
    )
    assert 100 < sliding.sum() < len(force_max) - 100
    np.testing.assert_allclose(size[sliding], force_max[sliding], rtol=1e-14)
    np.testing.assert_allclose(-stiffness[:, None] * spring_history, force, rtol=1e-13, atol=1e-16)


def test_spring_loss_is_never_negative(taichi_f64):
    """The loss of a step is at least 0 within rounding, also if the contact radius changes.

    The steps are shorter than the displacement; the trapezoid rule does not cover a reversal within one step.
    """
    stiffness, share, force_max, displacement_before, step = random_springs(seed=3)
    step *= (0.5 * np.linalg.norm(displacement_before, axis=1) / np.linalg.norm(step, axis=1))[:, None]
    _, _, lost = stretched(stiffness, share, force_max, displacement_before, step)
    scale = stiffness * (np.linalg.norm(displacement_before, axis=1) + np.linalg.norm(step, axis=1)) ** 2
    assert np.all(lost >= -1e-14 * scale)
    assert np.count_nonzero(lost > 1e-3 * scale) > 1000


def rotated_by_90_degrees(steps):
    """A tangential displacement after its contact plane rotates by 90 degrees about y."""
    displacement = np.array([[1.0, 0.5, 0.0]])
    angles = np.linspace(0.0, 0.5 * np.pi, steps + 1)
    normals = np.stack([np.sin(angles), np.zeros(steps + 1), np.cos(angles)], axis=1)
    for before, now in zip(normals[:-1], normals[1:], strict=True):
        rotated = np.zeros((1, 3))
        rotate(displacement, now[None, :], 0.5 * (before + now)[None, :], rotated)
        displacement = rotated
    return displacement[0]


def test_displacement_rotates_with_the_contact_plane(taichi_f64):
    """Fourth order in the angle of a step, so third order in total: half the step gives an eighth of the
    error."""
    errors = [np.linalg.norm(rotated_by_90_degrees(steps) - [0.0, 0.5, -1.0]) for steps in (20, 40)]
    assert errors[0] < 1e-3
    assert errors[0] / errors[1] > 7.5
    assert rotated_by_90_degrees(20)[1] == 0.5, "the component along the rotation axis is unchanged"


def test_directional_torque_opposes_rolling_and_never_reverses_it(taichi_f64):
    rng = np.random.default_rng(6)
    radius = 0.01
    friction = 0.1
    inertia = 4e-7
    dt = 3e-4
    normal_force = rng.uniform(0.0, 1.0, 500)
    rate = rng.normal(0.0, 1.0, (500, 3))
    rate[0] = 0.0
    torque = np.zeros((500, 3))
    apply_torque(radius, friction, normal_force, rate, inertia, dt, torque)
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
    """Neighbor j removes the fraction I_j / (I_i + I_j) = 1 / (1 + x^-5), x = R_j / R_i, of `STOPPED_SHARE`.

    The branch vectors from particle i to n contacting particles without mutual contact form angles of at
    least t:
    x / (1 + x) = sin(t / 2). The largest t for n points on a sphere: Tammes problem (Musin & Tarasov 2015,
    Exp. Math. 24:460).
    """
    angles = {
        3: 120.0, 4: 109.4712, 5: 90.0, 6: 90.0, 7: 77.8695, 8: 74.8585, 9: 70.5288, 10: 66.1468, 11: 63.4349,
        12: 63.4349, 13: 57.1367, 14: 55.6706
    }  # fmt: skip
    count = np.array(list(angles))
    sine = np.sin(0.5 * np.radians(list(angles.values())))
    ratio = sine / (1.0 - sine)
    total = count / (1.0 + ratio**-5)
    assert total.max() == pytest.approx(7.51, abs=0.01)
    assert STOPPED_SHARE * total.max() < 1.0
