"""`granflow validate`: all cases, the page in HTML and Markdown, and the data of both as JSON."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from granflow import __version__
from granflow.studies.page import page_text
from granflow.studies.tables import PageTable
from granflow.studies.validation.adhesion import adhesion_cases
from granflow.studies.validation.case import ValidationCase
from granflow.studies.validation.collisions import elastic_cases, restitution_cases
from granflow.studies.validation.motion import motion_cases
from granflow.studies.validation.oblique import oblique_cases

Family = Callable[[], list[ValidationCase]]
FAMILIES: Mapping[str, Family] = {
    "elastic collisions": elastic_cases,
    "restitution": restitution_cases,
    "oblique impacts": oblique_cases,
    "adhesion and viscoelasticity": adhesion_cases,
    "particles on planes": motion_cases,
}
"""Functions that simulate the cases, by the name in progress messages."""
HEADS = ("case", "reference", "granflow", "deviation", "allowed", "status", "note")


@dataclass(frozen=True)
class Section:
    """Section of the page: table of cases, and numbered notes with source, reason of the allowed deviation, remark."""

    table: PageTable
    notes: tuple[str, ...]


def write_validation(
    out: Path, families: Mapping[str, Family] = FAMILIES, report: Callable[[str], None] = lambda text: None
) -> list[ValidationCase]:
    """Simulate all cases; write validation.html, validation.md and validation.json to `out`, which is created.

    `report` is called with the name of each family. Returns the cases. Raises OSError if a file cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    cases = []
    for name, family in families.items():
        report(name)
        cases += family()
    stored = {"version": __version__, "date": date.today().isoformat(), "cases": [each.as_dict() for each in cases]}
    (out / "validation.json").write_text(json.dumps(stored, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    (out / "validation.html").write_text(rendered("validation.html", stored), encoding="utf-8")
    (out / "validation.md").write_text(rendered("validation.md.jinja", stored), encoding="utf-8")
    return cases


def rendered(template: str, stored: Mapping[str, Any]) -> str:
    """Text of the page from the content of validation.json; statuses are computed again."""
    cases = [ValidationCase.from_dict(each) for each in stored["cases"]]
    kinds = dict.fromkeys(each.kind for each in cases)
    return page_text(
        template,
        sections={kind: section_of([each for each in cases if each.kind == kind]) for kind in kinds},
        failed=[each.name for each in cases if each.status == "fail"],
        count=len(cases),
        version=stored["version"],
        date=stored["date"],
    )


def section_of(cases: Sequence[ValidationCase]) -> Section:
    """Table with a row for each case; cases of equal source, derivation and remark refer to the same note."""
    notes = list(dict.fromkeys(_note(each) for each in cases))
    rows = [
        (
            each.name if each.unit == "1" else f"{each.name} [{each.unit}]",
            f"{each.reference:.6g}", f"{each.value:.6g}", f"{100.0 * each.deviation:+.2g} %",
            f"{100.0 * each.allowed:.2g} %", each.status, str(notes.index(_note(each)) + 1),
        )
        for each in cases
    ]  # fmt: skip
    return Section(PageTable(HEADS, rows), tuple(notes))


def _note(case: ValidationCase) -> str:
    """Source, reason of the allowed deviation, and remark of a case."""
    parts = (f"Reference: {case.source}", f"Allowed deviation: {case.derivation}", case.remark)
    return ". ".join(each.rstrip(".") for each in parts if each) + "."
