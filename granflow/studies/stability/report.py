"""Output of the stability study: `stability.csv`, heat map and page."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from granflow.errors import GranflowError
from granflow.studies.figures import write_columns
from granflow.studies.page import Page, PageTable, Picture, Section, write_page
from granflow.studies.stability.case_families import BOUNDS, MANY, SIZES, STEPS, STIFFNESS, UNEQUAL, all_cases
from granflow.studies.stability.cases import ACCURATE, SILENT_LIMIT, CaseOutcome, percent
from granflow.studies.stability.heatmap import write_heatmap
from granflow.studies.stability.worker_pool import Report, run_cases

PAGE, CSV, HEATMAP = "stability.html", "stability.csv", "stability.png"
"""Names of page, CSV file and heat map."""

HEADS = ("family", "cases", "accurate", "error reported", "refused", "defects", "largest error")
"""Column headings of `summary_rows`."""


EXPLANATIONS = {
    STEPS: "Pairs of particles (E 100 MPa, diameter 2 mm, 1 m/s) collide head-on with Zhou's contact model for each "
    "target restitution, at time steps from 1 % to 500 % of the largest permitted one. The limit of the unloading "
    "tangent bounds the restitution from below at a given time step, with a warning; a scene with a time step above "
    "the limit is refused.",
    STIFFNESS: "A pair with the e(v) of stainless steel (Eq. 12; limit velocity 340 m/s), Young's moduli from rubber "
    "to beyond diamond, at the automatic time step. Above the limit velocity Eq. 12 gives e = 0. Soft particles at "
    "high velocity would pass through each other: the run aborts.",
    SIZES: "Particle radii from a micrometer to a meter (e 0.7, 1 m/s) in each precision.",
    UNEQUAL: "A particle against another of up to 100 times its size and up to a million times its density. The "
    "assessment refers to the restitution and the conservation of momentum.",
    MANY: "A particle below another of a million times its mass, and a column of 100 particles: from equilibrium, the "
    "floor must carry exactly the weight for 20 000 steps. The energy budget must be balanced for a bed of 64 "
    "particles compressed by a lid, two particles with an initial overlap of 50 %, a particle that hits a bed at "
    "1 km/s, friction 0 and 10, two colliding clouds without gravity, and a floor that vibrates at 100 g. An initial "
    "overlap stores energy; `numerics.max_overlap` limits it. Without this limit the particles must separate with "
    "the energy that the contact model returns.",
    BOUNDS: "Particles with the overlap that the check assumes get a small perturbation. A bisection to 2 % finds the "
    "time step at which the perturbation grows, for one particle between 2, 6 or 12 fixed particles, a straight chain "
    "of 10 free particles, and a densely packed block. The number is this measured limit over the limit of the check "
    "for the same particles. Below 1 the check accepts unstable time steps; above 2 it is too conservative.",
}
"""Paragraph of the page for each family."""


def stability(out: Path, full: bool, report: Report) -> tuple[list[CaseOutcome], str]:
    """Run all cases and write all files; returns the outcomes, and a sentence if the figure is missing, else ""."""
    outcomes = run_cases(all_cases(full), report)
    return outcomes, write_stability(out, outcomes)


def write_stability(out: Path, outcomes: Sequence[CaseOutcome]) -> str:
    """Write CSV, heat map and page; without matplotlib, skip the heat map and return a sentence.

    The CSV has one row per case and one column per field of CaseOutcome; the assessment is in the column `verdict`.
    """
    out.mkdir(parents=True, exist_ok=True)
    columns = {field.name: np.array([getattr(each, field.name) for each in outcomes]) for field in fields(CaseOutcome)}
    columns["verdict"] = columns.pop("assessment")  # the name of the column in earlier versions
    write_columns(out / CSV, columns)
    missing = ""
    try:
        write_heatmap(out / HEATMAP, outcomes)
    except GranflowError as error:
        missing = str(error)
    write_page(_page(out, outcomes, not missing), out / PAGE)
    return missing


def summary_rows(outcomes: Sequence[CaseOutcome]) -> list[tuple[str, ...]]:
    """One row per family with the cells of HEADS, and one for all cases."""
    families = dict.fromkeys(each.family for each in outcomes)
    rows = [_summary(family, [each for each in outcomes if each.family == family]) for family in families]
    return [*rows, _summary("all", outcomes)]


def _summary(name: str, outcomes: Sequence[CaseOutcome]) -> tuple[str, ...]:
    """Row of the summary table for a group of cases."""
    counts = Counter(each.kind for each in outcomes)
    errors = [each.error for each in outcomes if np.isfinite(each.error)]
    worst = percent(max(errors)) if errors else ""
    kinds = (str(counts[kind]) for kind in ("accurate", "error", "refused", "defect"))
    return (name, str(len(outcomes)), *kinds, worst)


def defects(outcomes: Sequence[CaseOutcome]) -> list[str]:
    """One line per defect."""
    return [
        f"{each.family}: {each.row}, {each.column}: {each.assessment}" for each in outcomes if each.kind == "defect"
    ]


def headline(outcomes: Sequence[CaseOutcome]) -> str:
    """Summary in two sentences."""
    counts = Counter(each.kind for each in outcomes)
    ratios = [each.reached for each in outcomes if each.family == BOUNDS and np.isfinite(each.reached)]
    between = (
        f" The measured stability limit is {min(ratios):.2f} to {max(ratios):.2f} times the limit of the check."
        if ratios
        else ""
    )
    return (
        f"Of {len(outcomes)} stiff and extreme cases {counts['accurate']} are stable and accurate within "
        f"{percent(ACCURATE)}, {counts['error']} stable with a reported error, {counts['refused']} refused with a "
        f"message, {counts['defect']} defects.{between}"
    )


def _page(out: Path, outcomes: Sequence[CaseOutcome], drawn: bool) -> Page:
    """HTML page with assessments, heat map and one section per family."""
    how = (
        "The cases run in separate processes. Assessments: stable and accurate, with an error of "
        f"up to {percent(ACCURATE)}; stable, with the error and the affected quantity; refused, with the "
        "message shown to the user. A value that is not finite, a crash, a case that does not end, or an error above "
        f"{percent(SILENT_LIMIT)} without a warning is a defect. Restitution errors are relative to the approach "
        "velocity: 0.015 instead of 0 is an error of 1.5 %."
    )
    table = PageTable("Cases by assessment.", HEADS, summary_rows(outcomes))
    parts: list[str | PageTable | Picture] = [how, table]
    if drawn:
        caption = "All cases: row and column within the family, with the error or the ratio of the stability limits."
        parts.append(Picture(out / HEATMAP, caption, (HEATMAP, CSV)))
    sections = [Section("Results", parts)]
    for family in dict.fromkeys(each.family for each in outcomes):
        of_family = [each for each in outcomes if each.family == family]
        sections.append(Section(family[0].upper() + family[1:], [EXPLANATIONS[family], _table(of_family)]))
    return Page("Stiff and extreme cases", headline(outcomes), sections)


def _table(outcomes: Sequence[CaseOutcome]) -> PageTable:
    """Table of the cases of one family."""
    rows = [
        (each.row, each.column, _figure(each.expected), _figure(each.reached), _figure(each.time_step), each.assessment)
        for each in outcomes
    ]
    reference = (
        outcomes[0].reference if len({each.reference for each in outcomes}) == 1 else "the reference of each case"
    )
    heads = ("", "case", "expected", "reached", "time step (s)", "assessment")
    return PageTable(f"Measured against {reference}.", heads, rows)


def _figure(number: float) -> str:
    """Number with four digits; empty for nan."""
    return f"{number:.4g}" if np.isfinite(number) else ""
