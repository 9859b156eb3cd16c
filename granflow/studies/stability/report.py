"""Output of the stability study: `stability.csv`, heat map and page."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from granflow.studies.page import write_study
from granflow.studies.stability.case_families import BOUNDS, MANY, SIZES, STEPS, STIFFNESS, UNEQUAL, all_cases
from granflow.studies.stability.cases import ACCURATE, SILENT_LIMIT, CaseOutcome
from granflow.studies.stability.heatmap import heatmap
from granflow.studies.stability.worker_pool import Report, run_cases
from granflow.studies.tables import PageTable, attribute_columns, percent

PAGE = "stability.html"
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
    "overlap stores energy; numerics.max_overlap limits it. Without this limit the particles must separate with "
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


def _by_family(outcomes: Sequence[CaseOutcome]) -> dict[str, list[CaseOutcome]]:
    """Outcomes of each family, in their order."""
    found: dict[str, list[CaseOutcome]] = {}
    for each in outcomes:
        found.setdefault(each.family, []).append(each)
    return found


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


def _families(outcomes: Sequence[CaseOutcome]) -> Iterator[tuple[str, str, PageTable]]:
    """Title, explanation and table of each family."""
    for family, group in _by_family(outcomes).items():
        rows = [(each.row, each.column, *map(_shown, (each.expected, each.reached, each.time_step)), each.assessment)
                for each in group]  # fmt: skip
        is_common = len({each.reference for each in group}) == 1
        reference = group[0].reference if is_common else "the reference of each case"
        heads = ("", "case", "expected", "reached", "time step (s)", "assessment")
        table = PageTable(heads, rows, f"Measured against {reference}.")
        yield family[0].upper() + family[1:], EXPLANATIONS[family], table


def _shown(number: float) -> str:
    """Number with four digits; empty for nan."""
    return f"{number:.4g}" if np.isfinite(number) else ""


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
