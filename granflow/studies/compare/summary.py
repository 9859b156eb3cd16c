"""Summary table: one row per quantity, one column per contact model, with the ratio to the first.

Values are stored in SI units and converted for display only.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from granflow.studies.compare.runs import VariantRun
from granflow.visible_text import readable

STRONG = 2.0
"""Multiple of the mean force above which a contact counts as strong."""

MISSING = "–"
"""Cell without a value."""


class Unit(NamedTuple):
    """SI unit of a value, unit in the table, and its value in SI units; empty text for dimensionless values."""

    si: str
    shown: str
    per_si: float


SECOND, MICROSECOND, MILLIMETER = Unit("s", "s", 1.0), Unit("s", "µs", 1e6), Unit("m", "mm", 1e3)
MILLIJOULE, MASS_FLOW = Unit("J", "mJ", 1e3), Unit("kg/s", "kg/s", 1.0)
NUMBER, PERCENT = Unit("", "", 1.0), Unit("", "%", 1e2)

Quantity = tuple[str, Unit, Callable[[VariantRun], float]]
"""Name, unit, and function that returns the value of a run in SI units, or nan."""


@dataclass(frozen=True)
class SummaryRow:
    """One quantity in SI units for all runs, in the order of the runs; nan if a run has no value.

    The first run is the reference of the ratios. `is_complete`: whether the value refers to a complete run, or does not
    depend on the run; ratios of other values are nan. `at_stage`: whether the value refers to the densest stage.
    """

    name: str
    unit: Unit
    values: tuple[float, ...]
    is_complete: tuple[bool, ...]
    at_stage: bool = False

    @property
    def label(self) -> str:
        """Name, with a star if the value refers to the densest stage."""
        return f"{self.name} *" if self.at_stage else self.name

    @property
    def ratios(self) -> tuple[float, ...]:
        """Ratios to the value of the first run; nan if that is 0 or missing, or for part of a run."""
        first = self.values[0] if self.is_complete[0] else 0.0
        pairs = zip(self.values, self.is_complete, strict=True)
        return tuple(value / first if first and is_complete else float("nan") for value, is_complete in pairs)


def densest_stage(runs: Sequence[VariantRun]) -> str:
    """Stage at the end of which the first complete run has the most contacts.

    Only stages with rows in all complete runs qualify: a stage that waits for rest may end before its first row.
    """
    finished = [run for run in runs if not run.stopped] or list(runs[:1])
    columns = finished[0].columns
    ends = {stage: count for stage, count in zip(columns["stage"].tolist(), columns["contact_count"], strict=True)}
    shared = [stage for stage in ends if all(stage in run.columns["stage"] for run in finished)]
    return max(shared or list(ends), key=lambda stage: ends[stage])


def at_end(stage: str, name: str) -> Callable[[VariantRun], float]:
    """Function that returns the value of a column at the end of a stage; nan if a run did not complete the stage."""

    def number(run: VariantRun) -> float:
        row = run.at_end_of(stage)
        return float("nan") if row is None else float(run.columns[name][row])

    return number


def _last(name: str, run: VariantRun) -> float:
    """Last value of a column."""
    return run.columns[name][-1]


def _height(stage: str, column: int, run: VariantRun) -> float:
    """Height [m] in the sample nearest to the end of a stage; nan if a run did not complete the stage."""
    time = at_end(stage, "time")(run)
    return run.heights[np.argmin(np.abs(run.heights[:, 0] - time)), column] if np.isfinite(time) else float("nan")


TIME_STEP: Quantity = ("time step", MICROSECOND, lambda run: run.time_step)

COST: tuple[Quantity, ...] = (
    ("simulated time", SECOND, lambda run: run.time),
    ("steps needed", NUMBER, lambda run: run.step_count),
    ("wall time of steps", SECOND, lambda run: run.seconds),
    ("wall time per step", MICROSECOND, lambda run: run.seconds / max(run.step_count, 1)),
    ("compilation", SECOND, lambda run: run.compile_seconds),
)
"""Steps and wall time."""

CONTACTS: tuple[Quantity, ...] = (
    ("maximum overlap/radius", PERCENT, lambda run: np.nanmax(run.columns["overlap_largest"])),
    ("median contact duration", MICROSECOND, lambda run: run.median_duration),
)
"""Contacts of the complete run."""

ENERGIES: tuple[Quantity, ...] = (
    ("kinetic energy, end", MILLIJOULE, partial(_last, "kinetic_energy")),
    ("lost: plastic", MILLIJOULE, partial(_last, "plastic_dissipation")),
    ("lost: friction", MILLIJOULE, partial(_last, "friction_dissipation")),
    ("lost: rolling", MILLIJOULE, partial(_last, "rolling_dissipation")),
    ("lost: damping", MILLIJOULE, partial(_last, "damping_dissipation")),
)
"""Energies at the end of the run."""

ENERGY_ERROR: Quantity = ("energy error, end", PERCENT, lambda run: abs(run.columns["energy_error"][-1]))


def _flow(meter: str) -> Quantity:
    """Mass flow rate through a meter."""
    return f"mass flow rate, {meter}", MASS_FLOW, lambda run: run.mass_flow(meter)


def _bed(stage: str) -> tuple[Quantity, ...]:
    """State of the bed at the end of a stage."""
    return (
        ("end of stage", SECOND, at_end(stage, "time")),
        ("center of mass", MILLIMETER, partial(_height, stage, 1)),
        ("surface", MILLIMETER, partial(_height, stage, 2)),
        ("coordination number", NUMBER, at_end(stage, "coordination_number")),
        ("mean overlap/radius", PERCENT, at_end(stage, "overlap_mean")),
        (f"contacts above {STRONG:g} <f>", PERCENT, lambda run: run.forces.share_above(stage, STRONG)),
    )


def summary(runs: Sequence[VariantRun]) -> list[SummaryRow]:
    """All rows with a finite value of at least one run: cost, flow, bed, contacts, energies that are not all zero."""

    is_complete = tuple(not run.stopped for run in runs)

    def rows(quantities: Iterable[Quantity], at_stage: bool = False) -> list[SummaryRow]:
        return [
            SummaryRow(name, unit, tuple(float(number(run)) for run in runs), is_complete, at_stage)
            for name, unit, number in quantities
        ]

    time_steps = [replace(row, is_complete=(True,) * len(runs)) for row in rows([TIME_STEP])]
    found = [
        *time_steps,
        *rows(COST),
        *rows(map(_flow, runs[0].meters)),
        *rows(_bed(densest_stage(runs)), at_stage=True),
    ]
    found += [*rows(CONTACTS), *(row for row in rows(ENERGIES) if any(row.values)), *rows([ENERGY_ERROR])]
    return [row for row in found if np.isfinite(row.values).any()]


def heads(runs: Sequence[VariantRun], is_short: bool = False) -> list[str]:
    """Column headings of the table, on several lines; `is_short`: those of ratios name the first contact model only."""
    first, *others = (run.variant.title.replace(" ", "\n", 1) for run in runs)
    pairs = ((title, f"over\n{first}" if is_short else f"{title}\nover {first}") for title in others)
    return ["", "unit", first, *(head for pair in pairs for head in pair)]


def as_text(rows: Sequence[SummaryRow]) -> list[list[str]]:
    """Cells of the table: value of the first contact model, then value and ratio of each other."""
    found = []
    for row in rows:
        _, unit, factor = row.unit
        first, *others = (factor * value for value in row.values)
        cells = [row.label, unit, _number(first)]
        for value, ratio in zip(others, row.ratios[1:], strict=True):
            cells += [_number(value), f"{ratio:.3g}" if np.isfinite(ratio) else MISSING]
        found.append(cells)
    return found


def summary_columns(runs: Sequence[VariantRun], rows: Sequence[SummaryRow]) -> dict[str, np.ndarray]:
    """Columns of compare.csv: one row per quantity and contact model, with values in SI units and their ratios."""
    laws = [run.variant.key for run in runs]
    return {
        "quantity": np.repeat([row.name for row in rows], len(laws)),
        "unit": np.repeat([row.unit.si for row in rows], len(laws)),
        "law": np.tile(laws, len(rows)),
        "value": np.array([value for row in rows for value in row.values]),
        "ratio": np.array([ratio for row in rows for ratio in row.ratios]),
    }


def _number(value: float) -> str:
    """Text of a value, or a dash for nan."""
    return readable(value) if np.isfinite(value) else MISSING
