"""Schema of walls and their motion."""

import math
from collections.abc import Iterator
from pathlib import PurePath
from typing import Annotated, Literal

from pydantic import Field, Tag

from granflow.geometry.shape import are_perpendicular
from granflow.scene.schema.fields import (
    Angle,
    AngularVelocity,
    Damping,
    Direction,
    Fault,
    FileName,
    Force,
    Frequency,
    Mass,
    Model,
    Names,
    NotNegativeLength,
    Number,
    Point,
    Positive,
    PositiveAngularVelocity,
    PositiveForce,
    PositiveLength,
    Pressure,
    ShortForm,
    Speed,
    Text,
    Time,
    UnscaledLength,
    Vector3,
    VelocityVector,
    choose_by_key,
    list_of,
    pair_list,
)

MeshScale = Annotated[float, Number(above=0, scaling=1)]
"""Factor from the length unit of a mesh file to m, above 0; proportional to `scale`."""


def side_faults(sides: tuple[Vector3, Vector3]) -> Iterator[Fault]:
    """Faults of the two `sides` of a rectangle, vectors [m]: they must have lengths above 0 and be perpendicular."""
    a, b = sides
    lengths = math.hypot(*a), math.hypot(*b)
    for i, length in enumerate(lengths):
        if length == 0:
            yield Fault(("sides", i), "a side must not be the zero vector")
    if all(lengths) and not are_perpendicular(a, b):
        angle = math.degrees(math.acos(_dot(a, b) / (lengths[0] * lengths[1])))
        yield Fault(("sides",), f"the two sides must be perpendicular, and their angle is {angle:.4g} deg")


def _dot(a: Vector3, b: Vector3) -> float:
    """Scalar product of two vectors."""
    return sum(x * y for x, y in zip(a, b, strict=True))


class TimedMotion(Model):
    """A motion from `start` to `end` or during stages; by default during the whole run.

    Motions of the same wall are superposed; a wall has at most one rotation.
    """

    kind: str = Field(description="kind of motion")
    start: Time | None = Field(None, description="time at which the motion begins [s]; default: start of the run")
    end: Time | None = Field(None, description="time at which the motion ends [s]; default: end of the run")
    stages: Names | None = Field(None, description="stages with this motion; its time starts at the first of them")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless either times or stages are given, and the end is after the start."""
        if self.stages is not None and (self.start is not None or self.end is not None):
            yield Fault(("stages",), "start or end is given too: keep either the times or the stages")
        elif self.end is not None and self.end <= (self.start or 0.0):
            yield Fault(("end",), f"the motion must end after its start at {self.start or 0.0:g} s")


class VibrationSpec(TimedMotion):
    """Sinusoidal motion along a direction from the given position; t is the time since the start [s].

        displacement:  amplitude * (sin(angular_frequency * t + phase) - sin(phase))
        velocity:      amplitude * angular_frequency * cos(angular_frequency * t + phase)

    The position is continuous at the start; the velocity is too if phase is 90 deg or -90 deg. The center of the
    oscillation is at -amplitude * sin(phase) from the given position. At the end the wall stops at its position.
    """

    kind: Literal["vibration"] = Field(description="kind of motion")
    direction: Direction = Field(description="direction of the motion; its length does not matter")
    amplitude: UnscaledLength | None = Field(None, description="amplitude, half of the peak-to-peak value [m]")
    frequency: Frequency | None = Field(None, description="frequency [Hz]")
    angular_frequency: PositiveAngularVelocity | None = Field(None, description="angular frequency [rad/s]")
    gamma: Positive | None = Field(None, description="peak acceleration over the magnitude of gravity")
    phase: Angle = Field(
        0.0, description="phase at the start [rad]; 0: the wall starts at full speed from the center of the oscillation"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly two of amplitude, frequency (of either kind) and gamma are given."""
        yield from super().faults()
        if self.frequency is not None and self.angular_frequency is not None:
            yield Fault(("angular_frequency",), "frequency is given too: keep one of them")
            return
        rate = self.frequency if self.frequency is not None else self.angular_frequency
        given = sum(value is not None for value in (self.amplitude, rate, self.gamma))
        if given != 2:
            count = ("none", "one", "two", "all three")[given]
            yield Fault((), f"gives {count} of amplitude, frequency and gamma; give exactly two of them", whole=True)

    def amplitude_and_angular_frequency(self, gravity: Vector3) -> tuple[float, float]:
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


class TranslationSpec(TimedMotion):
    """Motion at a constant velocity [m/s]."""

    kind: Literal["translation"] = Field(description="kind of motion")
    velocity: VelocityVector = Field(description="velocity [m/s]")


class RotationSpec(TimedMotion):
    """Rotation about an axis at a constant rate, right-handed.

    The torque on the wall refers to `point`.
    """

    kind: Literal["rotation"] = Field(description="kind of motion")
    point: Point = Field(description="a point on the axis [m]")
    axis: Direction = Field(description="direction of the axis; its length does not matter")
    angular_velocity: AngularVelocity = Field(description="angular velocity [rad/s], such as 30 rpm")


class ServoSpec(TimedMotion):
    """A servo wall: its velocity is proportional to the difference between prescribed and measured force.

        v = gain (F - f),      |v| <= velocity_max

    F: prescribed force, f: force of the wall on the particles [N], both along `direction`. Gravity does not act on it.
    """

    kind: Literal["servo"] = Field(description="kind of motion")
    direction: Direction = Field(description="direction of the force on the particles; its length does not matter")
    force: PositiveForce | None = Field(None, description="prescribed force on the particles [N]")
    pressure: Pressure | None = Field(
        None, description="prescribed pressure, force over the area of the wall [Pa]; instead of force"
    )
    velocity_max: Speed = Field(description="largest speed of the wall [m/s]")
    gain: Positive | None = Field(
        None, description="velocity over force difference [m/(s N)]; default: from stiffness and time step"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly one of force and pressure is given."""
        yield from super().faults()
        if self.force is None and self.pressure is None:
            yield Fault((), "has no prescribed force: give force or pressure", whole=True)
        elif self.force is not None and self.pressure is not None:
            yield Fault(("pressure",), "force is given too: keep one of them")


class FreeWallSpec(TimedMotion):
    """A free wall: a rigid body that contact forces, gravity and a given force move along one direction.

        M dv/dt = f + M g + force - damping v

    f: force of the particles on the wall [N], g: gravity [m/s2], both along `direction`. The wall starts at rest.
    """

    kind: Literal["free"] = Field(description="kind of motion")
    direction: Direction = Field(description="direction of the motion; its length does not matter")
    mass: Mass = Field(description="mass of the wall [kg]")
    force: Force = Field(0.0, description="additional force along the direction [N]")
    damping: Damping = Field(0.0, description="viscous damping constant, force over velocity [kg/s]")


MotionSpec = Annotated[
    Annotated[VibrationSpec, Tag("<vibration>")]
    | Annotated[TranslationSpec, Tag("<translation>")]
    | Annotated[RotationSpec, Tag("<rotation>")]
    | Annotated[ServoSpec, Tag("<servo>")]
    | Annotated[FreeWallSpec, Tag("<free>")],
    choose_by_key("kind"),
]
"""Any kind of motion; the key `kind` selects it."""


class Wall(Model):
    """Properties of walls of every shape.

    Shapes other than a plane have no thickness, and particles may be on both sides.
    """

    shape: str = Field(description="shape of the wall")
    material: Text = Field(description="name of the wall's material")
    appears_at: Time | None = Field(None, description="time at which the wall appears [s]; default: start of the run")
    vanishes_at: Time | None = Field(None, description="time at which the wall vanishes [s]; default: never")
    stages: Names | None = Field(None, description="stages in which the wall is present; default: all")
    motion: Annotated[tuple[MotionSpec, ...], list_of(one=True), ShortForm()] = Field(
        (), description="motion of the wall: one motion or a list of motions"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless either times or stages are given, or if the wall has two rotations."""
        if self.stages is not None and (self.appears_at is not None or self.vanishes_at is not None):
            yield Fault(("stages",), "appears_at or vanishes_at is given too: keep either the times or the stages")
        elif self.vanishes_at is not None and self.vanishes_at <= (self.appears_at or 0.0):
            yield Fault(("vanishes_at",), f"the wall must vanish after it appears at {self.appears_at or 0.0:g} s")
        rotations = [i for i, motion in enumerate(self.motion) if motion.kind == "rotation"]
        for i in rotations[1:]:
            yield Fault(("motion", i), "is a second rotation; a wall has at most one", whole=True)


class Plane(Wall):
    """An infinite plane; the half space behind it is solid, the particles are on the side of the normal.

    Its area is infinite: it has forces, but no pressure.
    """

    shape: Literal["plane"] = Field(description="shape of the wall")
    point: Point = Field(description="a point on the plane [m]")
    normal: Direction = Field(description="normal, toward the particles; its length does not matter")


class Rectangle(Wall):
    """A thin, flat, two-sided rectangle with the corner and the two edge vectors [m]."""

    shape: Literal["rectangle"] = Field(description="shape of the wall")
    corner: Point = Field(description="one corner [m]")
    sides: Annotated[tuple[Point, Point], pair_list("two edge vectors")] = Field(
        description="the two edge vectors from that corner, perpendicular [m]"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the edges have lengths above 0 and are perpendicular."""
        yield from super().faults()
        yield from side_faults(self.sides)


class AxialWall(Wall):
    """A surface of revolution about the line from `from` to `to` [m]."""

    from_: Point = Field(alias="from", description="one end of the axis [m]")
    to: Point = Field(description="the other end of the axis [m]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault if the axis has no length."""
        yield from super().faults()
        if self.from_ == self.to:
            yield Fault(("to",), "it is the same point as from; the end points of the axis must differ")


class Cylinder(AxialWall):
    """A thin two-sided cylinder without end faces, with the length of the axis."""

    shape: Literal["cylinder"] = Field(description="shape of the wall")
    radius: PositiveLength = Field(description="radius [m]")


class Cone(AxialWall):
    """A thin two-sided cone frustum without end faces; one radius may be 0."""

    shape: Literal["cone"] = Field(description="shape of the wall")
    radius_from: NotNegativeLength = Field(description="radius at `from` [m]")
    radius_to: NotNegativeLength = Field(description="radius at `to` [m]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless at least one radius is above 0."""
        yield from super().faults()
        if self.radius_from == self.radius_to == 0:
            yield Fault(("radius_to",), "radius_from is 0 too: one of them must be above 0")


class Disc(Wall):
    """A thin, two-sided disc, optionally with a circular hole at its center."""

    shape: Literal["disc"] = Field(description="shape of the wall")
    center: Point = Field(description="center [m]")
    normal: Direction = Field(description="normal; its length and sign do not matter")
    radius: PositiveLength = Field(description="outer radius [m]")
    hole_radius: NotNegativeLength = Field(0.0, description="radius of the hole [m]; 0: no hole")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the hole is smaller than the disc."""
        yield from super().faults()
        if self.hole_radius >= self.radius:
            yield Fault(("hole_radius",), f"the hole must be smaller than the disc of radius {self.radius:g} m")


class RotationStep(Model):
    """A right-handed rotation about an axis through the origin."""

    axis: Direction = Field(description="direction of the axis; its length does not matter")
    angle: Angle = Field(description="angle [rad], such as 90 deg")


class MeshWall(Wall):
    """Two-sided triangles from a file, transformed in this order: scale, rotate, translate.

    The orientation of the triangles has no effect; open edges are valid.
    """

    shape: Literal["mesh"] = Field(description="shape of the wall")
    file: FileName = Field(
        description="STL, OBJ, PLY, VTK or VTU file; path relative to the folder of the scene, without .."
    )
    scale: MeshScale = Field(1.0, description="factor from the length unit of the file to m, such as 0.001 for mm")
    rotate: Annotated[tuple[RotationStep, ...], list_of(one=True), ShortForm()] = Field(
        (), description="rotation of the mesh about the origin: one rotation, or a list in order of application"
    )
    translate: Point = Field((0.0, 0.0, 0.0), description="displacement of the mesh [m]")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the file lies in the folder of the scene, or below it."""
        yield from super().faults()
        path = PurePath(self.file)
        if path.is_absolute() or ".." in path.parts or not path.parts:
            yield Fault(("file",), "the file must be in the folder of the scene or below it; give a relative path")


AnyWall = Annotated[
    Annotated[Plane, Tag("<plane>")]
    | Annotated[Rectangle, Tag("<rectangle>")]
    | Annotated[Cylinder, Tag("<cylinder>")]
    | Annotated[Cone, Tag("<cone>")]
    | Annotated[Disc, Tag("<disc>")]
    | Annotated[MeshWall, Tag("<mesh>")],
    choose_by_key("shape"),
]
"""A wall of any shape; the key `shape` selects it."""
