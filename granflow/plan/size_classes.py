"""Size classes: if particle sizes differ much, separate cell grids keep the neighbor search fast."""

from collections.abc import Mapping

from granflow.scene.blocks.particles import Group

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
    spans = sorted(
        (0.5 * low, 0.5 * high) for group in particles.values() for low, high in group.size_spans()
    )
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
