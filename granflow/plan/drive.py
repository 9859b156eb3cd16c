"""Walls that the grains' forces move: servos that hold a force, and free walls with mass."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any, Literal

import numpy as np

from granflow.errors import SceneError
from granflow.laws.law import NormalLaw
from granflow.plan.time_step import Meeting
from granflow.plan.walls import PlannedWall
from granflow.scene import Scene
from granflow.scene import schema as scene_schema
from granflow.walls.catalogue import area_of
from granflow.walls.shape import unit

GAIN_SHARE = 0.2
"""Share of the force that is missing which a servo makes good in one step, if all grains it can touch do touch it."""

LARGEST_GAIN = 2.0
"""That share from which on a servo overshoots by more than it was short, step after step."""


@dataclass(frozen=True)
class Drive:
    """One driven motion: number of the wall, of the motion among those of the wall, and its law.

    `force` [N] along the unit `direction`: what a servo holds on the grains; of a free wall its own and its weight.
    """

    wall: int
    motion: int
    name: str
    kind: Literal["servo", "free"]
    direction: tuple[float, float, float]
    force: float
    gain: float
    """Of a servo: speed for every newton that is missing [m/(s N)]."""
    velocity_max: float
    """Of a servo [m/s]."""
    mass: float
    """Of a free wall [kg]."""
    damping: float
    """Of a free wall [kg/s]."""

    @property
    def key(self) -> str:
        """As messages and checkpoints name it."""
        return f"walls.{self.name}.motion.{self.motion}"


def drives_of(
    scene: Scene,
    walls: Sequence[PlannedWall],
    law: NormalLaw,
    meetings: Sequence[Meeting],
    velocity: float,
    step: float,
) -> tuple[Drive, ...]:
    """All driven motions in the order of walls and motions. Raises SceneError for one that the step [s] cannot carry.

    `velocity`: the fastest approach expected [m/s].
    """
    found = []
    for index, wall in enumerate(walls):
        for number, given in enumerate(scene.walls[wall.name].motion):
            if isinstance(given, scene_schema.Servo | scene_schema.Free):
                stiffness = _stiffness(scene, wall, given, law, meetings, velocity)
                make = _servo if isinstance(given, scene_schema.Servo) else _free
                found.append(make(scene, index, wall, number, given, stiffness, step))
    return tuple(found)


def _servo(
    scene: Scene, index: int, wall: PlannedWall, number: int, given: Any, stiffness: tuple[float, float], step: float
) -> Drive:
    """A servo moves at v = gain (F - f), at most velocity_max.

    Contacts of stiffness K then change their force by K dt v = gain K dt (F - f) in a step: below 2 of them the
    wall comes nearer to F in every step. It is a dashpot of 1/gain: it takes energy from the grains, and gives none.
    """
    alone, together = stiffness
    largest = LARGEST_GAIN / (alone * step)
    if given.gain is not None and given.gain > largest:
        place = scene.place("walls", wall.name, "motion", number, "gain")
        raise SceneError(
            f"{place}: walls.{wall.name}.motion.gain is {given.gain:.3g} m/(s N), but from {largest:.3g} on the wall "
            f"overshoots at every step of {step:.3g} s. Leave it out for {GAIN_SHARE / (together * step):.2g}."
        )
    force = given.force
    if force is None:
        force = given.pressure * (area_of(wall.shape) or 0.0)
    gain = given.gain if given.gain is not None else GAIN_SHARE / (together * step)
    return Drive(
        index, number, wall.name, "servo", _unit(given), force, gain, given.velocity_max, mass=1.0, damping=0.0
    )


def _free(
    scene: Scene, index: int, wall: PlannedWall, number: int, given: Any, stiffness: tuple[float, float], step: float
) -> Drive:
    """A free wall of mass M on contacts of stiffness K swings with w^2 = K/M; w dt must stay below 1."""
    least = stiffness[1] * step**2
    if given.mass < least:
        place = scene.place("walls", wall.name, "motion", number, "mass")
        raise SceneError(
            f"{place}: walls.{wall.name}.motion.mass is {given.mass:.3g} kg, but with all grains it can touch the wall "
            f"swings too fast for a step of {step:.3g} s: give it {least:.2g} kg or more, or lower run.time_step."
        )
    direction = _unit(given)
    force = given.force + given.mass * float(np.dot(scene.gravity, direction))
    return Drive(index, number, wall.name, "free", direction, force, 0.0, 0.0, mass=given.mass, damping=given.damping)


def _stiffness(
    scene: Scene, wall: PlannedWall, given: Any, law: NormalLaw, meetings: Sequence[Meeting], velocity: float
) -> tuple[float, float]:
    """Stiffness [N/m] of one contact at the fastest approach, and of as many as can be at the wall side by side.

    A layer of spheres of radius r in closest packing has one of them on every 2 sqrt(3) r^2 of the wall.
    """
    alone = max(law.loading_stiffness(m.pair, m.radius_eff, m.mass_eff, velocity) for m in meetings)
    radius = min(meeting.radius for meeting in meetings)
    area = area_of(wall.shape) or _section(scene, _unit(given))
    grains = sum(group.count for group in scene.particles.values())
    return alone, alone * max(min(grains, area / (2.0 * sqrt(3.0) * radius**2)), 1.0)


def _section(scene: Scene, direction: tuple[float, float, float]) -> float:
    """Area [m2] of the domain seen along a direction."""
    size = np.subtract(scene.domain.max, scene.domain.min)
    return float(np.abs(direction) @ [size[1] * size[2], size[2] * size[0], size[0] * size[1]])


def _unit(given: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in unit(given.direction))
    return x, y, z


def described(drive: Drive) -> Iterator[tuple[str, str]]:
    """What a drive was decided to be: names and values for people."""
    if drive.kind == "servo":
        yield "holds", f"{drive.force:.4g} N"
        yield "gain", f"{drive.gain:.3g} m/(s N)"
        yield "at most", f"{drive.velocity_max:.3g} m/s"
    else:
        yield "mass", f"{drive.mass:.4g} kg"
        yield "force, with its weight", f"{drive.force:.4g} N"
        yield "damping", f"{drive.damping:.3g} kg/s"
