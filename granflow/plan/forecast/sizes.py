"""Dimensions of walls and diameters that are far above the size of the domain or of an inlet: probably a wrong unit."""

from collections.abc import Iterator
from math import dist, hypot, inf

from granflow.load import Scene
from granflow.plan.size_classes import outer_diameter_range
from granflow.scene.schema.insertion import DiscFace, InletInsertion
from granflow.scene.schema.shapes import Axial, Rectangular
from granflow.scene.schema.walls import Wall

LARGE_DIAMETER = 10.0
"""Diameter over the longest side of the domain above which a unit is probably wrong; large spheres serve as walls."""

LARGE_WALL = 20.0
"""Dimension of a wall over the longest side of the domain above which a unit is probably wrong; walls can be larger
than the domain."""

RADII = ("radius", "radius_from", "radius_to", "hole_radius")
"""Keys of walls with one length."""

MILLI = 1e-3


def size_warnings(scene: Scene) -> Iterator[str]:
    """A sentence for each group with particles that are larger than the domain, and for each wall that is much larger.

    Particles of inlets are compared with the face. Domains that expand have no size. Meshes have notes of their own,
    and faces of boxes are compared with the domain by their positions.
    """
    for path, sentence in _oversizes(scene):
        yield f"{'.'.join(path)} ({scene.where(*path)}) {sentence}"


def size_problems(scene: Scene) -> Iterator[str]:
    """The sentences of `size_warnings` in the form of errors."""
    for path, sentence in _oversizes(scene):
        yield f"{scene.locate(*path)}: {'.'.join(path)} {sentence}"


def _oversizes(scene: Scene) -> Iterator[tuple[tuple[str, ...], str]]:
    """Path of the key and rest of the sentence of each length that is too large."""
    side = _longest_side(scene)
    domain = f"the longest side of the domain, {side:.3g} m"
    for name, group in scene.particles.items():
        diameter, path = outer_diameter_range(group)[1], ("particles", name, "diameter")
        width = _width(group.insert) if isinstance(group.insert, InletInsertion) else inf
        if diameter > width:
            face = f"larger than the face of the inlet, which is {width:.3g} m wide"
            yield path, f"is {diameter:.3g} m, {face}. {_likely(diameter, width)}"
        elif diameter > LARGE_DIAMETER * side and scene.domain.on_exit != "expand":
            yield path, f"is {diameter:.3g} m, {diameter / side:.0f} times {domain}. {_likely(diameter, side)}"
    for name, wall in scene.walls.items():
        if large := oversized(scene, name, wall):
            key, length = large
            rest = f"is {length:.3g} m, {length / side:.0f} times {domain}. {_likely(length, side)}"
            yield ("walls", name, key), rest


def oversized(scene: Scene, name: str, wall: Wall) -> tuple[str, float] | None:
    """Key and length [m] of the largest dimension of a wall if it is much larger than the domain."""
    if scene.domain.on_exit == "expand" or "." in name:
        return None
    key, length = max(_dimensions(wall), key=lambda each: each[1], default=("", 0.0))
    return (key, length) if length > LARGE_WALL * _longest_side(scene) else None


def _dimensions(wall: Wall) -> Iterator[tuple[str, float]]:
    """Keys and lengths [m] of a wall: radii, length of the axis, sides of a rectangle."""
    yield from ((key, getattr(wall, key)) for key in RADII if hasattr(wall, key))
    if isinstance(wall, Axial):
        yield "to", dist(wall.from_, wall.to)
    if isinstance(wall, Rectangular):
        yield "sides", max(hypot(*each) for each in wall.sides)


def _longest_side(scene: Scene) -> float:
    return max(high - low for low, high in zip(scene.domain.min, scene.domain.max, strict=True))


def _width(insertion: InletInsertion) -> float:
    """Diameter of the largest sphere that fits through the face of an inlet [m]."""
    face = insertion.face
    return 2.0 * face.disc.radius if isinstance(face, DiscFace) else min(hypot(*each) for each in face.rectangle.sides)


def _likely(length: float, limit: float) -> str:
    """Instruction for a length [m] above a limit [m]: the same number in mm, if that is below the limit."""
    if MILLI * length > limit:
        return "Check the units of both."
    return f"Check the unit: {length:.3g} mm is {MILLI * length:.3g} m."
