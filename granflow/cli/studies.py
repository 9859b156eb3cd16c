"""Verbs that study contact laws: collide, restitution, fit, paper."""

import argparse
import json
from pathlib import Path
from typing import Any

from granflow.cli.arguments import add_machine, add_scene_verb, load, quantity
from granflow.cli.messages import say, show_comparison, show_table, write_study
from granflow.errors import GranflowError


def collide(options: argparse.Namespace) -> int:
    """`granflow collide`: one head-on collision against its closed forms."""
    from granflow.study.collide import collide as collide_once

    names = ("law", "material", "diameter", "velocity", "diameter2", "material2", "wall", "restitution")
    numerics = ("settings", "steps_per_contact", "precision", "arch")
    numbers = collide_once(**{name: getattr(options, name) for name in (*names, *numerics)})
    if options.json:
        say(json.dumps(numbers, indent=2))
    else:
        show_comparison(numbers)
    return 0


def restitution(options: argparse.Namespace) -> int:
    """`granflow restitution`: what every pair of materials is asked and reaches at the scene's own time step."""
    from granflow.study.restitution import measure, restitution_rows, write_restitution

    scene = load(options)
    found, step = measure(scene, options.arch)
    heads = ("pair of materials", "velocity m/s", "asked", "reached", "difference %")
    show_table(scene.title, heads, restitution_rows(found))
    say(f"With steps of {step:.4g} s in {scene.run.precision}; * differs by more than 1 %.")
    write_study(options.out or Path("out") / scene.path.stem, write_restitution, found, scene.title)
    return 0


def fit(options: argparse.Namespace) -> int:
    """`granflow fit`: sigma and psi of Eq. 12 from measured velocities and restitutions."""
    from granflow.study.fit import fit as fitted
    from granflow.study.fit import fit_rows, limit_from_materials, write_fit
    from granflow.study.measurements import read_measurements

    out = options.out or Path("out") / options.data.stem
    if options.data.resolve() == (out / "fit.csv").resolve():
        raise GranflowError(f"{options.data} would be overwritten by the result fit.csv: name another --out.")
    data = read_measurements(options.data)
    limit = limit_from_materials(options.material, options.material2) if options.material else options.limit_velocity
    found = fitted(data, limit)
    show_table(f"Eq. 12 fitted to {len(data)} rows of {options.data}", ("", "value", "error", "unit"), fit_rows(found))
    say(f"For a pair in a scene:\n  {found.snippet()}")
    write_study(out, write_fit, data, found)
    return 0


def paper(options: argparse.Namespace) -> int:
    """`granflow paper`: the figures and tables of Zhou (2011) from simulated collisions, and all laws compared."""
    from granflow.study.paper import write_paper

    page = write_paper(options.out, lambda words: say(f"{words} ...", flush=True))
    say(f"Open {page} in a browser; the figures lie beside it as PNG and CSV.")
    return 0


def add_collide(verbs: Any) -> None:
    """`granflow collide` and its arguments."""
    summary = "run one head-on collision and compare it with the closed forms"
    parser = verbs.add_parser("collide", help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.add_argument("--law", default="zhou", help="contact law (zhou)")
    parser.add_argument(
        "--set",
        dest="settings",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="a setting of the law, such as --law thornton --set yield_ratio=2.8; may be repeated",
    )
    parser.add_argument("--material", required=True, metavar="PRESET", help="material, such as stainless_316")
    parser.add_argument("--diameter", required=True, type=quantity("length"), help="of the sphere, such as 25.4mm")
    parser.add_argument("--velocity", required=True, type=quantity("velocity"), help="of approach, such as 0.5")
    parser.add_argument("--material2", metavar="PRESET", help="of the other sphere or the wall (the same)")
    partner = parser.add_mutually_exclusive_group()
    partner.add_argument("--diameter2", type=quantity("length"), help="of the other sphere (the same)")
    partner.add_argument("--wall", action="store_true", help="collide with a wall instead of a sphere")
    parser.add_argument("--restitution", type=quantity("number"), help="asked for, 0 to 1 (from the material)")
    parser.add_argument("--steps-per-contact", metavar="N", type=float, help="duration over time step")
    parser.add_argument("--json", action="store_true", help="print JSON in SI units")
    add_machine(parser)
    parser.set_defaults(verb=collide)


def add_restitution(verbs: Any) -> None:
    """`granflow restitution` and its arguments."""
    parser = add_scene_verb(verbs, restitution, "show the restitution that a scene asks for and that it reaches")
    parser.add_argument("--out", metavar="DIR", type=Path, help="where CSV and PNG go (out/ and the scene's name)")
    add_machine(parser)


def add_fit(verbs: Any) -> None:
    """`granflow fit` and its arguments."""
    summary = "fit sigma and psi of Eq. 12 to measured restitutions"
    parser = verbs.add_parser("fit", help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.add_argument(
        "data", metavar="DATA.csv", type=Path, help="columns velocity [m/s] and restitution, maybe deviation or weight"
    )
    known = parser.add_mutually_exclusive_group(required=True)
    known.add_argument("--material", metavar="PRESET", help="limit velocity from Eq. 11 for this material")
    known.add_argument("--limit-velocity", type=quantity("velocity"), help="limit velocity, such as 340 m/s")
    known.add_argument("--fit-limit", action="store_true", help="fit the limit velocity, too")
    parser.add_argument("--material2", metavar="PRESET", help="of the partner, with --material (the same)")
    parser.add_argument("--out", metavar="DIR", type=Path, help="where CSV and PNG go (out/ and the data's name)")
    parser.set_defaults(verb=fit)


def add_paper(verbs: Any) -> None:
    """`granflow paper` and its arguments."""
    summary = "reproduce the figures and tables of Zhou (2011), and compare all laws, on one page"
    parser = verbs.add_parser("paper", help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.add_argument("--out", metavar="DIR", type=Path, default=Path("out/paper"), help="where it goes (out/paper)")
    parser.set_defaults(verb=paper)
