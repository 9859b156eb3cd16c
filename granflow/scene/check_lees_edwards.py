"""Features that cannot be combined with Lees-Edwards boundary conditions."""

from collections.abc import Iterator

from granflow.scene.schema.fields import Fault
from granflow.scene.validation import PartialScene
from granflow.scene.violations import Violation


def lees_edwards(scene_parts: PartialScene) -> Iterator[Violation]:
    """Lees-Edwards boxes support neither walls, nor insertion during the run, nor flow meters: the images move.

    One violation names all features of the scene that are not supported.
    """
    scene = scene_parts.scene
    if scene.domain.lees_edwards is None:
        return
    initial_kinds = ("positions", "lattice", "pack", "file")
    unsupported = {
        "walls": list(scene.walls),
        "particles inserted during the run": [
            name for name, group in scene.particles.items() if group.insert.kind not in initial_kinds
        ],
        "flow meters": list(scene.output.flow_meters),
    }
    found = " and ".join(f"{kind} ({', '.join(names)})" for kind, names in unsupported.items() if names)
    if found:
        yield (
            ("domain", "lees_edwards"),
            Fault((), f"cannot be combined with {found}: the periodic images move", whole=True),
        )
