"""The study in files: `stability.csv`, the heat map, and a page that explains both."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from granflow.errors import GranflowError
from granflow.study.figures import write_columns
from granflow.study.page import Page, PageTable, Picture, Section, write_page
from granflow.study.stability.case_families import BOUNDS, MANY, SIZES, STEPS, STIFFNESS, UNEQUAL, all_cases
from granflow.study.stability.cases import ACCURATE, NOT_OWNED, CaseOutcome, percent
from granflow.study.stability.heatmap import write_heatmap
from granflow.study.stability.worker_pool import Report, run_cases

PAGE, CSV, HEATMAP = "stability.html", "stability.csv", "stability.png"
HEADS = ("family", "cases", "accurate", "error said", "refused", "defects", "largest error")

EXPLANATIONS = {
    STEPS: "Pairs of spheres (E 100 MPa, diameter 2 mm, 1 m/s) meet head on under Zhou's law with each restitution, at "
    "time steps from 1 % of the largest that is allowed to 5 times it. The bound on the unloading tangent lets a step "
    "reach no restitution below a known one, of which the run warns; above the allowed step the scene is refused.",
    STIFFNESS: "A pair of stainless steel's e(v) (Eq. 12; limit velocity 340 m/s) with Young's moduli from rubber to "
    "beyond diamond, at the step that granflow chooses. Above the limit velocity Eq. 12 asks for e = 0. Soft spheres "
    "at high speed would pass through each other: a guard stops the run.",
    SIZES: "Spheres from a micrometer to a meter (e 0.7, 1 m/s) in each precision.",
    UNEQUAL: "A sphere against one up to 100 times as large and of up to a million times its density. Judged are the "
    "restitution and the momentum, which must not change.",
    MANY: "A grain under another of a million times its mass, and a column of 100: placed where their forces balance, "
    "they must go on carrying exactly their weight for 20 000 steps. A bed of 64 grains squeezed by a lid, two grains "
    "made half inside each other, a grain shot into a bed at 1 km/s, friction 0 and 10, two clouds that meet without "
    "gravity, and a floor that shakes at 100 g: judged by the energy ledger, which must find again all energy that "
    "came in. Grains made overlapping come with the energy of their overlap; the guard refuses them, and with the "
    "guard off they part with what their law gives back and no more.",
    BOUNDS: "Grains pressed to the overlap that the check reckons with are nudged, and the step is raised, by "
    "bisection to 2 %, until the nudge grows: a grain held between 2, 6 or 12 immovable others, a straight chain of "
    "10 free grains, and a block of densest packing. The number is that real bound over the step that the check allows "
    "for the same grains. Below 1 the check would let through a step that is not stable; above 2 it is too careful.",
}


def stability(out: Path, full: bool, report: Report) -> tuple[list[CaseOutcome], str]:
    """Run all cases and write everything; returns the outcomes and a sentence where a figure is missing, else ""."""
    outcomes = run_cases(all_cases(full), report)
    return outcomes, write_stability(out, outcomes)


def write_stability(out: Path, outcomes: Sequence[CaseOutcome]) -> str:
    """Write CSV, heat map and page; without matplotlib all but the heat map, and a sentence that says so."""
    out.mkdir(parents=True, exist_ok=True)
    names = [field.name for field in fields(CaseOutcome)]
    write_columns(out / CSV, {name: np.array([getattr(each, name) for each in outcomes]) for name in names})
    missing = ""
    try:
        write_heatmap(out / HEATMAP, outcomes)
    except GranflowError as error:
        missing = str(error)
    write_page(_page(out, outcomes, not missing), out / PAGE)
    return missing


def summary_rows(outcomes: Sequence[CaseOutcome]) -> list[tuple[str, ...]]:
    """One row a family, cells as HEADS says, and one for all."""
    families = dict.fromkeys(each.family for each in outcomes)
    rows = [_summary(family, [each for each in outcomes if each.family == family]) for family in families]
    return [*rows, _summary("all", outcomes)]


def _summary(name: str, outcomes: Sequence[CaseOutcome]) -> tuple[str, ...]:
    counts = Counter(each.kind for each in outcomes)
    errors = [each.error for each in outcomes if np.isfinite(each.error)]
    worst = percent(max(errors)) if errors else ""
    kinds = (str(counts[kind]) for kind in ("accurate", "error", "refused", "defect"))
    return (name, str(len(outcomes)), *kinds, worst)


def defects(outcomes: Sequence[CaseOutcome]) -> list[str]:
    """A line for each defect."""
    return [f"{each.family}: {each.row}, {each.column}: {each.verdict}" for each in outcomes if each.kind == "defect"]


def headline(outcomes: Sequence[CaseOutcome]) -> str:
    """What came out, in two sentences."""
    counts = Counter(each.kind for each in outcomes)
    ratios = [each.reached for each in outcomes if each.family == BOUNDS and np.isfinite(each.reached)]
    between = (
        f" The real bound of the step is {min(ratios):.2f} to {max(ratios):.2f} times the check's." if ratios else ""
    )
    return (
        f"Of {len(outcomes)} stiff and extreme cases {counts['accurate']} are stable and accurate within "
        f"{percent(ACCURATE)}, {counts['error']} stable with an error that is said, {counts['refused']} refused with a "
        f"message, {counts['defect']} defects.{between}"
    )


def _page(out: Path, outcomes: Sequence[CaseOutcome], drawn: bool) -> Page:
    how = (
        "Every case is run to its end, in processes of their own. Its verdict: stable and accurate, with an error of "
        f"up to {percent(ACCURATE)}; stable, with the error and the number that is in error; refused, with the "
        "message that a user sees. A number that is none, a crash, a case that does not end, or an error beyond "
        f"{percent(NOT_OWNED)} of which nobody was warned, is a defect. Errors of restitution are over the velocity of "
        "approach: asked 0 and reached 0.015 is an error of 1.5 %."
    )
    table = PageTable("Cases by verdict.", HEADS, summary_rows(outcomes))
    parts: list[str | PageTable | Picture] = [how, table]
    if drawn:
        caption = "Every case: a row and a column of its family, the error, or the ratio of the bounds."
        parts.append(Picture(out / HEATMAP, caption, (HEATMAP, CSV)))
    sections = [Section("What came out", parts)]
    for family in dict.fromkeys(each.family for each in outcomes):
        of_family = [each for each in outcomes if each.family == family]
        sections.append(Section(family[0].upper() + family[1:], [EXPLANATIONS[family], _table(of_family)]))
    return Page("Stiff and extreme cases", headline(outcomes), sections)


def _table(outcomes: Sequence[CaseOutcome]) -> PageTable:
    rows = [
        (each.row, each.column, _figure(each.expected), _figure(each.reached), _figure(each.time_step), each.verdict)
        for each in outcomes
    ]
    reference = outcomes[0].reference if len({each.reference for each in outcomes}) == 1 else "what each case names"
    heads = ("", "case", "expected", "reached", "time step (s)", "verdict")
    return PageTable(f"Measured against {reference}.", heads, rows)


def _figure(number: float) -> str:
    return f"{number:.4g}" if np.isfinite(number) else ""
