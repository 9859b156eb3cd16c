"""Checks of what the domain asks of the rest of a scene."""

from collections.abc import Iterator

from granflow.scene.draft import Draft
from granflow.scene.fields import Fault
from granflow.scene.findings import Finding


def shear(draft: Draft) -> Iterator[Finding]:
    """A sheared box has no walls, nobody comes later, and no meter counts in it: its images move."""
    scene = draft.scene
    if scene.domain.shear is None:
        return
    there = ("list", "lattice", "pack", "file")
    others = {
        "walls": list(scene.walls),
        "particles that come later": [name for name, group in scene.particles.items() if group.place.kind not in there],
        "flow meters": list(scene.output.meters),
    }
    found = " and ".join(f"{kind} ({', '.join(names)})" for kind, names in others.items() if names)
    if found:
        yield ("domain", "shear"), Fault((), f"does not go with {found}: the images of the box move", whole=True)
