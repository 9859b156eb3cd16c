"""`granflow accuracy` without a scene: measure all lines, write CSV, figures and a page."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from granflow.device.backend import Precision
from granflow.errors import GranflowError
from granflow.study.accuracy.axes import (
    DISTANCE,
    FULL_STEPS,
    INTEGRATORS,
    PHASES,
    PRECISIONS,
    RESTITUTIONS,
    STEPS,
    STUDIED_LAWS,
    VELOCITIES,
    YOUNG_MODULUS,
    StudiedLaw,
)
from granflow.study.accuracy.collisions import REPEATS
from granflow.study.accuracy.figures import QUANTITY_HEIGHT, WORK_HEIGHT, draw_quantities, draw_work
from granflow.study.accuracy.orders import fitted_order
from granflow.study.accuracy.points import QUANTITIES, WORDS, StudyLine, columns, line_in_process, spare_process
from granflow.study.accuracy.recommend import (
    default_sentence,
    recommendation,
    table_heads,
    table_rows,
    velocity_rows,
)
from granflow.study.figures import draw_to, require_plotting, write_columns
from granflow.study.page import Page, PageTable, Picture, Section, write_page

PAGE = "accuracy.html"
POINTS = "accuracy.csv"
WORK, ERRORS = "accuracy.png", "accuracy_quantities.png"

LEAD = (
    "What accuracy costs: collisions of two beads under every law, integrator and precision with time steps over three "
    "decades, against the exact solution, and the wall time they took."
)


@dataclass(frozen=True)
class TwoBodyStudy:
    """All lines measured, and what was refused."""

    lines: tuple[StudyLine, ...]
    refused: tuple[str, ...]
    target: float

    @property
    def recommendation(self) -> str:
        """The sentence that the study ends in."""
        return recommendation(self.lines, self.target)


def measure_two_bodies(
    target: float,
    full: bool = False,
    report: Callable[[str], None] = lambda words: None,
    studied_laws: Sequence[StudiedLaw] = STUDIED_LAWS,
    precisions: Sequence[Precision] = PRECISIONS,
    steps: Sequence[float] | None = None,
) -> TwoBodyStudy:
    """Measure every combination, each precision in a process of its own; `full` takes more steps and repeats."""
    counts = steps or (FULL_STEPS if full else STEPS)
    repeats = 3 * REPEATS if full else REPEATS
    lines, refused = [], []
    for precision in precisions:
        with spare_process() as process:
            for studied_law in studied_laws:
                for integrator in INTEGRATORS:
                    report(f"{studied_law.name}, {integrator.name}, {precision}")
                    order = (studied_law, integrator, precision, counts, repeats)
                    line, problems = process.submit(line_in_process, *order).result()
                    lines.append(line)
                    refused += problems
    return TwoBodyStudy(tuple(lines), tuple(dict.fromkeys(refused)), target)


def write_two_bodies(out: Path, study: TwoBodyStudy) -> None:
    """Write CSV and page, with figures where matplotlib is installed; raises GranflowError at the end where not."""
    out.mkdir(parents=True, exist_ok=True)
    write_columns(out / POINTS, columns([point for line in study.lines for point in line.points]))
    missing = _draw(out, study)
    write_page(_page(out, study, has_figures=missing is None), out / PAGE)
    if missing is not None:
        raise missing


def _draw(out: Path, study: TwoBodyStudy) -> GranflowError | None:
    """Both figures; what is missing to draw them."""
    try:
        require_plotting()
    except GranflowError as error:
        return error
    draw_to(out / WORK, draw_work(study.lines, study.target), WORK_HEIGHT)
    draw_to(out / ERRORS, draw_quantities(study.lines), QUANTITY_HEIGHT)
    return None


def _page(out: Path, study: TwoBodyStudy, has_figures: bool) -> Page:
    lines, target = study.lines, study.target
    rows = table_rows(lines, target)
    table_of_requirements = PageTable("What every combination reaches and needs.", table_heads(target), rows)
    heads, by_velocity = velocity_rows(lines, target)
    velocity_table = PageTable(f"Steps a collision for {100.0 * target:g} % by approach velocity.", heads, by_velocity)
    work: list[str | PageTable | Picture] = [study.recommendation, default_sentence(lines, target)]
    errors: list[str | PageTable | Picture] = []
    if has_figures:
        caption = (
            "Largest error of the restitution over all collisions of a line, (a) against the wall time of a "
            f"collision on one core, median of {lines[0].points[0].repeats} timings, (b) against the time step, with "
            f"the orders fitted in double precision. Errors below 1e-9 are drawn there. Dotted: {100.0 * target:g} %."
        )
        work.append(Picture(out / WORK, caption, (WORK, POINTS)))
        errors.append(Picture(out / ERRORS, "All errors in double precision, with fitted orders.", (ERRORS,)))
    return Page(
        "Error against run time",
        LEAD,
        [
            Section("Work and precision", [*work, table_of_requirements]),
            Section(
                "Slow impacts in single precision",
                [
                    "A slow impact overlaps little, and an overlap is a small difference of large numbers: that, "
                    "and not the "
                    "time step, bounds single precision; with very short steps, "
                    "positions no longer change at all.",
                    velocity_table,
                ],
            ),
            Section("Duration, overlap and energy", [*errors, _orders_table(lines)]),
            Section("How this was computed", [_method(), *_refused(study)]),
        ],
    )


def _orders_table(lines: Sequence[StudyLine]) -> PageTable:
    rows = []
    for line in lines:
        orders = [fitted_order(line.steps, line.error(quantity)) for quantity in QUANTITIES]
        rows.append((line.law, line.integrator, line.precision, *(order.words if order else "–" for order in orders)))
    heads = ("law", "integrator", "precision", *(WORDS[quantity] for quantity in QUANTITIES))
    caption = (
        "Orders of convergence, in brackets the steps a collision between which they were fitted; a dash where "
        "errors do not fall over enough points."
    )
    return PageTable(caption, heads, rows)


def _method() -> str:
    return (
        f"Pairs of equal beads of glass, softened to {YOUNG_MODULUS / 1e6:g} MPa as in the scenes that ship, meet "
        f"head on at {', '.join(f'{v:g}' for v in VELOCITIES)} m/s with restitutions of "
        f"{', '.join(f'{e:g}' for e in RESTITUTIONS)} (1 for the elastic law), {PHASES} times each, first touching at "
        "times spread evenly over a step, so that no lucky phase flatters. They stand side by side in one scene, "
        f"{1e3 * DISTANCE:g} mm from the origin, and are as large as makes all collisions last equally long. An "
        "error is the root mean square over the phases; a line shows the largest of all its collisions. That of the "
        "energy is of the share of the energy kept. Exact: Zhou (2011), Eqs. 5 and 13-15; the oscillator let go at "
        "zero force (Schwager & Poeschel 2007), onto which Hertz with Tsuji's damping is mapped (Antypov & Elliott "
        "2011). Largest overlap: between steps by a parabola. Wall time: of the steps of one duration, on one "
        "thread, after compiling, shared among all pairs; below some thirty steps, starting the kernels shows."
    )


def _refused(study: TwoBodyStudy) -> list[str]:
    if not study.refused:
        return []
    return [f"Left out as not stable, by the bound that `granflow check` uses: {'; '.join(study.refused)}."]
