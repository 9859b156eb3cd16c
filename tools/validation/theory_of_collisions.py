"""Collisions of two spheres integrated from the published forces, independently of the contact models.

Every formula is written from its publication; nothing is imported from `granflow.contact`. Symbols: E, G
effective moduli [Pa], R effective radius [m], M effective mass [kg], k = (4/3) E sqrt(R) [N/m^1.5], d overlap
[m].
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from granflow.geometry.sphere import sphere_mass

Force = Callable[[float, float], float]
"""Repulsion [N] from overlap [m] and overlap rate [m/s]."""
ACCURACY, INTEGRATION_ERROR = 1e-11, 1e-8
"""Relative tolerance of the integrations in each step, and bound of their error over a collision."""


@dataclass(frozen=True)
class Partner:
    """Sphere (or wall, with an infinite radius and mass) of one collision, in SI units.

    solid:   young_modulus, poisson_ratio, density
    radius:  [m]; infinite for a wall
    """

    solid: Mapping[str, float]
    radius: float

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return sphere_mass(self.radius, self.solid["density"])


@dataclass(frozen=True)
class Pair:
    """Two partners: their effective quantities."""

    one: Partner
    other: Partner

    @property
    def modulus(self) -> float:
        """1/E = (1 - nu1^2)/E1 + (1 - nu2^2)/E2 (Hertz 1882)."""
        return 1.0 / sum((1.0 - each["poisson_ratio"] ** 2) / each["young_modulus"] for each in self._solids)

    @property
    def shear_modulus(self) -> float:
        """1/G = (2 - nu1)/G1 + (2 - nu2)/G2 with G_i = E_i / (2 + 2 nu_i) (Mindlin 1949)."""
        return 1.0 / sum(
            (2.0 - each["poisson_ratio"]) * 2.0 * (1.0 + each["poisson_ratio"]) / each["young_modulus"]
            for each in self._solids
        )

    @property
    def radius(self) -> float:
        """1/R = 1/R1 + 1/R2."""
        return 1.0 / (1.0 / self.one.radius + 1.0 / self.other.radius)

    @property
    def mass(self) -> float:
        """1/M = 1/m1 + 1/m2."""
        return 1.0 / (1.0 / self.one.mass + 1.0 / self.other.mass)

    @property
    def k(self) -> float:
        """Hertz: F = k d^(3/2)."""
        return 4.0 / 3.0 * self.modulus * math.sqrt(self.radius)

    @property
    def _solids(self) -> tuple[Mapping[str, float], Mapping[str, float]]:
        return self.one.solid, self.other.solid

    def largest_overlap(self, velocity: float) -> float:
        """Maximum overlap [m] of an elastic collision (Zhou 2011, Eq. 5): (2/5) k d^(5/2) = M v^2 / 2."""
        return float((5.0 * self.mass * velocity**2 / (4.0 * self.k)) ** 0.4)


@dataclass(frozen=True)
class Rebound:
    """Maximum overlap [m] and force [N], durations of loading and unloading [s], and velocity of separation
    [m/s]."""

    overlap: float
    force: float
    loading: float
    unloading: float
    velocity: float

    @property
    def duration(self) -> float:
        """Duration of the contact [s]."""
        return self.loading + self.unloading


def collide(
    mass: float,
    velocity: float,
    length: float,
    loading: Force,
    unloading: Callable[[float], Force] | None = None,
) -> Rebound:
    """Integrate M d'' = -F(d, d') from first contact until the force is zero.

    length:     a length [m] of the order of the maximum overlap, to scale the equations
    loading:    force until the overlap decreases
    unloading:  the force from then on, by maximum overlap [m]; None: `loading`
    """
    from scipy.integrate import solve_ivp

    scale = length / (mass * velocity**2)

    def motion(force: Force) -> Callable[[float, tuple[float, float]], tuple[float, float]]:
        return lambda _, state: (state[1], -scale * force(length * state[0], velocity * state[1]))

    def rate(_: float, state: tuple[float, float]) -> float:
        return state[1]

    rate.terminal = True  # type: ignore[attr-defined]
    rate.direction = -1.0  # type: ignore[attr-defined]
    options = {"method": "DOP853", "rtol": ACCURACY, "atol": 1e-13, "max_step": 0.01}
    up = solve_ivp(motion(loading), (0.0, 100.0), (0.0, 1.0), events=rate, dense_output=False, **options)
    turn = float(up.t[-1])
    largest = length * float(up.y[0, -1])
    back = loading if unloading is None else unloading(largest)

    def remaining(_: float, state: tuple[float, float]) -> float:
        return scale * back(length * state[0], velocity * state[1])

    remaining.terminal = True  # type: ignore[attr-defined]
    remaining.direction = -1.0  # type: ignore[attr-defined]
    down = solve_ivp(motion(back), (0.0, 100.0), (up.y[0, -1], 0.0), events=remaining, **options)
    forces = [loading(length * x, velocity * w) for x, w in up.y.T]
    unit = length / velocity
    return Rebound(
        largest, max(forces), unit * turn, unit * float(down.t[-1]), -velocity * float(down.y[1, -1])
    )


def zhou_recovery(e: float) -> float:
    """Recovered share y of the maximum overlap (Zhou 2011, Eq. 8): y = (4/5) e^2 + (1/5) e^3 y^(5/2), by
    bisection."""
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if 0.8 * e**2 + 0.2 * e**3 * middle**2.5 > middle else (low, middle)
    return 0.5 * (low + high)


def signed_power(base: float, exponent: float) -> float:
    """Power of the magnitude with the sign of the base, so that a force changes its sign where the contact
    ends."""
    return math.copysign(abs(base) ** exponent, base)


def zhou_unloading(k: float, e: float, largest: float, overlap: float) -> float:
    """Force [N] on the unloading curve of a maximum overlap [m] (Zhou 2011, Eq. 4), negative below the
    residual one.

    F = lam (d - ds) + e^3 k (d - ds)^(3/2), with lam from the continuity of the force at the maximum overlap
    (Eq. 7)
    """
    if e == 1.0:
        return k * signed_power(overlap, 1.5)
    y = zhou_recovery(e)
    slope = (k * largest**1.5 - e**3 * k * (y * largest) ** 1.5) / (y * largest)
    above = overlap - (1.0 - y) * largest
    return slope * above + e**3 * k * signed_power(above, 1.5)


def zhou_tangent(e: float) -> float:
    """Slope of the unloading curve at the maximum overlap over that of Hertz, (3/2) k sqrt(dmax)."""
    y = zhou_recovery(e)
    return ((1.0 - e**3 * y**1.5) / y + 1.5 * e**3 * math.sqrt(y)) / 1.5


def zhou_collision(pair: Pair, e: float, velocity: float) -> Rebound:
    """Collision of Zhou's model with the restitution e."""
    k = pair.k
    return collide(
        pair.mass,
        velocity,
        pair.largest_overlap(velocity),
        lambda d, _: k * signed_power(d, 1.5),
        lambda largest: lambda d, _: zhou_unloading(k, e, largest, d),
    )


def zhou_restitution(sigma: float, psi: float, limit: float, velocity: float) -> float:
    """e(v) = exp(-sigma (v / (vlim - v))^psi) below the limit velocity [m/s] (Zhou 2011, Eq. 12)."""
    return math.exp(-sigma * (velocity / (limit - velocity)) ** psi)


def zhou_limit_velocity(strength: float, density: float) -> float:
    """vlim = sqrt(3 Y / rho) of the material with the lower yield strength [Pa] (Zhou 2011, Eq. 11)."""
    return math.sqrt(3.0 * strength / density)


def zhou_spring(pair: Pair, velocity: float) -> float:
    """Stiffness [N/m] of a linear spring with the energy of Hertz at the same overlap (Zhou 2011, Eq. 19)."""
    return float(0.8 * (1.25 * pair.k**4 * pair.mass * velocity**2) ** 0.2)


def damping_ratio(e: float) -> float:
    """Damping ratio zeta of a spring-dashpot without attraction whose restitution is e.

    The contact ends at zero force (Schwager & Poeschel 2007), for zeta < 1:

        e = exp(-zeta / w (pi - atan2(2 zeta w, 1 - 2 zeta^2))),   w = sqrt(1 - zeta^2)
    """
    from scipy.optimize import brentq

    def excess(zeta: float) -> float:
        w = math.sqrt(1.0 - zeta**2)
        return math.exp(-zeta / w * (math.pi - math.atan2(2.0 * zeta * w, 1.0 - 2.0 * zeta**2))) - e

    return float(brentq(excess, 0.0, 0.999, xtol=1e-14))


def hertz_dashpot(pair: Pair, e: float) -> Force:
    """Hertz force with Tsuji's damping, which gives the same e at each velocity (Antypov & Elliott 2011).

    F = k d^(3/2) + sqrt(5) zeta sqrt(M k) d^(1/4) d'
    """
    k = pair.k
    c = math.sqrt(5.0 * pair.mass * pair.k) * damping_ratio(e)
    return lambda d, rate: k * signed_power(d, 1.5) + c * max(d, 0.0) ** 0.25 * rate


def linear_dashpot(stiffness: float, mass: float, e: float) -> Force:
    """Spring of a stiffness K [N/m] with a dashpot: F = K d + 2 zeta sqrt(K M) d'."""
    c = 2.0 * damping_ratio(e) * math.sqrt(stiffness * mass) if e < 1.0 else 0.0
    return lambda d, rate: stiffness * d + c * rate


def thornton_restitution(pair: Pair, pressure: float, velocity: float) -> float:
    """Restitution of elastic, perfectly plastic spheres with the limiting pressure p [Pa] (Thornton 1997, Eq.
    72).

    e = sqrt(6 sqrt(3) / 5) sqrt(1 - r^2 / 6) (r / (r + 2 sqrt((6 - r^2) / 5)))^(1/4),   r = vy / v < 1
    M vy^2 / 2 = (2/5) k dy^(5/2),   dy = R (pi p / (2 E))^2
    """
    overlap = pair.radius * (0.5 * math.pi * pressure / pair.modulus) ** 2
    r = math.sqrt(0.8 * pair.k * overlap**2.5 / pair.mass) / velocity
    last = r / (r + 2.0 * math.sqrt((6.0 - r**2) / 5.0))
    return math.sqrt(6.0 * math.sqrt(3.0) / 5.0 * (1.0 - r**2 / 6.0)) * float(last**0.25)
