"""Smallest and largest diameter a group can have, before any is drawn."""

from granflow.scene.schema import ClassSizes, FromFile, Group


def diameter_range(group: Group) -> tuple[float, float]:
    """Smallest and largest diameter [m]."""
    if isinstance(group.place, FromFile) and group.place.found is not None:
        return group.place.found.diameter_min, group.place.found.diameter_max
    sizes = group.sizes
    if isinstance(sizes, float):
        return sizes, sizes
    if isinstance(sizes, tuple):
        return min(sizes), max(sizes)
    if isinstance(sizes, ClassSizes):
        present = [each.diameter for each in sizes.classes if each.fraction > 0.0]
        return min(present), max(present)
    return sizes.min, sizes.max
