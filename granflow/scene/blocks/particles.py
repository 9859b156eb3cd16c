"""Schema of the block `particles`: groups of particles of one material with one kind of insertion.

`Group` is last: it has all keys of a group, in the order of a scene file. Diameters are in `sizes`, clumps in
`particle_shapes`, kinds of insertion in `insertions`.
"""

from collections.abc import Iterator, Mapping
from math import log, sqrt
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, PrivateAttr, Tag, model_validator

from granflow.contact import registry
from granflow.scene.blocks.insertions import Insertion, InsertionKind, TimedInsertion, kinds
from granflow.scene.blocks.particle_shapes.clump import Clump
from granflow.scene.blocks.particle_shapes.shape import SPHERE, ParticleShape
from granflow.scene.blocks.sizes import GivenSizes, SizeDistribution, Sizes
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, KeyPath, missing, redundant, whole
from granflow.schema.model import (
    Flag,
    Model,
    Text,
    add_keys,
    choose_by,
    optional_key,
)
from granflow.visible_text import alternatives

# Keys `radius`, `velocity` and `angular_velocity`

RadiusOrMany = Annotated[
    Annotated[q.Radius, Tag("<one>")] | Annotated[tuple[q.Radius, ...], Tag("<list>")],
    choose_by(
        lambda value: "<list>" if isinstance(value, list | tuple) else "<one>",
        "one radius or a list of radii",
    ),
]
"""One radius [m] for all particles, or one for each."""


def _many_tag(value: Any) -> str:
    """Distinguish a list of vectors from one vector."""
    nested = isinstance(value, list | tuple) and bool(value) and isinstance(value[0], list | tuple)
    return "<list>" if nested else "<one>"


_one_or_many = choose_by(_many_tag, "a vector is expected, or a list of vectors")
VelocityOrMany = Annotated[
    Annotated[q.VelocityVector, Tag("<one>")] | Annotated[tuple[q.VelocityVector, ...], Tag("<list>")],
    _one_or_many,
]
"""One velocity (3,) [m/s] for all particles, or one for each."""
AngularVelocityOrMany = Annotated[
    Annotated[q.AngularVelocityVector, Tag("<one>")]
    | Annotated[tuple[q.AngularVelocityVector, ...], Tag("<list>")],
    _one_or_many,
]
"""One angular velocity (3,) [rad/s] for all particles, or one for each."""


# Key `fixed`


class FixedTo(Model):
    """The wall with which fixed particles move."""

    to: Text = Field(description="name of the wall with which the particles move", examples=["lid"])


def _fixed_tag(value: Any) -> str | None:
    """Distinguish a wall from true and false."""
    if isinstance(value, dict | FixedTo):
        return "<wall>"
    return "<flag>" if isinstance(value, bool) else None


Fixed = Annotated[
    Annotated[Flag, Tag("<flag>")] | Annotated[FixedTo, Tag("<wall>")],
    choose_by(_fixed_tag, "true, false or {to: WALL} is expected"),
]
"""Whether particles are fixed in space, or the wall with which they move."""


# Key `thermal`

EXCEEDED = 1e-3
"""Approximate probability that any particle is faster than `ThermalMotion.largest_speed`."""


class ThermalMotion(Model):
    """Random initial velocities with the Maxwell distribution, in addition to `velocity`; from the seed of
    the scene.

    All particles of the group have the same distribution, whatever their mass.
    """

    velocity_rms: q.Speed | None = Field(
        None,
        description="root mean square of the random velocities [m/s], to which they are scaled exactly",
        examples=["0.1 m/s"],
    )
    granular_temperature: q.GranularTemperature | None = Field(
        None,
        description="a third of the mean square of the random velocities [m2/s2], instead of velocity_rms",
    )
    zero_momentum: Flag = Field(True, description="remove the total momentum of the random velocities")

    @property
    def rms(self) -> float:
        """Root mean square of the random velocities [m/s]: sqrt(3 T)."""
        return self.velocity_rms or (3.0 * (self.granular_temperature or 0.0)) ** 0.5

    def velocities(self, radius: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """Velocities (n, 3) [m/s] of particles of one density with radii (n,) [m]: normal components, scaled
        to the rms.

        u <- u - sum m u / sum m    (zero_momentum)        u <- u rms / sqrt(sum u^2 / n)
        """
        velocity = random.standard_normal((len(radius), 3))
        if self.zero_momentum:
            weight = radius**3
            velocity -= weight @ velocity / weight.sum()
        return velocity * (self.rms / np.sqrt((velocity**2).sum() / len(radius)))

    def largest_speed(self, count: int) -> float:
        """Speed [m/s] that the velocities of `count` particles hardly exceed: rms / sqrt(3) sqrt(2 ln(n /
        p))."""
        return min(self.rms / sqrt(3.0) * sqrt(2.0 * log(count / EXCEEDED)), self.rms * sqrt(count))

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly one measure of the velocities is given."""
        if self.velocity_rms is None and self.granular_temperature is None:
            yield missing(("velocity_rms",), "root mean square velocity [m/s]; or give granular_temperature")
        elif self.velocity_rms is not None and self.granular_temperature is not None:
            yield redundant("granular_temperature", "velocity_rms")


# Groups


class Group(Model, populate_by_name=False, serialize_by_alias=True):
    """Particles of one material with one kind of insertion.

    Positions and files define the count by their rows; other groups give a count or a mass. Rain and inlets
    need neither: they run to their end time, or to the end of the run. Of several limits, the smallest number
    of particles applies.

    >>> insertion = gf.PositionsInsertion(positions=[[0, 0, 0], [0, 0, 0.1]])
    >>> gf.Group(material="glass", diameter="4 mm", insert=insertion).count
    2
    """

    material: Text = Field(description="name of the particles' material")
    count_given: q.ParticleCount | None = Field(
        None,
        alias="count",
        description=(
            "number of particles, or of clumps; default with positions or file: number of rows; with rain or "
            "inlet: those that enter until the run ends"
        ),
    )
    mass: q.ParticleMass | None = Field(
        None, description="total mass [kg], instead of count", examples=["20 g"]
    )
    diameter: Sizes = Field(
        None,
        description=(
            "diameter [m], or a size distribution; with positions, also a list; with file, not allowed"
        ),
    )
    radius: RadiusOrMany | None = Field(
        None,
        description="radius [m], instead of diameter; with positions, also a list; with file, not allowed",
        examples=["2 mm"],
    )
    clump: Clump | None = Field(
        None,
        description=(
            "rigid body of spheres in place of each sphere, {spheres: [{position: [..], radius: ..}, ...]}; "
            "instead of diameter"
        ),
    )
    liquid_content: q.Share | None = Field(
        None,
        description=(
            "initial volume of the liquid film on each particle over the volume of the particle, 0 for dry "
            "particles; required with contact.cohesion: {law: capillary_transfer, ...}"
        ),
        examples=["1 %"],
    )
    velocity: VelocityOrMany = Field(
        (0.0, 0.0, 0.0), description="initial velocity [m/s]", examples=[[0, 0, "-0.5 m/s"]]
    )
    angular_velocity: AngularVelocityOrMany = Field(
        (0.0, 0.0, 0.0), description="initial angular velocity [rad/s]", examples=[[0, 6, 0]]
    )
    thermal: ThermalMotion | None = Field(
        None,
        description="random initial velocities, {velocity_rms: 0.1 m/s} or {granular_temperature: ...}",
        examples=[{"velocity_rms": "0.1 m/s"}],
    )
    fixed_given: Fixed = Field(
        False,
        alias="fixed",
        description=(
            "true: the particles never move, such as those of a rough wall at rest; {to: WALL}: they move "
            "with the wall, as if they were glued to it"
        ),
        examples=[{"to": "lid"}],
    )
    insert: Insertion = Field(description=f"insertion, {{kind: {', '.join(kinds(lambda kind: True))}, ...}}")
    _count_of_flow: int | None = PrivateAttr(None)

    if TYPE_CHECKING:  # keys that particle equations add

        def __init__(self, *, material: Any, insert: Any, **keys: Any) -> None: ...

    @property
    def count(self) -> int:
        """Number of particles, or of clumps. Raises ValueError if it is not resolved yet."""
        count = self._count_of_flow if self.count_given is None else self.count_given
        if count is None:
            raise ValueError("The number of particles is not resolved; see granflow.particles.resolve.")
        return count

    @property
    def fixed(self) -> bool:
        """Whether no force moves the particles: they are at rest, or move with a wall."""
        return bool(self.fixed_given)

    @property
    def attached_to(self) -> str | None:
        """Name of the wall with which fixed particles move; None for others."""
        return self.fixed_given.to if isinstance(self.fixed_given, FixedTo) else None

    @property
    def flows_to_end(self) -> bool:
        """Whether particles enter until the run ends, so that their number follows from its duration."""
        limits = (self.count_given, self.mass, getattr(self.insert, "end", None))
        return isinstance(self.insert, TimedInsertion) and not any(limits)

    def with_flow_of(self, count: int) -> "Group":
        """This group with the number of particles that enter until the run ends.

        It is not a key: a resumed run with another duration has another number.
        """
        group = self.model_copy()
        group._count_of_flow = count
        return group

    @property
    def sphere_count(self) -> int:
        """Number of spheres: those of all clumps, or the number of particles. Raises as `count`."""
        return self.count * self.shape.sphere_count

    @property
    def shape(self) -> ParticleShape:
        """Shape of the particles."""
        return SPHERE if self.clump is None else self.clump

    def files(self) -> Iterator[tuple[str, str]]:
        """Yield key and path of each file that the group reads."""
        if self.insert.source is not None:
            yield "insert.file", self.insert.source
        if self.clump is not None and self.clump.file is not None:
            yield "clump.file", self.clump.file
        if isinstance(self.diameter, SizeDistribution) and self.diameter.source is not None:
            yield "diameter.file", self.diameter.source

    def with_files(self, copies: Mapping[str, str]) -> "Group":
        """This group with other paths of its files, by path."""
        changes: dict[str, Any] = {}
        if self.insert.source is not None:
            changes["insert"] = self.insert.with_source(copies[self.insert.source])
        if self.clump is not None and self.clump.file is not None:
            changes["clump"] = self.clump.model_copy(update={"file": copies[self.clump.file]})
        if isinstance(self.diameter, SizeDistribution) and self.diameter.source is not None:
            changes["diameter"] = self.diameter.with_source(copies[self.diameter.source])
        return self.model_copy(update=changes) if changes else self

    @property
    def diameters(self) -> tuple[float, float]:
        """Smallest and largest diameter [m] of spheres, before sampling; for a particle file, those in the
        file."""
        spans = self.size_spans()
        return spans[0][0], spans[-1][1]

    @property
    def outer_diameters(self) -> tuple[float, float]:
        """As `diameters`, but of the particles when they are inserted: those of the spheres around clumps."""
        outer = self.shape.outer_diameter
        return self.diameters if outer is None else (outer, outer)

    def size_spans(self) -> list[tuple[float, float]]:
        """Ranges of the diameters [m] of spheres, in ascending order; one range for a continuous
        distribution."""
        if self.insert.summary is not None:
            return [(self.insert.summary.diameter_min, self.insert.summary.diameter_max)]
        if self.shape.diameters:
            return [(each, each) for each in self.shape.diameters]
        return self.sizes.spans()

    @property
    def sizes(self) -> SizeDistribution:
        """Diameters [m] given in the scene, or twice the radii; the outer diameter of clumps.

        Raises ValueError if a file defines them.
        """
        if self.shape.outer_diameter is not None:
            return GivenSizes(self.shape.outer_diameter)
        if isinstance(self.diameter, SizeDistribution):
            return self.diameter
        if self.diameter is not None:
            return GivenSizes(self.diameter)
        if self.radius is None:
            raise ValueError("A file defines the diameters.")
        if isinstance(self.radius, tuple):
            return GivenSizes(tuple(2.0 * each for each in self.radius))
        return GivenSizes(2.0 * self.radius)

    @property
    def initial_speed(self) -> float:
        """Largest initial speed [m/s], from the scene or from the file with the particles.

        Random velocities count with `ThermalMotion.largest_speed`.
        """
        random = 0.0 if self.thermal is None else self.thermal.largest_speed(self.count)
        found = self.insert.summary
        return max(_largest_norm(self.velocity) + random, 0.0 if found is None else found.speed_max)

    @property
    def initial_rotation_rate(self) -> float:
        """Largest initial angular velocity [rad/s], from the scene or from the file with the particles."""
        found = self.insert.summary
        in_file = 0.0 if found is None else found.angular_velocity_max
        return max(_largest_norm(self.angular_velocity), in_file)

    @model_validator(mode="before")
    @classmethod
    def _count_rows(cls, given: Any) -> Any:
        """Fill in the count from a list of positions."""
        if not isinstance(given, dict) or "count" in given:
            return given
        insertion = given.get("insert")
        if isinstance(insertion, dict):
            positions = insertion.get("positions")
        else:
            positions = getattr(insertion, "positions", None)
        if not isinstance(positions, list | tuple):
            return given
        return given | {"count": max(1, len(positions))}

    def faults(self) -> Iterator[Fault]:
        """Yield the faults of count, mass, diameter, lists and velocities, and of fixed particles."""
        yield from self._amount_faults()
        yield from self._list_faults()
        yield from self._size_faults()
        yield from self.shape.faults_in_group(self)
        if self.thermal is not None:
            yield from self._thermal_faults(self.thermal)
        if self.fixed:
            yield from self._fixed_faults()
        if self.insert.from_program:
            kind = self.insert.kind
            reason = f"insert.kind is {kind}, so that it is an argument of particles.add; remove it"
            for key in ("velocity", "angular_velocity"):
                if np.any(getattr(self, key)):
                    yield Fault((key,), reason)

    def _size_faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly one of diameter, radius, clump and file defines the sizes."""
        given = [key for key in ("diameter", "radius") if getattr(self, key) is not None]
        if self.clump is not None:
            return
        if not given and not self.insert.defines_sizes:
            yield missing(("diameter",), "diameter [m], or a size distribution")
        elif given and self.insert.defines_sizes:
            yield Fault((given[0],), f"the file defines the sizes; remove {given[0]}")
        elif len(given) == 2:
            yield redundant("radius", "diameter")

    def _amount_faults(self) -> Iterator[Fault]:
        """Yield a fault unless count, mass, end time and rows agree on the number of particles."""
        insertion = self.insert
        count = self.count_given
        rows = len(insertion.points)
        if rows and count != rows:
            yield Fault(("count",), f"insert.positions has {rows} rows; remove count")
        if self.mass is not None and insertion.has_rows:
            yield Fault(
                ("mass",), f"it cannot be combined with insert: {{kind: {insertion.kind}}}; remove it"
            )
        elif self.mass is not None and count is not None:
            yield redundant("mass", "count")
        elif not (self.mass or count or insertion.has_rows or isinstance(insertion, TimedInsertion)):
            yield missing(("count",), "number of particles; or give mass")

    def _list_faults(self) -> Iterator[Fault]:
        """Lists require insert: {kind: positions} and must have the length of its positions."""
        rows = len(self.insert.points)
        for key, length in self._given_lists():
            if not rows:
                yield whole(key, "is a list, which requires insert: {kind: positions}; give one value")
            elif length != rows:
                reason = (
                    f"is a list of length {length}, but insert.positions has length {rows}; give one per "
                    "position"
                )
                yield whole(key, reason)

    def _thermal_faults(self, thermal: ThermalMotion) -> Iterator[Fault]:
        """Random velocities require mobile particles at the start; two of them for zero momentum."""
        if not _takes_thermal(type(self.insert)):
            accepted = alternatives(kinds(_takes_thermal))
            reason = f"insert.kind is {self.insert.kind}; random velocities require {accepted}"
            yield whole(("thermal",), f"cannot be combined with it: {reason}")
        elif self.fixed:
            yield whole(("thermal",), "cannot be combined with fixed; remove thermal")
        elif thermal.zero_momentum and self.count_given == 1:
            reason = "one particle has momentum; write zero_momentum: false, or give two particles"
            yield whole(("thermal",), f"cannot have zero momentum: {reason}")

    def _fixed_faults(self) -> Iterator[Fault]:
        """Fixed particles must exist from the start, and have no velocity of their own."""
        if isinstance(self.insert, TimedInsertion):
            timed = " and ".join(kinds(lambda kind: issubclass(kind, TimedInsertion)))
            others = alternatives(kinds(lambda kind: kind.order is not None))
            yield Fault(("fixed",), f"{timed} require moving particles; use {others}")
        for key in ("velocity", "angular_velocity"):
            if np.any(getattr(self, key)):
                wall = self.attached_to
                moves = (
                    "is true, so the particles do not move"
                    if wall is None
                    else f"is {{to: {wall}}}, so the particles move with this wall"
                )
                yield Fault((key,), f"fixed {moves}; remove {key}")

    def _given_lists(self) -> Iterator[tuple[KeyPath, int]]:
        """Yield the key path and the length of each value that is given as a list, one entry per particle."""
        for key in ("diameter", "radius"):
            if isinstance(getattr(self, key), tuple):
                yield (key,), len(getattr(self, key))
        for key in ("velocity", "angular_velocity"):
            value = getattr(self, key)
            if isinstance(value[0], tuple):
                yield (key,), len(value)
        if self.clump is not None and isinstance(self.clump.orientation, tuple):
            yield ("clump", "orientation"), len(self.clump.orientation)


def _takes_thermal(kind: type[InsertionKind]) -> bool:
    """Whether the scene gives new particles of a kind their velocities, and they exist at the start."""
    return kind.order is not None and not kind.defines_sizes


def _largest_norm(vectors: ArrayLike) -> float:
    """Largest norm of one vector (3,) or of many, (n, 3)."""
    return float(np.linalg.norm(np.atleast_2d(vectors), axis=1).max())


def use_registry() -> None:
    """Add the initial values that particle equations require of the groups, and sources of flows.

    A schema that is built must be rebuilt afterwards.
    """
    initial = {
        each.name: optional_key(Annotated[float, each.initial], f"initial value: {each.meaning}")
        for each in registry.equations()
    }
    sources = {
        name: optional_key(Annotated[float, each.type], f"{each.meaning}; default: 0")
        for name, (_, each) in registry.sources().items()
    }
    add_keys(Group, initial | sources)


use_registry()
