"""Elastic-plastic spring with history: Mindlin's tangential spring and the EPSD rolling spring.

The history is the elastic displacement. If the stiffness increases, the force is preserved and the
displacement decreases; if it decreases, the displacement is preserved and the force decreases with the
contact radius (Thornton, Cummins & Cleary 2013). The spring therefore never generates energy.
"""

import numpy as np

from granflow.device_functions import ti


@ti.func
def limit_ratio(force, cap):
    """Factor that limits a force [N] to `cap` [N]; 1 below the limit."""
    square = force.dot(force)
    return ti.select(square > cap * cap, cap / ti.sqrt(square), 1.0)


@ti.func
def elastic_plastic_spring(stiffness, factor, cap, rotated, step):
    """Force -k s [N] after one step of displacement, limited to `cap` [N], and the new displacement.

    stiffness:  present stiffness k [N/m]
    factor:     factor of the displacement for a change of the stiffness; min(previous / present stiffness, 1)
                preserves the force if the stiffness increases, and the displacement if it decreases
    rotated:    displacement of the previous step [m] in the present contact plane
    step:       relative tangential displacement in this step [m]

    For a rolling spring, torque [N m] replaces force and angle [rad] displacement. `ti.select` replaces a
    branch, so that the compiler can vectorize over contacts.
    """
    displacement_new = factor * rotated + step
    force = -stiffness * displacement_new
    ratio = limit_ratio(force, cap)
    return ratio * force, ratio * displacement_new


@ti.func
def spring_loss(stiffness, stiffness_ratio, rotated, step, force, displacement_new):
    """Energy dissipated by the spring in one step [J]: work on it minus the increase of its energy."""
    stiffness_before = stiffness_ratio * stiffness
    work = 0.5 * (stiffness_before * rotated - force).dot(step)
    return (
        work
        + 0.5 * stiffness_before * rotated.dot(rotated)
        - 0.5 * stiffness * displacement_new.dot(displacement_new)
    )


def reference_spring(
    stiffness: float, cap: float, carried: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Reference implementation of `elastic_plastic_spring` in numpy, with vectors (3,).

    carried:  rotated displacement of the previous step [m] after the change of the stiffness
    """
    trial = carried + step
    size = stiffness * float(np.sqrt(trial @ trial))
    displacement_new = trial if size <= cap else trial * (cap / size)
    return -stiffness * displacement_new, displacement_new
