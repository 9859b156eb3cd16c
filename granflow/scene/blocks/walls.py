"""Schema of the block `walls`: shapes, materials, presence and motions of walls.

`Wall` has the keys that all shapes share; each shape adds its own. Its key `motion` contains the motions of
`motions`. A box stands for up to six walls, by which `with_faces` replaces it while a scene
is read.
"""

from collections.abc import Iterator
from typing import Annotated, Any, Literal, get_args

from pydantic import Field

from granflow.scene.blocks.motions import MotionSpec
from granflow.scene.blocks.shapes import Axial, Rectangular, RotationStep
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, redundant, value_error, whole
from granflow.schema.model import FileName, Flag, ListOf, Model, Names, Text, choose_by_key, optional
from granflow.schema.quantities import Number


class Wall(Model):
    """Properties of walls of every shape.

    Shapes other than a plane have no thickness, and particles may be on both sides.
    """

    shape: str = Field(description="shape of the wall")
    material: Text = Field(description="name of the wall's material")
    appears_at: q.Time | None = optional("time at which the wall appears [s]", "start of the run")
    vanishes_at: q.Time | None = optional("time at which the wall vanishes [s]", "never")
    stages: Names | None = optional("stages in which the wall is present", "all")
    motion: Annotated[tuple[MotionSpec, ...], ListOf(one=True)] = Field(
        (), description="motion of the wall: one motion or a list of motions"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless either times or stages are given, or if the wall has two rotations."""
        if self.stages is not None and (self.appears_at is not None or self.vanishes_at is not None):
            yield redundant("stages", "appears_at or vanishes_at", keep="either the times or the stages")
        elif self.vanishes_at is not None and self.vanishes_at <= (self.appears_at or 0.0):
            yield Fault(
                ("vanishes_at",), f"the wall must vanish after it appears at {self.appears_at or 0.0:g} s"
            )
        rotations = [i for i, motion in enumerate(self.motion) if motion.rotates]
        for i in rotations[1:]:
            yield whole(("motion", i), "is a second rotation; a wall has at most one")


class Plane(Wall):
    """An infinite plane; the half space behind it is solid, the particles are on the side of the normal.

    Its area is infinite: it has forces, but no pressure.

    >>> gf.Plane(material="steel", point=[0, 0, 0], normal=[0, 0, 1])
    Plane(material='steel', point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0))
    """

    shape: Literal["plane"] = Field("plane", description="shape of the wall")
    point: q.Point = Field(description="a point on the plane [m]")
    normal: q.Direction = Field(description="normal, toward the particles; its length does not matter")


class Rectangle(Rectangular, Wall):
    """A thin, flat, two-sided rectangle with the corner and the two edge vectors [m].

    >>> gf.Rectangle(material="steel", corner=[0, 0, 0], sides=[["5 cm", 0, 0], [0, "5 cm", 0]]).sides
    ((0.05, 0.0, 0.0), (0.0, 0.05, 0.0))
    """

    shape: Literal["rectangle"] = Field("rectangle", description="shape of the wall")


class AxialWall(Axial, Wall):
    """A surface of revolution about the line from `from` to `to` [m]."""


class Cylinder(AxialWall):
    """A thin two-sided cylinder without end faces, with the length of the axis.

    >>> gf.Cylinder(material="steel", from_=[0, 0, 0], to=[0, 0, "20 cm"], radius="5 cm").radius
    0.05
    """

    shape: Literal["cylinder"] = Field("cylinder", description="shape of the wall")
    radius: q.PositiveLength = Field(description="radius [m]")


class Cone(AxialWall):
    """A thin two-sided cone frustum without end faces; one radius may be 0.

    >>> axis = {"from_": [0, 0, 0], "to": [0, 0, 0.1]}
    >>> gf.Cone(material="steel", **axis, radius_from="1 cm", radius_to="5 cm").radius_to
    0.05
    """

    shape: Literal["cone"] = Field("cone", description="shape of the wall")
    radius_from: q.NotNegativeLength = Field(description="radius at `from` [m]")
    radius_to: q.NotNegativeLength = Field(description="radius at `to` [m]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless at least one radius is above 0."""
        yield from super().faults()
        if self.radius_from == self.radius_to == 0:
            yield Fault(("radius_to",), "radius_from is 0 too: one of them must be above 0")


class Disc(Wall):
    """A thin, two-sided disc, optionally with a circular hole at its center.

    >>> place = {"center": [0, 0, 0], "normal": [0, 0, 1]}
    >>> gf.Disc(material="steel", **place, radius="5 cm", hole_radius="1 cm").hole_radius
    0.01
    """

    shape: Literal["disc"] = Field("disc", description="shape of the wall")
    center: q.Point = Field(description="center [m]")
    normal: q.Direction = Field(description="normal; its length and sign do not matter")
    radius: q.PositiveLength = Field(description="outer radius [m]")
    hole_radius: q.NotNegativeLength = Field(0.0, description="radius of the hole [m]; 0: no hole")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the hole is smaller than the disc."""
        yield from super().faults()
        if self.hole_radius >= self.radius:
            yield Fault(
                ("hole_radius",), f"the hole must be smaller than the disc of radius {self.radius:g} m"
            )


MeshScale = Annotated[float, Number(above=0, scaling=1)]
"""Factor from the length unit of a mesh file to m, above 0; proportional to `scale`."""


class MeshWall(Wall):
    """Two-sided triangles from a file, transformed in this order: scale, rotate, translate.

    The orientation of the triangles has no effect; open edges are valid.

    >>> gf.MeshWall(material="steel", file="meshes/bowl.stl", scale=0.001).file
    'meshes/bowl.stl'
    """

    shape: Literal["mesh"] = Field("mesh", description="shape of the wall")
    file: FileName = Field(
        description="STL, OBJ, PLY, VTK or VTU file; path relative to the folder of the scene"
    )
    scale: MeshScale = Field(
        1.0, description="factor from the length unit of the file to m, such as 0.001 for mm"
    )
    rotate: Annotated[tuple[RotationStep, ...], ListOf(one=True)] = Field(
        (),
        description="rotation of the mesh about the origin: one rotation, or a list in order of application",
    )
    translate: q.Point = Field((0.0, 0.0, 0.0), description="displacement of the mesh [m]")


# Boxes, which stand for several walls

FaceName = Literal["left", "right", "front", "back", "bottom", "top"]
"""Faces of a box at the smallest and the largest x, y and z."""
FACES: tuple[FaceName, ...] = get_args(FaceName)


class BoxWall(Wall):
    """A box with edges along the coordinate axes, from `min` to `max`, for particles inside; faces can be
    open.

    It stands for up to six walls with the names NAME.left and NAME.right (smallest and largest x), NAME.front
    and NAME.back (y), NAME.bottom and NAME.top (z), all with the same material, presence and motion. The
    faces are planes: infinite, also beyond an open face. With `finite` they are rectangles.

    >>> gf.BoxWall(material="steel", min=[0, 0, 0], max=["5 cm", "5 cm", "10 cm"], open=["top"]).open
    ('top',)
    """

    shape: Literal["box"] = Field("box", description="shape of the wall")
    min: q.Point = Field(description="corner with the smallest coordinates [m]")
    max: q.Point = Field(description="corner with the largest coordinates [m]")
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
        for i, (low, high) in enumerate(zip(self.min, self.max, strict=True)):
            if high <= low:
                yield Fault(("max", i), f"it must be above min, {low:g} m")
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
        shared: dict[str, Any] = {name: getattr(self, name) for name in Wall.model_fields if name != "shape"}
        for number, name in enumerate(FACES):
            if name not in self.open:
                axis, is_high = divmod(number, 2)
                build = self._rectangle if self.finite else self._plane
                yield name, build(axis, is_high, shared)

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


AnyWall = Annotated[Plane | Rectangle | Cylinder | Cone | Disc | BoxWall | MeshWall, choose_by_key("shape")]
"""A wall of any shape; the key `shape` selects it."""


def with_faces(walls: dict[str, Wall]) -> dict[str, Wall]:
    """The walls with the faces of each valid box in its place, named BOX.FACE; an invalid box remains.

    Raises PydanticCustomError if the scene gives a wall of that name, too.
    """
    found: dict[str, Wall] = {}
    for name, wall in walls.items():
        if isinstance(wall, BoxWall) and not any(wall.faults()):
            for face, each in wall.faces():
                if f"{name}.{face}" in walls:
                    raise value_error(f"{name}.{face} is also a face of the box {name}; rename one of them")
                found[f"{name}.{face}"] = each
        else:
            found[name] = wall
    return found
