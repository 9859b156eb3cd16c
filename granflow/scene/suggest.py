"""Suggestions for unknown names, and the table of renamed keys.

Similarity is that of difflib (Ratcliff and Obershelp), between 0 and 1.
"""

import difflib
from collections.abc import Iterable

_CLOSE = 0.6  # similarity from which a name is suggested


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


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The present name of a renamed key, else the known name closest to the word, if one is close; None otherwise."""
    names = list(known)
    matches = difflib.get_close_matches(word, names, n=1, cutoff=_CLOSE)
    return renamed(word, names) or (matches[0] if matches else None)


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
