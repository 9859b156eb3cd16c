"""Tangential slot: Mindlin's no-slip spring with history, capped by Coulomb friction.

The spring remembers its elastic displacement. While the contact grows the force is kept and the displacement
shrinks with the stiffer contact; while it shrinks the displacement is kept and the force falls with the contact
radius (Thornton, Cummins & Cleary 2013): so the spring never makes energy. The rolling spring is the same thing
with a torque and an angle.
"""

import numpy as np
import taichi as ti


@ti.func
def mindlin_stiffness(constants, radius_eff, overlap, history):
    """No-slip stiffness of a Hertz contact, 8 G sqrt(R d) [N/m] (Mindlin 1949); constants[1] is G."""
    return 8.0 * constants[1] * ti.sqrt(radius_eff * overlap)


@ti.func
def rotated_displacement(displacement, normal, normal_middle):
    """Displacement turned with the contact plane over one step.

        s' = s - (s . n) (n_before + n) / 2

    A pair that spins as one about its normal does not turn its spring: no peer does, and it costs a cross product.
    The mean of the old and the new normal keeps the length of s to fourth order in the angle turned.
    """
    return displacement - displacement.dot(normal) * normal_middle


@ti.func
def elastic_plastic_spring(stiffness, stiffness_ratio, cap, rotated, step):
    """Spring force -k s after one more step of displacement, held at `cap`; returns (force, displacement kept).

    `stiffness_ratio` is the stiffness one step ago over the present one: below 1 the force is kept, above 1 the
    displacement.
    Selected without a branch, which would keep the compiler from doing several contacts at once.
    """
    displacement_new = ti.min(stiffness_ratio, 1.0) * rotated + step
    force = -stiffness * displacement_new
    square = force.dot(force)
    ratio = ti.select(square > cap * cap, cap / ti.sqrt(square), 1.0)
    return ratio * force, ratio * displacement_new


@ti.func
def spring_loss(stiffness, stiffness_ratio, rotated, step, force, displacement_new):
    """Energy the spring took for good in one step [J]: work put in, less what it stores more than before."""
    stiffness_before = stiffness_ratio * stiffness
    work = 0.5 * (stiffness_before * rotated - force).dot(step)
    return (
        work + 0.5 * stiffness_before * rotated.dot(rotated) - 0.5 * stiffness * displacement_new.dot(displacement_new)
    )


def reference_spring(
    stiffness: float, stiffness_ratio: float, cap: float, rotated: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Numpy twin of `elastic_plastic_spring`."""
    trial = (rotated * stiffness_ratio if stiffness_ratio < 1.0 else rotated) + step
    size = stiffness * float(np.sqrt(trial @ trial))
    displacement_new = trial if size <= cap else trial * (cap / size)
    return -stiffness * displacement_new, displacement_new
