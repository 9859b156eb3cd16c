"""Force-controlled walls: their motions with the numbers that follow from contacts and time step.

The forces of the particles move these walls (`scene.blocks.motions.ForceControlledMotion`). A motion is
stable only if it is slow enough for the contacts of a layer of particles on the wall: its numbers and limits
follow from the stiffness and viscosity of such a layer, and from the time step.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from math import sqrt

import numpy as np

from granflow.contact.law import NormalLaw
from granflow.errors import SceneError
from granflow.geometry.mesh import Mesh
from granflow.geometry.periodic_box import AXES
from granflow.geometry.vectors import are_perpendicular, is_parallel
from granflow.load import Scene
from granflow.plan.pair_case import PairCase
from granflow.plan.stages import StageTimes, nominal_times
from granflow.plan.walls import PlannedWall
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.metrics import SolidFractionMetric, across
from granflow.scene.blocks.motions import ForceControlledMotion, Numbers, WallContacts
from granflow.scene.blocks.walls.rectangle import Plate
from granflow.scene.blocks.walls.revolved import Revolved
from granflow.schema.quantities import Vector3


@dataclass(frozen=True)
class ControlledMotion:
    """One force-controlled motion: index of the wall, index of the motion of this wall, name of the wall.

    spec:     the motion with unit vectors
    numbers:  see `ForceControlledMotion.numbers`
    source:   its line in the scene file
    section:  of a servo between walls; None for others
    """

    wall: int
    motion: int
    name: str
    spec: ForceControlledMotion
    numbers: Numbers
    source: str
    section: "Section | None" = None

    @property
    def direction(self) -> Vector3:
        """Unit vector along which the wall moves."""
        return self.spec.direction

    @property
    def force(self) -> float:
        """Force [N] of the wall on particles at rest along its direction, at the start."""
        return self.numbers["force"]

    def area_at(self, walls: Sequence[PlannedWall], offsets: np.ndarray | None = None) -> float | None:
        """Area [m2] to which a pressure refers: that of the wall, or of the section at displacements of all
        motions (motions,) [m], at the start by default; None for an infinite wall."""
        if self.section is None:
            return walls[self.wall].area
        return self.section.area * (1.0 if offsets is None else self.section.ratio(offsets))

    @property
    def key(self) -> str:
        """Key in messages and checkpoints."""
        return f"walls.{self.name}.motion.{self.motion}"


@dataclass(frozen=True)
class Section:
    """Section between pairs of opposite walls, across the direction of a servo.

        A = A0 product over pairs of (1 + sum over motions of s x),      x: displacements of the motions [m]

    area:     A0 [m2], at the start
    strains:  for each pair, s [1/m] by number of the motions of its walls
    """

    area: float
    strains: tuple[Mapping[int, float], ...]

    def ratio(self, offsets: np.ndarray) -> float:
        """A / A0 at displacements of all motions (motions,) [m]."""
        return float(np.prod([1.0 + sum(s * offsets[r] for r, s in each.items()) for each in self.strains]))


def controlled_motions_of(
    scene: Scene,
    walls: Sequence[PlannedWall],
    law: NormalLaw,
    pair_cases: Sequence[PairCase],
    velocity: float,
    step: float,
) -> tuple[ControlledMotion, ...]:
    """All force-controlled motions in order of the walls.

    `velocity` [m/s]: maximum expected impact velocity, at which `law` gives the stiffness of `pair_cases`;
    `step` [s].

    Raises SceneError for a motion that is unstable with the step, and for two at the same time.
    """
    controlled_motions = []
    for index, wall in enumerate(walls):
        for number, motion in enumerate(wall.motions):
            if isinstance(motion, ForceControlledMotion):
                between = _section_between(scene, walls, index, number)
                area = wall.area if between is None else between.area
                covered = area or section(scene.domain, motion.direction)
                layer = _layer(scene, covered, law, pair_cases, velocity, step)
                unstable = motion.instability(layer, step)
                if unstable is not None:
                    key, sentence = unstable
                    location = scene.locate("walls", wall.name, "motion", number, key)
                    raise SceneError(f"{location}: walls.{wall.name}.motion.{key} {sentence}")
                source = scene.where("walls", wall.name, "motion", number)
                numbers = motion.numbers(area or 0.0, scene.gravity_at_start, layer, step)
                controlled_motions.append(
                    ControlledMotion(index, number, wall.name, motion, numbers, source, between)
                )
    _refuse_two_at_once(scene, controlled_motions)
    return tuple(controlled_motions)


def _refuse_two_at_once(scene: Scene, motions: Sequence[ControlledMotion]) -> None:
    """Raise SceneError if two motions that are not perpendicular move a wall at the same time.

    Each would move it by the whole force, with the sum of their velocities.
    """
    times = nominal_times(scene.schedule)
    for first, second in combinations(motions, 2):
        if first.wall != second.wall or are_perpendicular(first.direction, second.direction):
            continue
        spans = product(active_spans(first.spec, times), active_spans(second.spec, times))
        if any(max(a[0], b[0]) < min(a[1], b[1]) for a, b in spans):
            location = scene.locate("walls", second.name, "motion", second.motion)
            raise SceneError(
                f"{location}: {second.key} and motion.{first.motion} move the wall at the same time along "
                "directions that are not perpendicular, but forces act on one motion at a time: give them "
                "different stages or times, or keep one of them."
            )


def active_spans(motion: ForceControlledMotion, times: StageTimes) -> list[tuple[float, float]]:
    """Start and end [s] of the times in which a motion is active, in their order; the end can be infinite."""
    if motion.stages is None:
        return [(motion.start_time, motion.end_time)]
    return [times[name] for name in motion.stages]


def _section_between(scene: Scene, walls: Sequence[PlannedWall], index: int, number: int) -> Section | None:
    """The section on which a motion of a wall presses; None if it names no walls.

    Raises SceneError for walls that are not flat, parallel in pairs and perpendicular to all others.
    """
    motion = walls[index].motions[number]
    assert isinstance(motion, ForceControlledMotion)
    names: Sequence[str] | None = getattr(motion, "between", None)
    if names is None:
        return None
    directions = [
        (wall.name, np.array(each.direction))
        for wall in walls
        for each in wall.motions
        if isinstance(each, ForceControlledMotion)
    ]
    key = ("walls", walls[index].name, "motion", number, "between")
    lengths: list[float] = []
    normals = [np.array(motion.direction)]
    strains: list[dict[int, float]] = []

    def refused(reason: str) -> SceneError:
        return SceneError(f"{scene.locate(*key)}: walls.{walls[index].name}.motion.between {reason}.")

    for name, other, normal, length in _opposite_walls(walls, names, refused):
        signs = {other: 1.0 / length, name: -1.0 / length}
        found = {
            r: signs[wall] * float(direction @ normal)
            for r, (wall, direction) in enumerate(directions)
            if wall in signs
        }
        lengths.append(abs(length))
        normals.append(normal)
        strains.append(found)
    if not are_perpendicular(*normals):
        raise refused("has walls that are not perpendicular to each other and parallel to the direction")
    if len(names) == 2:
        third = across(normals)
        if not third or AXES[third[0]] not in scene.domain.periodic:
            raise refused("has two walls, but no periodic axis across them; give four walls")
        lengths.append(float(np.subtract(scene.domain.max, scene.domain.min)[third[0]]))
    return Section(float(np.prod(lengths)), tuple(strains))


def _opposite_walls(
    walls: Sequence[PlannedWall], names: Sequence[str], refused: Callable[[str], SceneError]
) -> Iterator[tuple[str, str, np.ndarray, float]]:
    """Names, normal (3,) of the first, and signed distance [m] along it of each pair of opposite flat walls.

    Raises the error that `refused` makes of a reason.
    """
    by_name = {wall.name: wall for wall in walls}
    for name, other in zip(names[::2], names[1::2], strict=True):
        first, second = plane_of(by_name[name]), plane_of(by_name[other])
        if first is None or second is None:
            raise refused("has walls that are not flat; give planes, rectangles, discs or flat meshes")
        normal = first[1]
        length = float((second[0] - first[0]) @ normal)
        if not is_parallel(normal, second[1]) or length == 0.0:
            raise refused(f"has {name} and {other} as a pair, which are not opposite to each other")
        yield name, other, normal, length


def refuse_open_samples(scene: Scene, walls: Sequence[PlannedWall]) -> None:
    """Raise SceneError for a metric whose walls do not enclose a volume."""
    for key, metric in scene.output.metrics.items():
        if not isinstance(metric, SolidFractionMetric):
            continue
        path = f"output.metrics.{key}.between"
        place = scene.locate("output", "metrics", key, "between")

        def refused(reason: str, path: str = path, place: str = place) -> SceneError:
            return SceneError(f"{place}: {path} {reason}.")

        normals = [normal for *_, normal, _ in _opposite_walls(walls, metric.between, refused)]
        if not are_perpendicular(*normals):
            raise refused("has pairs that are not perpendicular to each other")
        open_axes = [AXES[k] for k in across(normals) if AXES[k] not in scene.domain.periodic]
        if metric.radius is None and (len(across(normals)) + len(normals) < len(AXES) or open_axes):
            axes = f" along {' and '.join(open_axes)}" if open_axes else ""
            raise refused(
                f"leaves the volume open{axes}, where the domain is not periodic. Give further pairs of "
                "walls, or radius for a cylinder"
            )


FLATNESS = 1e-6
"""Largest distance of a point from the plane of a flat mesh, over the size of the mesh: rounding of a text
file."""


def plane_of(wall: PlannedWall) -> tuple[np.ndarray, np.ndarray] | None:
    """A point of a flat wall and its unit normal; None for other walls."""
    surface = wall.surface
    if isinstance(surface, Plate):
        return np.asarray(surface.corner), np.asarray(surface.normal)
    if isinstance(surface, Revolved) and surface.direction_z == 0.0:
        return np.asarray(surface.origin), np.asarray(surface.axis)
    if isinstance(surface, Mesh):
        point, normal = surface.points[0], surface.adjacency.normal[0]
        height = np.abs((surface.points - point) @ normal)
        is_flat = height.max() <= FLATNESS * np.ptp(surface.points, axis=0).max()
        return (point, normal) if is_flat else None
    return surface.plane


def _layer(
    scene: Scene,
    area: float,
    law: NormalLaw,
    pair_cases: Sequence[PairCase],
    velocity: float,
    step: float,
) -> WallContacts:
    """The contacts of a layer of particles on an area [m2] of a wall.

    A layer of spheres of radius r in closest packing has one sphere per area 2 sqrt(3) r^2.
    """
    radius = min(pair_case.radius for pair_case in pair_cases)
    sphere_count = sum(group.sphere_count for group in scene.particles.values())
    in_layer = area / (2.0 * sqrt(3.0) * radius**2)
    responses = [
        (*law.present_response(*case.dashpot_arguments, velocity, step), case.resistance[0])
        for case in pair_cases
    ]
    return WallContacts(
        contact_count=max(min(sphere_count, in_layer), 1.0),
        stiffness=max(
            law.loading_stiffness(case.pair, case.radius_eff, case.mass_eff, velocity) for case in pair_cases
        ),
        resistance=max(
            viscosity + liquid + 0.5 * step * stiffness for stiffness, viscosity, liquid in responses
        ),
    )


def section(domain: Domain, direction: Sequence[float] | np.ndarray) -> float:
    """Projected area [m2] of the domain along a direction (3,), unit vector."""
    size = np.subtract(domain.max, domain.min)
    return float(np.abs(direction) @ [size[1] * size[2], size[2] * size[0], size[0] * size[1]])
