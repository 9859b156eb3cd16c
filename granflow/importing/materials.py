"""Materials, pairs and contact models of a script: property/global, pair_style, pair_coeff and the models of
walls.

The contact models of a scene are the same for all pairs, its coefficients belong to pairs of materials. A
type of the script is one material for each density; a wall has the material of its type, or one of its own if
its model differs from that of the particles. Restitution is that of a collision in the code, attraction at
its end included.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import exp, inf, log, pi, radians, sqrt
from typing import Any

from granflow.contact.theory import damping_ratio_for
from granflow.importing.collisions import collision, free_restitution, plastic_collision, tsuji
from granflow.importing.deck import (
    Deck,
    Fix,
    ParticleGroup,
    Translation,
    Words,
    impossible,
    not_needed,
    plain_style,
)
from granflow.importing.language import Command, DeckError
from granflow.importing.report import APPROXIMATED, Entry
from granflow.importing.scene_text import Draft, plain_name, quantity
from granflow.io.tables import is_number
from granflow.schema.messages import nearest, suggestion_sentence

REFERENCE_DENSITY = 2500.0
"""Density [kg/m3] of the material of a wall whose type no particle has; no result depends on it."""
LEAST_RESTITUTION = 0.01
"""Smallest restitution that is written; viscous models do not have 0."""

LEAST_TENSION = 0.005
"""Loss of tangential velocity over the normal velocity of an impact, below which it is not reported."""

TWO_SCENES = "a scene for each, the second with start_from"
"""The nearest to contacts that change between runs."""

# Properties (LIGGGHTS)


@dataclass(frozen=True)
class Known:
    """A name of property/global: dimension of its numbers, and what becomes of it."""

    dimension: str = "number"
    use: str = ""
    """Key of the scene; empty for one that only some models read."""
    refused: str = ""
    """Why it has no counterpart."""


PROPERTIES: dict[str, Known] = {
    "youngsModulus": Known("pressure", "materials.NAME.young_modulus"),
    "poissonsRatio": Known("number", "materials.NAME.poisson_ratio"),
    "coefficientRestitution": Known("number", "pairs.NAME.restitution"),
    "coefficientFriction": Known("number", "pairs.NAME.friction"),
    "coefficientRollingFriction": Known("number", "pairs.NAME.rolling_friction"),
    "coefficientRollingViscousDamping": Known("number", "pairs.NAME.rolling_damping"),
    "coeffRollingStiffness": Known("number"),
    "rollingStiffness": Known("number", "contact.rolling"),
    "characteristicVelocity": Known("velocity", "contact.normal.stiffness.reference_velocity"),
    "cohesionEnergyDensity": Known("pressure", "pairs.NAME.cohesion_energy_density"),
    "coefficientMaxElasticStiffness": Known("number", "pairs.NAME.restitution"),
    "coefficientAdhesionStiffness": Known("number", "contact.normal.tension"),
    "coefficientPlasticityDepth": Known("number", "contact.normal.plasticity_depth"),
    "kn": Known("stiffness", "contact.normal.stiffness.value"),
    "kt": Known("stiffness", "contact.tangential.stiffness"),
    "gamman": Known("rate", "pairs.NAME.restitution"),
    "gammat": Known("rate", "contact.tangential.damping"),
    "gamman_abs": Known("damping", "pairs.NAME.restitution"),
    "gammat_abs": Known("damping", "contact.tangential.damping"),
    "surfaceTension": Known("surface_energy", "pairs.NAME.surface_tension"),
    "contactAngle": Known("number", "pairs.NAME.contact_angle"),
    "surfaceLiquidContentInitial": Known("number", "particles.NAME.liquid_content"),
    "fluidViscosity": Known("viscosity", "contact.cohesion.viscous_force.viscosity"),
    "minSeparationDistanceRatio": Known("number", "contact.cohesion.viscous_force.min_separation_ratio"),
    "maxSeparationDistanceRatio": Known("number"),
    "maxLiquidContent": Known("number"),
    "lbVolumeFraction": Known("number"),
    "thermalConductivity": Known("conductivity", "materials.NAME.thermal_conductivity"),
    "thermalCapacity": Known("heat_capacity", "materials.NAME.heat_capacity"),
    "youngsModulusOriginal": Known("pressure", "materials.NAME.true_young_modulus"),
    "thermalExpansion": Known(refused="thermal expansion is not simulated"),
    "k_finnie": Known("compliance", "walls.NAME.wear.coefficient"),
    "FluidViscosity": Known("viscosity"),
    "CriticalStokes": Known("number"),
    "MaximumRestitution": Known("number"),
}  # fmt: skip
"""Names of property/global."""


RANGES = {
    "youngsModulus": (1.0, 1e13),
    "kn": (1e-9, inf),
    "characteristicVelocity": (1e-9, inf),
    "poissonsRatio": (0.0, 0.5),
    "coefficientRestitution": (0.0, 1.0),
    "coefficientFriction": (0.0, inf),
    "coefficientRollingFriction": (0.0, inf),
    "surfaceTension": (0.0, inf),
    "contactAngle": (0.0, pi / 2.0),
    "maxSeparationDistanceRatio": (1.0, inf),
    "surfaceLiquidContentInitial": (0.0, inf),
    "fluidViscosity": (0.0, inf),
}
"""Least and largest number of a property, in SI units."""


@dataclass
class Property:
    """The numbers of one property/global in SI units: one, one per type, or one per pair of types."""

    form: str
    numbers: tuple[float, ...]
    columns: int
    entry: Entry
    is_used: bool = False

    def of(self, first: int, second: int | None = None) -> float:
        """The number of a type, or of two types. Raises IndexError for a type without one."""
        self.is_used = True
        if self.form == "scalar":
            return self.numbers[0]
        if self.form == "peratomtype":
            return self.numbers[first - 1]
        return self.numbers[(first - 1) * self.columns + (second or first) - 1]


def property_global(deck: Deck, fix: Fix) -> None:
    """fix ID group property/global NAME scalar|vector|peratomtype|peratomtypepair [N] NUMBERS"""
    words = Words(deck, fix.entry.command, fix.words)
    name = words.word("the name of the property")
    form = words.word("scalar, peratomtype or peratomtypepair")
    if form not in (
        "scalar",
        "vector",
        "peratomtype",
        "atomtype",
        "peratomtypepair",
        "atomtypepair",
        "matrix",
    ):
        raise DeckError(
            fix.entry.command,
            f"property/global has no form {form}; it has scalar, peratomtype and peratomtypepair.",
        )
    form = {"atomtype": "peratomtype", "atomtypepair": "peratomtypepair"}.get(form, form)
    known = PROPERTIES.get(name)
    if known is None:
        fix.entry.impossible(f"the property {name} is not known", nearest(name, list(PROPERTIES)) or "")
        return
    if known.refused:
        fix.entry.impossible(known.refused, "mechanics without it (--partial)")
        return
    columns = words.whole("the number of types") if form in ("peratomtypepair", "matrix") else 1
    numbers = []
    while words:
        numbers.append(words.number(f"a number of {name}", known.dimension))
    low, high = RANGES.get(name, (-inf, inf))
    outside = next((each for each in numbers if not low <= each <= high), None)
    if outside is not None:
        unit = f" rad ({outside:g} degrees are {radians(outside):.4g} rad)" if name == "contactAngle" else ""
        raise DeckError(
            fix.entry.command, f"{name} has the number {outside:g}; give one from {low:g} to {high:g}{unit}."
        )
    needed = {"scalar": 1, "peratomtypepair": columns * columns}.get(form, len(numbers))
    if len(numbers) != needed or not numbers:
        raise DeckError(
            fix.entry.command,
            f"{name} has {len(numbers)} numbers, but {form} needs {needed or 'at least one'}.",
        )
    if form == "peratomtypepair":
        for i in range(columns):
            for j in range(i):
                if numbers[i * columns + j] != numbers[j * columns + i]:
                    raise DeckError(
                        fix.entry.command,
                        f"{name} is not symmetric: types {j + 1} and {i + 1} have two different numbers.",
                    )
    properties: dict[str, Property] = deck.own("properties", dict)
    before = properties.get(name)
    if before is not None and deck.time > 0.0 and before.numbers != tuple(numbers):
        fix.entry.impossible(f"{name} that changes at {deck.time:g} s", TWO_SCENES)
    properties[name] = Property(form, tuple(numbers), columns, fix.entry)


def needed(deck: Deck, name: str, model: "Model") -> Property:
    """A property that a model needs. Raises DeckError."""
    found: Property | None = deck.own("properties", dict).get(name)
    if found is None:
        raise DeckError(
            model.entry.command,
            f"{model.text} needs fix property/global {name}, which the script does not give.",
        )
    return found


# Models of contacts


@dataclass
class Model:
    """What a pair style or a wall says on contacts.

    normal, tangential, rolling, twisting, cohesion:  names in the script; "none" without
    numbers:                                          arguments by name (LAMMPS), in SI units
    options:                                          keywords with on or off (LIGGGHTS)
    """

    normal: str
    tangential: str
    entry: Entry
    text: str
    rolling: str = "none"
    twisting: str = "none"
    cohesion: str = "none"
    damping: str = ""
    numbers: dict[str, float] = field(default_factory=dict)
    options: dict[str, bool] = field(default_factory=dict)

    @property
    def styles(self) -> tuple[str, ...]:
        """The names of its parts."""
        return (self.normal, self.tangential, self.rolling, self.twisting, self.cohesion, self.damping)

    @property
    def key(self) -> tuple[Any, ...]:
        """What distinguishes models."""
        return (
            *self.styles,
            *(tuple(sorted(self.numbers.items())), tuple(sorted(self.options.items()))),
        )


def _mixed(first: Model, second: Model) -> Model:
    """The model of two types by the rule of LAMMPS: geometric means, and the effective modulus of both."""
    numbers = {name: sqrt(value * second.numbers[name]) for name, value in first.numbers.items()}
    if "E" in numbers:
        compliance = sum((1.0 - each.numbers["nu"] ** 2) / each.numbers["E"] for each in (first, second))
        numbers["E"] = 2.0 * (1.0 - numbers["nu"] ** 2) / compliance
    return replace(first, numbers=numbers)


@dataclass
class WallContact:
    """The contact of particles with walls of one type and model; `build` gives it a material.

    others:  the fixes of further walls with this model, which refer to the remarks on the first one
    """

    type: int
    model: Model
    material: str = ""
    others: list[Entry] = field(default_factory=list)


def wall_contact(deck: Deck, model: Model, type: int) -> WallContact:
    """The contact of a wall; the same object for the same model and type."""
    contacts: list[WallContact] = deck.own("wall_contacts", list)
    same = [each for each in contacts if each.model.key == model.key]
    if same:
        first = same[0]
        if model.entry is not first.model.entry and not any(each is model.entry for each in first.others):
            first.others.append(model.entry)
        model = replace(model, entry=first.model.entry)
    for each in same:
        if each.type == type:
            return each
    contacts.append(WallContact(type, model))
    return contacts[-1]


NORMALS = ("hertz", "hooke", "hooke/stiffness", "hertz/stiffness", "hooke/hysteresis")
"""Normal models of LIGGGHTS with a counterpart."""
TANGENTIALS = ("history", "incremental_history", "no_history", "off")
COHESIONS = ("off", "sjkr", "sjkr2", "easo/capillary/viscous")
ROLLINGS = ("off", "cdt", "epsd", "epsd2", "epsd3")
OPTIONS = (
    *("tangential_damping", "limitForce", "absolute_damping", "ktToKnUser", "tangential_reduce"),
    *("torsionTorque", "computeDissipatedEnergy", "computeElasticPotential", "disableNormalWhenBonded"),
    *("heating_normal_hertz", "heating_normal_hooke", "heating_tangential_history", "heating"),
)


UNLIKE = {
    "ktToKnUser": (
        "a ratio of the stiffnesses that is given (ktToKnUser)",
        "contact.tangential.stiffness_factor of the scene",
    ),
    "torsionTorque": (
        "rolling friction of rotations about the normal (torsionTorque)",
        "contact.twisting: marshall, or torsionTorque off",
    ),
}
"""Options without counterpart if they are on."""


def option(words: Words, key: str, entry: Entry) -> bool:
    """Read whether an option of a model is on."""
    is_on = words.flag(key)
    if is_on and key in UNLIKE:
        entry.impossible(*UNLIKE[key])
    return is_on


OLD_NAMES = tuple(
    f"{normal}{tangential}{kind}"
    for normal in ("hertz", "hooke")
    for tangential in ("", "/history")
    for kind in ("", "/stiffness", "/simple")
)
"""Models of LIGGGHTS 1 and 2 in the names of styles such as pair_style gran/hertz/history."""


def named_model(deck: Deck, words: Words, entry: Entry, name: str, stop: Sequence[str] = ()) -> Model:
    """Read what follows a style of LIGGGHTS 1 and 2: keywords, or two flags (LIGGGHTS 1).

    The manual of LIGGGHTS (tutorials on the syntax of 2.0 and 3.0) has their translation: the first flag is 1
    for tangential damping, 2 for rolling friction (cdt), 3 for both, the second one is 1 for cohesion (sjkr).
    """
    parts = name.split("/")
    normal = parts[0] + ("/stiffness" if {"stiffness", "simple"} & set(parts) else "")
    chosen = {"tangential": "history" if "history" in parts else "no_history"}
    options: dict[str, bool] = {}
    if words.next.isdigit():
        first = words.whole_between("the flag of damping and rolling friction", 0, 3)
        options["tangential_damping"] = first in (1, 3)
        chosen["rolling_friction"] = "cdt" if first >= 2 else "off"
        chosen["cohesion"] = "sjkr" if words.whole_between("the flag of cohesion", 0, 1) else "off"
    return liggghts_model(deck, words, entry, stop, normal, chosen, options)


def liggghts_model(
    deck: Deck,
    words: Words,
    entry: Entry,
    stop: Sequence[str] = (),
    normal: str = "",
    given: Mapping[str, str] | None = None,
    options: dict[str, bool] | None = None,
) -> Model:
    """Read `model hertz tangential history ...` up to one of the words `stop`; the last arguments are what a
    style of LIGGGHTS 1 and 2 says before."""
    start = words.at
    chosen = {"tangential": "off", "cohesion": "off", "rolling_friction": "off", "surface": "default"}
    chosen |= given or {}
    options = dict(options or {})
    while words and words.next not in stop:
        key = words.word("a keyword")
        if key == "model":
            normal = words.word("the name of the normal model")
        elif key in chosen:
            chosen[key] = words.word(f"the name of the {key} model")
        elif key == "viscous":
            if words.word("off or stokes") not in ("off", "no"):
                entry.impossible("restitution that depends on a Stokes number", "viscous off")
        elif key in OPTIONS:
            options[key] = option(words, key, entry)
        else:
            remedy = suggestion_sentence(key, ["model", *chosen, *OPTIONS], "keywords")
            raise DeckError(entry.command, f"contact models have no keyword {key}. {remedy}")
    for kind, name, known in (
        ("normal", normal, NORMALS),
        ("tangential", chosen["tangential"], TANGENTIALS),
        ("cohesion", chosen["cohesion"], COHESIONS),
        ("rolling friction", chosen["rolling_friction"], ROLLINGS),
    ):
        if name not in known:
            entry.impossible(f"the {kind} model {name}", f"one of {', '.join(known)}")
    if chosen["surface"] not in ("default", "sphere"):
        entry.impossible(f"surface {chosen['surface']}", "spheres without corrections")
    off = {"off": "none"}
    if chosen["tangential"] == "incremental_history" and not normal.startswith("hertz"):
        chosen["tangential"] = "history"  # equal with a constant stiffness
    return Model(
        normal=normal if normal in NORMALS else "hertz",
        tangential=off.get(chosen["tangential"], chosen["tangential"]),
        entry=entry,
        text=" ".join(words.words[start : words.at]),
        rolling=off.get(chosen["rolling_friction"], chosen["rolling_friction"]),
        cohesion=off.get(chosen["cohesion"], chosen["cohesion"]),
        options=options,
    )


def with_part(model: Model, words: Words, entry: Entry, key: str) -> Model:
    """The model of a wall with the rolling friction or cohesion that follows its shape (LIGGGHTS 2)."""
    known = ROLLINGS if key == "rolling_friction" else COHESIONS
    name = words.word(f"the name of the {key} model")
    if name not in known:
        entry.impossible(f"the {key} model {name}", f"one of {', '.join(known)}")
    name = "none" if name == "off" else name
    return replace(model, rolling=name) if key == "rolling_friction" else replace(model, cohesion=name)


def old_model(deck: Deck, words: Words, entry: Entry, style: str) -> Model:
    """Read `Kn Kt gamma_n gamma_t xmu dampflag` of gran/hooke, gran/hooke/history and gran/hertz/history."""
    is_hertz = style.startswith("hertz")
    kn = words.positive("Kn", "pressure" if is_hertz else "stiffness")
    kt = _or_default(words, "Kt", "pressure" if is_hertz else "stiffness", 2.0 / 7.0 * kn)
    gn = words.not_negative("gamma_n", "hertz_damping" if is_hertz else "rate")
    gt = _or_default(words, "gamma_t", "hertz_damping" if is_hertz else "rate", 0.5 * gn)
    mu = words.not_negative("xmu")
    damped = words.whole("dampflag")
    has_limit = words.next == "limit_damping"
    if has_limit:
        words.word("limit_damping")
    numbers = {"kn": kn, "kt": kt, "gn": gn, "gt": gt if damped else 0.0, "mu": mu}
    history = "history" if style.endswith("history") else "no_history"
    name = "hertz/stiffness" if is_hertz else "hooke/stiffness"
    options = {"limitForce": True} if has_limit else {}
    return Model(name, history, entry, style, numbers=numbers, options=options, damping="mass")


def _or_default(words: Words, what: str, dimension: str, default: float) -> float:
    """A number, or a default for NULL."""
    if words.next == "NULL":
        words.word(what)
        return default
    return words.number(what, dimension)


MINDLINS = ("mindlin", "mindlin/force", "mindlin_rescale", "mindlin_rescale/force")
"""Tangential models of granular (LAMMPS) whose stiffness grows with the contact."""
BY_NUMBER = ("tsuji", "coeff_restitution")
"""Damping models of granular (LAMMPS) whose number gives a restitution for each size and velocity."""
DAMPINGS = (*BY_NUMBER, "viscoelastic", "velocity", "mass_velocity")
"""Damping models of granular (LAMMPS) with a counterpart."""


def granular_model(deck: Deck, words: Words, entry: Entry, stop: Sequence[str] = ()) -> Model:
    """Read the sub-models of `granular` (LAMMPS), up to one of the words `stop`."""
    normal = words.word("the normal model")
    numbers: dict[str, float] = {}
    options: dict[str, bool] = {}
    tangential, rolling, twisting, damping, cohesion = "none", "none", "none", "viscoelastic", "none"
    if normal == "hooke":
        numbers["kn"] = words.positive("k_n", "stiffness")
        numbers["eta"] = words.not_negative("eta_n0")
    elif normal == "hertz":
        numbers["kn"] = words.positive("k_n", "pressure")
        numbers["eta"] = words.not_negative("eta_n0")
    elif normal in ("hertz/material", "dmt", "jkr"):
        numbers["E"] = words.positive("E", "pressure")
        numbers["eta"] = words.not_negative("eta_n0")
        numbers["nu"] = _poisson_ratio(words)
        if normal != "hertz/material":
            cohesion = normal
            numbers["gamma"] = words.not_negative("gamma", "surface_energy")
    else:
        entry.impossible(f"the normal model {normal}", "hooke, hertz, hertz/material, dmt or jkr")
        while words and words.next not in stop:
            words.word("a word")
        return Model("hertz", "none", entry, normal, numbers={"mu": 0.0, "E": 1e7, "nu": 0.3, "eta": 0.5})
    while words and words.next not in stop:
        key = words.word("a keyword")
        if key == "tangential":
            tangential = words.word("the tangential model")
            if tangential == "linear_nohistory":
                numbers["xt"], numbers["mu"] = words.not_negative("x_gamma,t"), words.not_negative("mu_s")
            elif tangential == "linear_history":
                numbers["kt"] = words.not_negative("k_t", "stiffness")
                numbers["xt"], numbers["mu"] = words.not_negative("x_gamma,t"), words.not_negative("mu_s")
            elif tangential in MINDLINS:
                if words.next == "NULL":
                    words.word("k_t")
                else:
                    numbers["kt"] = words.not_negative("k_t", "pressure")
                numbers["xt"], numbers["mu"] = words.not_negative("x_gamma,t"), words.not_negative("mu_s")
            else:
                entry.impossible(f"the tangential model {tangential}", f"linear_history or {MINDLINS[0]}")
                _skip_numbers(words)
        elif key == "rolling":
            rolling = words.word("the rolling model")
            if rolling == "sds":
                numbers["kr"] = words.not_negative("k_roll", "stiffness")
                numbers["gr"] = words.not_negative("gamma_roll", "damping")
                numbers["mur"] = words.not_negative("mu_roll")
            elif rolling != "none":
                entry.impossible(f"the rolling model {rolling}", "rolling sds")
                rolling = "none"
                _skip_numbers(words)
        elif key == "twisting":
            twisting = words.word("the twisting model")
            if twisting == "sds":
                numbers["ktw"] = words.not_negative("k_twist", "torque")
                numbers["gtw"] = words.plain("gamma_twist")
                numbers["mutw"] = words.not_negative("mu_twist", "length")
            elif twisting not in ("none", "marshall"):
                entry.impossible(f"the twisting model {twisting}", "twisting marshall or sds")
                twisting = "none"
                _skip_numbers(words)
        elif key == "damping":
            damping = words.word("the damping model")
            if damping not in DAMPINGS:
                entry.impossible(f"damping {damping}", f"damping {', '.join(DAMPINGS)}")
                damping = "viscoelastic"
        elif key == "limit_damping":
            options["limitForce"] = True
        elif key == "cutoff":
            words.number("the cutoff", "length")
        elif key == "heat":
            if words.word("the heat model") != "none":
                words.number("the conductivity")
                entry.impossible("heat conduction", "mechanics without heat (--partial)")
        else:
            raise DeckError(entry.command, f"granular has no keyword {key}.")
    spring = "hooke/stiffness" if normal == "hooke" else "hertz/stiffness"
    if damping == "coeff_restitution" and not 0.0 <= numbers["eta"] <= 1.0:
        raise DeckError(
            words.command, f"the restitution is {numbers['eta']:g}; give a number from 0 to 1, such as 0.7."
        )
    if normal not in ("hooke", "hertz") and damping in BY_NUMBER:
        spring = "hertz"
    return Model(
        spring,
        tangential,
        entry,
        normal,
        rolling=rolling,
        twisting=twisting,
        cohesion=cohesion,
        damping=damping,
        numbers=numbers,
        options=options,
    )


def _skip_numbers(words: Words) -> None:
    """Read the numbers of a part of a model that is not known."""
    while is_number(words.next) or words.next == "NULL":
        words.word("a number")


def _poisson_ratio(words: Words) -> float:
    """The next word as a Poisson ratio. Raises DeckError."""
    found = words.number("nu")
    if not -1.0 < found <= 0.5:
        raise DeckError(
            words.command, f"nu is {found:g}; give a Poisson ratio above -1 and at most 0.5, such as 0.3."
        )
    return found


PAIR_STYLES = ("gran", "gran/hooke", "gran/hooke/history", "gran/hertz/history", "granular")
"""Pair styles with contact forces."""


def pair_style(deck: Deck, command: Command, entry: Entry) -> None:
    """pair_style gran ... | gran/hooke[/history] ... | gran/hertz/history ... | granular | hybrid STYLE "
    "..."""
    words = Words(deck, command, command.words)
    style = words.word("the name of the pair style")
    if style in ("hybrid", "hybrid/overlay"):
        style = words.word("the name of a pair style")
    style = plain_style(style, PAIR_STYLES)
    if deck.family.get("pair_style") == "soft":
        deck.drop_separating_runs()
    before: Model | None = deck.family.get("model")
    deck.family["pair_style"] = style
    if style == "gran":
        deck.family["model"] = liggghts_model(deck, words, entry)
    elif deck.code == "liggghts" and style.removeprefix("gran/") in OLD_NAMES:
        deck.family["model"] = named_model(deck, words, entry, style.removeprefix("gran/"))
    elif style.startswith("gran/") and style in PAIR_STYLES:
        deck.family["model"] = old_model(deck, words, entry, style.removeprefix("gran/"))
        if words:
            entry.impossible(f"the further style {words.next}", "one granular style")
    elif style == "granular":
        deck.family["pair_entry"] = entry
        deck.own("pair_models", dict)
        if is_number(words.next):
            words.word("the cutoff")
        if words:
            entry.impossible(f"the further style {words.next}", "one granular style")
    elif style == "soft":
        words.skip()
        deck.own("relaxations", list).append(
            (entry, "the pair style soft", "kind: pack, which inserts without overlap")
        )
    elif style in ("none", "zero"):
        words.skip()
        deck.family.pop("model", None)
        deck.family.pop("pair_models", None)
        deck.family["pair_entry"] = entry
    else:
        entry.impossible(
            f"the pair style {style}", "gran, gran/hooke/history, gran/hertz/history or granular"
        )
    after: Model | None = deck.family.get("model")
    if before is not None and deck.time > 0.0 and (after is None or after.key != before.key):
        entry.impossible(f"contact models that change at {deck.time:g} s", TWO_SCENES)


def pair_coeff(deck: Deck, command: Command, entry: Entry) -> None:
    """pair_coeff I J [MODELS of granular]"""
    words = Words(deck, command, command.words)
    first, second = words.word("a type"), words.word("a type")
    deck.family["has_pair_coeff"] = True
    if plain_style(words.next, PAIR_STYLES) in PAIR_STYLES:
        words.word("the style")
    if deck.family.get("pair_style") == "soft":
        words.skip()
        entry.not_needed("the soft pair style separates random particles, see its line")
        return
    if "pair_models" not in deck.family or not words:
        entry.not_needed("the coefficients are in pair_style and the properties")
        return
    model = granular_model(deck, words, entry)
    for i in _types(deck, first, command):
        for j in _types(deck, second, command):
            models: dict[tuple[int, int], Model] = deck.family["pair_models"]
            before = models.get((min(i, j), max(i, j)))
            if before is not None and deck.time > 0.0 and before.key != model.key:
                entry.impossible(f"coefficients that change at {deck.time:g} s", TWO_SCENES)
            models[min(i, j), max(i, j)] = model


def _types(deck: Deck, text: str, command: Command) -> range:
    """The types of a range such as 1, *, 2* or 1*3."""
    low, star, high = text.partition("*")
    try:
        first = int(low) if low else 1
        last = (int(high) if high else deck.types) if star else first
    except ValueError:
        raise DeckError(command, f"{text} is not a type; give a number or a range such as 1*2.") from None
    return range(first, last + 1)


# Bodies in contact


def largest_bridge(radii: Iterable[float]) -> float:
    """Largest volume [m3] of a bridge between spheres of some radii [m] whose films have their own volume.

    Each gives the film of the cap that faces the partner: (1 - sqrt(1 - (r / (R + r))^2)) / 2 of it.
    """

    def given(radius: float, partner: float) -> float:
        share = 0.5 * (1.0 - sqrt(1.0 - (partner / (radius + partner)) ** 2))
        return share * 4.0 / 3.0 * pi * radius**3

    kinds = set(radii)
    return max(given(a, b) + given(b, a) for a in kinds for b in kinds)


@dataclass(frozen=True)
class Sort:
    """One material of particles: type and density, with the extreme radii [m] of its particles and the mean
    by mass."""

    name: str
    type: int
    density: float
    radii: tuple[float, float]
    radius: float

    def mass(self, radius: float) -> float:
        """Mass [kg] of a sphere."""
        return self.density * 4.0 / 3.0 * pi * radius**3


def effective(first: Sort, second: Sort | None, a: float, b: float) -> tuple[float, float]:
    """Effective radius [m] and mass [kg] of spheres of radii a and b; a wall (None) is infinite."""
    if second is None:
        return a, first.mass(a)
    m, n = first.mass(a), second.mass(b)
    return a * b / (a + b), m * n / (m + n)


def _dashpot_ratio(model: Model) -> float | None:
    """Tangential over normal dashpot of a model whose numbers are in its line; None for others."""
    if "xt" in model.numbers:
        return model.numbers["xt"]
    return model.numbers["gt"] / model.numbers["gn"] if model.numbers.get("gn") else None


def _approximations(entry: Entry) -> int:
    """Number of remarks on differences."""
    return sum(each.kind == APPROXIMATED for each in entry.remarks)


MOST_SIZES = 6
"""Most sizes of one insertion that become materials of their own."""


def is_by_size(deck: Deck) -> bool:
    """Whether the restitution of a model of the script depends on the size of the particles, so that each
    size has a material."""
    models = [deck.family.get("model"), *deck.family.get("pair_models", {}).values()]
    models += [each.model for each in deck.own("wall_contacts", list)]
    return any(
        ("E" in each.numbers or each.normal not in ("hertz", "hooke"))
        and each.damping not in BY_NUMBER
        and each.normal != "hooke/hysteresis"
        for each in models
        if each is not None
    )


def _sort_of(deck: Deck, group: ParticleGroup) -> tuple[int, float, float]:
    """What distinguishes the materials of groups: type, density, and the radius [m] of groups of one size if
    the restitution depends on it, otherwise 0."""
    has_size = is_by_size(deck) and group.radii[0] == group.radii[1] and "clump" not in group.keys
    return group.type, group.density, group.radii[0] if has_size else 0.0


def sorts_of(deck: Deck) -> list[Sort]:
    """The materials of the particles, in the order of the groups."""
    found: dict[tuple[int, float, float], list[ParticleGroup]] = {}
    for each in deck.particles:
        found.setdefault(_sort_of(deck, each), []).append(each)
    sorts = []
    for (type, density, size), groups in found.items():
        same = [key for key in found if key[0] == type]
        parts = [f"type{type}"]
        parts += [f"{density:g}"] if any(each[1] != density for each in same) else []
        parts += [f"{2e3 * size:.4g}mm"] if size and any(each[2] != size for each in same) else []
        name = parts[0] if len(parts) == 1 else plain_name("_".join(parts), "type")
        radii = [radius for each in groups for radius in each.radii]
        radius = sum(each.radius for each in groups) / len(groups)
        sorts.append(Sort(name, type, density, (min(radii), max(radii)), radius))
    return sorts


# The blocks


def build(deck: Deck, draft: Draft) -> None:
    """Write the blocks materials, pairs and contact; give groups and walls their materials."""
    sorts = sorts_of(deck)
    deck.family["sorts"] = {_sort_of(deck, each): None for each in deck.particles}
    deck.family["sorts"] = dict(zip(deck.family["sorts"], (each.name for each in sorts), strict=True))
    model = deck.family.get("model")
    models: dict[tuple[int, int], Model] = deck.family.get("pair_models", {})
    walls: list[WallContact] = deck.own("wall_contacts", list)
    if model is None and not models:
        entry = deck.family.get("pair_entry") or deck.runs[-1].entry
        if deck.family.get("pair_style") == "granular":
            raise DeckError(
                entry.command,
                "no pair_coeff gives the models of pair_style granular; give one, such as pair_coeff * * "
                "hertz/material 1e7 0.5 0.3 tangential mindlin NULL 1.0 0.5.",
            )
        if not walls:
            raise DeckError(
                entry.command, "no pair_style with contact forces precedes the end of the script."
            )
        model = walls[0].model
        entry.impossible(
            "particles without contacts with each other",
            f"a pair_style; --partial takes the model of {model.entry.command.where} for all contacts",
        )
    elif model is not None and "has_pair_coeff" not in deck.family:
        model.entry.approximated(
            "the code requires pair_coeff * *, which the script does not give; the scene has the "
            "coefficients of this line"
        )
    translator = Contacts(deck, sorts, model, models, walls)
    translator.write(draft)


def report_properties(deck: Deck) -> None:
    """Tell the properties what became of them, when all blocks are written."""
    for name, each in deck.own("properties", dict).items():
        if each.is_used and PROPERTIES[name].use:
            each.entry.translated(PROPERTIES[name].use)
        elif not each.is_used:
            each.entry.not_needed(f"no contact model of the script reads {name}")


def material_of(deck: Deck, group: ParticleGroup) -> str:
    """Name of the material of a group, after `build`."""
    return str(deck.family["sorts"][_sort_of(deck, group)])


@dataclass
class Contacts:
    """Translates the models of a deck: one set of contact laws, moduli of materials, coefficients of "
    "pairs."""

    deck: Deck
    sorts: list[Sort]
    model: Model | None
    models: dict[tuple[int, int], Model]
    walls: list[WallContact]
    stated: dict[tuple[int, str], tuple[Entry, list[str]]] = field(default_factory=dict)
    """Keys of pairs by the entry of their model and what is said on their restitution."""
    tensions: list[tuple[float, str, Entry]] = field(default_factory=list)
    """Change of the tangential velocity by friction during tension, over the normal velocity of an impact
    on a wall; pair and entry of its model."""

    def __post_init__(self) -> None:
        first = self.sorts[0] if self.sorts else Sort("type1", 1, REFERENCE_DENSITY, (1e-3, 1e-3), 1e-3)
        self.first = first
        self.main = self.of(first.type, first.type)
        self.speed = self._reference_speed()

    def of(self, i: int, j: int) -> Model:
        """The model of two types. Raises DeckError for types without one."""
        if self.model is not None:
            return self.model
        found = self.models.get((min(i, j), max(i, j)))
        if found is not None:
            return found
        own = [each for each in (self.models.get((i, i)), self.models.get((j, j))) if each is not None]
        if (
            len(own) == 2
            and own[0].styles == own[1].styles
            and own[0].numbers.keys() == own[1].numbers.keys()
        ):
            return _mixed(*own)
        mixed = own[0] if own else None
        if mixed is None:
            entry = self.deck.family["pair_entry"]
            raise DeckError(entry.command, f"no pair_coeff is given for the types {i} and {j}.")
        mixed.entry.approximated(f"the types {i} and {j} have no pair_coeff; those of one of them are taken")
        return mixed

    def _reference_speed(self) -> float:
        """A velocity [m/s] of impacts, for restitutions that depend on it: half of a fall through the box."""
        gravity = next((fix.data for fix in self.deck.fixes_of("gravity") if fix.data), (0.0, 0.0, 0.0))
        box = self.deck.box or (0.0,) * 6
        height = sum(abs(g) * abs(box[2 * k + 1] - box[2 * k]) for k, g in enumerate(gravity))
        return 0.5 * sqrt(2.0 * height) or 1.0

    # Writing

    def write(self, draft: Draft) -> None:
        """Write all three blocks."""
        before = [_approximations(wall.model.entry) for wall in self.walls]
        self._name_walls()
        for sort in self.sorts:
            draft.put(("materials", sort.name), self._material(self._moduli(sort.type), sort.density))
        for wall in self.walls:
            if wall.material not in (draft.get("materials") or {}):
                moduli = self._wall_moduli(wall)
                draft.put(("materials", wall.material), self._material(moduli, self._density(wall.type)))
        draft.put(("contact",), self._contact(), self.main.entry)
        for index, first in enumerate(self.sorts):
            for second in self.sorts[index:]:
                model = self.of(first.type, second.type)
                self._pair(draft, f"{first.name}-{second.name}", model, first, second, second.type)
        for first in self.sorts:
            for wall in self.walls:
                key = f"{first.name}-{wall.material}"
                given = draft.get("pairs") or {}
                if key not in given and f"{wall.material}-{first.name}" not in given:
                    self._pair(draft, key, wall.model, first, None, wall.type)
        for (_, text), (entry, keys) in self.stated.items():
            entry.translated(f"restitution of pairs.{', '.join(keys)}: {text}")
        self._remark_on_tension()
        for wall, count in zip(self.walls, before, strict=True):
            if _approximations(wall.model.entry) > count:
                for entry in wall.others:
                    entry.approximated(f"the contacts differ as those of {wall.model.entry.command.where}")

    def _name_walls(self) -> None:
        """Give each wall contact the name of its material."""
        count = 0
        for wall in self.walls:
            own = [each for each in self.sorts if each.type == wall.type]
            is_own = wall.model.normal.endswith("/stiffness")  # its restitution depends on the mass
            is_own = is_own or wall.model.cohesion == "sjkr2"  # whose contact area is another one at walls
            if (
                self.deck.code == "liggghts"
                and self.model
                and wall.model.key == self.model.key
                and not is_own
            ):
                wall.material = own[0].name if own else f"type{wall.type}"
                continue
            same = next(
                (
                    each
                    for each in self.walls
                    if each is not wall
                    and each.material
                    and each.model.key == wall.model.key
                    and each.type == wall.type
                ),
                None,
            )
            count += same is None
            wall.material = same.material if same else ("wall" if count == 1 else f"wall_{count}")

    def _density(self, type: int) -> float:
        found = [each.density for each in self.sorts if each.type == type]
        return found[0] if found else (self.sorts[0].density if self.sorts else REFERENCE_DENSITY)

    @staticmethod
    def _material(moduli: tuple[float, float], density: float) -> dict[str, Any]:
        young, poisson = moduli
        return {
            "young_modulus": quantity(young, "pressure"),
            "poisson_ratio": poisson,
            "density": density,
        }

    # Moduli

    def _number(self, name: str, model: Model, i: int, j: int | None = None) -> float:
        """A property of the script by type. Raises DeckError for a type without one."""
        found = needed(self.deck, name, model)
        try:
            return found.of(i, j)
        except IndexError:
            raise DeckError(found.entry.command, f"{name} has no number for type {max(i, j or 1)}.") from None

    def _moduli(self, type: int) -> tuple[float, float]:
        """Young's modulus [Pa] and Poisson ratio of a type."""
        model = self.of(type, type)
        if "E" in model.numbers:
            return model.numbers["E"], model.numbers["nu"]
        if model.normal in ("hooke/stiffness", "hertz/stiffness"):
            return self._moduli_of(model, type, type)
        young = self._number("youngsModulus", model, type)
        poisson = self._number("poissonsRatio", model, type)
        if model.normal in ("hooke", "hooke/hysteresis"):
            # kt = kn: with nu = 0 and the same plane-strain modulus the ratio 4 G*/E* is 1.
            self._remark_on_modulus(type, young, poisson)
            return young / (1.0 - poisson**2), 0.0
        return young, poisson

    def _remark_on_modulus(self, type: int, young: float, poisson: float) -> None:
        """Say which modulus of a type gives the stiffness of the model hooke without a Poisson ratio."""
        if poisson:
            properties = self.deck.own("properties", dict)
            for name in ("youngsModulus", "poissonsRatio"):
                properties[name].entry.translated(
                    "E / (1 - nu^2) with the Poisson ratio 0 has the normal stiffness of the model hooke and "
                    "its kt = kn",
                    f"type {type}: {young / (1.0 - poisson**2):.6g} Pa",
                )

    def _moduli_of(self, model: Model, i: int, j: int) -> tuple[float, float]:
        """Moduli for the stiffnesses of a model: those that give kt/kn, and for a Hertz spring kn.

        4 G*/E* = 2 (1 - nu) / (2 - nu), so that nu = (2 - 2 r) / (2 - r) for the ratio r of the stiffnesses.
        """
        limited = min(max(self._ratio_of_stiffnesses(model, i, j), 2.0 / 3.0), 1.3)
        poisson = round((2.0 - 2.0 * limited) / (2.0 - limited), 12) + 0.0
        is_hertz = model.normal == "hertz/stiffness"
        modulus_eff = 0.75 * self._stiffness("kn", model, i, j) if is_hertz else 5e6
        return 2.0 * (1.0 - poisson**2) * modulus_eff, poisson

    def _ratio_of_stiffnesses(self, model: Model, i: int, j: int) -> float:
        """Kt / Kn of a contact, the second of the loading: kt / kn, for Hertz springs over 1.5."""
        ratio = self._stiffness("kt", model, i, j) / self._stiffness("kn", model, i, j)
        return ratio / (1.5 if model.normal == "hertz/stiffness" else 1.0)

    def _stiffness_factor(self, model: Model, i: int) -> float:
        """Tangential stiffness of the script over the no-slip one of the moduli, for contacts of a type."""
        if model.tangential in ("none", "no_history"):
            return 1.0
        if "E" in model.numbers:
            young, poisson = model.numbers["E"], model.numbers["nu"]
            no_slip = 2.0 * young / ((2.0 - poisson) * (1.0 + poisson))
            return model.numbers.get("kt", no_slip) / no_slip
        if model.normal != "hertz/stiffness":
            return 1.0
        poisson = self._moduli_of(model, i, i)[1]
        return self._ratio_of_stiffnesses(model, i, i) * (2.0 - poisson) / (2.0 - 2.0 * poisson)

    def _stiffness(self, name: str, model: Model, i: int, j: int) -> float:
        """kn or kt of a model with numbers; those of hertz/stiffness are pressures [Pa]."""
        if name in model.numbers:
            return model.numbers[name]
        if name == "kt" and "kn" in model.numbers:  # granular without a tangential stiffness
            return model.numbers["kn"]
        found = self._number(name, model, i, j)
        if model.normal == "hertz/stiffness":  # read as a stiffness
            return found * self.deck.si(1.0, "pressure") / self.deck.si(1.0, "stiffness")
        return found

    def _wall_moduli(self, wall: WallContact) -> tuple[float, float]:
        """Moduli of the material of a wall, such that the contact has the stiffness of its model."""
        model = wall.model
        if self.deck.code == "liggghts" and not model.numbers:
            saved, self.model = self.model, model
            try:
                return self._moduli(wall.type)
            finally:
                self.model = saved
        young, poisson = self._moduli(self.first.type)
        if "E" in model.numbers:
            wanted = model.numbers["E"] / (2.0 * (1.0 - model.numbers["nu"] ** 2))
            poisson_wall = model.numbers["nu"]
        elif model.normal == "hertz/stiffness":
            equal, poisson_wall = self._moduli_of(model, wall.type, wall.type)
            wanted = equal / (2.0 * (1.0 - poisson_wall**2))
        else:
            return young, poisson
        rest = 1.0 / wanted - (1.0 - poisson**2) / young
        if rest <= 0.0:
            model.entry.approximated("the wall is stiffer than a rigid one with these particles; it is rigid")
            rest = 1e-6 / wanted
        for sort in self.sorts:
            young, poisson = self._moduli(sort.type)
            ratio = 1.0 / (rest + (1.0 - poisson**2) / young) / wanted
            if abs(ratio - 1.0) > 0.02:
                model.entry.approximated(
                    f"contacts of {sort.name} with the wall have {ratio:.3g} times the stiffness of the "
                    "script, in which it does not depend on the particle"
                )
        return (1.0 - poisson_wall**2) / rest, poisson_wall

    # Contact laws

    def _contact(self) -> dict[str, Any]:
        """The block `contact`, from the model of the first material."""
        models = [self.of(a.type, b.type) for k, a in enumerate(self.sorts) for b in self.sorts[k:]]
        models += [each.model for each in self.walls]
        main = self.main
        for each in models:
            if (each.normal, each.tangential) != (main.normal, main.tangential):
                each.entry.approximated(
                    f"the contact laws are those of {main.entry.command.where} for all contacts: "
                    f"{main.normal} and {main.tangential}, here {each.normal} and {each.tangential}"
                )
            self._remark_on_parts(each, models)
            if each.options.get("tangential_damping", True) != main.options.get("tangential_damping", True):
                each.entry.approximated(
                    f"the tangential dashpot is that of {main.entry.command.where} for all contacts"
                )
        contact: dict[str, Any] = {"normal": self._normal(main), "tangential": self._tangential(main)}
        rolling = next((each.rolling for each in models if each.rolling != "none"), "none")
        contact["rolling"] = {"epsd2": "epsd", "epsd": "sds", "epsd3": "sds", "cdt": "cdt", "sds": "sds"}.get(
            rolling, "none"
        )
        twisting = next((each for each in models if each.twisting != "none"), None)
        if twisting is not None and twisting.twisting == "marshall":
            contact["twisting"] = "marshall"
            for each in models:
                if each.twisting == "none":
                    each.entry.approximated("twisting marshall acts in all contacts, also in these")
        elif twisting is not None:
            contact["twisting"] = {
                "law": "torsion_spring",
                "stiffness": twisting.numbers["ktw"],
                "damping": twisting.numbers["gtw"],
            }
        cohesion = next((each for each in models if each.cohesion != "none"), None)
        if cohesion is not None:
            contact["cohesion"] = self._cohesion(cohesion)
        return contact

    def _remark_on_parts(self, model: Model, models: Sequence[Model]) -> None:
        """Say which part of a model is that of another one: the scene has one law for all contacts."""
        for part in ("rolling", "twisting", "cohesion"):
            own = getattr(model, part)
            taken = next((getattr(each, part) for each in models if getattr(each, part) != "none"), "none")
            if own not in ("none", taken):
                model.entry.approximated(f"the {part} law is {taken} for all contacts, here {own}")

    def _remark_on_coefficients(self, key: str, model: Model, i: int, j: int) -> None:
        """Say how the coefficients of a pair differ from those that the scene has once for all pairs."""
        main, first = self.main, self.first.type
        if model.normal != main.normal:
            return
        compared: list[tuple[str, float, float]] = []
        if model.normal == "hooke/stiffness":
            names = ["kn"] if model.tangential == "no_history" else ["kn", "kt"]
            for name in names:
                taken, own = (self._stiffness(name, *each) for each in ((main, first, first), (model, i, j)))
                compared.append((f"stiffness {name} [N/m]", taken, own))
        if model.normal == "hooke/hysteresis":
            for name in ("coefficientPlasticityDepth", "coefficientAdhesionStiffness"):
                taken, own = (self._number(name, *each) for each in ((main, first, first), (model, i, j)))
                compared.append((name, taken, own))
        ratio, own_ratio = _dashpot_ratio(main), _dashpot_ratio(model)
        if ratio is not None and own_ratio is not None:
            compared.append(("ratio of the tangential to the normal dashpot", ratio, own_ratio))
        for name, taken, own in compared:
            if abs(own - taken) > 1e-3 * max(abs(own), abs(taken)):
                model.entry.approximated(f"{key}: the {name} is {taken:.4g} for all pairs, here {own:.4g}")

    def _normal(self, main: Model) -> Any:
        first = self.first
        match main.normal:
            case "hertz":
                return "hertz"
            case "hooke":
                speed = self._number("characteristicVelocity", main, 1)
                return {"law": "linear", "stiffness": {"reference_velocity": quantity(speed, "velocity")}}
            case "hooke/stiffness":
                value = quantity(self._stiffness("kn", main, first.type, first.type), "stiffness")
                return {"law": "linear", "stiffness": {"value": value}}
            case "hertz/stiffness" if main.damping in (*BY_NUMBER, "velocity", "mass_velocity"):
                return "hertz"
            case "hertz/stiffness":
                return {"law": "kuwabara_kono", "reference_velocity": quantity(self.speed, "velocity")}
            case _:
                return self._luding(main)

    def _luding(self, main: Model) -> dict[str, Any]:
        i = self.first.type
        speed = self._number("characteristicVelocity", main, 1)
        tension = self._number("coefficientAdhesionStiffness", main, i, i)
        e = self._number("coefficientRestitution", main, i, i)
        main.entry.approximated(
            f"luding has no dashpot, which in the script has the restitution {e:g} in addition: the "
            f"restitution of the pairs gives the same collisions at {self.speed:.3g} m/s"
        )
        return {
            "law": "luding",
            "stiffness": {"reference_velocity": quantity(speed, "velocity")},
            "plasticity_depth": self._number("coefficientPlasticityDepth", main, i, i),
            **({"tension": tension} if tension else {}),
        }

    def _tangential(self, main: Model) -> Any:
        name = main.tangential
        first = self.first
        if name in ("none", "off"):
            return "none"
        damping = self._tangential_damping(main)
        self._remark_on_dashpots(main, damping)
        keys: dict[str, Any] = {"damping": round(damping, 6)} if damping else {}
        if damping and self.deck.code == "liggghts":
            keys["dashpot"] = "sticking"
        if name in ("no_history", "linear_nohistory"):
            if damping:
                return {"law": "sliding_dashpot", "damping": keys["damping"]}
            main.entry.approximated("without a tangential dashpot the script has no friction")
            return "none"
        if name == "linear_history" or (main.normal == "hooke/stiffness" and name == "history"):
            value = self._stiffness("kt", main, first.type, first.type)
            return {"law": "linear_history", "stiffness": quantity(value, "stiffness"), **keys}
        kept: dict[str, Any] = {
            "mindlin/force": {"unloading": "kept"},
            "incremental_history": {"unloading": "kept"},
            "mindlin_rescale": {"increments": "displacement"},
            "mindlin_rescale/force": {},
        }.get(name, {"increments": "displacement", "unloading": "kept"})
        if main.normal in ("hooke", "hooke/stiffness", "hooke/hysteresis"):
            kept = {}  # a constant stiffness: all variants are equal
        if main.normal == "hooke/hysteresis":
            keys = {}
            main.entry.approximated("the tangential spring has no dashpot with luding")
        factor = self._stiffness_factor(main, first.type)
        if abs(factor - 1.0) > 1e-6:
            keys["stiffness_factor"] = float(f"{factor:.9g}")
        for each in self.sorts:
            ratio = factor / self._stiffness_factor(self.of(each.type, each.type), each.type)
            if abs(ratio - 1.0) > 1e-3:
                self.of(each.type, each.type).entry.approximated(
                    f"the tangential stiffness of {each.name} is {ratio:.3g} times that of the script: its "
                    "ratio to the normal one is that of the first type"
                )
        return {"law": "mindlin", **kept, **keys} if kept or keys else "mindlin"

    def _tangential_damping(self, main: Model) -> float:
        """Tangential dashpot over the dashpot of the normal model of granflow, in the main contact."""
        if main.options.get("tangential_damping") is False:
            return 0.0
        first, i = self.first, self.first.type
        radius, mass = effective(first, first, first.radius, first.radius)
        e = self._restitution(main, first, first, i)
        zeta = damping_ratio_for(max(e, LEAST_RESTITUTION))
        if zeta == 0.0:
            return 0.0
        if main.normal == "hertz" and "E" not in main.numbers:
            young, poisson = self._moduli(i)
            shear = young / (4.0 * (1.0 + poisson) * (2.0 - poisson))
            plane = young / (2.0 * (1.0 - poisson**2))
            return sqrt(4.0 * shear / plane) * self._beta(main, i) / zeta
        if main.normal == "hooke":
            return self._beta(main, i) / zeta
        if main.normal == "hooke/hysteresis":
            return 0.0
        if "xt" in main.numbers:  # granular of LAMMPS: a factor of its normal dashpot
            varies = main.normal == "hertz/stiffness" or main.damping == "viscoelastic"  # with the overlap
            return main.numbers["xt"] * (1.0 if varies else self._zeta(main, radius, mass) / zeta)
        gn, gt = self._gamma(main, i, mass)
        if main.normal == "hertz/stiffness":
            return gt / gn if gn else 0.0
        stiffness = self._stiffness("kn", main, i, i)
        return gt * mass / (2.0 * zeta * sqrt(stiffness * mass))

    def _remark_on_dashpots(self, main: Model, damping: float) -> None:
        """Say how the ratio of the dashpots of other pairs differs (model hertz of LIGGGHTS)."""
        if main.normal != "hertz" or "E" in main.numbers or not damping:
            return
        types = {each.type for each in self.sorts}
        found = []
        for i in types:
            for j in types | {each.type for each in self.walls}:
                young = [self._moduli(each) for each in (i, j)]
                shear = 1.0 / sum(2.0 * (2.0 - nu) * (1.0 + nu) / e for e, nu in young)
                plane = 1.0 / sum((1.0 - nu**2) / e for e, nu in young)
                e = self._number("coefficientRestitution", main, i, j)
                zeta = damping_ratio_for(min(max(e, LEAST_RESTITUTION), 0.9999))
                found.append(sqrt(4.0 * shear / plane) * self._beta(main, i, j) / zeta)
        if not found:
            return
        if max(found) > 1.02 * damping or min(found) < 0.98 * damping:
            main.entry.approximated(
                f"the tangential dashpot over the normal one is {damping:.3g} for all pairs; in the script "
                f"it is {min(found):.3g} to {max(found):.3g}"
            )

    def _beta(self, model: Model, i: int, j: int | None = None) -> float:
        """Damping ratio of LIGGGHTS for its restitution."""
        e = min(max(self._number("coefficientRestitution", model, i, j or i), 1e-6), 0.9999)
        return -log(e) / sqrt(pi**2 + log(e) ** 2)

    def _gamma(self, model: Model, i: int, mass: float) -> tuple[float, float]:
        """Normal and tangential dashpot over the effective mass, as the script gives them."""
        if "gn" in model.numbers:
            return model.numbers["gn"], model.numbers["gt"]
        if model.options.get("absolute_damping"):
            return (
                self._number("gamman_abs", model, i, i) / mass,
                self._number("gammat_abs", model, i, i) / mass,
            )
        unit = 1.0
        if model.normal == "hertz/stiffness":  # read as a rate; it is one over a length
            unit = self.deck.si(1.0, "hertz_damping") / self.deck.si(1.0, "rate")
        return unit * self._number("gamman", model, i, i), unit * self._number("gammat", model, i, i)

    def _cohesion(self, model: Model) -> Any:
        if model.cohesion in ("sjkr", "sjkr2"):
            if model.options.get("tangential_reduce"):
                model.entry.approximated(
                    "attraction does not lower the limit of friction, as it does in the script with "
                    "tangential_reduce"
                )
            return "sjkr"
        if model.cohesion in ("dmt", "jkr"):
            return model.cohesion
        return self._bridges(model)

    def _bridges(self, model: Model) -> dict[str, Any]:
        """Liquid bridges of easo/capillary/viscous; films of the particles have the liquid content.

        The code takes the content as a volume over that of the particle, not in percent, and R / 2 as the
        effective radius at walls.
        """
        content = self._number("surfaceLiquidContentInitial", model, 1)
        for group in self.deck.particles:
            group.keys["liquid_content"] = content
        viscosity = self._number("fluidViscosity", model, 1)
        ratio = self._number("minSeparationDistanceRatio", model, 1)
        volume = 4.0 / 3.0 * pi * content * (1.0 - sqrt(0.75))  # over R^3, of two equal spheres
        if volume:
            soulie = exp(0.48 - 0.0082 * log(volume)) + 0.078 + 0.0018 * log(volume)
            model.entry.approximated(
                "the capillary force is that of Willett (2000), in the script of Soulie (2006): at contact "
                f"of equal spheres, with contact angle 0, {2.0 / soulie:.3g} times as large"
            )
        model.entry.approximated(
            "walls have the effective radius R, in the script R/2: there the capillary force is 2 times as "
            "large, the viscous one 2 times in contact and up to 4 times at a distance"
        )
        farthest = 2.0 * (self._number("maxSeparationDistanceRatio", model, 1) - 1.0)  # over R
        angle = max(self._number("contactAngle", model, each.type) for each in self.sorts)
        rupture = (1.0 + 0.5 * angle) * volume ** (1.0 / 3.0)  # over R
        if farthest < rupture:
            needed(self.deck, "maxSeparationDistanceRatio", model).entry.approximated(
                f"bridges of equal spheres with the initial content rupture at a distance of {rupture:.3g} "
                f"R, in the script at {farthest:.3g} R"
            )
        largest = (
            2.0 * (content or 1e-6) * largest_bridge(radius for each in self.sorts for radius in each.radii)
        )
        keys: dict[str, Any] = {"law": "capillary_transfer", "max_bridge_volume": f"{largest:.6g} m3"}
        origin = "twice the largest from films of the initial content"
        if not content:
            origin = "twice the largest from films with a content of 1e-6, because the initial one is 0"
        model.entry.approximated(f"a bridge has at most {largest:.3g} m3, {origin}")
        if viscosity:
            if ratio > 1.0:
                model.entry.approximated(f"the smallest distance is R* instead of {ratio:g} R*")
            keys["viscous_force"] = {
                "viscosity": f"{viscosity:.12g} Pa s",
                "min_separation_ratio": min(ratio, 1.0),
            }
        return keys

    # Coefficients of pairs

    def _pair(
        self, draft: Draft, key: str, model: Model, first: Sort, second: Sort | None, type: int
    ) -> None:
        """Write one pair; `type`: that of the partner."""
        e = self._restitution(model, first, second, type)
        self._remark_on_coefficients(key, model, first.type, type)
        self._state_restitution(key, model, first.type, type, e)
        values: dict[str, Any] = {"restitution": round(max(e, LEAST_RESTITUTION), 6)}
        if e < LEAST_RESTITUTION:
            model.entry.approximated(f"the restitution is {e:.3g}; {LEAST_RESTITUTION} is taken")
        spread = self._spread(model, first, second, type)
        if spread[1] - spread[0] > 0.002:
            model.entry.approximated(
                f"{key}: the restitution of the script depends on the size, from {spread[0]:.3g} to "
                f"{spread[1]:.3g}; here it is {e:.3g}"
            )
        if (draft.get("contact") or {}).get("tangential") == "none" or model.tangential == "none":
            values["friction"] = 0
        elif "mu" in model.numbers:
            values["friction"] = model.numbers["mu"]
        else:
            values["friction"] = self._number("coefficientFriction", model, first.type, type)
        rolling = (draft.get("contact") or {}).get("rolling", "none")
        if rolling != "none":
            values |= self._rolling(model, rolling, first, second, type)
        twisting = (draft.get("contact") or {}).get("twisting", "none")
        if isinstance(twisting, dict):
            values["twisting_friction"] = model.numbers.get("mutw", 0.0)
        cohesion = (draft.get("contact") or {}).get("cohesion", "none")
        if cohesion != "none":
            values |= self._cohesion_of(model, cohesion, first.type, type, second is None)
        elif values["friction"] and not model.options.get("limitForce"):
            limited = replace(model, options={**model.options, "limitForce": True})
            pulled = self._restitution(limited, first, second, type) - e
            self.tensions.append((2.0 * values["friction"] * pulled, key, model.entry))
        draft.put(("pairs", key), values)

    def _rolling(self, model: Model, law: str, first: Sort, second: Sort | None, type: int) -> dict[str, Any]:
        if model.rolling == "none":
            return {"rolling_friction": 0, **({"rolling_damping": 0.1} if law == "sds" else {})}
        if model.rolling == "sds":
            radius, mass = effective(first, second, first.radius, first.radius)
            inertia = 0.4 * mass * radius**2  # of the pair, about
            k = model.numbers["kr"] * radius**2
            ratio = model.numbers["gr"] * radius**2 / (2.0 * sqrt(inertia * k)) if k else 0.1
            model.entry.approximated(
                "the rolling stiffness is that of the tangential spring, not the number given"
            )
            return {"rolling_friction": model.numbers["mur"], "rolling_damping": round(min(ratio, 1.0), 4)}
        found = {"rolling_friction": self._number("coefficientRollingFriction", model, first.type, type)}
        if model.rolling == "cdt" and found["rolling_friction"]:
            model.entry.approximated(
                "the rolling torque follows the normal force with its dashpot, in the script without it: "
                "after an impact the surface velocity of the rotation differs by some percent"
            )
        if model.rolling in ("epsd", "epsd3"):
            self._remark_on_rolling(model, first.type, type, found["rolling_friction"])
            damping = self._number("coefficientRollingViscousDamping", model, first.type, type)
            found["rolling_damping"] = damping
        return found

    def _remark_on_rolling(self, model: Model, i: int, j: int, friction: float) -> None:
        """Say how the rolling stiffness differs: kt R^2 in the scene, c kn mu^2 R^2 in the script."""
        c = self._number("rollingStiffness", model, 1) if model.rolling == "epsd3" else 2.25
        if model.normal == "hertz":  # kt / kn = 8 G* / (4/3 E*)
            moduli = [self._moduli(i), self._moduli(j)]
            shear = 1.0 / sum(2.0 * (2.0 - nu) * (1.0 + nu) / young for young, nu in moduli)
            plane = 1.0 / sum((1.0 - nu**2) / young for young, nu in moduli)
            ratio = 6.0 * shear / plane
        elif model.normal.endswith("/stiffness"):
            ratio = self._stiffness("kt", model, i, j) / self._stiffness("kn", model, i, j)
        else:
            ratio = 1.0
        if friction and c:
            times = ratio / (c * friction**2)
            model.entry.approximated(
                f"the rolling stiffness is that of the tangential spring, {times:.3g} times that of the "
                f"script for the rolling friction {friction:g}"
            )

    def _cohesion_of(self, model: Model, law: Any, i: int, j: int, is_wall: bool) -> dict[str, Any]:
        if law == "sjkr":
            if model.cohesion == "none":
                return {"cohesion_energy_density": 0}
            density = self._number("cohesionEnergyDensity", model, i, j)
            if model.cohesion == "sjkr2" and not is_wall:  # the area 4 pi R* d; at walls 2 pi R d, as sjkr
                density *= 2.0
            return {"cohesion_energy_density": quantity(density, "energy_density")}
        if law in ("jkr", "dmt"):
            energy = 2.0 * model.numbers.get("gamma", 0.0)
            if energy and model.numbers.get("mu"):
                model.entry.approximated(
                    "friction is limited by mu times the Hertz force, in the script by mu |F + 2 Fp| with "
                    f"the pull-off force Fp = {'4' if law == 'dmt' else '3'} pi gamma R*"
                )
            return {"work_of_adhesion": quantity(energy, "surface_energy")}
        if model.cohesion == "none":
            return {"surface_tension": 0, "contact_angle": 0}
        angle = 0.5 * (self._number("contactAngle", model, i) + self._number("contactAngle", model, j))
        if angle:
            model.entry.approximated(
                "the contact angle of a pair is the mean of both, as in the manual of LIGGGHTS; "
                "its version 3.8.0 has the force of the angle 0"
            )
        tension = self._number("surfaceTension", model, 1)
        return {"surface_tension": quantity(tension, "surface_energy"), "contact_angle": angle}

    # Restitution

    def _state_restitution(self, key: str, model: Model, i: int, j: int, e: float) -> None:
        """Say where the restitution of a pair comes from, if it is not the number of the script."""
        if self.main.normal == "hooke/hysteresis":
            return  # see `_luding`
        text = f"{e:.4g}, that of a collision in the code"
        if model.normal in ("hertz", "hooke") and "E" not in model.numbers:
            given = self._number("coefficientRestitution", model, i, j)
            text += f" with {given:g} and limitForce"
        elif model.damping in BY_NUMBER:
            given = model.numbers["eta"]
            text += f" with damping {model.damping} of {given:g}"
        else:
            given = -1.0
            text += " with its dashpot"
            is_hertz = model.normal == "hertz/stiffness"
            if model.damping == "viscoelastic" or is_hertz:
                text += f" at {self.speed:.3g} m/s"
            constant = ("velocity", "mass_velocity") if is_hertz else ("viscoelastic",)
            if model.damping in constant:  # laws of granflow whose restitution is constant
                model.entry.approximated(
                    "the restitution of the script depends on the velocity; here it is that at "
                    f"{self.speed:.3g} m/s"
                )
        if abs(given - e) > 1e-6:
            self.stated.setdefault((id(model.entry), text), (model.entry, []))[1].append(key)

    def _remark_on_tension(self) -> None:
        """Say how much friction the tension at the end of a contact causes in the code, for each model.

        The dashpot pulls from the velocity e' v at which the force is zero (the restitution with limitForce)
        to the velocity e v at the end. Its impulse is m (e' - e) v, and friction is limited by mu |Fn|. An
        impact that slides throughout changes its tangential velocity by mu (1 + e) v in granflow, without
        tension, and by mu (1 + e + 2 (e' - e)) v in the code. Impacts that stick differ less.
        """
        for entry in {id(each[2]): each[2] for each in self.tensions}.values():
            share, key, _ = max(
                (each for each in self.tensions if each[2] is entry), key=lambda each: each[0]
            )
            if share > LEAST_TENSION:
                entry.approximated(
                    "the dashpot of the code pulls at the end of a contact, with friction up to mu |Fn|; "
                    "granflow cuts the tension: oblique impacts on a wall differ by up to about "
                    f"{share:.2g} of their normal velocity along the wall, and by {2.5 * share:.2g} in the "
                    f"surface velocity of the rotation ({key})"
                )

    def _spread(self, model: Model, first: Sort, second: Sort | None, type: int) -> tuple[float, float]:
        """Smallest and largest restitution of the sizes of a pair."""
        found = [
            self._restitution(model, first, second, type, a, b)
            for a in first.radii
            for b in (second.radii if second else (a,))
        ]
        return min(found), max(found)

    def _restitution(
        self,
        model: Model,
        first: Sort,
        second: Sort | None,
        type: int,
        a: float | None = None,
        b: float | None = None,
    ) -> float:
        """Restitution of a collision in the code; radii [m]: representative ones by default."""
        a = first.radius if a is None else a
        b = (second.radius if second else a) if b is None else b
        radius, mass = effective(first, second, a, b)
        limited = bool(model.options.get("limitForce"))
        if self.main.normal == "hooke/hysteresis":
            return self._plastic(model, first.type, type, radius, mass)
        if model.normal in ("hertz", "hooke") and "E" not in model.numbers:
            e = self._number("coefficientRestitution", model, first.type, type)
            zeta = -log(max(e, 1e-6)) / sqrt(pi**2 + log(max(e, 1e-6)) ** 2)
            return free_restitution(zeta, True) if limited else e
        if model.damping in BY_NUMBER:
            return free_restitution(self._zeta(model, radius, mass), limited)
        if model.normal == "hertz/stiffness" or model.damping in (
            "viscoelastic",
            "velocity",
            "mass_velocity",
        ):
            return self._integrated(model, first.type, type, radius, mass, limited)
        return free_restitution(self._zeta(model, radius, mass), limited)

    def _plastic(self, model: Model, i: int, j: int, radius: float, mass: float) -> float:
        """Restitution of luding at its limit that gives the collision of the code at the reference velocity.

        The impact of the code has a plastic spring and a dashpot (hooke/hysteresis) or its own restitution.
        """
        main = self.main
        modulus = [each[0] / (1.0 - each[1] ** 2) for each in (self._moduli(i), self._moduli(j))]
        plane = 1.0 / (1.0 / modulus[0] + 1.0 / modulus[1])
        reference = self._number("characteristicVelocity", main, 1)
        root = 16.0 / 15.0 * sqrt(radius) * plane
        spring = root * (mass * reference**2 / root) ** 0.2
        tension = self._number("coefficientAdhesionStiffness", main, i, i)
        depth = 2.0 * self._number("coefficientPlasticityDepth", main, i, i) * radius
        e = self._number("coefficientRestitution", model, i, j)

        def impact(ratio: float, zeta: float = 0.0, stiffens: bool = True) -> float:
            limit = depth * ratio / (ratio - 1.0)
            speed = self.speed / (limit * sqrt(spring / mass))
            return plastic_collision(float(f"{speed:.6g}"), ratio, tension, zeta, stiffens)

        wanted = e
        if model.normal == "hooke/hysteresis":
            zeta = -log(max(e, 1e-6)) / sqrt(pi**2 + log(max(e, 1e-6)) ** 2)
            wanted = impact(self._number("coefficientMaxElasticStiffness", model, i, j), zeta, False)
        low, high = 1.0001, 400.0  # kp / k1: the restitution decreases with it
        for _ in range(24):
            middle = sqrt(low * high)
            low, high = (middle, high) if impact(middle) > wanted else (low, middle)
        return 1.0 / sqrt(low)

    def _zeta(self, model: Model, radius: float, mass: float) -> float:
        """Damping ratio of a linear spring, or of a Hertz spring with Tsuji's dashpot."""
        if model.damping == "coeff_restitution":  # the dashpot of this restitution, tension included
            e = max(model.numbers["eta"], 1e-6)
            return -log(e) / sqrt(pi**2 + log(e) ** 2)
        if model.damping == "tsuji":
            return tsuji(model.numbers["eta"]) / (2.0 if model.normal == "hooke/stiffness" else sqrt(5.0))
        i = self.first.type
        stiffness = self._stiffness("kn", model, i, i)
        if "eta" in model.numbers:
            dashpot = self._eta(model) * (mass if model.damping == "mass_velocity" else 1.0)
            return dashpot / (2.0 * sqrt(stiffness * mass))
        gamma, _ = self._gamma(model, i, mass)
        return gamma * mass / (2.0 * sqrt(stiffness * mass))

    def _eta(self, model: Model) -> float:
        """The normal damping coefficient of granular in SI units."""
        kind = {"velocity": "damping", "mass_velocity": "rate", "viscoelastic": "hertz_damping"}[
            model.damping
        ]
        return self.deck.si(model.numbers["eta"], kind)

    def _integrated(self, model: Model, i: int, j: int, radius: float, mass: float, limited: bool) -> float:
        """Restitution by integration of a collision at the reference velocity.

        m x'' = -k x^p - c x^q x': with the overlap X = (m v^2 / k)^(1/(p+1)) and the time X / v as units the
        damping is c X^(q+1) / (m v).
        """
        is_hertz = model.normal in ("hertz/stiffness", "hertz")
        if "E" in model.numbers:
            kn = 4.0 / 3.0 * model.numbers["E"] / (2.0 * (1.0 - model.numbers["nu"] ** 2))
        else:
            kn = self._stiffness("kn", model, i, j)
        k, power = (kn * sqrt(radius), 1.5) if is_hertz else (kn, 1.0)
        exponent = 0.5
        if "eta" in model.numbers and model.damping != "viscoelastic":
            dashpot = self._eta(model) * (mass if model.damping == "mass_velocity" else 1.0)
            exponent = 0.0
        elif "eta" in model.numbers:
            dashpot = self._eta(model) * mass * sqrt(radius)
        elif model.options.get("absolute_damping"):
            dashpot = self._gamma(model, i, mass)[0] * mass * sqrt(radius)
        else:
            dashpot = self._gamma(model, i, mass)[0] * mass * sqrt(radius)
        length = (mass * self.speed**2 / k) ** (1.0 / (power + 1.0))
        damping = dashpot * length ** (exponent + 1.0) / (mass * self.speed)
        return collision(power, float(f"{damping:.9g}"), exponent, limited)


# Tables

COMMANDS: dict[str, Translation] = {
    "pair_style": Translation(pair_style, "contact, pairs, materials", "table of the models below"),
    "pair_coeff": Translation(pair_coeff, "pairs", "with pair_style granular"),
    "mass": not_needed("masses follow from density and size"),
    "pair_modify": not_needed("mixing of coefficients"),
    "bond_style": impossible("bonds", "clumps: particles.NAME.clump"),
    "bond_coeff": impossible("bonds", "clumps: particles.NAME.clump"),
    "kspace_style": impossible("long-range forces", "a Python program that adds forces"),
}
FIXES: dict[str, Translation] = {
    "property/global": Translation(
        property_global, "materials, pairs, contact", "table of the properties below"
    ),
}
MODELS: tuple[tuple[str, str, str], ...] = (
    ("model hertz", "normal: hertz", ""),
    ("model hooke", "normal: {law: linear, stiffness: {reference_velocity: V}}", "Poisson ratio 0: kt = kn"),
    (
        "model hooke/stiffness, gran/hooke",
        "normal: {law: linear, stiffness: {value: KN}}",
        "one KN for all pairs",
    ),
    (
        "model hertz/stiffness, gran/hertz/history",
        "normal: kuwabara_kono",
        "moduli and stiffness_factor from Kn, Kt",
    ),
    ("model hooke/hysteresis", "normal: luding", "the restitution accounts for the dashpot"),
    ("granular: hooke", "normal: linear", ""),
    ("granular: hertz, hertz/material", "normal: hertz", "restitution of its damping model"),
    ("granular: dmt, jkr", "cohesion: dmt, jkr", "work of adhesion 2 gamma"),
    ("tangential incremental_history, mindlin/force", "tangential: {law: mindlin, unloading: kept}", ""),
    (
        "tangential history, mindlin",
        "tangential: {law: mindlin, increments: displacement, unloading: kept}",
        "",
    ),
    ("tangential linear_history", "tangential: linear_history", ""),
    ("tangential no_history, linear_nohistory, gran/hooke", "tangential: sliding_dashpot", ""),
    (
        "tangential_damping on (default)",
        "tangential: {damping, dashpot}",
        "the ratio of the dashpots; LIGGGHTS: dashpot: sticking",
    ),
    ("rolling_friction cdt, epsd2, epsd", "rolling: cdt, epsd, sds", ""),
    ("granular: rolling sds", "rolling: sds", "rolling stiffness of the tangential spring"),
    ("granular: twisting marshall, sds", "twisting: marshall, torsion_spring", ""),
    ("cohesion sjkr, sjkr2", "cohesion: sjkr", "sjkr2: twice the energy density between particles"),
    (
        "cohesion easo/capillary/viscous",
        "cohesion: {law: capillary_transfer, viscous_force}, particles.NAME.liquid_content",
        "capillary force of Willett; at walls R in place of R/2; max_bridge_volume from the first films",
    ),
)
"""Rows of the documentation: models of the script and of the scene, and what differs."""
