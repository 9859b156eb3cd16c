"""Kinetic theory of cooling gases of smooth hard spheres, in the approximation of Enskog.

Temperature theta [m2/s2]: a third of the mean square velocity. With n particles of diameter s per volume and
the pair correlation chi at contact, each particle has w collisions per second, and a collision with the
normal velocity v dissipates m v^2 (1 - e^2) / 4:

    w = 4 n s^2 chi sqrt(pi theta),   chi = (1 - phi/2) / (1 - phi)^3       (Carnahan & Starling)
    d(theta)/dt = -w theta <u (1 - e(v)^2)> / 3,   v^2 = 4 theta u,   u exponentially distributed
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from granflow.geometry.shape import sphere_volume

Restitution = Callable[[np.ndarray], np.ndarray]
"""Coefficient of restitution over the normal velocity [m/s]."""
NODES, WEIGHTS = np.polynomial.laguerre.laggauss(24)
"""Quadrature over u."""
TIMES = 2000
"""Steps of the integration of the temperature."""


@dataclass(frozen=True)
class Gas:
    """Monodisperse gas: number of particles, diameter [m], volume [m3]."""

    count: int
    diameter: float
    volume: float

    @property
    def pair_correlation(self) -> float:
        """chi at contact."""
        phi = self.count * sphere_volume(0.5 * self.diameter) / self.volume
        return (1.0 - 0.5 * phi) / (1.0 - phi) ** 3

    def collision_rate(self, theta: float) -> float:
        """Collisions per particle and second at the temperature theta [m2/s2]."""
        density = self.count / self.volume
        return 4.0 * density * self.diameter**2 * self.pair_correlation * math.sqrt(math.pi * theta)


def kurtosis(e: float) -> float:
    """a_2 of the homogeneous cooling state with constant restitution (van Noije & Ernst 1998)."""
    return 16.0 * (1.0 - e) * (1.0 - 2.0 * e**2) / (81.0 - 17.0 * e + 30.0 * e**2 * (1.0 - e))


def haff_slope(gas: Gas, e: float, theta: float) -> float:
    """d(sqrt(theta_0 / theta))/dt [1/s] of Haff's law, (1 - e^2) w / 6, times 1 + 3 a_2 / 16; theta_0 =
    theta."""
    return (1.0 - e**2) * gas.collision_rate(theta) / 6.0 * (1.0 + 3.0 * kurtosis(e) / 16.0)


def loss_of(restitution: Restitution, theta: float) -> float:
    """<u (1 - e(v)^2)> over the normal velocities v = sqrt(4 theta u) of collisions at the temperature
    [m2/s2]."""
    return float(np.sum(WEIGHTS * NODES * (1.0 - restitution(np.sqrt(4.0 * theta * NODES)) ** 2)))


def cooling_curve(
    gas: Gas, restitution: Restitution, theta: float, end: float, factor: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) [s] to `end` and temperatures (n,) [m2/s2] from theta, with the cooling rate times
    `factor`."""
    time = np.linspace(0.0, end, TIMES + 1)
    found = [theta]
    for step in np.diff(time):
        half = found[-1] + 0.5 * step * _rate(gas, restitution, found[-1], factor)
        found.append(found[-1] + step * _rate(gas, restitution, half, factor))
    return time, np.array(found)


def _rate(gas: Gas, restitution: Restitution, theta: float, factor: float) -> float:
    """d(theta)/dt [m2/s3]."""
    return -factor * gas.collision_rate(theta) * theta * loss_of(restitution, theta) / 3.0


def viscoelastic_restitution(e: float, velocity: float) -> Restitution:
    """Restitution of viscoelastic spheres that have e at a velocity [m/s], over the velocity.

    In units of the undamped collision, x'' = -x^(3/2) - g x^(1/2) x' with g ~ v^(1/5), until the force is
    zero (Schwager & Poeschel 2008, doi 10.1103/PhysRevE.78.051304).
    """
    g = np.linspace(0.0, 1.0, 41)
    table = np.array([_rebound(each) for each in g])
    g_reference = float(np.interp(-e, -table, g))

    def restitution(speed: np.ndarray) -> np.ndarray:
        return np.interp(g_reference * (speed / velocity) ** 0.2, g, table)

    return restitution


def _rebound(g: float) -> float:
    """Restitution of a collision with the dissipation g."""
    from scipy.integrate import solve_ivp

    def motion(_: float, state: np.ndarray) -> tuple[float, float]:
        x = max(state[0], 0.0)
        return state[1], -(x**1.5) - g * math.sqrt(x) * state[1]

    def force(_: float, state: np.ndarray) -> float:
        return float(state[0] + g * state[1])

    force.terminal = True  # type: ignore[attr-defined]
    force.direction = -1.0  # type: ignore[attr-defined]
    run = solve_ivp(motion, (0.0, 10.0), (1e-9, 1.0), events=force, rtol=1e-10, atol=1e-12)
    return float(-run.y_events[0][0][1])
