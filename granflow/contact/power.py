"""Powers and exponentials of device functions; on Vulkan, which has neither in f64, from + - * / alone."""

from math import log

from granflow import kernel_language
from granflow.device_functions import at_compile_time, ti

SPLITTER = 2.0**27 + 1.0
"""Splits 53 bits into two halves of at most 26 bits (Dekker 1971)."""
LN2_HIGH = 355 / 512
"""Part of ln 2 with few bits: products with exponents are exact."""
LN2_LOW = -2.1219444005469058277e-4
"""ln 2 - LN2_HIGH."""
EXPONENT_BITS = (512, 256, 128, 64, 32, 16, 8, 4, 2, 1)
SERIES_OF_LOG, SERIES_OF_EXP = 13, 14
"""Terms of the series; the next ones are below 2^-60."""
LARGEST_EXPONENT = 1023 * log(2.0)


@at_compile_time
def lacks_f64_functions() -> bool:
    """True on Vulkan if contact models are evaluated in f64."""
    runtime = kernel_language.ti.lang.impl
    return runtime.current_cfg().arch == kernel_language.ti.vulkan and (
        runtime.get_runtime().default_fp == kernel_language.ti.f64
    )


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
    a_scaled, b_scaled = SPLITTER * a, SPLITTER * b
    a_high, b_high = a_scaled - (a_scaled - a), b_scaled - (b_scaled - b)
    a_low, b_low = a - a_high, b - b_high
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


@ti.func
def _logarithm(x):
    """ln x in two parts, x > 0.

    x = m 2^e,   1/sqrt(2) <= m < sqrt(2)
    ln x = e ln 2 + 2 artanh(s),   s = (m - 1)/(m + 1),   artanh(s) = s + s^3/3 + s^5/5 + ...
    """
    m, e = x, ti.cast(0.0, ti.f64)
    for bits in ti.static(EXPONENT_BITS):
        if m < ti.static(2.0 ** (1 - bits)):
            m, e = m * ti.static(2.0**bits), e - bits
        if m >= ti.static(2.0**bits):
            m, e = m * ti.static(2.0**-bits), e + bits
    if m > ti.static(2.0**0.5):
        m, e = 0.5 * m, e + 1.0
    above = m - 1.0
    below, below_error = _two_sum(ti.cast(1.0, ti.f64), m)  # of the same exponent, if m is larger
    s = above / below
    product, product_error = _two_product(s, below)
    s_error = ((above - product) - product_error - s * below_error) / below
    squared, series = s * s, ti.cast(0.0, ti.f64)
    for n in ti.static(range(SERIES_OF_LOG, 0, -1)):
        series = squared * (ti.static(1.0 / (2 * n + 1)) + series)
    high, error = _two_sum(e * LN2_HIGH, 2.0 * s)
    high, error = _two_sum(high, error + 2.0 * s_error + 2.0 * s * series + e * LN2_LOW)
    return high, error


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
def power_f64(x, y):
    """x^y = e^(y ln x) in f64 to 2 ulp for |y ln x| < 40, from + - * / alone; x >= 0, and 0 for x = 0."""
    result = ti.cast(0.0, ti.f64)
    if x > 0.0:
        high, low = _logarithm(x)
        product, error = _two_product(high, y)
        result = exponential_f64(product, error + low * y)
    return result
