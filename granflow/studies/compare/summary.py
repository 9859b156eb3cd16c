"""Summary table: one row per quantity, one column per contact model, with the ratio to the first.

Values are stored in SI units and converted for display only.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from granflow.studies.compare.runs import VariantRun
from granflow.visible_text import readable

STRONG = 2.0
"""Multiple of the mean force above which a contact counts as strong."""
MISSING = "–"
"""Cell without a value."""


DISPLAY_UNITS = {"time": ("µs", 1e6), "length": ("mm", 1e3), "energy_budget": ("mJ", 1e3), "share": ("%", 1e2)}
"""Display unit and factor from SI."""


@dataclass(frozen=True)
class SummaryRow:
    """One quantity in SI units for all runs, in the order of the runs; nan if a run has no value.

    The first run is the reference of the ratios.
    """

    name: str
    unit: str
    values: tuple[float, ...]
    display: tuple[str, float] = ("", 1.0)
    """Display unit and factor from SI; an empty unit for dimensionless quantities."""
    at_stage: bool = False
    """Whether the value refers to the densest stage."""

    @property
    def label(self) -> str:
        """Name, with a star if the value refers to the densest stage."""
        return f"{self.name} *" if self.at_stage else self.name

    @property
    def ratios(self) -> tuple[float, ...]:
        """Ratios to the value of the first run; nan if that is 0 or missing."""
        first = self.values[0]
        return tuple(value / first if first else float("nan") for value in self.values)


def densest_stage(runs: Sequence[VariantRun]) -> str:
    """Stage at the end of which the first complete run has the most contacts.

    Only stages with rows in all complete runs qualify: a stage that waits for rest may end before its first row.
    """
    finished = [run for run in runs if not run.stopped] or list(runs[:1])
    columns = finished[0].columns
    ends = {stage: count for stage, count in zip(columns["stage"].tolist(), columns["contact_count"], strict=True)}
    shared = [stage for stage in ends if all(stage in run.columns["stage"] for run in finished)]
    return max(shared or list(ends), key=lambda stage: ends[stage])


def summary(runs: Sequence[VariantRun]) -> list[SummaryRow]:
    """All rows with a finite value of at least one run: cost, flow, bed, contacts, energies."""
    stage = densest_stage(runs)
    rows = [*_cost(runs), *_flow(runs), *_bed(runs, stage), *_contacts(runs), *_energies(runs)]
    return [row for row in rows if np.isfinite(row.values).any()]


def _row(
    runs: Sequence[VariantRun], name: str, unit: str, number: Callable[[VariantRun], float], display: str = ""
) -> SummaryRow:
    """One row with the value of `number` for each run; `display` is a key of DISPLAY_UNITS or empty.

    `unit`: SI unit of the value.
    """
    values = tuple(float(number(run)) for run in runs)
    return SummaryRow(name, unit, values, DISPLAY_UNITS[display] if display else (unit, 1.0))


def _cost(runs: Sequence[VariantRun]) -> list[SummaryRow]:
    """Rows on time step, steps and wall time."""
    return [
        _row(runs, "time step", "s", lambda run: run.plan.time_step, "time"),
        _row(runs, "simulated time", "s", lambda run: run.time),
        _row(runs, "steps needed", "", lambda run: run.step_count),
        _row(runs, "wall time of steps", "s", lambda run: run.seconds),
        _row(runs, "wall time per step", "s", lambda run: run.seconds / max(run.step_count, 1), "time"),
        _row(runs, "compilation", "s", lambda run: run.compile_seconds),
    ]


def _flow(runs: Sequence[VariantRun]) -> list[SummaryRow]:
    """Rows on the mass flow rate through each meter."""

    def flow(meter: str) -> Callable[[VariantRun], float]:
        return lambda run: run.mass_flow(meter)

    return [_row(runs, f"mass flow rate, {meter}", "kg/s", flow(meter)) for meter in runs[0].meters]


def at_end(stage: str, name: str) -> Callable[[VariantRun], float]:
    """Function that returns the value of a column at the end of a stage; nan if a run did not complete the stage."""

    def number(run: VariantRun) -> float:
        row = run.at_end_of(stage)
        return float("nan") if row is None else float(run.columns[name][row])

    return number


def _bed(runs: Sequence[VariantRun], stage: str) -> list[SummaryRow]:
    """Rows on the bed at the end of the densest stage.

    Heights are those of the sample nearest to that time.
    """
    when = at_end(stage, "time")

    def height(column: int) -> Callable[[VariantRun], float]:
        def number(run: VariantRun) -> float:
            nearest = int(np.argmin(np.abs(run.heights[:, 0] - when(run)))) if np.isfinite(when(run)) else None
            return float("nan") if nearest is None else float(run.heights[nearest, column])

        return number

    rows = [
        _row(runs, "end of stage", "s", when),
        _row(runs, "center of mass", "m", height(1), "length"),
        _row(runs, "surface", "m", height(2), "length"),
        _row(runs, "coordination number", "", at_end(stage, "coordination_number")),
        _row(runs, "mean overlap/radius", "", at_end(stage, "overlap_mean"), "share"),
        _row(runs, f"contacts above {STRONG:g} <f>", "", lambda run: run.forces.share_above(stage, STRONG), "share"),
    ]
    return [replace(row, at_stage=True) for row in rows]


def _contacts(runs: Sequence[VariantRun]) -> list[SummaryRow]:
    """Rows on the contacts of the complete run."""
    return [
        _row(runs, "maximum overlap/radius", "", lambda run: np.nanmax(run.columns["overlap_largest"]), "share"),
        _row(runs, "median contact duration", "s", lambda run: run.median_duration, "time"),
    ]


def _energies(runs: Sequence[VariantRun]) -> list[SummaryRow]:
    """Rows on the energies at the end of the run; rows of zeros are omitted."""
    names = {
        "kinetic energy, end": "kinetic_energy",
        "lost: plastic": "plastic_dissipation",
        "lost: friction": "friction_dissipation",
        "lost: rolling": "rolling_dissipation",
        "lost: damping": "damping_dissipation",
    }

    def last(name: str) -> Callable[[VariantRun], float]:
        return lambda run: run.columns[name][-1]

    rows = [_row(runs, label, "J", last(name), "energy_budget") for label, name in names.items()]
    error = _row(runs, "energy error, end", "", lambda run: abs(run.columns["energy_error"][-1]), "share")
    return [*(row for row in rows if any(row.values)), error]


def heads(runs: Sequence[VariantRun]) -> list[str]:
    """Column headings of the table; titles of several words use two lines."""
    first, *others = (run.variant.title.replace(" ", "\n", 1) for run in runs)
    return ["", "unit", first, *(head for title in others for head in (title, "ratio"))]


def as_text(rows: Sequence[SummaryRow]) -> list[list[str]]:
    """Cells of the table: value of the first contact model, then value and ratio of each other."""
    found = []
    for row in rows:
        unit, factor = row.display
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
        "unit": np.repeat([row.unit for row in rows], len(laws)),
        "law": np.tile(laws, len(rows)),
        "value": np.array([value for row in rows for value in row.values]),
        "ratio": np.array([ratio for row in rows for ratio in row.ratios]),
    }


def _number(value: float) -> str:
    """Text of a value, or a dash for nan."""
    return readable(value) if np.isfinite(value) else MISSING
