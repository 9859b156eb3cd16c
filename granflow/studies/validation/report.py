"""`granflow validate`: all cases, the page in HTML and Markdown, and the data of both as JSON."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any

from granflow import __version__
from granflow.io.files import write_text
from granflow.studies.page import page_text
from granflow.studies.tables import PageTable
from granflow.studies.validation.adhesion import adhesion_cases
from granflow.studies.validation.at_rest import bed_cases, column_cases, reloading_cases, resting_cases
from granflow.studies.validation.attraction import attraction_cases
from granflow.studies.validation.case import ValidationCase
from granflow.studies.validation.collisions import elastic_cases, restitution_cases, stated_cases, steel_cases
from granflow.studies.validation.cooling import MODULI, QUICK_COUNT, haff_cases, viscoelastic_gas_cases
from granflow.studies.validation.motion import motion_cases
from granflow.studies.validation.normal_models import normal_model_cases
from granflow.studies.validation.oblique import oblique_cases
from granflow.studies.validation.peers.compare import CASES, Stored, peer_cases, run_peers
from granflow.studies.validation.peers.silo import SILO
from granflow.studies.validation.rheology import cell_cases, layer_cases
from granflow.studies.validation.rolling_models import rolling_model_cases, twisting_cases
from granflow.studies.validation.silo import QUICK_COUNT as QUICK_SILO
from granflow.studies.validation.silo import discharge_cases, janssen_cases
from granflow.studies.validation.sticking import sticking_cases
from granflow.studies.validation.vibrated import vibrated_cases

Family = Callable[[], list[ValidationCase]]
TWO_BODY: Mapping[str, Family] = {
    "elastic collisions": elastic_cases,
    "collisions of Zhou's model": restitution_cases,
    "stated closed forms": stated_cases,
    "restitution over velocity": steel_cases,
    "other normal models": normal_model_cases,
    "oblique impacts": oblique_cases,
    "impacts that stick": sticking_cases,
    "adhesion and viscoelasticity": adhesion_cases,
    "attractions": attraction_cases,
    "rolling models": rolling_model_cases,
    "twisting models": twisting_cases,
    "particles on planes": motion_cases,
    "reloading": reloading_cases,
    "damping at rest": resting_cases,
    "compressed row": bed_cases,
    "static column": column_cases,
    "vibrated particle": vibrated_cases,
}
"""Functions that simulate cases of few particles, by the name in progress messages."""
QUICK_REPEATS = 2
"""Runs of a silo that the quick validation compares with stored figures of LIGGGHTS and LAMMPS."""
QUICK: Mapping[str, Family] = {
    **TWO_BODY,
    "cooling gas": partial(haff_cases, MODULI[1:2], QUICK_COUNT),
    "narrow silo": partial(janssen_cases, QUICK_SILO),
    "discharge of a silo": partial(peer_cases, SILO.name, None, QUICK_REPEATS),
    "sheared box": cell_cases,
}
"""Cases of `granflow validate --quick`."""
FAMILIES: Mapping[str, Family] = {
    **TWO_BODY,
    "cooling gas": haff_cases,
    "cooling gas of viscoelastic spheres": viscoelastic_gas_cases,
    "narrow silo": janssen_cases,
    "discharge of a silo": discharge_cases,
    "layer on a slope": layer_cases,
    "sheared box": cell_cases,
}
"""All cases but those of LIGGGHTS and LAMMPS."""
HEADS = ("case", "reference", "granflow", "deviation", "allowed", "status", "note")


@dataclass(frozen=True)
class Section:
    """Section of the page: table of cases, and numbered notes with source, reason of the allowed deviation,
    remark."""

    table: PageTable
    notes: tuple[str, ...]


def peer_families(peers: Stored) -> dict[str, Family]:
    """Functions that simulate the cases of LIGGGHTS and LAMMPS; stored figures stand for codes missing in
    `peers`."""
    return {f"{name} of LIGGGHTS and LAMMPS": partial(peer_cases, name, peers) for name in CASES}


def write_validation(
    out: Path,
    quick: bool = False,
    report: Callable[[str], None] = lambda text: None,
    with_peers: bool = False,
) -> list[ValidationCase]:
    """Simulate the cases; write validation.html, validation.md and validation.json to `out`, which is
    created.

    quick:       only the cases of QUICK
    report:      called with the name of each family
    with_peers:  run LIGGGHTS and LAMMPS in `out`/peers, if they are installed, instead of showing their
                 stored figures

    Returns the cases. Raises OSError if a file cannot be written, GranflowError if no other code can be run.
    """
    out.mkdir(parents=True, exist_ok=True)
    peers = run_peers(out / "peers", report) if with_peers else {}
    cases = []
    for name, family in (QUICK if quick else {**FAMILIES, **peer_families(peers)}).items():
        report(name)
        cases += family()
    stored = {
        "version": __version__,
        "date": date.today().isoformat(),
        "quick": quick,
        "cases": [each.as_dict() for each in cases],
    }
    write_text(out / "validation.json", json.dumps(stored, indent=1, ensure_ascii=False) + "\n")
    write_text(out / "validation.html", rendered("validation.html", stored))
    write_text(out / "validation.md", rendered("validation.md.jinja", stored))
    return cases


def rendered(template: str, stored: Mapping[str, Any]) -> str:
    """Text of the page from the content of validation.json; statuses are computed again."""
    cases = [ValidationCase.from_dict(each) for each in stored["cases"]]
    kinds = dict.fromkeys(each.kind for each in cases)
    return page_text(
        template,
        sections={kind: section_of([each for each in cases if each.kind == kind]) for kind in kinds},
        failed=[each.name for each in cases if each.status == "fail"],
        missed=[each.name for each in cases if each.status == "miss"],
        quick=stored.get("quick", False),
        count=len(cases),
        wrong_models=stored.get("wrong_models", []),
        version=stored["version"],
        date=stored["date"],
    )


def section_of(cases: Sequence[ValidationCase]) -> Section:
    """Table with a row for each case; cases of equal source, derivation and remark refer to the same note."""
    notes = list(dict.fromkeys(_note(each) for each in cases))
    rows = [
        (
            each.name if each.unit == "1" else f"{each.name} [{each.unit}]",
            f"{each.reference:.6g}",
            f"{each.value:.6g}",
            f"{100.0 * each.deviation:+.2g} %",
            f"{100.0 * each.allowed:.2g} %",
            each.status,
            str(notes.index(_note(each)) + 1),
        )
        for each in cases
    ]
    return Section(PageTable(HEADS, rows), tuple(notes))


def _note(case: ValidationCase) -> str:
    """Source, reason of the allowed deviation, and remark of a case."""
    parts = (f"Reference: {case.source}", f"Allowed deviation: {case.derivation}", case.remark)
    return ". ".join(each.rstrip(".") for each in parts if each) + "."
