"""Outlets in numeric form, and the depth of points in an outlet (numpy); the device only tests inside or
outside."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, inf, log2
from typing import Literal

import numpy as np

from granflow.errors import SceneError
from granflow.geometry.clump import ClumpShape
from granflow.geometry.shape import sphere_volume
from granflow.load import Scene
from granflow.scene.blocks.domain import BoxOutlet, DiscOutlet, Outlet
from granflow.scene.blocks.particles import ClassSizes, FileInsertion, Group
from granflow.scene.blocks.run import Damping

# Damping of all motion for settling: its numbers by stage, and the limit of the drag.

RESOLVED_DECAY = 0.2
"""Largest product of drag rate and time step g dt: the decay rate of the scheme is wrong by (g dt)^2 / 12 =
0.3 %."""


@dataclass(frozen=True)
class PlannedDamping:
    """Damping of all particles: Cundall ratio, drag rate [1/s], and the stages in which it acts (None:
    all)."""

    cundall: float
    drag: float
    stages: tuple[str, ...] | None

    def values(self, stage: str) -> tuple[float, float]:
        """Cundall ratio and drag rate [1/s] in a stage."""
        acts = self.stages is None or stage in self.stages
        return (self.cundall, self.drag) if acts else (0.0, 0.0)


def planned_damping(damping: Damping | None) -> PlannedDamping | None:
    """The damping of the scene; None without."""
    damping = damping
    return (
        None
        if damping is None
        else PlannedDamping(damping.cundall or 0.0, damping.drag or 0.0, damping.stages)
    )


def refuse_unresolved_drag(scene: Scene, time_step: float) -> None:
    """Raise SceneError if a time step [s] does not resolve the decay of the velocities."""
    drag = (scene.damping.drag if scene.damping is not None else None) or 0.0
    if drag * time_step > RESOLVED_DECAY:
        raise SceneError(
            f"{scene.locate('damping', 'drag')}: damping.drag is {drag:g} 1/s, but the time step of "
            f"{time_step:.3g} s does not resolve the decay; give at most {RESOLVED_DECAY / time_step:.2g} "
            "1/s, or a smaller time step."
        )


@dataclass(frozen=True)
class PlannedOutlet:
    """One outlet: a box, or the region behind a plane and within `radius` [m] of an axis.

    `low`, `high` (3,) [m]: corners of the box, or None. `point` (3,) [m], `normal` (3,), unit vector: of the
    plane; the region is on the side to which the normal points. `radius` [m]: infinite for a half space and a
    box.
    """

    name: str
    low: np.ndarray | None
    high: np.ndarray | None
    point: np.ndarray
    normal: np.ndarray
    radius: float

    @property
    def kind(self) -> Literal["box", "half_space", "disc"]:
        """Kind of the region."""
        return "box" if self.low is not None else "disc" if self.radius < inf else "half_space"

    def depth(self, points: np.ndarray) -> np.ndarray:
        """Depth [m] (n,) of points (n, 3) [m] inside the outlet: distance from its surface, negative outside.

        Outside near an edge, the absolute value is a lower bound of the distance.
        """
        if self.low is not None and self.high is not None:
            return np.asarray(np.minimum(points - self.low, self.high - points).min(axis=1))
        along = (points - self.point) @ self.normal
        across = np.linalg.norm(points - self.point - along[:, None] * self.normal, axis=1)
        return np.asarray(np.minimum(along, self.radius - across))


def planned_outlets(outlets: Mapping[str, Outlet]) -> tuple[PlannedOutlet, ...]:
    """All outlets of a scene, in its order, with normals of unit length."""
    planned = []
    for name, outlet in outlets.items():
        if isinstance(outlet, BoxOutlet):
            low, high = np.array(outlet.box.min), np.array(outlet.box.max)
            planned.append(PlannedOutlet(name, low, high, low, np.zeros(3), inf))
        elif isinstance(outlet, DiscOutlet):
            disc = outlet.disc
            planned.append(_behind_plane(name, disc.center, disc.normal, disc.radius))
        else:
            planned.append(_behind_plane(name, outlet.half_space.point, outlet.half_space.normal, inf))
    return tuple(planned)


def _behind_plane(name: str, point: Sequence[float], normal: Sequence[float], radius: float) -> PlannedOutlet:
    """The outlet behind a plane through `point` [m], within `radius` [m] of the axis along `normal`."""
    direction = np.array(normal)
    return PlannedOutlet(name, None, None, np.array(point), direction / np.linalg.norm(direction), radius)


def outlet_of(outlets: Sequence[PlannedOutlet], position: np.ndarray, in_domain: np.ndarray) -> np.ndarray:
    """Index of the outlet that deleted each particle (n,), -1 for none: the outlet with the largest depth.

    `position` (n, 3) [m]; `in_domain` (n,) bool. A deleted particle inside the domain is always in an outlet,
    except for rounding. The order of the outlets decides between equal depths.
    """
    if not outlets:
        return np.full(len(position), -1)
    depth = np.stack([outlet.depth(position) for outlet in outlets])
    return np.where(in_domain | (depth.max(axis=0) >= 0.0), depth.argmax(axis=0), -1)


# Range of particle sizes before sampling, and size classes with separate cell grids.

CLASSES_FROM_RATIO = 3.0
"""Ratio of largest to smallest radius from which the neighbor search uses size classes."""
CLASS_WIDTH = 2.5
"""Ratio of largest to smallest radius within a class."""
Span = tuple[float, float]
"""Smallest and largest value [m]."""


def diameter_range(group: Group) -> Span:
    """Smallest and largest diameter [m] of a group, before sampling; for a particle file, those in the file.

    Those of the spheres of clumps.
    """
    spans = _diameters(group)
    return spans[0][0], spans[-1][1]


def outer_diameter_range(group: Group) -> Span:
    """As `diameter_range`, but of the spheres around clumps: the size of the particles when they are
    inserted."""
    return diameter_range(group) if group.clump is None else (group.clump.outer_diameter,) * 2


def size_classes(particles: Mapping[str, Group]) -> tuple[float, ...]:
    """Largest radius [m] of each size class, in ascending order; a single class if all sizes are similar.

    Similar: the largest is less than CLASSES_FROM_RATIO times the smallest. Within a class, the ratio is at
    most CLASS_WIDTH. A class begins with the smallest radius that no class contains yet, so that no class is
    empty.
    """
    spans = sorted((0.5 * low, 0.5 * high) for group in particles.values() for low, high in _diameters(group))
    smallest = spans[0][0]
    largest = max(high for _, high in spans)
    if largest < CLASSES_FROM_RATIO * smallest:
        return (largest,)
    class_radii: list[float] = []
    while not class_radii or class_radii[-1] < largest:
        largest_covered = 0.0 if not class_radii else class_radii[-1]
        first = min(max(low, largest_covered) for low, high in spans if high > largest_covered)
        end = CLASS_WIDTH * first
        class_radii.append(max(min(high, end) for low, high in spans if low <= end))
    return tuple(class_radii)


def _diameters(group: Group) -> list[Span]:
    """Ranges of the diameters [m] of a group, in ascending order; one range for a continuous distribution."""
    if isinstance(group.insert, FileInsertion) and group.insert.found is not None:
        return [(group.insert.found.diameter_min, group.insert.found.diameter_max)]
    if group.clump is not None:
        return [(each, each) for each in sorted({2.0 * sphere.radius for sphere in group.clump.spheres})]
    sizes = group.sizes
    if isinstance(sizes, float):
        return [(sizes, sizes)]
    if isinstance(sizes, tuple):
        return [(each, each) for each in sorted(set(sizes))]
    if isinstance(sizes, ClassSizes):
        return [
            (each, each) for each in sorted(each.diameter for each in sizes.classes if each.fraction > 0.0)
        ]
    return [(sizes.min, sizes.max)]


# Groups and stages of a scene in numeric form.


@dataclass(frozen=True)
class PlannedGroup:
    """One group of particles: name, number of particles, name of the material, whether its particles are
    fixed.

    `diameters` [m]: smallest and largest, of spheres. `source`: position of its count in the scene file.
    `clump`: shape of its particles; None for spheres. `liquid_content`: initial volume of the film over that
    of the particle.
    """

    name: str
    count: int
    material: str
    fixed: bool
    diameters: tuple[float, float]
    source: str
    clump: ClumpShape | None = None
    liquid_content: float = 0.0

    @property
    def sphere_count(self) -> int:
        """Number of spheres."""
        return self.count * (1 if self.clump is None else len(self.clump))


@dataclass(frozen=True)
class StageCondition:
    """A condition that ends a stage: a quantity is above or below a value, one of which is None, during
    `hold` [s]."""

    quantity: str
    above: float | None
    below: float | None
    hold: float

    def is_met(self, value: float) -> bool:
        """Whether a value satisfies the condition; NaN does not."""
        return (self.above is not None and value > self.above) or (
            self.below is not None and value < self.below
        )


@dataclass(frozen=True)
class PlannedStage:
    """One stage of a run: name, and longest duration [s].

    `kinetic_energy_below` [J]: mean kinetic energy per particle at which it ends earlier, or None. `key`,
    `source`: key of the duration in the scene, and its position in the file. `until`: conditions, any of
    which ends the stage, from its `shortest` duration [s] on.
    """

    name: str
    longest: float
    kinetic_energy_below: float | None
    key: str
    source: str
    until: tuple[StageCondition, ...] = ()
    shortest: float = 0.0

    @property
    def has_condition(self) -> bool:
        """Whether the stage can end before its longest duration."""
        return self.kinetic_energy_below is not None or bool(self.until)


def planned_groups(scene: Scene) -> tuple[PlannedGroup, ...]:
    """The groups in the order of the scene."""
    return tuple(
        PlannedGroup(
            name,
            group.count,
            group.material,
            group.fixed,
            diameter_range(group),
            scene.locate("particles", name, "count"),
            None if group.clump is None else group.clump.shape,
            group.liquid_content or 0.0,
        )
        for name, group in scene.particles.items()
    )


def planned_stages(scene: Scene) -> tuple[PlannedStage, ...]:
    """The stages in the order of the scene; a scene without stages has one, "run"."""
    stages = []
    for index, stage in enumerate(scene.schedule):
        key = "max_duration" if stage.duration is None else "duration"
        path = ("stages", index, key) if scene.stages else ("run", "duration")
        source = ".".join(map(str, path)), scene.locate(*path)
        until = tuple(
            StageCondition(each.quantity, each.above, each.below, each.hold) for each in stage.until
        )
        stages.append(
            PlannedStage(
                stage.name, stage.longest, stage.kinetic_energy_below, *source, until, stage.min_duration
            )
        )
    return tuple(stages)


# Liquid films: unit of the volumes, and what a model that transfers liquid does not support.

LIQUID_BITS = 50
"""Binary digits of the volume of all liquid in its unit: three fewer than f64 has, for the halves of odd
volumes and for particles that a program adds."""


def liquid_unit(groups: Sequence[PlannedGroup]) -> float:
    """Unit [m3] of liquid volumes, a power of two: bridges take whole units, so that all sums of volumes are
    exact.

    The liquid of all groups, with the largest diameters, over 2^LIQUID_BITS; 1 without liquid.
    """
    total = sum(
        group.count * group.liquid_content * sphere_volume(0.5 * group.diameters[1]) for group in groups
    )
    return 2.0 ** (ceil(log2(total)) - LIQUID_BITS) if total > 0.0 else 1.0


def refuse_coarse_liquid(scene: Scene, transfers_liquid: bool) -> None:
    """Raise SceneError if a model transfers liquid in another precision than f64."""
    if transfers_liquid and scene.run.precision != "f64":
        raise SceneError(
            f"{scene.locate('run', 'precision')}: run.precision is {scene.run.precision}, but "
            f"contact.cohesion: {scene.contact.name('cohesion')} conserves liquid in f64 only; write f64."
        )
