"""Checks of what the domain asks of the rest of a scene."""

from collections.abc import Iterator

from granflow.scene.fields import Fault
from granflow.scene.validation import PartialScene
from granflow.scene.violations import Violation


def lees_edwards(scene_parts: PartialScene) -> Iterator[Violation]:
    """A sheared box has no walls, nobody comes later, and no meter counts in it: its images move."""
    scene = scene_parts.scene
    if scene.domain.lees_edwards is None:
        return
    initial_kinds = ("positions", "lattice", "pack", "file")
    unsupported = {
        "walls": list(scene.walls),
        "particles that come later": [
            name for name, group in scene.particles.items() if group.insert.kind not in initial_kinds
        ],
        "flow meters": list(scene.output.flow_meters),
    }
    found = " and ".join(f"{kind} ({', '.join(names)})" for kind, names in unsupported.items() if names)
    if found:
        yield ("domain", "lees_edwards"), Fault((), f"does not go with {found}: the images of the box move", whole=True)
