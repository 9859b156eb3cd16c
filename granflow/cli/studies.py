"""Verbs that study contact models: collide, restitution, fit, paper, validate.

Equation numbers are those of Y. H. Zhou, Theor. Appl. Mech. Lett. 1, 041006 (2011).
"""

import argparse
import json
from pathlib import Path
from typing import Any

from granflow.cli.arguments import add_machine, add_out, add_scene_verb, add_verb, load, quantity
from granflow.cli.messages import say, say_progress, show_comparison, show_table, write_study
from granflow.errors import GranflowError


def collide(options: argparse.Namespace) -> int:
    """`granflow collide`: simulate one head-on collision and compare it with closed-form results.

    Prints a table, or JSON in SI units. Raises GranflowError for an unknown material, contact model or option.
    """
    from granflow.studies.collide import collide as collide_once

    names = ("law", "material", "diameter", "velocity", "diameter2", "material2", "wall", "restitution")
    numerics = ("settings", "steps_per_contact", "precision", "arch")
    numbers = collide_once(**{name: getattr(options, name) for name in (*names, *numerics)})
    if options.json:
        say(json.dumps(numbers, indent=2))
    else:
        show_comparison(numbers)
    return 0


def restitution(options: argparse.Namespace) -> int:
    """`granflow restitution`: requested and simulated restitution of each pair of materials at the time step.

    The impact velocities [m/s] are below the maximum expected one. Writes CSV and PNG files.
    """
    from granflow.studies.restitution import measure, restitution_rows, write_restitution

    scene = load(options)
    found, step = measure(scene, options.arch)
    heads = ("pair of materials", "velocity m/s", "requested", "simulated", "difference %")
    show_table(scene.title, heads, restitution_rows(found))
    say(f"Time step {step:.4g} s, precision {scene.run.precision}; * marks a difference of more than 1 %.")
    write_study(options.out or Path("out") / scene.path.stem, write_restitution, found, scene.title)
    return 0


def fit(options: argparse.Namespace) -> int:
    """`granflow fit`: fit sigma and psi of Eq. 12 (Zhou 2011) to measured impact velocities and restitutions.

    The limit velocity [m/s] is given, from the material (Eq. 11), or fitted. Raises GranflowError if the result would
    overwrite the data, or if the data are invalid.
    """
    from granflow.studies.fit import fit as fitted
    from granflow.studies.fit import fit_rows, limit_from_materials, write_fit
    from granflow.studies.measurements import read_measurements

    out = options.out or Path("out") / options.data.stem
    if options.data.resolve() == (out / "fit.csv").resolve():
        raise GranflowError(f"{options.data} would be overwritten by the result fit.csv: give another --out.")
    data = read_measurements(options.data)
    limit = limit_from_materials(options.material, options.material2) if options.material else options.limit_velocity
    found = fitted(data, limit)
    title = f"Zhou (2011), Eq. 12, fitted to {len(data)} rows of {options.data}"
    show_table(title, ("", "value", "error", "unit"), fit_rows(found))
    say(f"For a pair in a scene:\n  {found.snippet()}")
    write_study(out, write_fit, data, found)
    return 0


def paper(options: argparse.Namespace) -> int:
    """`granflow paper`: reproduce the figures and tables of Zhou (2011) and compare all contact models.

    Writes one page with its figures (PNG) and their data (CSV).
    """
    from granflow.studies.paper.report import write_paper

    page = write_paper(options.out or Path("out/paper"), say_progress)
    say(f"Open {page} in a browser; the same directory contains the figures as PNG and CSV.")
    return 0


def validate(options: argparse.Namespace) -> int:
    """`granflow validate`: compare published numbers and closed forms with simulations, on one page.

    Writes the page as HTML and Markdown, and its data as JSON. Returns 1 if a deviation exceeds the allowed one where
    the reference applies.
    """
    from granflow.studies.validation.report import write_validation

    out = options.out or Path("out/validation")
    cases = write_validation(out, options.quick, say_progress, options.peers)
    failed = [each for each in cases if each.status == "fail"]
    for each in (each for each in cases if each.status != "pass"):
        say(f"{each.status}: {each.kind}, {each.name}: {each.value:g} instead of {each.reference:g} {each.unit}")
    passed = sum(each.status == "pass" for each in cases)
    say(f"{passed} of {len(cases)} cases pass. Open {out / 'validation.html'} in a browser.")
    return 1 if failed else 0


def add_collide(verbs: Any) -> None:
    """Add `granflow collide` and its arguments.

    Quantities are in SI units or have a unit, such as 25.4mm; --diameter2 and --wall exclude each other.
    """
    parser = add_verb(verbs, collide, "simulate one head-on collision and compare it with closed-form results")
    add, length, velocity = parser.add_argument, quantity("length"), quantity("velocity")
    add("--law", default="zhou", help="normal contact model (default: zhou)")
    add(
        "--set", dest="settings", metavar="KEY=VALUE", action="append", default=[],
        help="option of the contact model, such as --law thornton --set yield_ratio=2.8; repeatable",
    )  # fmt: skip
    add("--material", required=True, metavar="PRESET", help="material, such as stainless_316")
    add("--diameter", required=True, type=length, help="diameter of the sphere, such as 25.4mm")
    add("--velocity", required=True, type=velocity, help="impact velocity, such as 0.5 (m/s)")
    add("--material2", metavar="PRESET", help="material of the other sphere or of the wall (default: the same)")
    partner = parser.add_mutually_exclusive_group()
    partner.add_argument("--diameter2", type=length, help="diameter of the other sphere (default: the same)")
    partner.add_argument("--wall", action="store_true", help="collide with a wall instead of a sphere")
    add("--restitution", type=quantity("number"), help="requested restitution, 0 to 1 (default: from the material)")
    add(
        "--steps-per-contact", metavar="N", type=float,
        help="time steps per expected contact duration (default: from the automatic time step)",
    )  # fmt: skip
    add("--json", action="store_true", help="print JSON in SI units")
    add_machine(parser, "f64")


def add_restitution(verbs: Any) -> None:
    """Add `granflow restitution` and its arguments."""
    summary = "print requested and simulated restitution for each pair of materials at the time step of the scene"
    parser = add_scene_verb(verbs, restitution, summary)
    add_out(parser, "out/SCENE", "CSV and PNG")
    add_machine(parser)


def add_fit(verbs: Any) -> None:
    """Add `granflow fit` and its arguments.

    Exactly one of --material, --limit-velocity and --fit-limit determines the limit velocity.
    """
    parser = add_verb(verbs, fit, "fit sigma and psi of the restitution curve (Zhou 2011, Eq. 12) to measurements")
    columns = "table with the columns velocity [m/s] and restitution, optionally deviation or weight"
    parser.add_argument("data", metavar="DATA.csv", type=Path, help=columns)
    known = parser.add_mutually_exclusive_group(required=True)
    add = known.add_argument
    add("--material", metavar="PRESET", help="compute the limit velocity of this material (Zhou 2011, Eq. 11)")
    add("--limit-velocity", type=quantity("velocity"), help="limit velocity, such as 340 m/s")
    add("--fit-limit", action="store_true", help="also fit the limit velocity")
    second = "with --material: material of the second body (default: the same)"
    parser.add_argument("--material2", metavar="PRESET", help=second)
    add_out(parser, "out/DATA", "CSV and PNG")


def add_paper(verbs: Any) -> None:
    """Add `granflow paper` and its arguments."""
    summary = "reproduce the figures and tables of Zhou (2011) and compare all contact models, on one page"
    add_out(add_verb(verbs, paper, summary), "out/paper")


def add_validate(verbs: Any) -> None:
    """Add `granflow validate` and its arguments."""
    summary = "compare published numbers and closed forms with simulations, on one page"
    parser = add_verb(verbs, validate, summary)
    few = "only the cases of few particles and the cheap ones of many: 5 minutes instead of up to 35, on two cores"
    extent = parser.add_mutually_exclusive_group()
    extent.add_argument("--quick", action="store_true", help=few)
    both = "run LIGGGHTS (liggghts) and LAMMPS (lmp), as far as installed, for about 25 minutes more"
    extent.add_argument("--peers", action="store_true", help=both)
    add_out(parser, "out/validation")
