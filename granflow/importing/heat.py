"""Heat of a script of LIGGGHTS: heat/gran, thermal properties, temperatures of particles and walls.

The mechanics does not depend on it. LIGGGHTS conducts sqrt(2 pi) times the heat of two half spaces in contact
with the contact radius of Hertz, so that the conductivity of the scene is that of the script times this
factor.
"""

from math import pi, sqrt

from granflow.importing.deck import Deck, Fix, Translation, Words, impossible
from granflow.importing.materials import Property
from granflow.importing.scene_text import Draft, number

HEAT = ("heat/gran", "heat/gran/conduction")
"""Styles of fixes that conduct heat."""
CONDUCTANCE = sqrt(2.0 * pi)
"""Conductance of a contact in LIGGGHTS over that of granflow at the same conductivity."""
LEAST_CONDUCTIVITY = 1e-9
"""Conductivity [W/m/K] of a material that conducts no heat in the script; that of still air is 0.03."""
KEYS = {
    "thermalConductivity": ("thermal_conductivity", "W/m/K", CONDUCTANCE),
    "thermalCapacity": ("heat_capacity", "J/kg/K", 1.0),
    "youngsModulusOriginal": ("true_young_modulus", "Pa", 1.0),
}
"""Key of a material, unit and factor of a property."""


def heat_gran(deck: Deck, fix: Fix) -> None:
    """fix ID group heat/gran initial_temperature T [area_correction yes|no] [contact_area STYLE]"""
    words = Words(deck, fix.entry.command, fix.words)
    temperature, corrected = 0.0, False
    while words:
        key = words.word("a keyword")
        if key == "initial_temperature":
            temperature = words.plain("the temperature")
        elif key == "area_correction":
            corrected = words.flag(key)
        elif key == "store_contact_data":
            words.flag(key)
        elif key == "contact_area":
            style = words.word("the style of the area")
            if style != "overlap":
                fix.entry.impossible(f"contact_area {style}", "contact_area overlap")
                words.skip()
        else:
            fix.entry.impossible(f"the keyword {key} of heat/gran")
            words.skip()
    fix.data = temperature
    if corrected:
        deck.family["area_correction"] = True
    if any(run.steps for run in deck.runs):
        deck.own("changes", set).add(deck.time)


def wall_temperature(deck: Deck, fix: Fix, temperature: float) -> None:
    """Remember the temperature [K] of a wall or mesh of a fix."""
    deck.own("wall_temperatures", dict)[id(fix.entry)] = temperature


def build(deck: Deck, draft: Draft) -> None:
    """Add the keys of heat to the materials, contact laws, particles and walls of the scene."""
    fixes = [fix for fix in deck.fixes_of(*HEAT) if isinstance(fix.data, float)]
    acting = [fix for fix in fixes if deck.acting(fix)]
    properties: dict[str, Property] = deck.family.get("properties", {})
    if not acting:
        return
    fix = acting[0]
    draft.blocks["contact"]["heat"] = "conduction"
    fix.entry.translated("contact.heat", "particles.NAME.temperature")
    types: dict[str, int] = {name: type for (type, *_), name in deck.family["sorts"].items()}
    types |= {each.material: each.type for each in deck.family.get("wall_contacts", [])}
    for name, material in draft.blocks.get("materials", {}).items():
        for given, (key, unit, factor) in KEYS.items():
            found = properties.get(given)
            if key == "true_young_modulus" and "area_correction" not in deck.family:
                continue
            if found is not None:
                value = found.of(max(1, types[name])) * factor
                if key == "thermal_conductivity" and value == 0.0:
                    value = LEAST_CONDUCTIVITY
                    found.entry.approximated(f"{name} has the conductivity {value:g} W/m/K in place of 0")
                material[key] = f"{number(value)} {unit}"
    if "thermalConductivity" in properties:
        properties["thermalConductivity"].entry.approximated(
            f"times {CONDUCTANCE:.4g}: contacts conduct the heat of the script, within half of the overlap "
            "over the radius"
        )
    for group in draft.blocks.get("particles", {}).values():
        group["temperature"] = f"{number(fix.data)} K"
    end = max(run.end for run in deck.runs)
    if fix.end is not None and fix.end < end:
        fix.entry.approximated(f"heat flows until the end, also after unfix at {fix.end:g} s")
    temperatures: dict[int, float] = deck.family.get("wall_temperatures", {})
    for name, wall in draft.blocks.get("walls", {}).items():
        for entry in draft.owners.get(("walls", name), ()):
            if id(entry) in temperatures:
                wall["temperature"] = f"{number(temperatures[id(entry)])} K"
                entry.translated(f"walls.{name}.temperature")


COMMANDS: dict[str, Translation] = {}
FIXES: dict[str, Translation] = {
    "heat/gran": Translation(
        heat_gran, "contact.heat, temperature", "the conductivity is multiplied by 2.507"
    ),
    "heat/gran/conduction": Translation(heat_gran, "contact.heat, temperature", "as heat/gran"),
    "heat/gran/radiation": impossible(
        "radiation between particles", "contact.heat: {law: conduction, surroundings: T}"
    ),
}
