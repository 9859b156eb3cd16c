"""Corrections within a step, which several contact models share.

First contact, turning point and separation rarely coincide with a time level. The leapfrog scheme applies the
force at one time level over the whole step around it, which is second order if the force is smooth. The force
is not smooth at first contact (dashpot), at the maximum overlap where unloading starts, and at the overlap
where it ends. Uncorrected, these points cost one order of convergence, or most of the accuracy of a small
restitution. Each function replaces the value at the time level by the mean over the step or by the exact
extremum.
"""

from typing import Any

import numpy as np

from granflow.device_functions import ti


@ti.func
def turning_point(largest, force, mass_eff, time_step, overlap_rate_half):
    """Maximum overlap [m] between two time levels, evaluated at the first step with a decreasing overlap.

        d(t) = dn + vn t - a t^2 / 2      =>      dmax = dn + vn^2 / (2 a)

    `largest` is the overlap dn of the previous step, `force` the force there, a = force / M the deceleration
    of the isolated pair, `overlap_rate_half` the overlap rate half a step later, so that vn =
    overlap_rate_half + a dt / 2. The deceleration differs if other contacts act on the pair; vn is therefore
    limited to half a step from the turning point, so that the maximum overlap increases by at most a dt^2 /
    8.
    """
    deceleration = force / mass_eff
    half_step_change = 0.5 * deceleration * time_step
    rate = ti.min(ti.max(overlap_rate_half + half_step_change, -half_step_change), half_step_change)
    return largest + 0.5 * rate * rate / deceleration


def reference_turning_point(
    largest: float, force: float, mass_eff: float, time_step: float, overlap_rate_half: float
) -> float:
    """Reference implementation of `turning_point` in numpy; returns the maximum overlap [m]."""
    deceleration = force / mass_eff
    half_step_change = 0.5 * deceleration * time_step
    return float(
        largest
        + np.clip(overlap_rate_half + half_step_change, -half_step_change, half_step_change) ** 2
        / (2.0 * deceleration)
    )


@ti.func
def mean_above(above, rate, time_step):
    """Mean of max(d - ds, 0) over the step around the time level [m]; separation occurs inside a step.

        mean of max(u, 0) over [u - h/2, u + h/2],  h = |d'| dt     =  u,  (u + h/2)^2 / (2 h),  or  0

    above:  u = d - ds at the time level [m]
    rate:   overlap rate d' [m/s]
    """
    half = 0.5 * ti.abs(rate) * time_step
    inside = ti.min(ti.max(above + half, 0.0), 2.0 * half)
    divisor = ti.select(half > 0.0, 4.0 * half, 1.0)  # at zero rate the interval is empty
    return ti.max(above - half, 0.0) + inside * inside / divisor


def reference_mean_above(above: float, rate: float, time_step: float) -> float:
    """Reference implementation of `mean_above` in numpy [m]."""
    half = 0.5 * abs(rate) * time_step
    if above >= half:
        return above
    return 0.0 if above <= -half else (above + half) ** 2 / (4.0 * half)


TOUCHING = 1.0 + 1e-6
"""Largest overlap of the first step of a contact over the travel in this step: a contact whose surfaces touch
exactly at a time level has no force there, and the overlap of the next level is that travel, but for
rounding."""


@ti.func
def share_in_contact(overlap, rate, time_step):
    """Share of the step around the time level during which the surfaces are in contact, for a force that does
    not begin at 0.

        (d + h/2) / h    in the step of first contact or separation, d < h = |d'| dt;    else 1

    In the first step it also covers the time since first contact, so that it is between 1/2 and 3/2. The
    force changes d', so that a step too many has a share if the separation is close to a time level.
    """
    travel = ti.abs(rate) * time_step
    partial = (travel > 0.0) & (overlap <= TOUCHING * travel)
    return ti.select(partial, overlap / ti.select(partial, travel, 1.0) + 0.5, 1.0)


def reference_share_in_contact(overlap: float, rate: float, time_step: float) -> float:
    """Reference implementation of `share_in_contact` in numpy."""
    travel = abs(rate) * time_step
    return overlap / travel + 0.5 if 0.0 < overlap <= TOUCHING * travel else 1.0


@ti.func
def share_before_rupture(left, attraction, contact):
    """Share of the step around the time level during which an attraction acts that ends at a distance.

        u / h + 1/2    in the last step before rupture, u < h = -(d' + a dt) dt;    else 1

    left:        distance u [m] up to rupture
    attraction:  [N], a = attraction / M, which slows an isolated pair down
    contact:     with the overlap rate d' [m/s] half a step before

    It also covers the time from the middle of the next step to rupture, so that it is between 1/2 and 3/2:
    after rupture the pair may be beyond the range of the model.
    """
    rate = contact.overlap_rate + attraction / contact.mass_eff * contact.time_step
    travel = ti.max(-rate, 0.0) * contact.time_step
    partial = (travel > 0.0) & (left < travel)
    return ti.select(partial, left / ti.select(partial, travel, 1.0) + 0.5, 1.0)


def reference_share_before_rupture(left: float, attraction: float, contact: Any) -> float:
    """Reference implementation of `share_before_rupture` in numpy."""
    dt = contact.time_step
    travel = -(contact.overlap_rate + attraction / contact.mass_eff * dt) * dt
    return left / travel + 0.5 if left < travel else 1.0


def build_step_mean(power: float) -> Any:
    """Device function (overlap, rate, time_step) -> (overlap_at, weight): mean of d^power over the step, 0
    for d < 0.

    The mean is weight overlap_at^power. In the first step of a contact, which also covers the time since
    first contact, or since the surfaces touched at the previous time level, it is the integral over [0, d +
    h/2]; later the mean over [d - h/2, d + h/2] to second order (h = |d'| dt):

        (d + h/2)^(p + 1) / ((p + 1) h)            d^p (1 + p (p - 1) / 24 (h/d)^2)
    """
    curvature = power * (power - 1.0) / 24.0

    @ti.func
    def step_mean(overlap, rate, time_step):
        travel = ti.abs(rate) * time_step
        first = overlap <= TOUCHING * rate * time_step
        overlap_at = ti.select(first, overlap + 0.5 * travel, overlap)
        ratio = ti.select(first, overlap_at, ti.min(travel, overlap)) / ti.select(first, travel, overlap)
        return overlap_at, ti.select(first, ratio / (power + 1.0), 1.0 + curvature * ratio * ratio)

    return step_mean


def reference_step_mean(power: float, overlap: float, rate: float, time_step: float) -> float:
    """Reference implementation of `build_step_mean` in numpy; returns the mean [m^power].

    overlap:    d [m], above 0
    rate:       overlap rate d' [m/s], positive during approach
    time_step:  [s]
    """
    travel = abs(rate) * time_step
    if overlap <= TOUCHING * rate * time_step:
        return float((overlap + 0.5 * travel) ** (power + 1.0) / ((power + 1.0) * travel))
    share = min(travel / overlap, 1.0)
    return float(overlap**power * (1.0 + power * (power - 1.0) / 24.0 * share**2))
