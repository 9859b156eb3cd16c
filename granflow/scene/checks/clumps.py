"""Parts of a scene that cannot be combined with clumps."""

from collections.abc import Iterator

from granflow.scene.partial import PartialScene
from granflow.scene.schema.faults import Fault, whole


def unsupported(parts: PartialScene) -> Iterator[Fault]:
    """Clumps support no sheared boxes, damping of all motion, adaptive steps, earlier runs and fields on grids."""
    scene = parts.scene
    names = [name for name, group in scene.particles.items() if group.clump is not None]
    if not names:
        return
    clumps = f"cannot be combined with the clumps of particles.{names[0]}"
    if scene.damping is not None:
        yield whole(("damping",), f"{clumps}: it acts on single spheres; remove one of the two")
    if scene.domain.lees_edwards is not None:
        yield whole(("domain", "lees_edwards"), f"{clumps}, which cross no sheared boundary; remove one of the two")
    if scene.run.time_step == "adaptive":
        yield whole(("run", "time_step"), f"{clumps}; give a number, or leave it out")
    if scene.start_from is not None:
        yield whole(("start_from",), f"{clumps}: it reads spheres only; remove one of the two")
    if scene.output.fields:
        yield whole(("output", "fields"), f"{clumps}: stresses need the forces inside a clump; remove one of the two")
