"""Schema of the block `walls`: shapes, materials, presence and motions of walls.

`Wall` has the keys that all shapes share; each shape adds its own. The motions, which the key `motion` of a
wall contains, precede it. A box stands for up to six walls, by which `with_faces` replaces it while a scene
is read.
"""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_args

from pydantic import Field

from granflow.scene.blocks import quantities as q
from granflow.scene.blocks.quantities import Number
from granflow.scene.blocks.shapes import Axial, Rectangular, RotationStep
from granflow.scene.faults import Fault, missing, redundant, value_error, whole
from granflow.scene.model import FileName, Flag, ListOf, Model, Names, Text, choose_by_key, optional

# Key `motion`


class TimedMotion(Model):
    """A motion from `start` to `end` or during stages; by default during the whole run.

    Motions of the same wall are superposed; a wall has at most one rotation.
    """

    force_controlled: ClassVar[bool] = False
    """True for motions that respond to the force of the particles on the wall."""

    kind: str = Field(description="kind of motion")
    start: q.Time | None = optional("time at which the motion begins [s]", "start of the run")
    end: q.Time | None = optional("time at which the motion ends [s]", "end of the run")
    stages: Names | None = Field(
        None, description="stages with this motion; its time starts at the first of them"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless either times or stages are given, and the end is after the start."""
        if self.stages is not None and (self.start is not None or self.end is not None):
            yield redundant("stages", "start or end", keep="either the times or the stages")
        elif self.end is not None and self.end <= (self.start or 0.0):
            yield Fault(("end",), f"the motion must end after its start at {self.start or 0.0:g} s")

    def _ramp_faults(self, name: str, ramp_duration: float | None) -> Iterator[Fault]:
        """Yield a fault for an initial value of the velocity `name` without ramp."""
        if getattr(self, f"initial_{name}") is not None and ramp_duration is None:
            yield missing(("ramp_duration",), f"the time during which initial_{name} changes to {name}")


class Vibration(TimedMotion):
    """Sinusoidal motion along a direction from the given position; t is the time since the start [s].

        displacement:  amplitude * (sin(angular_frequency * t + phase) - sin(phase))
        velocity:      amplitude * angular_frequency * cos(angular_frequency * t + phase)

    The position is continuous at the start; the velocity is too if phase is 90 deg or -90 deg. The center of
    the oscillation is at -amplitude * sin(phase) from the given position. At the end the wall stops at its
    position.

    >>> gf.Vibration(direction=[0, 0, 1], amplitude="2 mm", frequency="25 Hz")
    Vibration(direction=(0.0, 0.0, 1.0), amplitude=0.002, frequency=25.0)
    """

    kind: Literal["vibration"] = Field("vibration", description="kind of motion")
    direction: q.Direction = Field(description="direction of the motion; its length does not matter")
    amplitude: q.UnscaledLength | None = Field(
        None, description="amplitude, half of the peak-to-peak value [m]"
    )
    frequency: q.Frequency | None = Field(None, description="frequency [Hz]")
    angular_frequency: q.PositiveAngularVelocity | None = Field(None, description="angular frequency [rad/s]")
    gamma: q.Positive | None = Field(None, description="peak acceleration over the magnitude of gravity")
    phase: q.Angle = Field(
        0.0,
        description=(
            "phase at the start [rad]; 0: the wall starts at full speed from the center of the oscillation"
        ),
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly two of amplitude, frequency (of either kind) and gamma are given."""
        yield from super().faults()
        if self.frequency is not None and self.angular_frequency is not None:
            yield redundant("angular_frequency", "frequency")
            return
        rate = self.frequency if self.frequency is not None else self.angular_frequency
        given = sum(value is not None for value in (self.amplitude, rate, self.gamma))
        if given != 2:
            count = ("none", "one", "two", "all three")[given]
            yield whole((), f"gives {count} of amplitude, frequency and gamma; give exactly two of them")

    def amplitude_and_angular_frequency(self, gravity: q.Vector3) -> tuple[float, float]:
        """Amplitude A [m] and angular frequency w [rad/s], from those given and gamma.

            gamma = A w^2 / |g|

        `gravity` g (3,) [m/s2].
        """
        omega = self.angular_frequency
        if omega is None and self.frequency is not None:
            omega = 2 * math.pi * self.frequency
        peak = (self.gamma or 0.0) * math.hypot(*gravity)
        if omega is None:
            assert self.amplitude is not None
            return self.amplitude, math.sqrt(peak / self.amplitude)
        return (peak / omega**2 if self.amplitude is None else self.amplitude), omega


class VelocityMotion(TimedMotion):
    """A velocity [m/s] that is constant, or changes linearly during a ramp at the start."""

    velocity: q.VelocityVector = Field(description="velocity [m/s], after the ramp if there is one")
    ramp_duration: q.PositiveTime | None = optional(
        "time from the start during which the velocity changes linearly [s]", "no ramp"
    )
    initial_velocity: q.VelocityVector | None = optional(
        "with ramp_duration: velocity at the start [m/s]", "0"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for an initial velocity without ramp."""
        yield from super().faults()
        yield from self._ramp_faults("velocity", self.ramp_duration)


class Translation(VelocityMotion):
    """Motion at a velocity [m/s] that is constant, or changes linearly during a ramp at the start.

    >>> gf.Translation(velocity=[0, 0, "10 cm/s"], start="0.5 s")
    Translation(start=0.5, velocity=(0.0, 0.0, 0.1))
    """

    kind: Literal["translation"] = Field("translation", description="kind of motion")


class SurfaceVelocity(VelocityMotion):
    """Velocity of the surface along itself, as of a conveyor belt: the surface moves, the shape of the wall
    does not.

    The velocity is given in the frame of the wall and rotates with it. At each contact the component in the
    contact plane acts, v - (v . n) n: friction drives the particles, and faces across the velocity are at
    rest.

    >>> gf.SurfaceVelocity(velocity=["1 m/s", 0, 0], ramp_duration="0.2 s").velocity
    (1.0, 0.0, 0.0)
    """

    kind: Literal["surface_velocity"] = Field("surface_velocity", description="kind of motion")


class Rotation(TimedMotion):
    """Rotation about an axis, right-handed, at a rate that is constant or changes linearly during a ramp at
    the start.

    The torque on the wall refers to `point`.

    >>> gf.Rotation(point=[0, 0, 0], axis=[0, 1, 0], angular_velocity="30 rpm").angular_velocity
    3.141592653589793
    """

    kind: Literal["rotation"] = Field("rotation", description="kind of motion")
    point: q.Point = Field(description="a point on the axis [m]")
    axis: q.Direction = Field(description="direction of the axis; its length does not matter")
    angular_velocity: q.AngularVelocity = Field(
        description="angular velocity [rad/s], such as 30 rpm; after the ramp if there is one"
    )
    ramp_duration: q.PositiveTime | None = optional(
        "time from the start during which the rate changes linearly [s]", "no ramp"
    )
    initial_angular_velocity: q.AngularVelocity | None = optional(
        "with ramp_duration: angular velocity at the start [rad/s]", "0"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for an initial angular velocity without ramp."""
        yield from super().faults()
        yield from self._ramp_faults("angular_velocity", self.ramp_duration)


TABLE_COLUMNS = {
    "displacements": "length",
    "velocities": "velocity",
    "angles": "angle",
    "angular_velocities": "angular_velocity",
}
"""Columns of a table of a motion besides the times, and their dimensions."""
MOST_ROWS = 10_000
"""Largest number of rows of a table; the resolved scene contains them."""
_T = TypeVar("_T")
_Column = Annotated[tuple[_T, ...], ListOf(some="[0, 0.1, 0.2]")]
_Displacement = Annotated[float, Number("length")]


class TableMotion(TimedMotion):
    """Motion from a table, a CSV file or lists: times, and displacements, velocities, angles or angular
    velocities.

    Times count from the start of the motion. Velocities are linear between rows; displacements and angles are
    interpolated with a continuous velocity and without overshoot (Fritsch & Butland), and count from the
    first row. The wall is at rest before the first and after the last row.

    >>> times = [0, "10 ms", "20 ms"]
    >>> gf.TableMotion(direction=[0, 0, 1], times=times, displacements=[0, "1 mm", 0]).displacements
    (0.0, 0.001, 0.0)
    """

    kind: Literal["table"] = Field("table", description="kind of motion")
    file: FileName | None = Field(
        None,
        description=(
            "CSV file with the columns time and displacement, velocity, angle or angular_velocity, such as "
            "time [ms], displacement [mm]; path relative to the folder of the scene"
        ),
    )
    direction: q.Direction | None = Field(None, description="direction of displacements or velocities")
    point: q.Point | None = Field(None, description="with angles: a point on the axis [m]")
    axis: q.Direction | None = Field(None, description="with angles: direction of the axis, right-handed")
    times: _Column[q.Time] | None = Field(
        None, description="times [s], ascending; instead of a file, or from it"
    )
    displacements: _Column[_Displacement] | None = Field(
        None, description="displacements along the direction [m]"
    )
    velocities: _Column[q.Velocity] | None = Field(None, description="velocities along the direction [m/s]")
    angles: _Column[q.Angle] | None = Field(None, description="angles about the axis [rad]")
    angular_velocities: _Column[q.AngularVelocity] | None = Field(
        None, description="rates about the axis [rad/s]"
    )

    @property
    def column(self) -> str | None:
        """Name of the given column besides the times; None if it is not known yet, or several are given."""
        given = [name for name in TABLE_COLUMNS if getattr(self, name) is not None]
        return given[0] if len(given) == 1 else None

    @property
    def rotates(self) -> bool:
        """Whether the table contains angles or angular velocities."""
        return self.column is not None and self.column.startswith("ang")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the table is complete and a direction, or point and axis, belong to it."""
        yield from super().faults()
        if self.file is None and (self.times is None or self.column is None):
            yield whole((), f"has no table: give file, or times and one of {', '.join(TABLE_COLUMNS)}")
        elif self.times is not None and self.column is not None:
            yield from self._row_faults(self.times, getattr(self, self.column))
        if self.direction is None and (self.point is None or self.axis is None):
            yield whole((), "has neither direction (translation) nor point and axis (rotation)")
        elif self.direction is not None and (self.point is not None or self.axis is not None):
            yield redundant("direction", "point or axis")
        elif self.column is not None and self.rotates == (self.direction is not None):
            needed = "point and axis" if self.rotates else "direction"
            yield whole((), f"contains {self.column.replace('_', ' ')}, which require {needed}")

    def _row_faults(self, times: tuple[float, ...], values: tuple[float, ...]) -> Iterator[Fault]:
        if len(times) < 2 or len(times) > MOST_ROWS:
            yield Fault(("times",), f"a table has 2 to {MOST_ROWS} rows")
        if len(values) != len(times):
            yield Fault((str(self.column),), f"{len(times)} values are expected, one for each of the times")
        for index, (before, after) in enumerate(pairwise(times), start=1):
            if after <= before:
                yield Fault(("times", index), f"times must ascend, and the one before is {before:g} s")
                return


class Servo(TimedMotion):
    """A servo wall: its velocity follows the difference between prescribed and measured force.

        v = gain (F - f),      |v| <= velocity_max

    F: prescribed force, f: force of the wall on the particles [N], both along `direction`. Gravity does not
    act on it.

    >>> gf.Servo(direction=[0, 0, -1], pressure="2 kPa", velocity_max="1 m/s").pressure
    2000.0
    """

    force_controlled: ClassVar[bool] = True

    kind: Literal["servo"] = Field("servo", description="kind of motion")
    direction: q.Direction = Field(
        description="direction of the force on the particles; its length does not matter"
    )
    force: q.PositiveForce | None = Field(None, description="prescribed force on the particles [N]")
    pressure: q.Pressure | None = Field(
        None, description="prescribed pressure, force over the area of the wall [Pa]; instead of force"
    )
    velocity_max: q.Speed = Field(description="largest speed of the wall [m/s]")
    gain: q.Positive | None = optional(
        "velocity over force difference [m/(s N)]", "from stiffness and time step"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly one of force and pressure is given."""
        yield from super().faults()
        if self.force is None and self.pressure is None:
            yield whole((), "has no prescribed force: give force or pressure")
        elif self.force is not None and self.pressure is not None:
            yield redundant("pressure", "force")


class FreeWall(TimedMotion):
    """A free wall: a rigid body that contact forces, gravity and a given force move along one direction.

        M dv/dt = f + M g + force - damping v

    f: force of the particles on the wall [N], g: gravity [m/s2], both along `direction`. The wall starts at
    rest.

    >>> gf.FreeWall(direction=[0, 0, 1], mass="200 g").mass
    0.2
    """

    force_controlled: ClassVar[bool] = True

    kind: Literal["free"] = Field("free", description="kind of motion")
    direction: q.Direction = Field(description="direction of the motion; its length does not matter")
    mass: q.Mass = Field(description="mass of the wall [kg]")
    force: q.Force = Field(0.0, description="additional force along the direction [N]")
    damping: q.Damping = Field(0.0, description="viscous damping constant, force over velocity [kg/s]")


MotionSpec = Annotated[
    Vibration | Translation | Rotation | TableMotion | SurfaceVelocity | Servo | FreeWall,
    choose_by_key("kind"),
]
"""Any kind of motion; the key `kind` selects it."""


# Walls


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
        rotations = [
            i
            for i, motion in enumerate(self.motion)
            if motion.kind == "rotation" or (motion.kind == "table" and motion.axis is not None)
        ]
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
