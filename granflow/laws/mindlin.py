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
def carried_displacement(displacement, normal, normal_middle):
    """Displacement turned with the contact plane over one step.

        s' = s - (s . n) (n_before + n) / 2

    A pair that spins as one about its normal does not turn its spring: no peer does, and it costs a cross product.
    The mean of the old and the new normal keeps the length of s to fourth order in the angle turned.
    """
    return displacement - displacement.dot(normal) * normal_middle


@ti.func
def elastic_plastic_spring(stiffness, share, cap, carried, step):
    """Spring force -k s after one more step of displacement, held at `cap`; returns (force, displacement kept).

    `share` is the stiffness one step ago over the present one: below 1 the force is kept, above 1 the displacement.
    Selected without a branch, which would keep the compiler from doing several contacts at once.
    """
    kept = ti.min(share, 1.0) * carried + step
    force = -stiffness * kept
    square = force.dot(force)
    ratio = ti.select(square > cap * cap, cap / ti.sqrt(square), 1.0)
    return ratio * force, ratio * kept


@ti.func
def spring_loss(stiffness, share, carried, step, force, kept):
    """Energy the spring took for good in one step [J]: work put in, less what it stores more than before."""
    before = share * stiffness
    work = 0.5 * (before * carried - force).dot(step)
    return work + 0.5 * before * carried.dot(carried) - 0.5 * stiffness * kept.dot(kept)


def reference_spring(
    stiffness: float, share: float, cap: float, carried: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Numpy twin of `elastic_plastic_spring`."""
    trial = (carried * share if share < 1.0 else carried) + step
    size = stiffness * float(np.sqrt(trial @ trial))
    kept = trial if size <= cap else trial * (cap / size)
    return -stiffness * kept, kept
