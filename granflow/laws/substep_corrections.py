"""What happens inside a step: first touch, turning point and parting rarely fall on the moments that are computed.

The leapfrog takes the force at one moment for the whole step around it. That is second order as long as the force is
smooth. A dashpot that is there from first touch on, the largest overlap that an unloading curve starts from, and the
overlap at which it ends are not: they cost an order, or most of the accuracy of a small restitution. Each function
here puts the mean over the step, or the true moment, in place of the value at the moment computed.
"""

from typing import Any

import numpy as np
import taichi as ti


@ti.func
def turning_point(largest, force, mass_eff, time_step, overlap_rate_half):
    """Largest overlap [m] reached between two steps, where the first overlap behind it has just been seen.

        d(t) = dn + vn t - a t^2 / 2      =>      dmax = dn + vn^2 / (2 a)

    `largest` is the overlap dn of the step before, `force` the force there, a = force / M the deceleration of the
    pair alone, `overlap_rate_half` the rate of overlap half a step later, so that vn = late_rate + a dt / 2. A pair
    that others
    push, too, decelerates differently: vn stays within half a step of the turning point, so that the largest overlap
    grows by no more than a dt^2 / 8.
    """
    deceleration = force / mass_eff
    half_step_change = 0.5 * deceleration * time_step
    rate = ti.min(ti.max(overlap_rate_half + half_step_change, -half_step_change), half_step_change)
    return largest + 0.5 * rate * rate / deceleration


@ti.func
def mean_above(above, rate, time_step):
    """Mean of max(d - ds, 0) over the step around this moment [m]: a contact that parts does so inside a step.

    mean of max(u, 0) over [u - h/2, u + h/2],  h = |d'| dt     =  u,  (u + h/2)^2 / (2 h),  or  0
    """
    half = 0.5 * ti.abs(rate) * time_step
    inside = ti.min(ti.max(above + half, 0.0), 2.0 * half)
    smallest = 1e-30  # of any length; without travel nothing lies inside
    return ti.max(above - half, 0.0) + inside * inside / ti.max(4.0 * half, smallest)


def build_step_mean(power: float) -> Any:
    """Device function (overlap, rate, time_step) -> (place, weight): mean of d^power over the step, 0 before touch.

    It is weight place^power. In the first step of a contact, which also stands for the time since the true first
    touch, the integral over [0, d + h/2]; later the mean over [d - h/2, d + h/2] to second order (h = |d'| dt):

        (d + h/2)^(p + 1) / ((p + 1) h)            d^p (1 + p (p - 1) / 24 (h/d)^2)
    """
    curvature = power * (power - 1.0) / 24.0

    @ti.func
    def step_mean(overlap, rate, time_step):
        travel = ti.abs(rate) * time_step
        first = overlap < rate * time_step
        overlap_at = ti.select(first, overlap + 0.5 * travel, overlap)
        ratio = ti.select(first, overlap_at, ti.min(travel, overlap)) / ti.select(first, travel, overlap)
        return overlap_at, ti.select(first, ratio / (power + 1.0), 1.0 + curvature * ratio * ratio)

    return step_mean


def reference_step_mean(power: float, overlap: float, rate: float, time_step: float) -> float:
    """Numpy twin of `build_step_mean`: the mean itself."""
    travel = abs(rate) * time_step
    if overlap < rate * time_step:
        return float((overlap + 0.5 * travel) ** (power + 1.0) / ((power + 1.0) * travel))
    share = min(travel / overlap, 1.0)
    return float(overlap**power * (1.0 + power * (power - 1.0) / 24.0 * share**2))


def reference_mean_above(above: float, rate: float, time_step: float) -> float:
    """Numpy twin of `mean_above`."""
    half = 0.5 * abs(rate) * time_step
    if above >= half:
        return above
    return 0.0 if above <= -half else (above + half) ** 2 / (4.0 * half)


def reference_turning_point(
    largest: float, force: float, mass_eff: float, time_step: float, overlap_rate_half: float
) -> float:
    """Numpy twin of `turning_point`."""
    deceleration = force / mass_eff
    half_step_change = 0.5 * deceleration * time_step
    return float(
        largest
        + np.clip(overlap_rate_half + half_step_change, -half_step_change, half_step_change) ** 2 / (2.0 * deceleration)
    )
