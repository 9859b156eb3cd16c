"""Wall motion: tables with a continuous rate, ramps, rotation matrices, and the poses of a wall. numpy only.

The kinds of motion are records of `scene.blocks.motions`, which use these functions.

Velocities can have a ramp: during `ramp_duration` T from the start of the motion they change linearly from an
initial value v0 to v,

    v(t) = v - (v - v0) max(1 - t/T, 0),    integral of v = v t - (v - v0) [T/2 - max(T - t, 0)^2 / (2 T)]

and during a ramp at the end they decrease linearly to 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

# Motion from a table: a displacement or an angle between rows, with a continuous rate.
#
# Between two rows the value is a cubic polynomial with given values and rates at both rows (Hermite):
#
#     y(u) = y0 + u [h r0 + u (c + u d)],    u = (t - t0) / h
#     c = 3 (y1 - y0) - h (2 r0 + r1),       d = h (r0 + r1) - 2 (y1 - y0)
#
# Before the first and after the last row, value and rate are those of rest.


@dataclass(frozen=True, eq=False)
class MotionTable:
    """Rows of a table: ascending times (n,) [s], values (n,) [m or rad], rates (n,) [m/s or rad/s].

    n is at least 2.
    """

    times: np.ndarray
    values: np.ndarray
    rates: np.ndarray
    _quadratic: np.ndarray = field(init=False)
    _cubic: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        steps = np.diff(self.times)
        changes = np.diff(self.values)
        first, last = self.rates[:-1], self.rates[1:]
        object.__setattr__(self, "_quadratic", 3.0 * changes - steps * (2.0 * first + last))
        object.__setattr__(self, "_cubic", steps * (first + last) - 2.0 * changes)

    @classmethod
    def of_values(cls, times: Sequence[float], values: Sequence[float]) -> "MotionTable":
        """The table of values (n,), with the rates of a monotone interpolation (Fritsch & Butland 1984).

        Between rows the value stays between those of the rows: it does not overshoot.
        """
        from scipy.interpolate import PchipInterpolator

        x = np.asarray(times, dtype=float)
        y = np.asarray(values, dtype=float)
        return cls(x, y - y[0], np.asarray(PchipInterpolator(x, y).derivative()(x)))

    @classmethod
    def of_rates(cls, times: Sequence[float], rates: Sequence[float]) -> "MotionTable":
        """The table of rates (n,), which are linear between rows; the values are their integrals."""
        x = np.asarray(times, dtype=float)
        r = np.asarray(rates, dtype=float)
        return cls(x, np.concatenate([[0.0], np.cumsum(0.5 * np.diff(x) * (r[1:] + r[:-1]))]), r)

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Value and rate (k,) at times (k,) [s] after the start of the motion."""
        row = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        step = np.diff(self.times)[row]
        rate = self.rates[row]
        c = self._quadratic[row]
        d = self._cubic[row]
        u = np.clip((times - self.times[row]) / step, 0.0, 1.0)
        value = self.values[row] + u * (step * rate + u * (c + u * d))
        inside = (times >= self.times[0]) & (times < self.times[-1])
        return value, inside * (rate + u * (2.0 * c + 3.0 * u * d) / step)

    @property
    def largest_rate(self) -> float:
        """Largest magnitude of the rate: at a row, or between rows at u = -c / (3 d)."""
        rates = self.rates
        c = self._quadratic
        d = self._cubic
        u = np.where(d == 0.0, 0.0, -c / np.where(d == 0.0, 1.0, 3.0 * d))
        between = rates[:-1] + u * (2.0 * c + 3.0 * u * d) / np.diff(self.times)
        return float(max(np.abs(rates).max(), np.abs(between[(u > 0.0) & (u < 1.0)]).max(initial=0.0)))

    @property
    def largest_change_of_rate(self) -> float:
        """Largest magnitude of the time derivative of the rate, without jumps.

        The rate is linear between rows.
        """
        ends = np.stack([2.0 * self._quadratic, 2.0 * self._quadratic + 6.0 * self._cubic])
        return float(np.abs(ends / np.diff(self.times) ** 2).max())

    @property
    def shortest_step(self) -> float:
        """Shortest time between two rows [s]."""
        return float(np.diff(self.times).min())


# The pose of a wall.


@dataclass(frozen=True)
class Poses:
    """Poses and velocities of a wall at k times, float64.

    offset:            (k, 3) [m], displacement of the pivot
    rotation:          (k, 3, 3)
    velocity:          (k, 3) [m/s] of the pivot
    angular_velocity:  (k, 3) [rad/s]
    pivot:             (3,) [m] in the rest pose; the point of the rotation, or the origin without rotation
    surface_velocity:  (k, 3) [m/s] of the surface along itself, in addition to the motion of the wall

    A point p of the wall at rest is at `rotation @ (p - pivot) + pivot + offset`. A point of the wall at x
    has the velocity `velocity + angular_velocity x (x - pivot - offset)`.
    """

    offset: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    pivot: np.ndarray
    surface_velocity: np.ndarray


def ramp(duration: float, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lag [s] behind a motion without ramp, and remaining share of the change, at elapsed times (k,) [s].

        T/2 - max(T - t, 0)^2 / (2 T)  and  max(1 - t/T, 0)

    Both are 0 without ramp (T = 0).
    """
    if not duration:
        return np.zeros(len(time)), np.zeros(len(time))
    remaining = np.maximum(1.0 - time / duration, 0.0)
    return 0.5 * duration * (1.0 - remaining**2), remaining


def rotation_matrices(axis: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotation matrices about an axis (Rodrigues).

        I + sin(a) K + (1 - cos(a)) K K        K the cross product matrix of the axis

    axis:     (3,) unit vector
    angles:   (k,) [rad]
    Returns:  (k, 3, 3); 1 - cos(a) is evaluated as 2 sin^2(a/2), which is accurate for small angles
    """
    cross = np.cross(axis, np.eye(3)).T
    half_sine = np.sin(angles / 2)[:, None, None]
    return np.eye(3) + np.sin(angles)[:, None, None] * cross + 2 * half_sine**2 * (cross @ cross)
