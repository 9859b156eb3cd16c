"""`granflow accuracy` without a scene: measures all lines and writes CSV, figures and a page."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from granflow.errors import GranflowError
from granflow.studies.accuracy import axes
from granflow.studies.accuracy.axes import STUDIED_LAWS
from granflow.studies.accuracy.collisions import REPEATS
from granflow.studies.accuracy.figures import draw_convergence, draw_quantities, draw_work
from granflow.studies.accuracy.orders import fitted_order
from granflow.studies.accuracy.points import (
    QUANTITIES,
    QUANTITY_LABELS,
    StudyLine,
    columns,
    measured_line,
)
from granflow.studies.accuracy.recommend import default_sentence, recommendation, table_heads, table_rows, velocity_rows
from granflow.studies.figures import Drawing
from granflow.studies.page import write_study
from granflow.studies.tables import PageTable


@dataclass(frozen=True)
class TwoBodyStudy:
    """All measured lines, and descriptions of the rejected time steps."""

    lines: tuple[StudyLine, ...]
    refused: tuple[str, ...]
    target: float

    @property
    def recommendation(self) -> str:
        """Concluding sentence of the study."""
        return recommendation(self.lines, self.target)


def measure_two_bodies(
    target: float, full: bool = False, report: Callable[[str], None] = lambda text: None
) -> TwoBodyStudy:
    """Measure every combination.

    `target`: relative error of the restitution. `full`: more time steps and repeats. `report` receives progress
    messages.
    """
    counts = axes.FULL_STEPS if full else axes.STEPS
    repeats = 3 * REPEATS if full else REPEATS
    lines, refused = [], []
    for precision in axes.PRECISIONS:
        for studied_law in STUDIED_LAWS:
            report(f"{studied_law.name}, {precision}")
            line, problems = measured_line(studied_law, precision, counts, repeats, threads=1)
            lines.append(line)
            refused += problems
    return TwoBodyStudy(tuple(lines), tuple(dict.fromkeys(refused)), target)


def write_two_bodies(out: Path, study: TwoBodyStudy) -> None:
    """Write accuracy.csv with one row per point, and the page, with figures if matplotlib is installed.

    Raises GranflowError at the end if it is not, after all other files are written.
    """
    lines, target = study.lines, study.target
    missing = write_study(
        out / "accuracy.html",
        "accuracy.html",
        tables={"accuracy.csv": columns([point for line in lines for point in line.points])},
        figures={
            "accuracy.png": Drawing(draw_work(lines, target), 6.4),
            "accuracy_convergence.png": Drawing(draw_convergence(lines, target), 3.0),
            "accuracy_quantities.png": Drawing(draw_quantities(lines), 8.4),
        },
        study=study,
        axes=axes,
        target=f"{100.0 * target:g}",
        default=default_sentence(lines, target),
        requirements=PageTable(table_heads(target), table_rows(lines, target)),
        by_velocity=PageTable(*velocity_rows(lines, target)),
        orders=_orders(lines),
    )
    if missing:
        raise GranflowError(missing)


def _orders(lines: Sequence[StudyLine]) -> PageTable:
    """Table of the fitted orders of all errors."""
    rows = []
    for line in lines:
        orders = [fitted_order(line.steps, line.error(quantity)) for quantity in QUANTITIES]
        rows.append((line.law, line.precision, *(order.text if order else "–" for order in orders)))
    heads = ("contact model", "precision", *(QUANTITY_LABELS[quantity] for quantity in QUANTITIES))
    return PageTable(heads, rows)
