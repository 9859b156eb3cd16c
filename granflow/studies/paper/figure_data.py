"""Data of a figure of the paper: points, deviations of simulation from theory, and drawing function."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow.studies.tables import percent


@dataclass(frozen=True)
class FigureDeviation:
    """Largest relative deviation: `quantity` names simulated and reference value, `where` the point.

    `largest`, `target`: fractions, not percentages; `target` is None without one.
    """

    quantity: str
    largest: float
    where: str
    target: float | None = None
    remark: str = ""

    @property
    def is_within_target(self) -> bool:
        """Whether the deviation is within its target; True without a target."""
        return self.target is None or self.largest <= self.target

    def sentence(self) -> str:
        """Sentence with the deviation, its target and a remark."""
        target = ""
        if self.target is not None:
            target = f" (target {percent(self.target)}, {'satisfied' if self.is_within_target else 'not satisfied'})"
        text = f"Largest deviation of {self.quantity}: {percent(self.largest)} at {self.where}{target}. {self.remark}"
        return text.strip()


@dataclass(frozen=True)
class FigureData:
    """One figure: file name, title, caption, columns of its CSV file, deviations, and drawing function.

    `columns`: name -> array (rows,), all of the same length.
    """

    name: str
    title: str
    caption: str
    columns: Mapping[str, np.ndarray]
    deviations: tuple[FigureDeviation, ...]
    draw: Callable[[Any, Mapping[str, np.ndarray]], None]
    """Called with an empty matplotlib figure and the columns."""
    height: float
    """Height of the figure [inch]."""


def relative_deviation(
    quantity: str,
    simulated: np.ndarray,
    theory: np.ndarray,
    where: Callable[[int], str],
    target: float | None = None,
    remark: str = "",
) -> FigureDeviation:
    """Largest value of |simulated / theory - 1|; `where` describes the point of an index.

    `simulated`, `theory` (n,): values in the same unit.
    """
    shares = np.abs(np.asarray(simulated) / np.asarray(theory) - 1.0)
    worst = int(np.argmax(shares))
    return FigureDeviation(quantity, float(shares[worst]), where(worst), target, remark)
