"""Groups of particles in numeric form: numbers, materials, and sizes before any diameter is drawn.

The smallest and largest diameters of all groups determine the time step and the cells of the neighbor
search. If they differ much, size classes with separate cell grids keep the search fast.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from granflow.geometry.clump import ClumpShape
from granflow.load import Scene
from granflow.scene.blocks.particles import ClassSizes, FileInsertion, Group


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


# Range of the diameters of a group.

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
    if group.clump is None:
        return diameter_range(group)
    return group.clump.outer_diameter, group.clump.outer_diameter


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
        used = [each.diameter for each in sizes.classes if each.fraction > 0.0]
        return [(each, each) for each in sorted(used)]
    return [(sizes.min, sizes.max)]


# Size classes with separate cell grids.

CLASSES_FROM_RATIO = 3.0
"""Ratio of largest to smallest radius from which the neighbor search uses size classes."""
CLASS_WIDTH = 2.5
"""Ratio of largest to smallest radius within a class."""


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
