"""Closed forms of Zhou (2011) for one binary collision, in numpy float64.

Symbols as in the paper (Theor. Appl. Mech. Lett. 1, 041006, doi 10.1063/2.1104106): `e` restitution
coefficient, `k` Hertz stiffness [N/m^1.5], `M` effective mass [kg], `v` approach velocity [m/s], `x` ratio of
residual to maximum overlap, `y = 1 - x`. Arguments of the type Number broadcast; equation numbers are those
of the paper.
"""

import math
from functools import cache
from typing import TypeAlias

import numpy as np
from numpy.polynomial.legendre import leggauss

from granflow.contact.material import PairMaterial

Number: TypeAlias = float | np.ndarray

LOADING_DURATION = 0.4 * math.sqrt(math.pi) * math.gamma(0.4) / math.gamma(0.9)
"""eta1 of Eq. 14: the integral of du / sqrt(1 - u^2.5) from 0 to 1, 1.4716..."""

MIN_VELOCITY_SHARE = 0.01
"""Lower limit of the impact velocity in Eq. 19 per contact, over the largest velocity."""


def hertz_stiffness(modulus: Number, radius: Number) -> Number:
    """Hertz stiffness k = (4/3) E sqrt(R) [N/m^1.5] from effective modulus [Pa] and radius [m]."""
    return 4.0 / 3.0 * modulus * np.sqrt(radius)


def recovery(e: Number) -> np.ndarray:
    """Recovered fraction y = 1 - x of the maximum overlap (Zhou 2011, Eq. 8, exact).

        y = (4/5) e^2 + (1/5) e^3 y^2.5

    e:        restitution in [0, 1], any shape
    Returns:  float64 of the same shape
    Raises:   ValueError for e outside [0, 1]

    Solved by fixed-point iteration; the slope of the right side is at most 1/2.
    """
    e = np.asarray(e, dtype=float)
    if np.any((e < 0.0) | (e > 1.0)):
        raise ValueError("a restitution coefficient must be in [0, 1]")
    number: Number = e if e.ndim else float(e)  # floats are ten times faster than 0-d arrays
    first = 0.8 * number**2
    share = 0.2 * number**3
    y = first
    for _ in range(80):
        y = first + share * y**2.5
    return np.asarray(y)


def residual_closed_form(e: Number) -> np.ndarray:
    """Ratio x of residual to maximum overlap by the paper's closed form (Eq. 9), within 1.2 % of the root.

    x = 1 - (4/5) e^2 - (c/5) e^8 / (1 - (1 - c) e) + e^16 (1 - e),   c = (4/5)^2.5
    """
    e = np.asarray(e, dtype=float)
    c = 0.8**2.5
    return 1.0 - 0.8 * e**2 - 0.2 * c * e**8 / (1.0 - (1.0 - c) * e) + e**16 * (1.0 - e)


def unloading_slope(e: Number) -> np.ndarray:
    """Dimensionless slope of the unloading line (Eq. 7): 0 at e = 1, infinite at e = 0.

        Lambda(e) = lam / (k sqrt(dmax)) = (1 - e^3 y^1.5) / y

    Raises ValueError for e outside [0, 1].
    """
    e = np.asarray(e, dtype=float)
    y = recovery(e)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (1.0 - e**3 * y**1.5) / y
    return np.where(e == 1.0, 0.0, np.where(e == 0.0, np.inf, slope))


def unloading_tangent(e: Number) -> np.ndarray:
    """Tangent stiffness at the start of unloading over k sqrt(dmax): Lambda + 1.5 e^3 sqrt(y) (from Eq. 4).

    1.5, the Hertz tangent, at e = 1; infinite at e = 0. Raises ValueError for e outside [0, 1].
    """
    e = np.asarray(e, dtype=float)
    return unloading_slope(e) + 1.5 * e**3 * np.sqrt(recovery(e))


def overlap_max(k: Number, mass: Number, velocity: Number) -> Number:
    """Maximum overlap [m] of a collision from energy conservation (Eq. 5).

    dmax = (5 M v^2 / (4 k))^(2/5)
    """
    return (1.25 * mass * velocity**2 / k) ** 0.4


def hertz_tangent(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
    """Hertz tangent stiffness at the maximum overlap of a collision, 1.5 k sqrt(dmax) [N/m].

    Arguments as for `law.NormalLaw.phase_durations`.
    """
    k = float(hertz_stiffness(pair.modulus_eff, radius_eff))
    return 1.5 * k * float(np.sqrt(overlap_max(k, mass_eff, velocity)))


def velocity_for_radius(modulus: float, radius_eff: float, mass_eff: float, contact_radius: float) -> float:
    """Impact velocity [m/s] of a Hertz contact that reaches a contact radius a [m].

    M v^2 / 2 = 8 E a^5 / (15 R^2)
    """
    return math.sqrt(16.0 * modulus * contact_radius**5 / (15.0 * mass_eff)) / radius_eff


def time_scale(k: Number, mass: Number, velocity: Number) -> Number:
    """Time scale [s] of a collision (Eq. 13).

    Ts = dmax / v = (25 M^2 / (16 k^2 v))^(1/5)
    """
    return (25.0 * mass**2 / (16.0 * k**2 * velocity)) ** 0.2


@cache
def unloading_duration(e: float) -> float:
    """eta2 of Eq. 15: unloading time over Ts, by Gauss quadrature after u - x = y sin(t).

    eta2 = int_x^1 e du / sqrt(kappa (y^2 - (u-x)^2) + e^5 (y^2.5 - (u-x)^2.5)),  kappa = (5/4) e^2 Lambda
    """
    if e == 0.0:
        return 0.0
    y = float(recovery(e))
    kappa = 1.25 * e**2 * float(unloading_slope(e))
    nodes, weights = gauss_nodes(120)
    angle = np.pi / 4.0 * (nodes + 1.0)
    s = np.sin(angle)
    # (1 - s^2.5) / cos^2, finite at s = 1 where it is 1.25
    power = (1.0 - s**2.5) / np.cos(angle) ** 2
    integrand = e / np.sqrt(kappa + e**5 * np.sqrt(y) * power)
    return float(np.pi / 4.0 * np.sum(weights * integrand))


@cache
def gauss_nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss nodes and weights on [-1, 1]; cached, because their computation dominates the time of a plan."""
    return leggauss(count)


def duration(e: float, k: Number, mass: Number, velocity: Number) -> Number:
    """Collision duration T = (eta1 + eta2) Ts [s] (Eq. 13)."""
    return (LOADING_DURATION + unloading_duration(e)) * time_scale(k, mass, velocity)


def equivalent_spring(k: Number, mass: Number, velocity: Number) -> Number:
    """Stiffness [N/m] of a linear spring with the same energy at the same maximum overlap (Eqs. 18, 19).

    alpha = (4/5) k sqrt(dmax)
    """
    return 0.8 * k * np.sqrt(overlap_max(k, mass, velocity))


def least_restitution(k: Number, mass: Number, largest: Number, time_step: Number, angle: Number) -> Number:
    """Smallest restitution at a time step, not from the paper: the unloading tangent is at most angle^2 M /
    dt^2.

    The tangent is close to k sqrt(dmax) / (0.8 e^2), so e^2 = 1.25 k sqrt(dmax) dt^2 / (angle^2 M). May
    exceed 1.

    largest:    maximum overlap dmax [m]
    time_step:  dt [s]
    angle:      bound on sqrt(K / M) dt [rad]
    """
    return np.sqrt(1.25 * k * np.sqrt(largest) / mass) * time_step / angle


LOSS_TOLERANCE = 0.05
"""Error of the energy lost in a collision, see `loss_error`, above which a scene gets a warning.

The rate at which a granular gas cools is proportional to the lost share 1 - e^2 of the energy, and the
granular temperature of a sheared one inversely proportional to it (Haff, J. Fluid Mech. 134 (1983) 401). An
error of e = 0.5 by 0.01 changes the share by 1.3 %, less than measured restitutions scatter.
"""
LEAST_LOSS = 0.2
"""Smallest share to which an error is relative: that of e = 0.89. Of more elastic particles, friction and the
number of collisions determine what is lost."""


def loss_error(reached: float, e: float) -> float:
    """Error of the energy that a collision loses, over that energy.

        |e'^2 - e^2| / max(1 - e^2, LEAST_LOSS)

    reached:  simulated restitution e'
    e:        given restitution
    """
    return abs(reached**2 - e**2) / max(1.0 - e**2, LEAST_LOSS)


@cache
def damping_ratio_for(e: float) -> float:
    """Damping ratio of a spring-dashpot without attraction for restitution e (Schwager & Poeschel 2007).

    The contact ends when the force reaches zero, not when the overlap does. For zeta < 1,

        e = exp(-zeta / sqrt(1 - zeta^2) (pi - atan2(2 zeta sqrt(1 - zeta^2), 1 - 2 zeta^2)))

    and its continuation for zeta >= 1. The Hertz contact with damping ~ d^(1/4) obeys the same relation
    (Antypov & Elliott 2011 map it to the linear one). Raises ValueError for e outside (0, 1].
    """
    if not 0.0 < e <= 1.0:
        raise ValueError("a viscous contact model supports any restitution in (0, 1], not 0")
    low, high = 0.0, 1.0
    while viscous_restitution(high) > e:
        high *= 2.0
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if viscous_restitution(middle) > e else (low, middle)
    return 0.5 * (low + high) if e < 1.0 else 0.0


def viscous_restitution(zeta: float) -> float:
    """Restitution of a spring-dashpot with the damping ratio `zeta` > 0 whose contact ends at zero force."""
    if abs(zeta - 1.0) < 1e-9:
        return float(np.exp(-2.0))
    if zeta < 1.0:
        root = np.sqrt(1.0 - zeta**2)
        release_angle = np.pi - np.arctan2(2.0 * zeta * root, 1.0 - 2.0 * zeta**2)
        return float(np.exp(-zeta / root * release_angle))
    exponent = 2.0 * np.arccosh(zeta) / np.sqrt(1.0 - 1.0 / zeta / zeta)
    return float(np.exp(-exponent))
