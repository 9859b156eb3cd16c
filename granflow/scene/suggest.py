"""Names that were probably meant."""

import difflib
from collections.abc import Iterable

_CLOSE = 0.6  # similarity from which a name is suggested


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The known word that was probably meant, if there is one."""
    match = difflib.get_close_matches(word, list(known), n=1, cutoff=_CLOSE)
    return match[0] if match else None


def suggestion_or_list(word: str, known: Iterable[str], kind: str) -> str:
    """Remedy for an unknown word: the one meant, or all there are."""
    names = list(known)
    match = nearest(word, names)
    if match:
        return f"Did you mean {match}?"
    return f"The {kind} are {', '.join(names)}" if names else f"There are no {kind}"
