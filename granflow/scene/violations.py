"""Results of the consistency checks between the parts of a scene.

A violation is a key path with a fault; `messages.problem_at` converts it to a message with a source position.
"""

from collections.abc import Callable, Iterable, Iterator

from granflow.scene.document import KeyPath
from granflow.scene.schema.fields import Fault
from granflow.scene.suggest import nearest
from granflow.scene.validation import PartialScene

Violation = tuple[KeyPath, Fault]
"""Key path of a part of the scene, and its fault."""

Check = Callable[[PartialScene], Iterator[Violation]]
"""Consistency check between the parts of a scene."""


def unknown(path: KeyPath, name: str, known: Iterable[str], kind: str) -> Violation:
    """The violation for an unknown name, with the closest known name or a list of all."""
    names = list(known)
    suggestion = nearest(name, names)
    if suggestion:
        return path, Fault((), f"there is no such {kind}. Did you mean {suggestion}?")
    known_names = f"the {kind}s are {', '.join(names)}" if names else f"the scene has no {kind}s"
    return path, Fault((), f"there is no such {kind}; {known_names}")
