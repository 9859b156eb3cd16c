"""What all validation cases share: the record of a compared number, and the shipped scenes.

A family is a function that simulates and returns such records; `run.py` collects the families.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from granflow import Scene, load_scene
from granflow.io.files import example_paths

Row = tuple[str, float, float, str]
"""What is compared, reference, number from granflow, and unit."""


@dataclass(frozen=True)
class ValidationCase:
    """One number of a reference and the same number from granflow, both in `unit` (SI).

    kind, name:  section of the page, and what is compared
    reference:   published number or closed form; `source` gives its origin
    value:       number from granflow
    allowed:     largest allowed deviation, relative to `scale`; `derivation` gives its reason
    scale:       value to which the deviation is relative; None for the reference
    remark:      what holds of a formula and what lies beyond its range, or empty
    in_range:    False if the reference is used beyond its range; a larger deviation is then shown, but does
                 not fail
    """

    kind: str
    name: str
    reference: float
    source: str
    value: float
    unit: str
    allowed: float
    derivation: str
    scale: float | None = None
    remark: str = ""
    in_range: bool = True

    @property
    def deviation(self) -> float:
        """Difference of value and reference relative to the scale; nan if the value is not a number."""
        return (self.value - self.reference) / abs(self.reference if self.scale is None else self.scale)

    @property
    def status(self) -> str:
        """`pass` if the deviation is at most the allowed one, otherwise `fail`, or `miss` beyond the
        reference's range.

        A value that is not finite fails.
        """
        if math.isfinite(self.deviation) and abs(self.deviation) <= self.allowed:
            return "pass"
        return "fail" if self.in_range or not math.isfinite(self.deviation) else "miss"

    def as_dict(self) -> dict[str, Any]:
        """Fields of the case for JSON, with deviation and status."""
        return asdict(self) | {"deviation": self.deviation, "status": self.status}

    @classmethod
    def from_dict(cls, stored: dict[str, Any]) -> "ValidationCase":
        """Case from `as_dict`; deviation and status are computed again."""
        return cls(**{name: value for name, value in stored.items() if name not in ("deviation", "status")})


def cases_of(
    kind: str, name: str, source: str, allowed: float, derivation: str, rows: Sequence[Row]
) -> list[ValidationCase]:
    """A case for each row, with `name` and what the row compares, and the same allowed deviation."""
    return [
        ValidationCase(
            kind=kind,
            name=f"{name}: {what}",
            reference=float(reference),
            source=source,
            value=float(value),
            unit=unit,
            allowed=allowed,
            derivation=derivation,
        )
        for what, reference, value, unit in rows
    ]


def shipped_scene(name: str, overrides: Sequence[str] = ()) -> Scene:
    """A shipped scene in double precision, such as "flat_silo", with overrides KEY=VALUE."""
    return load_scene(example_paths()[name], ["run.precision=f64", *overrides])
