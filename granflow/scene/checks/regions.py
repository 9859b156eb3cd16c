"""Regions of particle groups in the domain, and features that the boundaries of the domain exclude."""

import math
from collections.abc import Iterator

from granflow.scene.document import KeyPath
from granflow.scene.partial import PartialScene
from granflow.scene.schema.faults import Fault, whole
from granflow.scene.schema.insertion import (
    BoxRegion,
    CylinderRegion,
    DiscFace,
    FileInsertion,
    InletInsertion,
    PositionsInsertion,
    PythonInsertion,
    RectangleFace,
    TimedInsertion,
)
from granflow.scene.schema.quantities import Vector3
from granflow.visible_text import alternatives

_AXES = "xyz"


def some_particles(parts: PartialScene) -> Iterator[Fault]:
    """At least one group of particles must be given."""
    node = parts.document.root.child("particles")
    if node is not None and node.entries == {}:
        yield Fault(("particles",), "at least one group of particles is required")


def inside_domain(parts: PartialScene) -> Iterator[Fault]:
    """Initial positions and insertion regions must lie inside the domain.

    Centers only: a particle may extend beyond the domain. Inverted domains are reported by another check.
    """
    low, high = parts.scene.domain.min, parts.scene.domain.max
    for name, group in parts.scene.particles.items():
        path: KeyPath = ("particles", name, "insert")
        if isinstance(group.insert, PositionsInsertion):
            for index, point in enumerate(group.insert.positions):
                if not all(a <= x <= b or b <= a for a, x, b in zip(low, point, high, strict=True)):
                    yield Fault((*path, "positions", index), "it lies outside the domain")
        if isinstance(group.insert, PositionsInsertion | FileInsertion | PythonInsertion):
            continue
        key = "face" if isinstance(group.insert, InletInsertion) else "region"
        for axis, (a, b) in enumerate(_extent(getattr(group.insert, key))):
            if low[axis] < high[axis] and (a < low[axis] or b > high[axis]):
                reach = f"extends from {a:.4g} to {b:.4g} m in {_AXES[axis]}"
                yield whole((*path, key), f"{reach}, beyond the domain, {low[axis]:g} to {high[axis]:g} m")


def _extent(region: BoxRegion | CylinderRegion | RectangleFace | DiscFace) -> Iterator[tuple[float, float]]:
    """Smallest and largest coordinate [m] of a region or a face along each axis.

    For a cylinder with the unit axis a, a radius R extends by R sqrt(1 - a_k^2) along axis k from each end.
    """
    if isinstance(region, BoxRegion):
        yield from zip(region.box.min, region.box.max, strict=True)
    elif isinstance(region, RectangleFace):
        for c, p, q in zip(region.rectangle.corner, *region.rectangle.sides, strict=True):
            corners = (c, c + p, c + q, c + p + q)
            yield min(corners), max(corners)
    elif isinstance(region, DiscFace):
        disc = region.disc
        yield from _round_extent(disc.center, disc.center, disc.normal, disc.radius)
    else:
        a, b = region.cylinder.from_, region.cylinder.to
        yield from _round_extent(a, b, (b[0] - a[0], b[1] - a[1], b[2] - a[2]), region.cylinder.radius)


def _round_extent(a: Vector3, b: Vector3, axis: Vector3, radius: float) -> Iterator[tuple[float, float]]:
    """Extent along each axis of two circles around the points a and b [m], perpendicular to `axis`."""
    length = math.hypot(*axis) or 1.0
    for p, q, along in zip(a, b, axis, strict=True):
        reach = radius * math.sqrt(max(0.0, 1 - (along / length) ** 2))
        yield min(p, q) - reach, max(p, q) + reach


def lees_edwards(parts: PartialScene) -> Iterator[Fault]:
    """Lees-Edwards boxes support neither walls, nor insertion during the run, nor flow meters: the images move.

    One fault names all features of the scene that are not supported.
    """
    scene = parts.scene
    if scene.domain.lees_edwards is None:
        return
    inserted = [name for name, group in scene.particles.items() if isinstance(group.insert, TimedInsertion)]
    unsupported = {
        "walls": list(scene.walls),
        "particles inserted during the run": inserted,
        "flow meters": list(scene.output.flow_meters),
    }
    found = [f"{kind} ({', '.join(names)})" for kind, names in unsupported.items() if names]
    if scene.damping is not None:
        yield Fault(
            ("damping",), "domain.lees_edwards is given, and no frame is at rest in uniform shear; remove one of them"
        )
    if found:
        unsupported_text = alternatives(found)
        yield whole(("domain", "lees_edwards"), f"cannot be combined with {unsupported_text}: the periodic images move")
