"""Restitution of collisions in the codes: springs with dashpots, also while the dashpot pulls."""

from functools import cache
from math import exp, pi, sqrt

from granflow.contact.theory import viscous_restitution

OVERDAMPED = 1000.0
"""Damping above which no restitution is left: it is about 1 / damping^2, and the steps become unstable."""


def free_restitution(zeta: float, has_limit: bool) -> float:
    """Restitution of a spring with a dashpot of the damping ratio zeta; `has_limit`: without attraction.

    With attraction the contact ends at zero overlap: e = exp(-pi zeta / sqrt(1 - zeta^2)), 0 for zeta >= 1.
    """
    if zeta <= 0.0:
        return 1.0
    if not has_limit:
        return exp(-pi * zeta / sqrt(1.0 - zeta * zeta)) if zeta < 1.0 else 0.0
    return viscous_restitution(zeta)


@cache
def collision(power: float, damping: float, exponent: float, has_limit: bool) -> float:
    """Restitution of x'' + g x^q x' + x^p = 0 with x(0) = 0, x'(0) = 1, by steps of Runge-Kutta.

    power p, damping g, exponent q; `has_limit`: the contact ends at zero force, otherwise at zero overlap.
    """

    if damping > OVERDAMPED:
        return 0.0

    def slope(x: float, v: float) -> float:
        x = max(x, 0.0)
        return -(x**power) - damping * x**exponent * v

    x, v, h = 0.0, 1.0, 1e-3
    for _ in range(200_000):
        k1 = slope(x, v)
        k2 = slope(x + 0.5 * h * v, v + 0.5 * h * k1)
        k3 = slope(x + 0.5 * h * (v + 0.5 * h * k1), v + 0.5 * h * k2)
        k4 = slope(x + h * (v + 0.5 * h * k2), v + h * k3)
        x += h * (v + h / 6.0 * (k1 + k2 + k3))
        v += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        if x <= 0.0 or (has_limit and v < 0.0 and slope(x, v) >= 0.0):
            return min(max(0.0, -v), 1.0)  # the error of the steps can exceed 1 without damping
    return 0.0


@cache
def plastic_collision(
    speed: float, ratio: float, tension: float, zeta: float = 0.0, stiffens: bool = True
) -> float:
    """Restitution of Luding's law by small steps, with a dashpot as in hooke/hysteresis of LIGGGHTS.

    Units: limit overlap 1, k1 = 1, mass 1. `speed`: of the impact; `ratio`: kp / k1 at the limit overlap;
    `tension`: kc / k1; `zeta`: damping ratio of the dashpot on k1; `stiffens`: whether loading beyond the
    limit follows kp (granflow) or k1 (LIGGGHTS).
    """
    x, v, largest, h = 0.0, speed, 0.0, 1e-3
    for _ in range(100_000):
        largest = max(largest, x)
        k2 = 1.0 + (ratio - 1.0) * min(largest, 1.0)
        if stiffens and largest >= 1.0:  # loading and unloading on one line beyond the limit
            spring = ratio * (x - (1.0 - 1.0 / ratio))
        else:
            spring = min(x, largest - k2 * (largest - x))
        if spring < -tension * x:
            spring = -tension * x
            largest = min(largest, x * (k2 + tension) / (k2 - 1.0)) if k2 > 1.0 else largest
        v -= h * (spring + 2.0 * zeta * v)
        x += h * v
        if x <= 0.0 or (v < 0.0 and spring <= 0.0 and tension == 0.0 and zeta == 0.0):
            return max(0.0, -v / speed)
    return 0.0


def tsuji(e: float) -> float:
    """The polynomial of LAMMPS (damping tsuji): dashpot over sqrt(k M)."""
    terms = (1.2728, -4.2783, 11.087, -22.348, 27.467, -18.022, 4.8218)
    return sum(factor * e**power for power, factor in enumerate(terms))
