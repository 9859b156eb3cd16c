"""Exact solution of a head-on collision for each contact model of the study: closed forms, and one quadrature."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from granflow.contact import theory


@dataclass(frozen=True)
class Exact:
    """Exact solution of a collision.

    Restitution, duration [s], time of the maximum overlap after first contact [s], maximum overlap [m]; overlap at
    which the force vanishes during unloading over the maximum, None where it depends on a dashpot.
    """

    restitution: float
    duration: float
    peak_time: float
    overlap_max: float
    end_ratio: float | None


def zhou(e: float, k: float, mass: float, velocity: float) -> Exact:
    """Zhou's model (Zhou 2011, Eqs. 5 and 13-15); `k` Hertz stiffness [N/m^1.5], `mass` effective [kg].

    A contact ends at x = 1 - y of the maximum overlap, with y the root of Eq. 8.
    """
    scale = float(theory.time_scale(k, mass, velocity))
    duration = float(theory.duration(e, k, mass, velocity))
    largest, end_ratio = float(theory.overlap_max(k, mass, velocity)), 1.0 - float(theory.recovery(e))
    return Exact(e, duration, theory.LOADING_DURATION * scale, largest, end_ratio)


def linear(e: float, k: float, mass: float, velocity: float) -> Exact:
    """Spring of Eq. 19 with dashpot: an oscillator until its force vanishes (Schwager & Poeschel 2007).

    `e`: restitution, `k`: Hertz stiffness [N/m^1.5], `mass`: effective [kg], `velocity` [m/s].
    """
    oscillator = _Oscillator(float(theory.equivalent_spring(k, mass, velocity)), mass, velocity, e)
    return Exact(e, oscillator.end, oscillator.peak, float(oscillator.at(oscillator.peak)), 0.0 if e == 1.0 else None)


def hertz(e: float, k: float, mass: float, velocity: float) -> Exact:
    """Hertz's spring with Tsuji's damping, as an oscillator z = d^(5/4) in the time ds = (5/4) d^(1/4) dt.

    In these variables both models satisfy M v dv/dz = -(4/5) (k z + c v) (Antypov & Elliott 2011), so that

        t = (4/5) int z(s)^(-1/5) ds

    Arguments as in `linear`; for e = 1 the contact is elastic, and the duration is twice the time of loading.
    """
    oscillator = _Oscillator(0.8 * k, mass, velocity, e)
    rise = _contact_time(oscillator, 0.0, oscillator.peak)
    fall = rise if e == 1.0 else _contact_time(oscillator, oscillator.peak, oscillator.end)
    return Exact(e, rise + fall, rise, float(oscillator.at(oscillator.peak)) ** 0.8, 0.0 if e == 1.0 else None)


EXACT: Mapping[str, Callable[[float, float, float, float], Exact]] = {"zhou": zhou, "hertz": hertz, "linear": linear}
"""Exact solution by name of the contact model; arguments as in `zhou`."""


class _Oscillator:
    """M z'' = -K z - 2 zeta sqrt(K M) z' from z = 0 with a velocity, until its force vanishes; e sets zeta < 1.

    `peak`, `end`: times of the maximum of z and of zero force.
    """

    def __init__(self, stiffness: float, mass: float, velocity: float, e: float) -> None:
        zeta = theory.damping_ratio_for(e)
        root = float(np.sqrt(1.0 - zeta**2))
        natural = float(np.sqrt(stiffness / mass))
        self.decay, self.frequency, self.velocity = zeta * natural, root * natural, velocity
        self.peak = float(np.arctan2(root, zeta)) / self.frequency
        self.end = (np.pi - float(np.arctan2(2.0 * zeta * root, 1.0 - 2.0 * zeta**2))) / self.frequency

    def at(self, time: float | np.ndarray) -> np.ndarray:
        """z at a time, a number or an array of any shape."""
        displacement = np.exp(-self.decay * np.asarray(time)) * np.sin(self.frequency * np.asarray(time))
        return np.asarray(self.velocity / self.frequency * displacement)


def _contact_time(oscillator: _Oscillator, begin: float, end: float) -> float:
    """Contact time [s] for the oscillator time from `begin` to `end`, s = begin + (end - begin) q^5.

        t = (4/5) int z(s)^(-1/5) ds

    At first contact z ~ s, and z^(-1/5) ds = (q^5)^(-1/5) 5 q^4 dq is smooth.
    """
    from scipy.integrate import quad

    def integrand(q: float) -> float:
        return 5.0 * q**4 * float(oscillator.at(begin + (end - begin) * q**5)) ** -0.2

    return 0.8 * (end - begin) * float(quad(integrand, 0.0, 1.0, epsabs=0.0, epsrel=1e-13)[0])
