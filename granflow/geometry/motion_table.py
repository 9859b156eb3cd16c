"""Motion from a table: a displacement or an angle between rows, with a continuous rate. numpy only.

Between two rows the value is a cubic polynomial with given values and rates at both rows (Hermite):

    y(u) = y0 + u [h r0 + u (c + u d)],    u = (t - t0) / h
    c = 3 (y1 - y0) - h (2 r0 + r1),       d = h (r0 + r1) - 2 (y1 - y0)

Before the first and after the last row, value and rate are those of rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf

import numpy as np


@dataclass(frozen=True, eq=False)
class MotionTable:
    """Rows of a table: ascending times (n,) [s], n at least 2; values (n,) [m or rad] and rates (n,) [m/s or rad/s]."""

    times: np.ndarray
    values: np.ndarray
    rates: np.ndarray
    _quadratic: np.ndarray = field(init=False)
    _cubic: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        steps, changes = np.diff(self.times), np.diff(self.values)
        first, last = self.rates[:-1], self.rates[1:]
        object.__setattr__(self, "_quadratic", 3.0 * changes - steps * (2.0 * first + last))
        object.__setattr__(self, "_cubic", steps * (first + last) - 2.0 * changes)

    @classmethod
    def of_values(cls, times: Sequence[float], values: Sequence[float]) -> "MotionTable":
        """The table of values (n,), with the rates of a monotone interpolation (Fritsch & Butland 1984).

        Between rows the value stays between those of the rows: it does not overshoot.
        """
        from scipy.interpolate import PchipInterpolator

        x, y = np.asarray(times, dtype=float), np.asarray(values, dtype=float)
        return cls(x, y - y[0], np.asarray(PchipInterpolator(x, y).derivative()(x)))

    @classmethod
    def of_rates(cls, times: Sequence[float], rates: Sequence[float]) -> "MotionTable":
        """The table of rates (n,), which are linear between rows; the value is their integral from the first row."""
        x, r = np.asarray(times, dtype=float), np.asarray(rates, dtype=float)
        return cls(x, np.concatenate([[0.0], np.cumsum(0.5 * np.diff(x) * (r[1:] + r[:-1]))]), r)

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Value and rate (k,) at times (k,) [s] after the start of the motion."""
        row = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        step, rate, c, d = np.diff(self.times)[row], self.rates[row], self._quadratic[row], self._cubic[row]
        u = np.clip((times - self.times[row]) / step, 0.0, 1.0)
        value = self.values[row] + u * (step * rate + u * (c + u * d))
        inside = (times >= self.times[0]) & (times < self.times[-1])
        return value, inside * (rate + u * (2.0 * c + 3.0 * u * d) / step)

    @property
    def largest_rate(self) -> float:
        """Largest magnitude of the rate: at a row, or between rows at u = -c / (3 d)."""
        rates, c, d = self.rates, self._quadratic, self._cubic
        u = np.where(d == 0.0, 0.0, -c / np.where(d == 0.0, 1.0, 3.0 * d))
        between = rates[:-1] + u * (2.0 * c + 3.0 * u * d) / np.diff(self.times)
        return float(max(np.abs(rates).max(), np.abs(between[(u > 0.0) & (u < 1.0)]).max(initial=0.0)))

    @property
    def largest_change_of_rate(self) -> float:
        """Largest magnitude of the time derivative of the rate, which is linear between rows; without jumps."""
        ends = np.stack([2.0 * self._quadratic, 2.0 * self._quadratic + 6.0 * self._cubic])
        return float(np.abs(ends / np.diff(self.times) ** 2).max())

    @property
    def shortest_step(self) -> float:
        """Shortest time between two rows [s]."""
        return float(np.diff(self.times).min())


@dataclass(frozen=True)
class TableTranslation:
    """Translation along a unit direction by the displacement of a table [m], from `start` to `end` [s]."""

    direction: tuple[float, float, float]
    table: MotionTable
    start: float = 0.0
    end: float = inf


@dataclass(frozen=True)
class TableRotation:
    """Rotation about an axis by the angle of a table [rad], from `start` to `end` [s].

    point:  [m], point on the axis in the rest pose
    axis:   unit vector; the rotation is right-handed
    """

    point: tuple[float, float, float]
    axis: tuple[float, float, float]
    table: MotionTable
    start: float = 0.0
    end: float = inf
