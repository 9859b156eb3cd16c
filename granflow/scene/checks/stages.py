"""Stages, times and motions of walls."""

from collections.abc import Iterator

from granflow.scene.document import KeyPath
from granflow.scene.partial import PartialScene, unknown
from granflow.scene.schema.damping import Damping
from granflow.scene.schema.faults import Fault, missing
from granflow.scene.schema.motions import FreeWall, MotionSpec, Servo, Vibration
from granflow.scene.schema.scene import SceneInput
from granflow.scene.schema.walls import Plane, Wall


def names(parts: PartialScene) -> Iterator[Fault]:
    """Unique stage names, and references of walls, motions and damping to existing stages only.

    A scene without stages has the single stage "run".
    """
    stages = parts.scene.stages
    known = [stage.name for stage in stages] or ["run"]
    for index, name in enumerate(known):
        if name in known[:index]:
            reason = f"stages.{known.index(name)} has the same name; give each stage a different name"
            yield Fault(("stages", index, "name"), reason)
    for path, part in [*_walls(parts.scene), *_motions(parts.scene), *_damping(parts.scene)]:
        for index, name in enumerate(part.stages or ()):
            location = (*path, "stages", index)
            if name not in known and stages:
                yield unknown(location, name, known, "stage")
            elif name not in known:
                remedy = "remove stages" if path == ("damping",) else "give times instead of stages"
                yield Fault(location, f"the scene has no stages; {remedy}")


def _walls(scene: SceneInput) -> Iterator[tuple[KeyPath, Wall]]:
    """Each wall with its key path."""
    yield from ((("walls", name), wall) for name, wall in scene.walls.items())


def _motions(scene: SceneInput) -> Iterator[tuple[KeyPath, MotionSpec]]:
    """Each motion of a wall with its key path."""
    for path, wall in _walls(scene):
        yield from (((*path, "motion", index), motion) for index, motion in enumerate(wall.motion))


def _damping(scene: SceneInput) -> Iterator[tuple[KeyPath, Damping]]:
    """The damping with its key path, if there is one."""
    if scene.damping is not None:
        yield ("damping",), scene.damping


def duration(parts: PartialScene) -> Iterator[Fault]:
    """Exactly one of `run.duration` and `stages` must be given."""
    is_given = parts.scene.run.duration is not None
    if not is_given and not parts.scene.stages:
        yield missing(("run", "duration"), "give the simulated time, such as 2 s, or stages")
    if is_given and parts.scene.stages:
        yield Fault(("run", "duration"), "the stages have durations; remove run.duration")


def gamma_requires_gravity(parts: PartialScene) -> Iterator[Fault]:
    """Gamma, the peak acceleration over gravity, requires gravity."""
    for path, motion in _motions(parts.scene) if not any(parts.scene.gravity) else ():
        if isinstance(motion, Vibration) and motion.gamma is not None:
            yield Fault((*path, "gamma"), "gravity is zero; give amplitude and frequency")


def force_controlled_walls(parts: PartialScene) -> Iterator[Fault]:
    """Prescribed pressures require a wall with an area; force-controlled walls require a constant time step.

    The limits of their gain and mass are computed for one time step.
    """
    scene = parts.scene
    controlled = [(path, each) for path, each in _motions(scene) if isinstance(each, Servo | FreeWall)]
    for path, motion in controlled:
        has_pressure = isinstance(motion, Servo) and motion.pressure is not None
        if has_pressure and isinstance(scene.walls[str(path[1])], Plane):
            yield Fault((*path, "pressure"), "a plane is infinite and has no area; give force, or use a rectangle")
    if controlled and scene.run.time_step == "adaptive":
        path, motion = controlled[0]
        reason = f"walls.{path[1]} is {motion.kind}, which requires a constant time step; write auto"
        yield Fault(("run", "time_step"), reason)
