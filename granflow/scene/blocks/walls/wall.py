"""What all walls of a scene share: material, presence, motions; and what each kind of wall answers.

A wall of a scene has its values as given; `surface` is its geometry at rest.
"""

from collections.abc import Iterator, Mapping
from math import inf
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

from pydantic import Field

from granflow.geometry.surface import Surface
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.motions import MotionSpec
from granflow.scene.blocks.wear import WearSpec
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, redundant
from granflow.schema.model import GroupNames, ListOf, Model, StageNames, Text, optional


class WallNote(NamedTuple):
    """One sentence about a wall; check and explain show all notes, a run only those with `warning`."""

    wall: str
    sentence: str
    warning: bool


class Wall(Model):
    """Properties of walls of every shape.

    Shapes other than a plane have no thickness, and particles may be on both sides.
    """

    is_bounded: ClassVar[bool] = True
    """False if the surface is infinite."""

    shape: str = Field(description="shape of the wall")
    material: Text = Field(description="name of the wall's material")
    appears_at: q.Time | None = optional("time at which the wall appears [s]", "start of the run")
    vanishes_at: q.Time | None = optional("time at which the wall vanishes [s]", "never", examples=["1 s"])
    stages: StageNames | None = optional("stages in which the wall is present", "all", examples=[["settle"]])
    groups: GroupNames | None = optional(
        "groups of particles that touch the wall; all others pass through it", "all", examples=[["coarse"]]
    )
    motion: Annotated[tuple[MotionSpec, ...], ListOf(one=True)] = Field(
        (),
        description="motion of the wall: one, or a list of motions, each in the frame of those before it",
        examples=[{"kind": "vibration", "direction": [0, 0, 1], "amplitude": "1 mm", "frequency": "25 Hz"}],
    )
    torque_point: q.Point | None = optional(
        "point in space to which the torque of the particles in output.wall_forces refers [m]",
        "the point of the first rotation of the wall, which moves with the motions before it; the origin "
        "without rotation",
        examples=[[0, 0, "10 cm"]],
    )
    wear: WearSpec | None = optional(
        "law by which the particles wear the wall, whose surface does not change",
        "no wear",
        examples=[{"law": "archard", "coefficient": 1e-4, "hardness": "2 GPa"}],
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless either times or stages are given."""
        if self.stages is not None and (self.appears_at is not None or self.vanishes_at is not None):
            yield redundant("stages", "appears_at or vanishes_at", keep="either the times or the stages")
        elif self.vanishes_at is not None and self.vanishes_at <= (self.appears_at or 0.0):
            yield Fault(
                ("vanishes_at",), f"the wall must vanish after it appears at {self.appears_at or 0.0:g} s"
            )

    def surface(self, folder: Path) -> Surface:
        """The surface at rest. `folder`: that of the scene, to which the paths of files are relative.

        Raises FormatError for a file that cannot be used, with a reason that follows its path.
        """
        raise NotImplementedError

    def periodic_area(self, domain: Domain) -> float | None:
        """Area [m2] of an infinite wall in one period of the domain; None if it is infinite there, too."""
        return None

    def has_area(self, domain: Domain) -> bool:
        """Whether the wall has an area, and with it a pressure."""
        return self.is_bounded or self.periodic_area(domain) is not None

    def dimensions(self) -> Iterator[tuple[str, float]]:
        """Yield lengths [m] of a bounded wall that is not from a file, such as radii, each with its key."""
        yield from ()

    def refuse_size(self, surface: Surface, domain: Domain, smallest: float) -> None:
        """Raise FormatError for a surface from a file whose size indicates a wrong unit of length.

        `smallest`: diameter [m] of the smallest particle.
        """

    def notes(self, name: str, surface: Surface, domain: Domain, smallest: float) -> Iterator[WallNote]:
        """Notes for the user on a wall from a file, with its name; none for other walls."""
        yield from ()

    @property
    def has_notes(self) -> bool:
        """Whether the kind has `notes`, about the size and place of the surface among others."""
        return type(self).notes is not Wall.notes

    @property
    def start_time(self) -> float:
        """Time [s] at which the wall appears; 0 by default."""
        return self.appears_at or 0.0

    @property
    def end_time(self) -> float:
        """Time [s] at which the wall vanishes; infinite by default."""
        return inf if self.vanishes_at is None else self.vanishes_at

    def holds(self, group: str) -> bool:
        """Whether particles of a group can be in contact with the wall."""
        return self.groups is None or group in self.groups

    def is_present(self, stage: str, time: float) -> bool:
        """Whether the wall is present in a stage at `time` [s]."""
        return (self.stages is None or stage in self.stages) and self.start_time <= time < self.end_time

    @property
    def is_permanent(self) -> bool:
        """Whether the wall is present during the whole run."""
        return self.stages is None and self.start_time <= 0.0 and self.end_time == inf

    @property
    def is_force_controlled(self) -> bool:
        """Whether the forces of the particles move the wall."""
        return any(each.force_controlled for each in self.motion)

    @property
    def has_belt(self) -> bool:
        """Whether the wall has a surface velocity."""
        return any(each.is_belt for each in self.motion)

    def files(self) -> Iterator[tuple[str, str]]:
        """Yield key and path of each file that the wall or its motions read."""
        for index, motion in enumerate(self.motion):
            if motion.file_name is not None:
                yield f"motion.{index}.file", motion.file_name

    def with_files(self, copies: Mapping[str, str]) -> "Wall":
        """This wall with other paths of its files, by path."""
        motions = tuple(each.with_file(copies) for each in self.motion)
        return self.model_copy(update={"motion": motions} if motions != self.motion else {})

    def walls(self, name: str) -> Iterator[tuple[str, "Wall"]]:
        """Yield the walls for which this one stands, with their names: itself, or the faces of a box."""
        yield name, self


def shared_keys(wall: Wall) -> dict[str, Any]:
    """Values of the keys that all walls share, besides the shape."""
    return {name: getattr(wall, name) for name in Wall.model_fields if name != "shape"}
