"""Suggestions for unknown names: renamed keys, names in other codes, and similar names.

Similarity is that of difflib (Ratcliff and Obershelp), between 0 and 1.
"""

import difflib
from collections.abc import Iterable

_CLOSE = 0.6  # similarity from which a name is suggested


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The known name that a word probably means; None without one.

    In this order: the present name of a renamed key, a synonym, the name with the most similar letters.
    """
    names = list(known)
    matches = difflib.get_close_matches(word, names, n=1, cutoff=_CLOSE)
    return renamed(word, names) or synonym(word, names) or next(iter(matches), None)


def suggestion_or_list(word: str, known: Iterable[str], kind: str) -> str:
    """Remedy for an unknown word: its new name, the closest known word, or a list of all known words.

    `kind`: plural noun for the list. The list is a sentence without a period.
    """
    names = list(known)
    if new := renamed(word, names):
        return f"{word} was renamed to {new}."
    match = nearest(word, names)
    if match:
        return f"Did you mean {match}?"
    return f"The {kind} are {', '.join(names)}" if names else f"There are no {kind}"


def suggestion_sentence(word: str, known: Iterable[str], kind: str) -> str:
    """As `suggestion_or_list`, with a period unless it is a question."""
    remedy = suggestion_or_list(word, known, kind)
    return remedy if remedy.endswith(("?", ".")) else f"{remedy}."


# Renamed keys

RENAMED_KEYS = {
    "adhesion": "cohesion",
    "any_size": "any_scale",
    "at_most": "max_duration",
    "beyond": "half_space",
    "by": "group_by",
    "energy": "energy_budget",
    "gradient_along": "gradient",
    "grow": "expand",
    "indices": "metrics",
    "leaving": "on_exit",
    "list": "positions",
    "loads": "wall_forces",
    "measure": "analyze",
    "meters": "flow_meters",
    "onset": "impact",
    "overlap_limit": "max_overlap",
    "peak": "max_overlap",
    "place": "insert",
    "restitution": "restitution_at",
    "shear": "lees_edwards",
    "size": "scale",
    "spin": "angular_velocity",
    "time_step_safety": "time_step_fraction",
    "velocity_along": "flow",
}
"""Keys and values of version 0.1, and their present names."""


def renamed(word: str, known: Iterable[str]) -> str | None:
    """The present name of a renamed key, if it is one of the known names; None otherwise."""
    new = RENAMED_KEYS.get(word)
    return new if new in list(known) else None


# Names in other codes

SYNONYMS: dict[str, tuple[str, ...]] = {
    "ball": ("particles",),
    "belt": ("surface_velocity", "motion"),
    "boundary": ("domain", "periodic", "on_exit"),
    "coefficientfriction": ("friction",),
    "coefficientrestitution": ("restitution",),
    "coefficientrollingfriction": ("rolling_friction",),
    "cof": ("friction",),
    "cohesionenergydensity": ("cohesion_energy_density",),
    "cor": ("restitution",),
    "conveyor": ("surface_velocity", "motion"),
    "dt": ("time_step",),
    "dump": ("output", "interval"),
    "e": ("young_modulus", "restitution"),
    "en": ("restitution",),
    "epsd2": ("epsd", "sds"),
    "facet": ("mesh",),
    "factory": ("rain",),
    "fix": ("walls",),
    "fixmovemesh": ("motion",),
    "fixwallgran": ("walls", "plane"),
    "freeze": ("fixed",),
    "gaussian": ("normal",),
    "grain": ("particles",),
    "hertzmaterial": ("hertz",),
    "hertzmindlin": ("hertz", "mindlin"),
    "history": ("mindlin",),
    "hooke": ("linear",),
    "hookean": ("linear",),
    "hookehysteresis": ("luding",),
    "insertpack": ("pack",),
    "insertrateregion": ("rain",),
    "insertstream": ("inlet",),
    "jkr": ("cohesion",),
    "lsd": ("linear",),
    "meshsurface": ("mesh",),
    "mindlindeltashear": ("mindlin",),
    "movemesh": ("motion",),
    "mu": ("friction",),
    "nu": ("poisson_ratio",),
    "omega": ("angular_velocity",),
    "oscillation": ("vibration",),
    "paircoeff": ("pairs",),
    "pairstyle": ("contact",),
    "pour": ("rain",),
    "random": ("pack", "rain"),
    "rectangularwall": ("rectangle",),
    "rho": ("density",),
    "rotate": ("rotation",),
    "simplifiedjkr": ("sjkr",),
    "sphere": ("particles",),
    "springdashpot": ("linear", "spring"),
    "stl": ("mesh",),
    "stream": ("inlet",),
    "surfaceenergy": ("work_of_adhesion",),
    "surfacevel": ("surface_velocity", "motion"),
    "surfacevelocity": ("surface_velocity", "motion"),
    "target": ("force", "pressure"),
    "thermo": ("output", "timeseries_interval"),
    "timestep": ("time_step",),
    "tsuji": ("hertz",),
    "wallgran": ("walls", "plane"),
    "wiggle": ("vibration",),
    "xmu": ("friction",),
    "youngsmodulus": ("young_modulus",),
    "zplane": ("plane",),
}
"""Names in other codes (LIGGGHTS, LAMMPS, YADE, MercuryDPM, EDEM), in lowercase letters and digits only, and
names here for the same or the nearest feature, in the order of preference."""


def synonym(word: str, known: Iterable[str]) -> str | None:
    """The first known name for a name in another code; None if there is none."""
    names = list(known)
    plain = "".join(letter for letter in word.lower() if letter.isalnum())
    return next((name for name in SYNONYMS.get(plain, ()) if name in names), None)
