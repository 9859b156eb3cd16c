"""`granflow accuracy` without a scene: measures all lines and writes CSV, figures and a page."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from granflow.errors import GranflowError
from granflow.studies.accuracy.axes import (
    DISTANCE,
    FULL_STEPS,
    INTEGRATOR,
    PHASES,
    PRECISIONS,
    RESTITUTIONS,
    STEPS,
    STUDIED_LAWS,
    VELOCITIES,
    YOUNG_MODULUS,
    StudiedLaw,
)
from granflow.studies.accuracy.collisions import REPEATS
from granflow.studies.accuracy.figures import QUANTITY_HEIGHT, WORK_HEIGHT, draw_quantities, draw_work
from granflow.studies.accuracy.orders import fitted_order
from granflow.studies.accuracy.points import (
    QUANTITIES,
    QUANTITY_LABELS,
    StudyLine,
    columns,
    measured_line,
    worker_process,
)
from granflow.studies.accuracy.recommend import default_sentence, recommendation, table_heads, table_rows, velocity_rows
from granflow.studies.figures import draw_to, require_plotting, write_columns
from granflow.studies.page import Page, PageTable, Picture, Section, write_page

PAGE = "accuracy.html"
POINTS = "accuracy.csv"
"""CSV file with one row per point."""

WORK, ERRORS = "accuracy.png", "accuracy_quantities.png"
"""Figures of error against wall time, and of all errors."""


LEAD = (
    "Accuracy against cost: collisions of two particles for every contact model, integrator and precision, with time "
    "steps over three decades, compared with the exact solution, and their wall time."
)
"""First paragraph of the page."""


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
    target: float,
    full: bool = False,
    report: Callable[[str], None] = lambda text: None,
    studied_laws: Sequence[StudiedLaw] = STUDIED_LAWS,
    precisions: Sequence[str] = PRECISIONS,
    steps: Sequence[float] | None = None,
) -> TwoBodyStudy:
    """Measure every combination, each precision in a separate process.

    `target`: relative error of the restitution. `full`: more time steps and repeats. `report` receives progress
    messages. `steps`: numbers of steps per collision instead of the default ones. Raises GranflowError if a process
    dies.
    """
    counts = steps or (FULL_STEPS if full else STEPS)
    repeats = 3 * REPEATS if full else REPEATS
    lines, refused = [], []
    for precision in precisions:
        with worker_process() as process:
            for studied_law in studied_laws:
                report(f"{studied_law.name}, {INTEGRATOR}, {precision}")
                line, problems = process.submit(measured_line, studied_law, precision, counts, repeats, 1).result()
                lines.append(line)
                refused += problems
    return TwoBodyStudy(tuple(lines), tuple(dict.fromkeys(refused)), target)


def write_two_bodies(out: Path, study: TwoBodyStudy) -> None:
    """Write CSV and page, with figures if matplotlib is installed.

    Raises GranflowError at the end if it is not, after all other files are written.
    """
    out.mkdir(parents=True, exist_ok=True)
    write_columns(out / POINTS, columns([point for line in study.lines for point in line.points]))
    missing = _draw(out, study)
    write_page(_page(out, study, has_figures=missing is None), out / PAGE)
    if missing is not None:
        raise missing


def _draw(out: Path, study: TwoBodyStudy) -> GranflowError | None:
    """Draw both figures; returns the error if matplotlib is missing."""
    try:
        require_plotting()
    except GranflowError as error:
        return error
    draw_to(out / WORK, draw_work(study.lines, study.target), WORK_HEIGHT)
    draw_to(out / ERRORS, draw_quantities(study.lines), QUANTITY_HEIGHT)
    return None


def _page(out: Path, study: TwoBodyStudy, has_figures: bool) -> Page:
    """HTML page with recommendation, tables, figures and method."""
    lines, target = study.lines, study.target
    rows = table_rows(lines, target)
    table_of_requirements = PageTable("Accuracy and requirement of every combination.", table_heads(target), rows)
    heads, by_velocity = velocity_rows(lines, target)
    velocity_table = PageTable(
        f"Steps per collision for {100.0 * target:g} % by approach velocity.", heads, by_velocity
    )
    work: list[str | PageTable | Picture] = [study.recommendation, default_sentence(lines, target)]
    errors: list[str | PageTable | Picture] = []
    if has_figures:
        caption = (
            "Largest restitution error over all collisions of a line, (a) against the wall time per "
            f"collision on one core, median of {lines[0].points[0].repeats} timings, (b) against the time step, with "
            f"the orders fitted in double precision. Errors below 1e-9 are drawn at 1e-9. Dotted: {100.0 * target:g} %."
        )
        work.append(Picture(out / WORK, caption, (WORK, POINTS)))
        errors.append(
            Picture(out / ERRORS, "All errors in double precision, with fitted orders of convergence.", (ERRORS,))
        )
    return Page(
        "Error against run time",
        LEAD,
        [
            Section("Work and precision", [*work, table_of_requirements]),
            Section(
                "Slow impacts in single precision",
                [
                    "The overlap is a small difference of large numbers, and smallest in a slow impact. The "
                    "resolution of the overlap, not the "
                    "time step, limits the accuracy of single precision; with very short time steps, "
                    "positions do not change at all.",
                    velocity_table,
                ],
            ),
            Section("Duration, overlap and energy", [*errors, _orders_table(lines)]),
            Section("How this was computed", [_method(), *_refused(study)]),
        ],
    )


def _orders_table(lines: Sequence[StudyLine]) -> PageTable:
    """Table of the fitted orders of all errors."""
    rows = []
    for line in lines:
        orders = [fitted_order(line.steps, line.error(quantity)) for quantity in QUANTITIES]
        rows.append((line.law, line.integrator, line.precision, *(order.text if order else "–" for order in orders)))
    heads = ("contact model", "integrator", "precision", *(QUANTITY_LABELS[quantity] for quantity in QUANTITIES))
    caption = (
        "Orders of convergence; in parentheses the range of steps per collision of the fit; a dash where "
        "the errors decrease over too few points."
    )
    return PageTable(caption, heads, rows)


def _method() -> str:
    """Description of the collisions, errors, exact solutions and timings."""
    return (
        f"Pairs of equal glass particles, softened to {YOUNG_MODULUS / 1e6:g} MPa as in the example scenes, collide "
        f"head-on at {', '.join(f'{v:g}' for v in VELOCITIES)} m/s with restitutions of "
        f"{', '.join(f'{e:g}' for e in RESTITUTIONS)} (1 for the elastic model), {PHASES} times each, with times of "
        "first contact evenly spaced over one step, so that no phase biases the result. All pairs are in one scene, "
        f"{1e3 * DISTANCE:g} mm from the origin; their diameters make all collisions last equally long. An "
        "error is the root mean square over the phases; a line shows the largest error of all its collisions. The "
        "energy error refers to the retained share of the energy. Exact solutions: Zhou (2011), Eqs. 5 and 13-15; "
        "the oscillator until zero force (Schwager & Poeschel 2007), onto which Hertz with Tsuji's damping is mapped "
        "(Antypov & Elliott 2011). Maximum overlap: parabola through the samples. Wall time: steps of one duration, "
        "on one thread, after compilation, divided by the number of pairs; below about thirty steps, kernel launches "
        "contribute noticeably."
    )


def _refused(study: TwoBodyStudy) -> list[str]:
    """Sentence on the time steps that were rejected as unstable; empty without one."""
    if not study.refused:
        return []
    return [f"Omitted because unstable by the limit of `granflow check`: {'; '.join(study.refused)}."]
