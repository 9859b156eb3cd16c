"""Wrong models: inserts one error at a time into a copy of the source, and runs the validation cases that
must fail.

    python tools/validation/wrong_models.py            all of WRONG_MODELS; writes docs/validation_results.json
    python tools/validation/wrong_models.py NAME ...   only the given ones; the rows of others stay
    python tools/validation/wrong_models.py --check    only checks that the text of each error occurs once in
                                                       its file

The page of the documentation shows the result as a table.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))
from source_copy import copy_to, write_later  # noqa: E402

from validation.run import PAGE, RESULTS, write_stored  # noqa: E402

LONGEST = 900.0
"""Time limit [s] of the cases of one wrong model."""
RUN = """
import json, sys
from importlib import import_module
cases = []
for each in sys.argv[1:]:
    module, name = each.split(":")
    cases += getattr(import_module("validation." + module), name)()
print("CASES" + json.dumps([each.as_dict() for each in cases]))
"""
"""Program that runs the families of its arguments."""
ZHOU, UNLOADING = "granflow/contact/normal/zhou.py", "granflow/contact/normal/zhou.py"
THEORY, MATERIAL = "granflow/contact/theory.py", "granflow/contact/material.py"
NORMAL, ROLLING = "granflow/contact/normal/", "granflow/contact/rolling/"
TANGENTIAL, COHESION = "granflow/contact/tangential/", "granflow/contact/cohesion/"
TWISTING, LAW = "granflow/contact/twisting/", "granflow/contact/law.py"


@dataclass(frozen=True)
class WrongModel:
    """A wrong model: replacements (file, text, erroneous text) and families of cases (module:function) that
    detect it.

    small:  whether the error is a change of a model by 10 %; the others are the errors of the review
    """

    name: str
    changes: tuple[tuple[str, str, str], ...]
    families: tuple[str, ...]
    small: bool = False


REVIEW = (
    WrongModel(
        "Zhou, Eq. 4: the memory of the maximum overlap is lost",
        ((ZHOU, "history_new.overlap_max = ti.max(overlap, overlap_max)", "history_new.overlap_max = overlap"),),
        ("collisions:restitution_cases", "at_rest:reloading_cases"),
    ),
    WrongModel(
        "Zhou, Eq. 7: the slope without the term e^3 y^1.5",
        ((UNLOADING, "slope = ti.sqrt(radius * overlap_max) * (1.0 - cube * y * ti.sqrt(y)) / y",
          "slope = ti.sqrt(radius * overlap_max) / y"),),
        ("collisions:restitution_cases",),
    ),
    WrongModel(
        "Zhou, Eq. 8: recovery 0.7 e^2 for 0.8 e^2",
        ((UNLOADING, "first = 0.8 * e * e", "first = 0.7 * e * e"),),
        ("collisions:restitution_cases",),
    ),
    WrongModel(
        "Zhou, Eq. 11: limit velocity without the factor 3",
        ((MATERIAL, "np.sqrt(3.0 * strength / -minus_density)", "np.sqrt(strength / -minus_density)"),),
        ("collisions:steel_cases",),
    ),
    WrongModel(
        "Zhou, Eq. 12: half the velocity ratio",
        ((UNLOADING, "power(velocity / (limit - velocity), constants.psi)",
          "power(0.5 * velocity / (limit - velocity), constants.psi)"),
         (MATERIAL, "(below / (self.limit_velocity - below))", "(0.5 * below / (self.limit_velocity - below))")),
        ("collisions:steel_cases",),
    ),
    WrongModel(
        "Zhou, Eq. 16: unloading time times 0.7",
        ((THEORY, "return float(np.pi / 4.0 * np.sum(weights * integrand))",
          "return float(0.7 * np.pi / 4.0 * np.sum(weights * integrand))"),),
        ("collisions:stated_cases",),
    ),
    WrongModel(
        "Zhou, Eq. 19: stiffness times 1.25",
        (("granflow/contact/normal/linear.py", "return 0.8 * k * power(", "return 1.0 * k * power("),
         (THEORY, "return 0.8 * k * np.sqrt(overlap_max(k, mass, velocity))",
          "return 1.0 * k * np.sqrt(overlap_max(k, mass, velocity))")),
        ("collisions:stated_cases", "normal_models:normal_model_cases"),
    ),
    WrongModel(
        "Hertz: effective mass of a pair halved",
        (("granflow/engine/pair.py", "return one * other / (one + other)",
          "return 0.5 * one * other / (one + other)"),),
        ("collisions:elastic_cases", "collisions:restitution_cases"),
    ),
    WrongModel(
        "Coulomb limit times 1.2",
        ((TANGENTIAL + "mindlin.py", "return constants.friction * contact.normal_load",
          "return 1.2 * constants.friction * contact.normal_load"),),
        ("sticking:sticking_cases",),
    ),
    WrongModel(
        "Mindlin: tangential stiffness times 1.2",
        ((LAW, "return 8.0 * constants.shear_modulus_eff", "return 9.6 * constants.shear_modulus_eff"),),
        ("sticking:sticking_cases",),
    ),
    WrongModel(
        "Mindlin: without rescaling",
        ((TANGENTIAL + "mindlin.py", "factor = ti.min(ratio, 1.0)", "factor = ratio"),),
        ("sticking:sticking_cases",),
    ),
    WrongModel(
        "rolling limit times 1.2",
        ((ROLLING + "epsd.py", "limit = constants.rolling_friction * contact.radius_eff * contact.normal_load",
          "limit = 1.2 * constants.rolling_friction * contact.radius_eff * contact.normal_load"),),
        ("rolling_models:rolling_model_cases",),
    ),
    WrongModel(
        "rest_damping 0.5 for 0.1",
        ((ZHOU, "REST_DAMPING = 0.1", "REST_DAMPING = 0.5"),),
        ("at_rest:resting_cases",),
    ),
    WrongModel(
        "JKR: pull-off force of DMT, 2 pi w R for 3/2 pi w R",
        ((COHESION + "jkr.py", "return unit * (4.0 / 3.0 * (above * ti.sqrt(above) - cube * cube) + 2.0 * cube)",
          "return 4.0 / 3.0 * unit * (4.0 / 3.0 * (above * ti.sqrt(above) - cube * cube) + 2.0 * cube)"),),
        ("adhesion:adhesion_cases",),
    ),
    WrongModel(
        "SJKR: half the attraction",
        ((COHESION + "sjkr.py", "return 2.0 * math.pi * constants.cohesion_energy_density",
          "return math.pi * constants.cohesion_energy_density"),),
        ("attraction:sjkr_cases",),
    ),
)  # fmt: skip
"""The 15 wrong models of the review."""
MODELS = (
    ("zhou, loading", ZHOU, "loading_force = stiffness * ti.sqrt", "loading_force = 1.1 * stiffness * ti.sqrt",
     "collisions:restitution_cases"),
    ("zhou, unloading", UNLOADING, "return stiffness * above * (slope + hertz),",
     "return 1.1 * stiffness * above * (slope + hertz),", "collisions:restitution_cases"),
    ("zhou, sigma", UNLOADING, "exponential(-constants.sigma * power", "exponential(-1.1 * constants.sigma * power",
     "collisions:steel_cases"),
    ("zhou, rest_damping", UNLOADING, "damping *= constants.rest_damping", "damping *= 1.1 * constants.rest_damping",
     "at_rest:resting_cases"),
    ("zhou, damping_ratio", ZHOU, "return 2.0 * constants.damping_ratio * weight * root",
     "return 2.2 * constants.damping_ratio * weight * root", "at_rest:resting_cases"),
    ("hertz, spring", NORMAL + "hertz.py", "elastic = stiffness * ti.sqrt(contact.radius_eff * contact.overlap)",
     "elastic = 1.1 * stiffness * ti.sqrt(contact.radius_eff * "
     "contact.overlap)", "normal_models:normal_model_cases"),
    ("hertz, dashpot", NORMAL + "hertz.py", "damping = constants.viscosity * weight",
     "damping = 1.1 * constants.viscosity * weight", "normal_models:normal_model_cases"),
    ("linear, spring", NORMAL + "linear.py", "elastic = stiffness * contact.overlap",
     "elastic = 1.1 * stiffness * contact.overlap", "normal_models:normal_model_cases"),
    ("linear, dashpot", NORMAL + "linear.py", "2.0 * constants.damping_ratio * share * ti.sqrt(",
     "2.2 * constants.damping_ratio * share * ti.sqrt(", "normal_models:normal_model_cases"),
    ("walton_braun, unloading", NORMAL + "walton_braun.py", "return stiffness * (1.0 + excess)",
     "return 1.1 * stiffness * (1.0 + excess)", "normal_models:normal_model_cases"),
    ("luding, growth of the stiffness", NORMAL + "luding.py",
     "growth = (1.0 - share) ** 2 / (2.0 * self.plasticity_depth * share)",
     "growth = 1.1 * (1.0 - share) ** 2 / (2.0 * self.plasticity_depth * "
     "share)", "normal_models:normal_model_cases"),
    ("eepa, unloading", NORMAL + "eepa.py", "steep = self.loading(constants, contact) / (1.0 - constants.plasticity)",
     "steep = 1.1 * self.loading(constants, contact) / (1.0 - constants.plasticity)",
     "normal_models:normal_model_cases"),
    ("thornton, yield pressure", NORMAL + "thornton.py", "self.yield_ratio * pair.yield_strength",
     "1.1 * self.yield_ratio * pair.yield_strength", "normal_models:normal_model_cases"),
    ("kuwabara_kono, dissipation", NORMAL + "kuwabara_kono.py", "damping = constants.dissipation * k * power",
     "damping = 1.1 * constants.dissipation * k * power", "adhesion:viscoelastic_cases"),
    ("mindlin, stiffness", LAW, "return 8.0 * constants.shear_modulus_eff", "return 8.8 * constants.shear_modulus_eff",
     "sticking:sticking_cases"),
    ("mindlin, friction limit", TANGENTIAL + "mindlin.py", "return constants.friction * contact.normal_load",
     "return 1.1 * constants.friction * contact.normal_load", "sticking:sticking_cases"),
    ("mindlin, dashpot", TANGENTIAL + "mindlin.py", "constants.damping * contact.normal_damping, 0.0",
     "1.1 * constants.damping * contact.normal_damping, 0.0", "sticking:sticking_cases"),
    ("linear_history, stiffness", TANGENTIAL + "linear_history.py", "return constants.spring_stiffness",
     "return 1.1 * constants.spring_stiffness", "sticking:sticking_cases"),
    ("sliding_dashpot, dashpot", TANGENTIAL + "sliding_dashpot.py", "trial = -constants.damping",
     "trial = -1.1 * constants.damping", "sticking:sticking_cases"),
    ("sliding_dashpot, limit", TANGENTIAL + "sliding_dashpot.py", "return constants.friction * contact.normal_load",
     "return 1.1 * constants.friction * contact.normal_load", "sticking:sticking_cases"),
    ("cdt, torque", ROLLING + "cdt.py", "return constants.rolling_friction * contact.radius_eff * contact.normal_load",
     "return 1.1 * constants.rolling_friction * contact.radius_eff * contact.normal_load",
     "rolling_models:rolling_model_cases"),
    ("viscous, torque", ROLLING + "viscous.py", "return constants.rolling_dissipation * contact.radius_eff",
     "return 1.1 * constants.rolling_dissipation * contact.radius_eff", "rolling_models:rolling_model_cases"),
    ("epsd and sds, stiffness", ROLLING + "epsd.py", "spring = contact.stiffness * contact.radius_eff *",
     "spring = 1.1 * contact.stiffness * contact.radius_eff *", "rolling_models:rolling_model_cases"),
    ("epsd and sds, limit", ROLLING + "epsd.py",
     "limit = constants.rolling_friction * contact.radius_eff * contact.normal_load",
     "limit = 1.1 * constants.rolling_friction * contact.radius_eff * contact.normal_load",
     "rolling_models:rolling_model_cases"),
    ("sds, dashpot", ROLLING + "sds.py", "damping = 2.0 * constants.rolling_damping",
     "damping = 2.2 * constants.rolling_damping", "rolling_models:rolling_model_cases"),
    ("marshall, stiffness", TWISTING + "marshall.py", "return 0.5 * contact.stiffness * square",
     "return 0.55 * contact.stiffness * square", "rolling_models:twisting_cases"),
    ("marshall, limit", TWISTING + "marshall.py", "limit = 2.0 / 3.0 * constants.friction",
     "limit = 2.2 / 3.0 * constants.friction", "rolling_models:twisting_cases"),
    ("torsion_spring, stiffness", TWISTING + "torsion_spring.py", "return constants.torsion_stiffness, coefficient,",
     "return 1.1 * constants.torsion_stiffness, coefficient,", "rolling_models:twisting_cases"),
    ("torsion_spring, limit", TWISTING + "torsion_spring.py", "constants.twisting_friction * contact.normal_load\n\n",
     "1.1 * constants.twisting_friction * contact.normal_load\n\n", "rolling_models:twisting_cases"),
    ("torsion_spring, dashpot", TWISTING + "torsion_spring.py", "coefficient += constants.torsion_damping",
     "coefficient += 1.1 * constants.torsion_damping", "rolling_models:twisting_cases"),
    ("sjkr, attraction", COHESION + "sjkr.py", "return 2.0 * math.pi * constants.cohesion_energy_density",
     "return 2.2 * math.pi * constants.cohesion_energy_density", "attraction:sjkr_cases"),
    ("dmt, attraction", COHESION + "dmt.py", "return 2.0 * math.pi * constants.work_of_adhesion",
     "return 2.2 * math.pi * constants.work_of_adhesion", "adhesion:adhesion_cases"),
    ("jkr, work of adhesion", COHESION + "jkr.py", 'return pair.properties["work_of_adhesion"], pair.modulus_eff',
     'return 1.1 * pair.properties["work_of_adhesion"], pair.modulus_eff', "adhesion:adhesion_cases"),
    ("capillary bridges, attraction", COHESION + "capillary.py",
     "return 4.0 * math.pi * contact.radius_eff * tension / (1.0",
     "return 4.4 * math.pi * contact.radius_eff * tension / (1.0",
     "attraction:bridge_cases"),
    ("capillary bridges, rupture distance", COHESION + "capillary.py", "return 1.0 + 0.5 * contact_angle",
     "return 1.1 * (1.0 + 0.5 * contact_angle)", "attraction:bridge_cases"),
    ("viscous bridges, force", COHESION + "lubrication.py",
     "stokes = 6.0 * math.pi * constants.viscosity * contact.radius_eff",
     "stokes = 6.6 * math.pi * constants.viscosity * contact.radius_eff", "viscous_bridge:viscous_bridge_cases"),
    ("van_der_waals, attraction", COHESION + "van_der_waals.py",
     "attraction = constants.hamaker_constant * contact.radius_eff",
     "attraction = 1.1 * constants.hamaker_constant * contact.radius_eff", "attraction:van_der_waals_cases"),
    ("archard, worn volume", "granflow/scene/blocks/wear.py",
     "return load.normal_force * load.slip_speed\n\n        return archard",
     "return 1.1 * load.normal_force * load.slip_speed\n\n        return archard", "equipment:wear_cases"),
    ("finnie, worn volume", "granflow/scene/blocks/wear.py", "power = 2.0 * load.force * speed * share",
     "power = 2.2 * load.force * speed * share", "equipment:wear_cases"),
    ("deforming box, pressure", "granflow/engine/deformation.py",
     "pressure = self._sum(self.fields.virial, chunks, axis)",
     "pressure = 1.1 * self._sum(self.fields.virial, chunks, axis)", "deforming_box:deforming_box_cases"),
)  # fmt: skip
"""Models changed by 10 %: what changes, file, text, erroneous text, family."""
WRONG_MODELS = REVIEW + tuple(
    WrongModel(f"{name} times 1.1", ((file, old, new),), (family,), True)
    for name, file, old, new, family in MODELS
)


def problems(models: Sequence[WrongModel], root: Path = ROOT) -> list[str]:
    """Messages for the changes whose text does not occur exactly once in their file."""
    found = []
    for each in models:
        for file, old, _ in each.changes:
            path = root / file
            count = path.read_text(encoding="utf-8").count(old) if path.is_file() else 0
            if count != 1:
                found.append(f"{each.name}: {file} contains the text {old!r} {count} times instead of once.")
    return found


@contextmanager
def changed(copy: Path, model: WrongModel) -> Iterator[None]:
    """Applies the changes to the copy and restores the files on exit."""
    before = {copy / file: (copy / file).read_text(encoding="utf-8") for file, _, _ in model.changes}
    for file, old, new in model.changes:
        path = copy / file
        write_later(path, path.read_text(encoding="utf-8").replace(old, new))
    try:
        yield
    finally:
        for path, text in before.items():
            write_later(path, text)


def failing_cases(copy: Path, families: Sequence[str], kernels: Path) -> tuple[int, list[dict[str, Any]]]:
    """Number of cases of the families, and those that fail. Raises SystemExit if they do not run."""
    path = os.pathsep.join(str(folder) for folder in (copy, copy / "tools"))
    environment = os.environ | {"PYTHONPATH": path, "GRANFLOW_CACHE": str(kernels)}
    command = [sys.executable, "-c", RUN, *families]
    done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, timeout=LONGEST)
    lines = [line for line in done.stdout.splitlines() if line.startswith("CASES")]
    if not lines:
        raise SystemExit(f"{' '.join(families)}: {done.stderr.strip().splitlines()[-1:]}")
    cases = json.loads(lines[-1].removeprefix("CASES"))
    return len(cases), [each for each in cases if each["status"] == "fail"]


def result_of(copy: Path, model: WrongModel, kernels: Path) -> dict[str, Any]:
    """Row of the table: number of cases, of failing ones, and the failing case with the largest deviation."""
    with changed(copy, model):
        try:
            count, failing = failing_cases(copy, model.families, kernels)
        except SystemExit as error:
            print(f"{'ERROR':10} {model.name}: {error}", flush=True)
            raise
    worst = max(failing, key=lambda each: abs(each["deviation"]) / max(each["allowed"], 1e-300), default=None)
    print(
        f"{'killed' if failing else 'SURVIVED':10} {model.name}: {len(failing)} of {count} cases fail",
        flush=True,
    )
    return {
        "name": model.name, "small": model.small, "cases": count, "failing": len(failing),
        "worst": None if worst is None else {key: worst[key] for key in ("kind", "name", "deviation", "allowed")},
    }  # fmt: skip


def main() -> int:
    """Runs the wrong models; returns 1 if one is not killed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", help="names of wrong models; default: all")
    parser.add_argument(
        "--check", action="store_true", help="only check that the changes apply to the source"
    )
    options = parser.parse_args()
    chosen = [each for each in WRONG_MODELS if not options.names or each.name in options.names]
    stale = [
        f"{name} is not the name of a wrong model." for name in set(options.names) - {m.name for m in chosen}
    ]
    stale += problems(chosen)
    if stale:
        print("\n".join(stale), file=sys.stderr)
        return 1
    if options.check:
        print(f"{len(chosen)} wrong models fit the source.")
        return 0
    with tempfile.TemporaryDirectory() as folder:
        copy = copy_to(Path(folder) / "copy")
        kernels = Path(folder) / "kernels"
        families = sorted({family for each in chosen for family in each.families})
        failing = failing_cases(copy, families, kernels)[1]
        if failing:
            print("\n".join(f"Without an error, {each['name']} fails." for each in failing), file=sys.stderr)
            return 1
        rows = [result_of(copy, each, kernels) for each in chosen]
    surviving = [row["name"] for row in rows if not row["failing"]]
    print(
        f"{len(rows) - len(surviving)} of {len(rows)} killed"
        + (f"; not: {', '.join(surviving)}" if surviving else "")
    )
    write_page(rows)
    return 1 if surviving else 0


def write_page(rows: Sequence[dict[str, Any]]) -> None:
    """Replaces rows of the table of wrong models in the stored results and in the page of the
    documentation."""
    stored = json.loads(RESULTS.read_text(encoding="utf-8"))
    by_name = {row["name"]: row for row in (*stored.get("wrong_models", []), *rows)}
    stored["wrong_models"] = [by_name[each.name] for each in WRONG_MODELS if each.name in by_name]
    write_stored(PAGE, RESULTS, stored)


if __name__ == "__main__":
    sys.exit(main())
