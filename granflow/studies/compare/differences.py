"""Differences between contact models with their 95 % confidence intervals, and what these show.

Two runs of one scene always differ: packings with other random numbers scatter, and flows fluctuate. The
scatter of a quantity is known from repetitions with other seeds. A single run has the fluctuation of its flow
in time only (`granflow.steady_flow_error`), which does not contain the scatter between packings.
"""

from dataclasses import dataclass
from math import hypot, isfinite, nan, sqrt
from typing import NamedTuple

import numpy as np
from scipy import stats

CONFIDENCE = 0.95
"""Probability with which an interval contains the difference of the means."""


class Estimate(NamedTuple):
    """A mean with its standard error; `size`: number of values of which it is the mean."""

    mean: float
    error: float
    size: int

    @classmethod
    def of(cls, values: "np.ndarray | list[float]") -> "Estimate":
        """Mean of values (n,); the error is nan for fewer than two."""
        size = len(values)
        error = float(np.std(values, ddof=1)) / sqrt(size) if size > 1 else nan
        return cls(float(np.mean(values)) if size else nan, error, size)


@dataclass(frozen=True)
class Difference:
    """Value of a contact model minus that of the first one, SI units, with its confidence interval.

    `quantity`, `unit`: as in the summary table; `title`, `first`: of both contact models; `reference`: mean
    of the first one; `low`, `high`: bounds of the interval.
    """

    quantity: str
    unit: str
    title: str
    first: str
    reference: float
    value: float
    low: float
    high: float

    @property
    def relative(self) -> tuple[float, float, float]:
        """Difference and bounds of the interval over the magnitude of the reference; nan if that is 0."""
        over = abs(self.reference) or nan
        return self.value / over, self.low / over, self.high / over

    @property
    def conclusion(self) -> str:
        """What the interval shows."""
        if self.low > 0.0 or self.high < 0.0:
            return "larger" if self.value > 0.0 else "smaller"
        return "equal" if self.low == self.high else "not distinguishable"


def welch_interval(first: Estimate, other: Estimate) -> tuple[float, float]:
    """Confidence interval of the mean of `other` minus that of `first`; nan if an error is not known.

    Welch's interval for samples of different variance, with the degrees of freedom of Satterthwaite
    (B. L. Welch, Biometrika 34 (1947) 28).
    """
    difference = other.mean - first.mean
    error = hypot(first.error, other.error)
    if not isfinite(error):
        return nan, nan
    if error == 0.0:
        return difference, difference
    parts = sum((each.error / error) ** 4 / (each.size - 1) for each in (first, other))
    reach = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, 1.0 / parts)) * error
    return difference - reach, difference + reach


def difference_of(
    quantity: str, unit: str, titles: tuple[str, str], first: Estimate, other: Estimate
) -> Difference | None:
    """The difference of two estimates; None if the error of one is not known."""
    low, high = welch_interval(first, other)
    if not isfinite(low):
        return None
    return Difference(quantity, unit, titles[1], titles[0], first.mean, other.mean - first.mean, low, high)
