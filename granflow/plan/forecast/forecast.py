"""One forecast of a plan."""

from dataclasses import dataclass
from typing import Literal

Cause = Literal["impact", "weight", "wall", "cohesion"]
"""Causes of overlaps: an impact, the weight of the bed, a wall that presses on the bed, an attraction."""


@dataclass(frozen=True)
class Forecast:
    """One forecast for `granflow explain`: name, value and remark; `warning`: sentence for check and run, or None.

    cause, overlap:  of a forecast overlap: its cause, and the overlap over the smaller radius; None and 0 for others
    force:           largest contact force [N] of a static pressure, for the pair with the largest overlap
    """

    name: str
    value: str
    remark: str
    warning: str | None = None
    cause: Cause | None = None
    overlap: float = 0.0
    force: float = 0.0
