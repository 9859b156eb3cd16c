"""Block `gravity`: a constant vector, or gravity that changes with time.

`ChangingGravity` has a vector, or a table of vectors, and motions: rotations turn it, a vibration adds an
oscillating acceleration. A stage can replace the gravity of the scene. `GravityCourse` is what acts from a
time on: `at` evaluates it for the device and for the host.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, Tag

from granflow.geometry.motion import rotation_matrices
from granflow.scene.blocks.motions import (
    AngularFrequency,
    Frequency,
    RockingRotation,
    SteadyRotation,
    TimedMotion,
    angular_frequency_of,
    frequency_faults,
)
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, redundant, whole
from granflow.schema.model import ListOf, Model, choose_by, choose_by_key

# Motions of gravity: the kinds of the motions of walls that have a meaning for a vector


class GravityRotation(SteadyRotation):
    """Gravity turns about an axis, right-handed, at a rate that is constant or changes linearly during ramps
    at the start and at the end.

    A box that tilts about this axis by an angle, seen from the box, is gravity that turns by the opposite
    angle.

    >>> gf.GravityRotation(axis=[0, 1, 0], angular_velocity="1 deg/s", stages=["tilt"]).axis
    (0.0, 1.0, 0.0)
    """

    kind: Literal["rotation"] = Field("rotation", description="kind of motion")


class GravityOscillation(RockingRotation):
    """Gravity turns to and fro about an axis, sinusoidal in time t since the start [s], as in a rocking box.

        angle = amplitude * (sin(angular_frequency * t + phase) - sin(phase))

    >>> gf.GravityOscillation(axis=[0, 1, 0], amplitude="5 deg", frequency="2 Hz").frequency
    2.0
    """

    kind: Literal["oscillation"] = Field("oscillation", description="kind of motion")


class GravityVibration(TimedMotion):
    """An oscillating acceleration that is added to gravity from the start to the end, at time t since the
    start [s].

        amplitude * sin(angular_frequency * t + phase)

    In a frame that vibrates with the displacement A sin(w t), gravity has this term with the amplitude A w^2.

    >>> gf.GravityVibration(amplitude=[0, 0, "20 m/s2"], frequency="25 Hz").amplitude
    (0.0, 0.0, 20.0)
    """

    oscillates: ClassVar[bool] = True

    kind: Literal["vibration"] = Field("vibration", description="kind of motion")
    amplitude: q.AccelerationVector = Field(
        description="amplitude of the acceleration [m/s2]", examples=[[0, 0, "20 m/s2"]]
    )
    frequency: Frequency = None
    angular_frequency: AngularFrequency = None
    phase: q.Angle = Field(0.0, description="phase at the start [rad]", examples=["90 deg"])

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless one of frequency and angular_frequency is given."""
        yield from super().faults()
        yield from frequency_faults(self.frequency, self.angular_frequency)

    def _numbers(self, gravity: Sequence[float]) -> dict[str, Any]:
        rate = angular_frequency_of(self.frequency, self.angular_frequency)
        return {"frequency": None, "angular_frequency": rate}

    def acceleration(self, times: np.ndarray) -> np.ndarray:
        """Added acceleration (k, 3) [m/s2] at `times` (k,) [s]; 0 outside start <= t < end."""
        assert self.angular_frequency is not None
        phases = self.angular_frequency * self.elapsed(times) + self.phase
        return np.outer(np.sin(phases) * self.is_running(times), self.amplitude)

    @property
    def period(self) -> float:
        """2 pi / w [s]."""
        return 2.0 * math.pi / angular_frequency_of(self.frequency, self.angular_frequency)


GravityMotion = Annotated[
    GravityRotation | GravityOscillation | GravityVibration,
    choose_by_key("kind"),
]
"""Any kind of motion of gravity; the key `kind` selects it."""


# Gravity that changes

MOST_ROWS = 10_000
"""Largest number of rows of a table."""


class ChangingGravity(Model):
    """Gravity that changes with time: a vector or a table of vectors, and motions that act on it.

    A table is linear between its rows and constant before the first and after the last one; its times count
    from the start of the run, in a stage from that of the stage. The motions act in their order; each of them
    holds its last angle after its end. Motions of a stage begin with it, unless they have a later start.

    >>> gf.ChangingGravity(times=[0, "1 s"], vectors=[[0, 0, 0], [0, 0, -9.81]]).vectors[-1]
    (0.0, 0.0, -9.81)
    """

    vector: q.AccelerationVector | None = Field(
        None, description="gravity before the motions begin [m/s2]", examples=[[0, 0, -9.81]]
    )
    times: Annotated[tuple[q.Time, ...], ListOf(some="[0, 1]")] | None = Field(
        None, description="times of a table [s], ascending; instead of vector", examples=[[0, "1 s"]]
    )
    vectors: Annotated[tuple[q.AccelerationVector, ...], ListOf(some="[[0, 0, 0], [0, 0, -9.81]]")] | None = (
        Field(
            None,
            description="gravity at the times of the table [m/s2]",
            examples=[[[0, 0, 0], [0, 0, -9.81]]],
        )
    )
    motion: Annotated[tuple[GravityMotion, ...], ListOf(one=True)] = Field(
        (),
        description="rotation, oscillation or vibration of gravity, or a list of them",
        examples=[{"kind": "rotation", "axis": [0, 1, 0], "angular_velocity": "1 deg/s"}],
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless either a vector or a complete table is given."""
        if self.vector is not None:
            for key in ("times", "vectors"):
                if getattr(self, key) is not None:
                    yield redundant(key, "vector")
        elif self.times is None or self.vectors is None:
            yield whole(
                (),
                "has neither a vector nor a table: give vector, such as [0, 0, -9.81], or times and vectors",
            )
        else:
            yield from self._row_faults(self.times, self.vectors)
        yield from self._turn_faults()

    def _turn_faults(self) -> Iterator[Fault]:
        """Yield a fault for the first motion if it turns gravity that is zero."""
        vectors = self.vectors if self.vector is None else (self.vector,)
        if vectors and not any(map(any, vectors)) and self.motion and self.motion[0].rotates:
            reason = "it turns gravity, which is zero; give a vector, such as [0, 0, -9.81], or remove it"
            yield Fault(("motion", 0), reason)

    def _row_faults(self, times: Sequence[float], vectors: Sequence[q.Vector3]) -> Iterator[Fault]:
        if len(times) < 2 or len(times) > MOST_ROWS:
            yield Fault(("times",), f"a table has 2 to {MOST_ROWS} rows")
        if len(vectors) != len(times):
            yield Fault(("vectors",), f"{len(times)} vectors are expected, one for each of the times")
        for index, (before, after) in enumerate(pairwise(times), start=1):
            if after <= before:
                yield Fault(("times", index), f"times must ascend, and the one before is {before:g} s")
                return


def _gravity_tag(value: Any) -> str | None:
    """The form of gravity; None for a number or text."""
    if isinstance(value, int | float | str):
        return None
    return "<changing>" if isinstance(value, dict | ChangingGravity) else "<list>"


Gravity = Annotated[
    Annotated[q.AccelerationVector, Tag("<list>")] | Annotated[ChangingGravity, Tag("<changing>")],
    choose_by(
        _gravity_tag,
        "a vector is expected, [0, 0, -9.81], or how it changes, {vector: [0, 0, -9.81], motion: {kind: "
        "rotation, axis: [0, 1, 0], angular_velocity: 1 deg/s}}",
    ),
]
"""A constant vector, or gravity that changes."""
AnyGravity = q.Vector3 | ChangingGravity


def vectors_of(gravity: AnyGravity) -> tuple[q.Vector3, ...]:
    """The vector, or the vectors of the table, without the motions [m/s2]."""
    if not isinstance(gravity, ChangingGravity):
        return (gravity,)
    if gravity.vector is not None:
        return (gravity.vector,)
    return gravity.vectors or ((0.0, 0.0, 0.0),)  # incomplete keys have a fault


def motions_of(gravity: AnyGravity) -> tuple[TimedMotion, ...]:
    """The motions, none of a constant vector."""
    return gravity.motion if isinstance(gravity, ChangingGravity) else ()


def bound_of(gravity: AnyGravity, measure: Callable[[np.ndarray], float], largest: float) -> float:
    """Upper bound of a measure of gravity at all times.

    measure:  seminorm of a vector (3,) [m/s2], such as |g . d|
    largest:  its value for the unit vector for which it is largest, to which rotations can turn gravity
    """
    motions = motions_of(gravity)
    added = [each.amplitude for each in motions if isinstance(each, GravityVibration)]
    turns = any(each.rotates for each in motions)

    def size(vector: Sequence[float]) -> float:
        return largest * float(np.linalg.norm(vector)) if turns else measure(np.array(vector, float))

    return max(map(size, vectors_of(gravity))) + sum(map(size, added))


# What acts during a run


@dataclass(frozen=True)
class GravityCourse:
    """Gravity as it acts, from a time on.

    since:    time [s] from which the rows count
    times:    (n,) [s] of the rows; one row for a constant vector
    vectors:  (n, 3) [m/s2]
    motions:  with unit vectors and their times
    """

    since: float
    times: tuple[float, ...]
    vectors: tuple[q.Vector3, ...]
    motions: tuple[TimedMotion, ...]

    def at(self, times: np.ndarray) -> np.ndarray:
        """Gravity (k, 3) [m/s2] at `times` (k,) [s]."""
        rows = np.array(self.vectors, float)
        found = np.stack([np.interp(times - self.since, self.times, column) for column in rows.T], axis=1)
        for motion in self.motions:
            if isinstance(motion, GravityVibration):
                found = found + motion.acceleration(times)
            elif isinstance(motion, SteadyRotation | RockingRotation):
                turns = rotation_matrices(np.asarray(motion.axis), motion.angle_and_rate(times)[0])
                found = np.einsum("kij,kj->ki", turns, found)
        return found


def course_of(
    gravity: AnyGravity, since: float, stage_times: Mapping[str, tuple[float, float]]
) -> GravityCourse:
    """The course of a gravity that acts since a time [s], given the times of the stages that have begun."""
    motions = tuple(
        each.numeric((0.0, 0.0, 0.0)).at(stage_times).not_before(since) for each in motions_of(gravity)
    )
    is_table = isinstance(gravity, ChangingGravity) and gravity.times is not None
    times = gravity.times if is_table else (0.0,)  # type: ignore[union-attr]
    assert times is not None
    return GravityCourse(since, times, vectors_of(gravity), motions)
