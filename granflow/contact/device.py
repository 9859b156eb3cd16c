"""Device functions that several contact models share: corrections within a step, powers and exponentials.

First contact, turning point and separation rarely coincide with a time level. The leapfrog scheme applies the
force at one time level over the whole step around it, which is second order if the force is smooth. The force
is not smooth at first contact (dashpot), at the maximum overlap where unloading starts, and at the overlap
where it ends. Uncorrected, these points cost one order of convergence, or most of the accuracy of a small
restitution. Each function of the first section replaces the value at the time level by the mean over the step
or by the exact extremum.
"""

from math import log
from typing import Any

import numpy as np

from granflow import kernel_language
from granflow.device_functions import at_compile_time, ti

# Corrections within a step


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


# Powers and exponentials; on Vulkan, which has neither in f64, from + - * / alone


@ti.func
def power(x, y):
    """x^y for x >= 0: `ti.pow`, or `power_f64`."""
    result = 0.0 * x
    if ti.static(lacks_f64_functions()):
        result = power_f64(x, y)
    else:
        result = ti.pow(x, y)
    return result


@ti.func
def exponential(x):
    """e^x: `ti.exp`, or `exponential_f64`."""
    result = 0.0 * x
    if ti.static(lacks_f64_functions()):
        result = exponential_f64(x, 0.0 * x)
    else:
        result = ti.exp(x)
    return result


@at_compile_time
def lacks_f64_functions() -> bool:
    """True on Vulkan if contact models are evaluated in f64."""
    runtime = kernel_language.ti.lang.impl
    return runtime.current_cfg().arch == kernel_language.ti.vulkan and (
        runtime.get_runtime().default_fp == kernel_language.ti.f64
    )


@ti.func
def power_f64(x, y):
    """x^y = e^(y ln x) in f64 to 2 ulp for |y ln x| < 40, from + - * / alone; x >= 0, and 0 for x = 0."""
    result = ti.cast(0.0, ti.f64)
    if x > 0.0:
        high, low = _logarithm(x)
        product, error = _two_product(high, y)
        result = exponential_f64(product, error + low * y)
    return result


@ti.func
def exponential_f64(x, x_error):
    """e^(x + x_error) in f64 to 2 ulp, from + - * / alone.

    e^x = 2^k e^r,   |r| <= ln(2)/2,   e^r = 1 + r + r^2/2! + ...
    """
    bounded = ti.max(ti.min(x, LARGEST_EXPONENT), -LARGEST_EXPONENT)
    k = ti.floor(bounded / ti.static(log(2.0)) + 0.5)
    r, r_error = _two_sum(bounded - k * LN2_HIGH, -k * LN2_LOW)
    series = ti.cast(0.0, ti.f64)
    for n in ti.static(range(SERIES_OF_EXP, 1, -1)):
        series = (1.0 + series) * r / n
    result = 1.0 + (r + (r * series + (r_error + x_error) * (1.0 + r)))
    scale = ti.abs(k)
    for bits in ti.static(EXPONENT_BITS):
        if scale >= bits:
            scale -= bits
            if k > 0.0:
                result *= ti.static(2.0**bits)
            else:
                result *= ti.static(2.0**-bits)
    if x < -LARGEST_EXPONENT:
        result = 0.0
    return result


@ti.func
def _logarithm(x):
    """ln x in two parts, x > 0.

    x = m 2^e,   1/sqrt(2) <= m < sqrt(2)
    ln x = e ln 2 + 2 artanh(s),   s = (m - 1)/(m + 1),   artanh(s) = s + s^3/3 + s^5/5 + ...
    """
    m = x
    e = ti.cast(0.0, ti.f64)
    for bits in ti.static(EXPONENT_BITS):
        if m < ti.static(2.0 ** (1 - bits)):
            m = m * ti.static(2.0**bits)
            e = e - bits
        if m >= ti.static(2.0**bits):
            m = m * ti.static(2.0**-bits)
            e = e + bits
    if m > ti.static(2.0**0.5):
        m = 0.5 * m
        e = e + 1.0
    above = m - 1.0
    below, below_error = _two_sum(ti.cast(1.0, ti.f64), m)  # of the same exponent, if m is larger
    s = above / below
    product, product_error = _two_product(s, below)
    s_error = ((above - product) - product_error - s * below_error) / below
    squared = s * s
    series = ti.cast(0.0, ti.f64)
    for n in ti.static(range(SERIES_OF_LOG, 0, -1)):
        series = squared * (ti.static(1.0 / (2 * n + 1)) + series)
    high, error = _two_sum(e * LN2_HIGH, 2.0 * s)
    high, error = _two_sum(high, error + 2.0 * s_error + 2.0 * s * series + e * LN2_LOW)
    return high, error


@ti.func
def _two_sum(a, b):
    """Sum and its rounding error for |a| >= |b| (Dekker 1971).

    Vulkan drivers replace (a + b) - a by b, but leave a - (a + b) as it is.
    """
    total = a + b
    return total, b + (a - total)


@ti.func
def _two_product(a, b):
    """Product and its rounding error (Dekker 1971)."""
    product = a * b
    a_scaled = SPLITTER * a
    a_high = a_scaled - (a_scaled - a)
    a_low = a - a_high
    b_scaled = SPLITTER * b
    b_high = b_scaled - (b_scaled - b)
    b_low = b - b_high
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


SPLITTER = 2.0**27 + 1.0
"""Splits 53 bits into two halves of at most 26 bits (Dekker 1971)."""
LN2_HIGH = 355 / 512
"""Part of ln 2 with few bits: products with exponents are exact."""
LN2_LOW = -2.1219444005469058277e-4
"""ln 2 - LN2_HIGH."""
EXPONENT_BITS = (512, 256, 128, 64, 32, 16, 8, 4, 2, 1)
SERIES_OF_LOG = 13
SERIES_OF_EXP = 14
"""Terms of the series; the next ones are below 2^-60."""
LARGEST_EXPONENT = 1023 * log(2.0)
