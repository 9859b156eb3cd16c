"""Which sizes there can be, before any is drawn, and the classes of sizes that the search takes one by one."""

from granflow.scene import Scene
from granflow.scene.schema import ClassSizes, FileInsertion, Group

CLASSES_FROM_RATIO = 3.0
"""Largest over smallest radius from which on the search takes sizes class by class."""

CLASS_WIDTH = 2.5
"""Largest over smallest radius within a class."""

Span = tuple[float, float]


def diameter_range(group: Group) -> Span:
    """Smallest and largest diameter [m]."""
    spans = _diameters(group)
    return spans[0][0], spans[-1][1]


def size_classes(scene: Scene) -> tuple[float, ...]:
    """Largest radius [m] of each class of sizes, from small to large; only one where all are of a size, or nearly.

    A class begins with the smallest radius that is in none yet, so that there is none without particles.
    """
    spans = sorted((0.5 * low, 0.5 * high) for group in scene.particles.values() for low, high in _diameters(group))
    smallest, largest = spans[0][0], max(high for _, high in spans)
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
    """Ranges of diameters [m] that a group can have, from small to large."""
    if isinstance(group.insert, FileInsertion) and group.insert.found is not None:
        return [(group.insert.found.diameter_min, group.insert.found.diameter_max)]
    sizes = group.sizes
    if isinstance(sizes, float):
        return [(sizes, sizes)]
    if isinstance(sizes, tuple):
        return [(each, each) for each in sorted(set(sizes))]
    if isinstance(sizes, ClassSizes):
        return [(each, each) for each in sorted(each.diameter for each in sizes.classes if each.fraction > 0.0)]
    return [(sizes.min, sizes.max)]
