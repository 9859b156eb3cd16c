"""A figure of the paper as numbers: its points, how far simulation is from theory, and how it is drawn."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class FigureDeviation:
    """The largest relative deviation of something: `quantity` says of what from what, `where` names the point."""

    quantity: str
    largest: float
    where: str
    target: float | None = None
    remark: str = ""

    @property
    def has_touched(self) -> bool:
        """Whether it stays within its target; true where there is none."""
        return self.target is None or self.largest <= self.target

    def sentence(self) -> str:
        """In words, with the target and a remark."""
        text_parts = f"Largest deviation of {self.quantity}: {percent(self.largest)} at {self.where}"
        if self.target is not None:
            text_parts += f" (target {percent(self.target)}, {'met' if self.has_touched else 'not met'})"
        return f"{text_parts}. {self.remark}".strip()


@dataclass(frozen=True)
class FigureData:
    """One figure: file name, title, caption, the columns of its CSV, deviations, and what draws it."""

    name: str
    title: str
    caption: str
    columns: Mapping[str, np.ndarray]
    deviations: tuple[FigureDeviation, ...]
    draw: Callable[[Any, Mapping[str, np.ndarray]], None]
    """Gets an empty matplotlib figure and the columns."""
    height: float
    """Of the drawn figure [inch]."""


def percent(share: float) -> str:
    """A share as a percentage with two digits that count."""
    return f"{100.0 * share:.2g} %" if share >= 1e-6 else "below 0.0001 %"


def relative_deviation(
    quantity: str,
    simulated: np.ndarray,
    theory: np.ndarray,
    where: Callable[[int], str],
    target: float | None = None,
    remark: str = "",
) -> FigureDeviation:
    """The largest of |simulated / theory - 1|; `where` names the point of an index."""
    shares = np.abs(np.asarray(simulated) / np.asarray(theory) - 1.0)
    worst = int(np.argmax(shares))
    return FigureDeviation(quantity, float(shares[worst]), where(worst), target, remark)
