"""Which sizes there can be, before any is drawn, and the classes of sizes that the search takes one by one."""

from granflow.scene import Scene
from granflow.scene.schema import ClassSizes, FromFile, Group

WIDE = 3.0
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
    if largest < WIDE * smallest:
        return (largest,)
    found: list[float] = []
    while not found or found[-1] < largest:
        above = 0.0 if not found else found[-1]
        first = min(max(low, above) for low, high in spans if high > above)
        end = CLASS_WIDTH * first
        found.append(max(min(high, end) for low, high in spans if low <= end))
    return tuple(found)


def _diameters(group: Group) -> list[Span]:
    """Ranges of diameters [m] that a group can have, from small to large."""
    if isinstance(group.place, FromFile) and group.place.found is not None:
        return [(group.place.found.diameter_min, group.place.found.diameter_max)]
    sizes = group.sizes
    if isinstance(sizes, float):
        return [(sizes, sizes)]
    if isinstance(sizes, tuple):
        return [(each, each) for each in sorted(set(sizes))]
    if isinstance(sizes, ClassSizes):
        return [(each, each) for each in sorted(each.diameter for each in sizes.classes if each.fraction > 0.0)]
    return [(sizes.min, sizes.max)]
