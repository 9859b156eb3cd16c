"""`granflow stability`: runs all cases in worker processes; writes `stability.csv`, a heat map and a page."""

import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from math import nan
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from granflow import start
from granflow.studies.figures import FULL_WIDTH, Drawing, PageTable, attribute_columns, percent
from granflow.studies.page import write_study
from granflow.studies.stability.cases import (
    ACCURATE,
    BOUNDS,
    MANY,
    SILENT_LIMIT,
    SIZES,
    STEPS,
    STIFFNESS,
    UNEQUAL,
    CaseOutcome,
    CaseResult,
    StabilityCase,
    all_cases,
    case_outcome,
    run_case,
)

PAGE = "stability.html"
HEADS = ("family", "cases", "accurate", "error reported", "refused", "defects", "largest error")
"""Column headings of `summary_rows`."""
Report = Callable[[CaseOutcome], None]
"""Function that receives each outcome."""
EXPLANATIONS = {
    STEPS: (
        "Pairs of particles (E 100 MPa, diameter 2 mm, 1 m/s) collide head-on with Zhou's contact model for "
        "each target restitution, at time steps from 1 % to 500 % of the largest permitted one. The limit of "
        "the unloading tangent bounds the restitution from below at a given time step, with a warning; a "
        "scene with a time step above the limit is refused."
    ),
    STIFFNESS: (
        "A pair with the e(v) of stainless steel (Eq. 12; limit velocity 340 m/s), Young's moduli from "
        "rubber to beyond diamond, at the automatic time step. Above the limit velocity Eq. 12 gives e = 0. "
        "Soft particles at high velocity would pass through each other: the run aborts."
    ),
    SIZES: "Particle radii from a micrometer to a meter (e 0.7, 1 m/s) in each precision.",
    UNEQUAL: (
        "A particle against another of up to 100 times its size and up to a million times its density. The "
        "assessment refers to the restitution and the conservation of momentum."
    ),
    MANY: (
        "A particle below another of a million times its mass, and a column of 100 particles: from "
        "equilibrium, the floor must carry exactly the weight for 20 000 steps. The energy budget must be "
        "balanced for a bed of 64 particles compressed by a lid, two particles with an initial overlap of 50 "
        "%, a particle that hits a bed at 1 km/s, friction 0 and 10, two colliding clouds without gravity, "
        "and a floor that vibrates at 100 g. An initial overlap stores energy; numerics.max_overlap limits "
        "it. Without this limit the particles must separate with the energy that the contact model returns."
    ),
    BOUNDS: (
        "Particles with the overlap that the check assumes get a small perturbation. A bisection to 2 % "
        "finds the time step at which the perturbation grows, for one particle between 2, 6 or 12 fixed "
        "particles, a straight chain of 10 free particles, and a densely packed block. The number is this "
        "measured limit over the limit of the check for the same particles. Below 1 the check accepts "
        "unstable time steps; above 2 it is too conservative."
    ),
}
"""Paragraph of the page for each family."""


def stability(out: Path, full: bool, report: Report) -> tuple[list[CaseOutcome], str]:
    """Run all cases and write all files; returns the outcomes, and a sentence if the figure is missing, else
    ""."""
    outcomes = run_cases(all_cases(full), report)
    return outcomes, write_stability(out, outcomes)


def write_stability(out: Path, outcomes: Sequence[CaseOutcome]) -> str:
    """Write CSV, heat map and page; without matplotlib, skip the heat map and return a sentence.

    The CSV has one row per case and one column per field of CaseOutcome; the assessment is in the column
    `verdict`.
    """
    columns = attribute_columns(outcomes, (field.name for field in fields(CaseOutcome)))
    columns["verdict"] = columns.pop("assessment")  # the name of the column in earlier versions
    return write_study(
        out / PAGE,
        "stability.html",
        tables={"stability.csv": columns},
        figures={"stability.png": heatmap(outcomes)},
        headline=headline(outcomes),
        accurate=ACCURATE,
        silent_limit=SILENT_LIMIT,
        summary=PageTable(HEADS, summary_rows(outcomes)),
        families=list(_families(outcomes)),
    )


def headline(outcomes: Sequence[CaseOutcome]) -> str:
    """Summary in two sentences."""
    counts = Counter(each.kind for each in outcomes)
    ratios = [each.reached for each in outcomes if each.family == BOUNDS and np.isfinite(each.reached)]
    between = (
        f" The measured stability limit is {min(ratios):.2f} to {max(ratios):.2f} times the limit of the "
        "check."
        if ratios
        else ""
    )
    return (
        f"Of {len(outcomes)} stiff and extreme cases {counts['accurate']} are stable and accurate within "
        f"{percent(ACCURATE)}, {counts['error']} stable with a reported error, {counts['refused']} refused "
        f"with a message, {counts['defect']} defects.{between}"
    )


def defects(outcomes: Sequence[CaseOutcome]) -> list[str]:
    """One line per defect."""
    return [
        f"{each.family}: {each.row}, {each.column}: {each.assessment}"
        for each in outcomes
        if each.kind == "defect"
    ]


def summary_rows(outcomes: Sequence[CaseOutcome]) -> list[tuple[str, ...]]:
    """One row per family with the cells of HEADS, and one for all cases."""
    return [_summary(name, group) for name, group in {**_by_family(outcomes), "all": outcomes}.items()]


def _summary(name: str, outcomes: Sequence[CaseOutcome]) -> tuple[str, ...]:
    """Row of the summary table for a group of cases."""
    counts = Counter(each.kind for each in outcomes)
    errors = [each.error for each in outcomes if np.isfinite(each.error)]
    worst = percent(max(errors)) if errors else ""
    kinds = (str(counts[kind]) for kind in ("accurate", "error", "refused", "defect"))
    return (name, str(len(outcomes)), *kinds, worst)


def _by_family(outcomes: Sequence[CaseOutcome]) -> dict[str, list[CaseOutcome]]:
    """Outcomes of each family, in their order."""
    found: dict[str, list[CaseOutcome]] = {}
    for each in outcomes:
        found.setdefault(each.family, []).append(each)
    return found


def _families(outcomes: Sequence[CaseOutcome]) -> Iterator[tuple[str, str, PageTable]]:
    """Title, explanation and table of each family."""
    for family, group in _by_family(outcomes).items():
        rows = [
            (
                each.row,
                each.column,
                *map(_shown, (each.expected, each.reached, each.time_step)),
                each.assessment,
            )
            for each in group
        ]
        is_common = len({each.reference for each in group}) == 1
        reference = group[0].reference if is_common else "the reference of each case"
        heads = ("", "case", "expected", "reached", "time step (s)", "assessment")
        table = PageTable(heads, rows, f"Measured against {reference}.")
        yield family[0].upper() + family[1:], EXPLANATIONS[family], table


def _shown(number: float) -> str:
    """Number with four digits; empty for nan."""
    return f"{number:.4g}" if np.isfinite(number) else ""


# ---------------------------------------------------------------- worker processes
#
# Each has one start of Taichi; a case has a time limit.

WORKER_COUNT = 2
"""Number of processes."""
TIMEOUT = 180.0
"""Time limit per case [s]."""


def run_cases(cases: Sequence[StabilityCase], report: Report, timeout: float = TIMEOUT) -> list[CaseOutcome]:
    """Outcomes of all cases, in the order of the cases; `report` receives each outcome on completion.

    Cases of one family and precision run in one process and share cached results. `timeout` [s] applies to
    each case. A crash or timeout is a defect of its case and does not end the study.
    """
    with ThreadPoolExecutor(WORKER_COUNT) as executor:
        parts = executor.map(lambda batch: _run_batch(batch, report, timeout), _batches(cases))
        found = {(each.family, each.row, each.column): each for part in parts for each in part}
    return [found[case.family, case.row, case.column] for case in cases]


def _batches(cases: Sequence[StabilityCase]) -> list[list[StabilityCase]]:
    """Batches of cases with equal family and precision."""
    batches: dict[tuple[str, str], list[StabilityCase]] = {}
    for case in cases:
        batches.setdefault((case.family, case.precision), []).append(case)
    return list(batches.values())


def _run_batch(batch: list[StabilityCase], report: Report, timeout: float) -> list[CaseOutcome]:
    """Run the cases of a batch; after a timeout or a crash the remaining cases run in a new process."""
    found: list[CaseOutcome] = []
    while len(found) < len(batch):
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_run_in_worker, args=(there, batch[len(found) :]), daemon=True)
        process.start()
        there.close()
        found += _receive(here, batch[len(found) :], report, timeout)
        process.kill()
        process.join()
    return found


def _receive(
    pipe: Connection, cases: list[StabilityCase], report: Report, timeout: float
) -> list[CaseOutcome]:
    """Receive outcomes up to the first case without a result."""
    found: list[CaseOutcome] = []
    for case in cases:
        reason = ""
        if not pipe.poll(timeout):
            reason = f"not finished in {timeout:g} s"
        else:
            try:
                found.append(pipe.recv())
            except EOFError:
                reason = "the process ended without a result"
        if reason:
            found.append(
                case_outcome(case, CaseResult("", nan, nan, nan, nan), timeout, "defect", f"defect: {reason}")
            )
        report(found[-1])
        if reason:
            break
    return found


def _run_in_worker(pipe: Any, cases: Sequence[StabilityCase]) -> None:
    """Worker process: start Taichi, run the cases and send each outcome."""
    start("cpu", cases[0].precision, 1)  # type: ignore[arg-type]
    for case in cases:
        pipe.send(run_case(case))


# ---------------------------------------------------------------- heat map
#
# One grid per family, one cell per case, colored by assessment and error.

SMALLEST, LARGEST = 1e-5, 1.0
"""Range of errors of the color scale."""
REFUSED, DEFECT = (0.85, 0.85, 0.87), (0.80, 0.05, 0.10)
"""Colors of refused cases and of defects (red, green, blue; 0 to 1)."""
GREENS, OCHRES = "YlGn_r", "YlOrBr"
"""Color maps of accurate cases and of cases with an error."""
PANELS = ((STEPS, STEPS), (STIFFNESS, SIZES), (STIFFNESS, UNEQUAL), (MANY, MANY), (BOUNDS, BOUNDS))
"""Families by row of the figure; a repeated family spans two columns."""
HEIGHTS = (3.4, 1.3, 1.3, 1.6, 4.2)
"""Relative heights of the rows of panels."""
TITLES = {
    STEPS: "Target restitution (rows) against time step over the largest permitted one (columns)",
    STIFFNESS: "Young's modulus and impact velocity, Eq. 12",
    SIZES: "Size and precision",
    UNEQUAL: "Unequal partners",
    MANY: "Many particles, three contact models",
    BOUNDS: "Measured stability limit of the time step over the limit of the check (required: 1 to 2)",
}
"""Titles of the panels by family."""


def heatmap(outcomes: Sequence[CaseOutcome]) -> Drawing:
    """Drawing of all families."""
    return Drawing(lambda figure: _draw(figure, outcomes), 8.6, FULL_WIDTH)


def _draw(figure: Any, outcomes: Sequence[CaseOutcome]) -> None:
    """Draw one panel per family, and the legend."""
    from matplotlib.patches import Patch

    axes = figure.subplot_mosaic([list(row) for row in PANELS], height_ratios=HEIGHTS)
    for family, axis in axes.items():
        _panel(axis, [each for each in outcomes if each.family == family])
        axis.set_title(TITLES[family])
    colors = [(_color("accurate", 1e-4), "within 1 %"), (_color("error", 0.1), "stable, error reported")]
    colors += [(REFUSED, "refused with a message"), (DEFECT, "defect")]
    patches = [Patch(facecolor=color, edgecolor="0.4", linewidth=0.4, label=label) for color, label in colors]
    figure.legend(handles=patches, loc="outside lower center", ncols=4)


def _panel(axis: Any, outcomes: Sequence[CaseOutcome]) -> None:
    """Draw the grid of one family with one cell per case."""
    rows = list(dict.fromkeys(each.row for each in outcomes))
    columns = list(dict.fromkeys(each.column for each in outcomes))
    colors = np.ones((max(len(rows), 1), max(len(columns), 1), 3))
    for each in outcomes:
        cell = rows.index(each.row), columns.index(each.column)
        colors[cell] = _color(each.kind, each.error)
        axis.text(cell[1], cell[0], _cell_text(each), ha="center", va="center", fontsize=5.5)
    axis.imshow(colors, aspect="auto", interpolation="nearest")
    axis.set_xticks(range(len(columns)), [_split(column) for column in columns], fontsize=5.5)
    axis.set_yticks(range(len(rows)), rows, fontsize=6.0)
    axis.minorticks_off()
    axis.tick_params(length=0.0)


def _split(label: str) -> str:
    """Split a long label into two lines."""
    words = label.split(" ")
    middle = len(label) // 2
    if len(label) < 12 or len(words) == 1:
        return label
    cuts = range(1, len(words))
    cut = min(cuts, key=lambda n: abs(len(" ".join(words[:n])) - middle))
    return " ".join(words[:cut]) + "\n" + " ".join(words[cut:])


def _cell_text(each: CaseOutcome) -> str:
    """Text of a cell: ratio of stability limits, error, or kind of assessment."""
    if each.kind == "refused" or not np.isfinite(each.error):
        return each.kind
    return f"{each.reached:.2f}" if each.family == BOUNDS else percent(each.error)


def _color(kind: str, error: float) -> Any:
    """Color of a cell by kind of assessment and error."""
    from matplotlib import colormaps

    if kind in ("refused", "defect"):
        return REFUSED if kind == "refused" else DEFECT
    share = np.log(np.clip(error, SMALLEST, LARGEST) / SMALLEST) / np.log(LARGEST / SMALLEST)
    if kind == "accurate":
        return colormaps[GREENS](0.45 + 0.5 * share)[:3]
    return colormaps[OCHRES](0.7 * share - 0.2)[:3]
