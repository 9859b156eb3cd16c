"""Powers and exponentials that replace those of Vulkan in f64, against decimal arithmetic of 40 digits."""

from decimal import Decimal, localcontext

import numpy as np

from granflow.device_functions import exponential_f64, power_f64
from granflow.kernel_language import ti

ULPS = 2.0


def in_ulps(found, exact):
    """Largest difference from exact values (Decimal) in units of the last place."""
    pairs = zip(found, exact, strict=True)
    return max(float(abs(Decimal(float(f)) - e) / Decimal(float(np.spacing(float(e))))) for f, e in pairs)


def evaluated(function, *arguments):
    """Values (n,) of a device function of arguments (n,)."""
    found = np.zeros(len(arguments[0]))
    first = arguments[0]
    second = arguments[-1]

    @ti.kernel
    def evaluate(x: ti.types.ndarray(), y: ti.types.ndarray(), values: ti.types.ndarray()):
        for i in range(x.shape[0]):
            values[i] = function(x[i], y[i])

    evaluate(first, second, found)
    return found


def test_power_and_exponential_are_exact_to_2_ulp(taichi_f64):
    """Bases from 1e-30 to 1e12 with the exponents of the contact models, and bases near 1."""
    rng = np.random.default_rng(1)
    x = np.concatenate(
        [10.0 ** rng.uniform(-30.0, 12.0, 600), 1.0 + rng.normal(0.0, 1e-6, 100), [1.0, 2.0, 0.5]]
    )
    y = rng.choice([0.2, 0.4, 0.54, 1.5, 0.25], len(x))
    y = np.where(np.abs(y * np.log(x)) < 40.0, y, 0.2)
    z = np.concatenate([rng.uniform(-650.0, 650.0, 400), rng.normal(0.0, 1e-3, 100), [0.0, 1.0, -1.0]])
    with localcontext() as context:
        context.prec = 40
        powers = [Decimal(float(a)) ** Decimal(float(b)) for a, b in zip(x, y, strict=True)]
        assert in_ulps(evaluated(power_f64, x, y), powers) <= ULPS
        exponentials = [Decimal(float(a)).exp() for a in z]
        assert in_ulps(evaluated(exponential_f64, z, 0.0 * z), exponentials) <= ULPS
    assert evaluated(power_f64, np.zeros(1), np.full(1, 0.4)).tolist() == [0.0]
    assert evaluated(exponential_f64, np.full(1, -800.0), np.zeros(1)).tolist() == [0.0]
