"""Validation: compares published numbers, closed forms and other codes with simulations, on one page.

    python tools/validation/run.py             all cases, about 35 minutes on two cores; writes the page of the
                                               documentation, docs/pages/validation.md, and its data,
                                               docs/validation_results.json
    python tools/validation/run.py --quick     cases of few particles and the cheap ones of many, 5 minutes;
                                               writes both files to out/validation
    python tools/validation/run.py --peers     all cases; runs LIGGGHTS (liggghts) and LAMMPS (lmp), as far as
                                               installed, for about 25 minutes more
    python tools/validation/run.py --only "wear of walls" "motions"
                                               the given families; the rows and dates of all others stay

Each case has a reference, an allowed deviation with its reason, and a status (`case.py`). Without --peers, the
figures of LIGGGHTS and LAMMPS are those that `run_peers.py` stored. Exit code 1: a deviation exceeds the
allowed one where the reference applies.
"""
# ruff: noqa: E402 (the modules of this folder are imported after its path is known)

import argparse
import json
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from granflow import GranflowError, __version__

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))

from validation.adhesion import adhesion_cases
from validation.at_rest import bed_cases, column_cases, reloading_cases, resting_cases
from validation.attraction import attraction_cases
from validation.case import ValidationCase
from validation.collisions import elastic_cases, restitution_cases, stated_cases, steel_cases
from validation.cooling import MODULI, QUICK_COUNT, haff_cases, viscoelastic_gas_cases
from validation.deforming_box import deforming_box_cases
from validation.equipment import equipment_motion_cases, residence_cases, wear_cases
from validation.heat_bed import heat_bed_cases
from validation.motion import motion_cases
from validation.normal_models import normal_model_cases
from validation.oblique import oblique_cases
from validation.peers.compare import CASES, Stored, peer_cases, run_peers
from validation.peers.silo import SILO
from validation.rheology import cell_cases, layer_cases
from validation.rolling_models import rolling_model_cases, twisting_cases
from validation.silo import QUICK_COUNT as QUICK_SILO
from validation.silo import discharge_cases, janssen_cases
from validation.sticking import sticking_cases
from validation.triaxial import triaxial_cases
from validation.vibrated import vibrated_cases
from validation.viscous_bridge import viscous_bridge_cases

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
    "viscous bridges": viscous_bridge_cases,
    "wear of walls": wear_cases,
    "residence times": residence_cases,
    "motions": equipment_motion_cases,
    "deforming box": deforming_box_cases,
}
"""Functions that simulate cases of few particles, by the name in progress messages."""
QUICK_REPEATS = 2
"""Runs of a silo that --quick compares with stored figures of LIGGGHTS and LAMMPS."""
QUICK: Mapping[str, Family] = {
    **TWO_BODY,
    "cooling gas": partial(haff_cases, MODULI[1:2], QUICK_COUNT),
    "narrow silo": partial(janssen_cases, QUICK_SILO),
    "discharge of a silo": partial(peer_cases, SILO.name, None, QUICK_REPEATS),
    "sheared box": cell_cases,
}
"""Cases of --quick."""
FAMILIES: Mapping[str, Family] = {
    **TWO_BODY,
    "cooling gas": haff_cases,
    "cooling gas of viscoelastic spheres": viscoelastic_gas_cases,
    "narrow silo": janssen_cases,
    "discharge of a silo": discharge_cases,
    "layer on a slope": layer_cases,
    "sheared box": cell_cases,
    "heat in a bed": heat_bed_cases,
    "triaxial compression": triaxial_cases,
}
"""All cases but those of LIGGGHTS and LAMMPS."""
PAGE = ROOT / "docs" / "pages" / "validation.md"
RESULTS = ROOT / "docs" / "validation_results.json"
"""Page of the documentation, and the data from which it is rendered."""
TEMPLATE = Path(__file__).with_name("page.md.jinja")
SUBJECTS = {
    "Chung & Ooi": "Elastic impacts of spheres of four materials: overlap, force and duration of Hertz.",
    "Collisions of Zhou's model": "Head-on collisions with given restitution: rebound, duration, overlap and force.",
    "Restitution over velocity": "Restitution that decreases with the impact velocity, from 0.01 to 10 m/s.",
    "Other normal models": "Head-on collisions with all other normal models.",
    "Oblique impacts": "Rebound angle and spin of impacts at an angle, sliding and sticking.",
    "Impacts that stick": "Oblique impacts with tangential models of Mindlin and their variants.",
    "Adhesion": "Pull-off force, and rebound of particles that nearly stick.",
    "Viscoelastic spheres": "Restitution of viscoelastic spheres from 0.01 to 10 m/s.",
    "Attractions": "Forces of cohesion and liquid bridges over the distance.",
    "Rolling and twisting models": "Deceleration of rolling and spinning spheres.",
    "Bouncing particle": "Heights of successive bounces on a floor.",
    "Two stacked spheres": "Two spheres that are compressed between two plates and released.",
    "Sliding and rolling": "A sphere that first slides and then rolls on a plane.",
    "Contacts that last": "Contacts that are loaded again, and the decay of oscillations under a load.",
    "Inelastic particle on a vibrating plate": "Take-off and periodic bounces on a vibrating plate.",
    "Viscous liquid bridges": "Two wet spheres that separate, and that collide.",
    "Wear of walls": "Worn volume of a sliding body (Archard) and of impacts (Finnie).",
    "Residence times": "Mean and deviation of two streams of known velocity.",
    "Motions of walls and gravity": "A chain of motions, servos, gravity that turns, a sphere in a spherical wall.",
    "Deforming box": "Pressures, widths and work of a periodic lattice that is compressed.",
    "Gas of inelastic spheres": "Cooling of a granular gas (Haff's law).",
    "Gas of viscoelastic spheres": "Cooling of a gas whose restitution depends on the velocity.",
    "Narrow silo": "Weight that the walls of a silo carry (Janssen).",
    "Discharge of a flat-bottomed silo": "Mass flow rate over the diameter of the orifice (Beverloo).",
    "Sheared flows": "Friction and solid fraction of flows over the inertial number.",
    "Heat conduction in a bed": "Effective conductivity of beds of spheres in air and in vacuum.",
    "Triaxial compression": "Stress ratio and volume of a sheared packing (LAMMPS).",
    "LIGGGHTS and LAMMPS, column": "Collapse of a column, from the same initial state.",
    "LIGGGHTS and LAMMPS, hopper": "Discharge of a hopper, from the same initial state.",
    "LIGGGHTS and LAMMPS, flat silo with a slot": "Discharge through a slot, from the same initial state.",
    "LIGGGHTS and LAMMPS, flat silo with a round orifice": "Discharge of the scene `flat_silo`.",
    "LIGGGHTS and LAMMPS, impact of a sphere": "A large sphere that falls on a bed.",
    "LIGGGHTS and LAMMPS, shaken box": "Power that a vibrating box transfers to a bed.",
    "LIGGGHTS and LAMMPS, drum without rolling friction": "Slope and power of a rotating drum.",
    "LIGGGHTS and LAMMPS, drum with rolling friction": "The same with a rolling model.",
}
"""What each section of the page compares, for its table of contents."""
HEADS = ("case", "reference", "granflow", "deviation", "allowed", "status", "note")
"""Columns of the tables."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the cases that the command line selects, writes page and data, and prints the deviations."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    extent = parser.add_mutually_exclusive_group()
    extent.add_argument("--quick", action="store_true", help="only cheap cases")
    extent.add_argument("--peers", action="store_true", help="run LIGGGHTS and LAMMPS")
    extent.add_argument(
        "--only",
        nargs="+",
        default=(),
        choices=list(all_families()),
        metavar="FAMILY",
        help=f"replace the rows of these families alone: {', '.join(all_families())}",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="directory of validation.md and validation_results.json"
    )
    options = parser.parse_args(arguments)
    out = options.out or (ROOT / "out" / "validation" if options.quick else None)
    page, results = (out / PAGE.name, out / RESULTS.name) if out else (PAGE, RESULTS)
    try:
        found = simulated_families(
            options.quick, options.peers, options.only, page.parent / "peers" if out else Path("out/peers")
        )
    except GranflowError as error:
        parser.error(str(error))
    write(page, results, found, options.quick, bool(options.only))
    cases = [each for family in found.values() for each in family]
    for each in cases:
        if each.status != "pass":
            print(
                f"{each.status}: {each.kind}, {each.name}: {each.value:g} instead of {each.reference:g} "
                f"{each.unit}"
            )
    statuses = [each.status for each in cases]
    print(f"{statuses.count('pass')} of {len(cases)} cases pass. Written: {page}, {results}")
    return 1 if "fail" in statuses else 0


def simulated_families(
    quick: bool, with_peers: bool, only: Sequence[str], folder: Path
) -> dict[str, list[ValidationCase]]:
    """Cases of the families of QUICK, of those named in `only`, or of all; prints the name of each family when
    it starts.

    with_peers:  run the installed ones of LIGGGHTS and LAMMPS in `folder` instead of reading their stored
                 figures

    Raises GranflowError if no other code can be run.
    """
    families = QUICK if quick else all_families(run_peers(folder, print) if with_peers else {})
    found = {}
    for name, family in families.items():
        if not only or name in only:
            print(name, flush=True)
            found[name] = family()
    return found


def all_families(peers: Stored | None = None) -> dict[str, Family]:
    """FAMILIES, and those of LIGGGHTS and LAMMPS; stored figures are read for codes that `peers` lacks."""
    return {
        **FAMILIES,
        **{f"{name} of LIGGGHTS and LAMMPS": partial(peer_cases, name, peers) for name in CASES},
    }


def write(
    page: Path, results: Path, found: Mapping[str, Sequence[ValidationCase]], quick: bool, merge: bool
) -> None:
    """Writes the data of the cases of each family, with version and date, and the page rendered from them.

    merge:  keep the stored rows of the other families

    The complete page keeps the table of wrong models, which `wrong_models.py` writes.
    """
    now = {"version": __version__, "date": date.today().isoformat()}
    families = {name: {**now, "cases": [each.as_dict() for each in cases]} for name, cases in found.items()}
    stored = {"quick": quick, "families": families}
    if not quick:
        before = json.loads(RESULTS.read_text(encoding="utf-8"))
        stored["wrong_models"] = before["wrong_models"]
        if merge:
            merged = {**before["families"], **families}
            stored["families"] = {name: merged[name] for name in all_families() if name in merged}
    write_stored(page, results, stored)


def write_stored(page: Path, results: Path, stored: Mapping[str, Any]) -> None:
    """Writes the data as JSON, and the page."""
    for path, text in (
        (results, json.dumps(stored, indent=1, ensure_ascii=False) + "\n"),
        (page, rendered(stored)),
    ):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def rendered(stored: Mapping[str, Any]) -> str:
    """Text of the page from the data; statuses are computed again."""
    cases: dict[str, list[ValidationCase]] = {}
    origins: dict[str, set[str]] = {}
    for family in stored["families"].values():
        for each in map(ValidationCase.from_dict, family["cases"]):
            cases.setdefault(each.kind, []).append(each)
            origins.setdefault(each.kind, set()).add(f"{family['version']}, {family['date']}")
    every = [each for of_kind in cases.values() for each in of_kind]
    environment = Environment(
        loader=FileSystemLoader(TEMPLATE.parent),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(TEMPLATE.name).render(
        sections={kind: section_of(of_kind, origins[kind]) for kind, of_kind in cases.items()},
        failed=[each.name for each in every if each.status == "fail"],
        missed=[each.name for each in every if each.status == "miss"],
        quick=stored["quick"],
        count=len(every),
        wrong_models=stored.get("wrong_models", []),
    )


@dataclass(frozen=True)
class Section:
    """Section of the page: the cells of a table of cases, and numbered notes with source, reason of the
    allowed deviation, remark.

    subject:  what is compared, one sentence
    largest:  largest deviation of a case within the range of its reference, over the allowed one
    origin:   versions of granflow and dates of the simulations
    """

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str]
    subject: str
    largest: float
    origin: str


def section_of(cases: Sequence[ValidationCase], origins: Collection[str]) -> Section:
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
    # A case that must be exact has the allowed deviation 0.
    shares = [abs(each.deviation) / each.allowed for each in cases if each.in_range and each.deviation]
    largest = max(shares, default=0.0)
    origin = "; ".join(sorted(origins))
    return Section(HEADS, rows, notes, SUBJECTS.get(cases[0].kind, ""), largest, origin)


def _note(case: ValidationCase) -> str:
    """Source, reason of the allowed deviation, and remark of a case."""
    parts = (f"Reference: {case.source}", f"Allowed deviation: {case.derivation}", case.remark)
    return ". ".join(each.rstrip(".") for each in parts if each) + "."


if __name__ == "__main__":
    sys.exit(main())
