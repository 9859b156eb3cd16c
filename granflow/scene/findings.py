"""What checks between the parts of a scene find."""

from collections.abc import Callable, Iterable, Iterator

from granflow.scene.document import KeyPath
from granflow.scene.draft import Draft
from granflow.scene.fields import Fault
from granflow.scene.suggest import nearest

Finding = tuple[KeyPath, Fault]
Check = Callable[[Draft], Iterator[Finding]]


def unknown(path: KeyPath, name: str, known: Iterable[str], kind: str) -> Finding:
    """A name that is not among the known ones, with the one that was probably meant."""
    names = list(known)
    near = nearest(name, names)
    if near:
        return path, Fault((), f"there is no such {kind}. Did you mean {near}?")
    listed = f"the {kind}s are {', '.join(names)}" if names else f"the scene has no {kind}s"
    return path, Fault((), f"there is no such {kind}; {listed}")
