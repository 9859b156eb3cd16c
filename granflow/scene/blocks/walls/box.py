"""Box: six walls or fewer, by which it is replaced while a scene is read (`kinds.with_faces`)."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal, get_args

from pydantic import Field

from granflow.scene.blocks.primitives import Box
from granflow.scene.blocks.walls.half_space import Plane
from granflow.scene.blocks.walls.rectangle import Rectangle
from granflow.scene.blocks.walls.wall import Wall, shared_keys
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, whole
from granflow.schema.model import Flag, ListOf

FaceName = Literal["left", "right", "front", "back", "bottom", "top"]
"""Faces of a box at the smallest and the largest x, y and z."""
FACES: tuple[FaceName, ...] = get_args(FaceName)


class BoxWall(Box, Wall):
    """A box with edges along the coordinate axes, from `min` to `max`, for particles inside; faces can be
    open.

    It stands for up to six walls with the names NAME.left and NAME.right (smallest and largest x), NAME.front
    and NAME.back (y), NAME.bottom and NAME.top (z), all with the same material, presence and motion. The
    faces are planes: infinite, also beyond an open face. With `finite` they are rectangles.

    >>> gf.BoxWall(material="steel", min=[0, 0, 0], max=["5 cm", "5 cm", "10 cm"], open=["top"]).open
    ('top',)
    """

    shape: Literal["box"] = Field("box", description="shape of the wall")
    open: Annotated[tuple[FaceName, ...], ListOf(some="[top]")] = Field(
        (), description="faces without a wall: left, right (x), front, back (y), bottom, top (z)"
    )
    finite: Flag = Field(
        False,
        description="true: rectangles, which have a pressure and end at the box; false: infinite planes",
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for an empty extent, an open box without faces, and motions of single walls."""
        yield from super().faults()
        if set(self.open) == set(FACES):
            yield Fault(("open",), "all six faces are open; leave one closed, or remove the wall")
        for i, motion in enumerate(self.motion):
            if motion.force_controlled:
                reason = (
                    "moves one wall: replace the box by single walls, or open this face and add it as a "
                    "rectangle"
                )
                yield whole(("motion", i), f"is of kind {motion.kind}, which {reason}")

    def faces(self) -> Iterator[tuple[FaceName, Plane | Rectangle]]:
        """Yield the closed faces by name, as walls with the properties of the box."""
        shared = shared_keys(self)
        for number, name in enumerate(FACES):
            if name not in self.open:
                axis, is_high = divmod(number, 2)
                build = self._rectangle if self.finite else self._plane
                yield name, build(axis, is_high, shared)

    def walls(self, name: str) -> Iterator[tuple[str, Wall]]:
        """The closed faces, named BOX.FACE; an invalid box remains."""
        if any(self.faults()):
            yield name, self
        else:
            yield from ((f"{name}.{face}", wall) for face, wall in self.faces())

    def _plane(self, axis: int, is_high: int, shared: dict[str, Any]) -> Plane:
        """The plane across an axis at the smallest or largest coordinate; its normal points inside."""
        normal = [0.0, 0.0, 0.0]
        normal[axis] = -1.0 if is_high else 1.0
        return Plane.model_construct(point=self._corner(axis, is_high), normal=_vector(normal), **shared)

    def _rectangle(self, axis: int, is_high: int, shared: dict[str, Any]) -> Rectangle:
        """The rectangle across an axis at the smallest or largest coordinate."""
        edges = []
        for k in range(3):
            edge = [0.0, 0.0, 0.0]
            edge[k] = self.max[k] - self.min[k]
            edges.append(_vector(edge))
        del edges[axis]
        first, second = edges
        return Rectangle.model_construct(corner=self._corner(axis, is_high), sides=(first, second), **shared)

    def _corner(self, axis: int, is_high: int) -> q.Vector3:
        """The corner with the smallest coordinates, moved along an axis to its largest if `is_high`."""
        corner = list(self.min)
        if is_high:
            corner[axis] = self.max[axis]
        return _vector(corner)


def _vector(values: list[float]) -> q.Vector3:
    x, y, z = values
    return x, y, z
