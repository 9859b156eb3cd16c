"""Key `motion` of walls: a kind of motion is one class below, with its keys and its pose at given times.

The class also has the largest speed, the period and the keys in checkpoints. A motion of a scene has its
values as given; `numeric` returns a motion of the same class with unit vectors and without optional values.
Plan, engine, live walls and checkpoints have such motions, and only these have poses and speeds.

A wall is in its rest pose until its first motion starts and keeps its pose when its last motion ends.
The motions of a wall form a chain: each is in the frame that the ones before it in the list move. The first
one is in space, the last one is that of the wall in the frame of all others.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from math import inf
from types import SimpleNamespace
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from pydantic import Field

from granflow.device_functions import ti
from granflow.geometry.motion import MotionTable, Poses, ramp, rotation_matrices
from granflow.geometry.vectors import unit
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, missing, redundant, whole
from granflow.schema.model import FileName, ListOf, Model, StageNames, WallNames, choose_by_key, optional
from granflow.schema.quantities import Number

LEVEL = 1e-6
"""Largest cosine of the angle between a velocity and the vertical at which it counts as level."""


class TimedMotion(Model):
    """A motion from `start` to `end` or during stages; by default during the whole run.

    Points and directions of a motion are those of the scene at rest, and move with the motions before it in
    the list of its wall.
    """

    force_controlled: ClassVar[bool] = False
    """True for motions that respond to the force of the particles on the wall (`ForceControlledMotion`)."""
    follows_force: ClassVar[bool] = False
    """True for motions with a target force."""
    is_belt: ClassVar[bool] = False
    """True if the surface moves along itself and the wall does not."""
    oscillates: ClassVar[bool] = False
    """True for motions to and fro with a period."""
    saved_numbers: ClassVar[Mapping[str, int]] = {}
    """Keys in checkpoints with their count of numbers. A program can assign the kinds that have them."""

    kind: str = Field(description="kind of motion")
    start: q.Time | None = optional("time at which the motion begins [s]", "start of the run")
    end: q.Time | None = optional("time at which the motion ends [s]", "end of the run", examples=["1.5 s"])
    stages: StageNames | None = Field(
        None,
        description="stages with this motion; its time starts at the first of them and pauses in others",
        examples=[["settle"]],
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless either times or stages are given, and the end is after the start."""
        if self.stages is not None and (self.start is not None or self.end is not None):
            yield redundant("stages", "start or end", keep="either the times or the stages")
        elif self.end is not None and self.end <= (self.start or 0.0):
            yield Fault(("end",), f"the motion must end after its start at {self.start or 0.0:g} s")

    @property
    def start_time(self) -> float:
        """Start [s]; 0 by default."""
        return self.start or 0.0

    @property
    def end_time(self) -> float:
        """End [s]; infinite by default."""
        return inf if self.end is None else self.end

    def numeric(self, gravity: Sequence[float]) -> "TimedMotion":
        """This motion with unit vectors and without optional values.

        `gravity` (3,) [m/s2]: for amplitudes given by gamma.
        """
        times = {"start": self.start_time, "end": self.end_time}
        return self.model_copy(update=times | self._numbers(gravity))

    def _numbers(self, gravity: Sequence[float]) -> dict[str, Any]:
        """Values of `numeric` besides start and end that differ from those given."""
        return {}

    def at(self, stage_times: Mapping[str, tuple[float, float]]) -> "TimedMotion":
        """This motion with its times [s], given those of the stages; infinite if its stages have not begun.

        With `stages` it runs in these, from the start of the first one on, and for `run_out` after the last
        one that has ended. A stage between them is a pause of its time: its start is later by the duration of
        the pause.
        """
        if self.stages is None:
            return self
        started = [times for name, times in stage_times.items() if name in self.stages]
        if not started:
            return self.model_copy(update={"start": inf, "end": inf})
        start, end = started[0]
        for begin_again, end_again in started[1:]:
            if begin_again > end:
                start += begin_again - end
            end = end_again
        return self.model_copy(update={"start": start, "end": end + self.run_out})

    @property
    def run_out(self) -> float:
        """Time [s] that the motion takes to stop after its stages."""
        return 0.0

    def not_before(self, time: float) -> "TimedMotion":
        """This motion with a start at `time` [s] or later."""
        return self.model_copy(update={"start": max(self.start_time, time)})

    def is_in_stage(self, stage: str) -> bool:
        """Whether the motion can be active in a stage."""
        return self.stages is None or stage in self.stages

    def elapsed(self, times: np.ndarray) -> np.ndarray:
        """Elapsed time (k,) [s]: 0 before the start, constant after the end."""
        return np.maximum(np.minimum(times, self.end_time) - self.start_time, 0.0)

    def is_running(self, times: np.ndarray) -> np.ndarray:
        """Whether (k,) the motion is active at each time (k,) [s]: start <= t < end."""
        return (self.start_time <= times) & (times < self.end_time)

    def displacement_and_rate(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacement (k, 3) [m] and velocity (k, 3) [m/s] of the wall at `times` (k,) [s].

        The velocity is zero outside start <= t < end.
        """
        return np.zeros((len(times), 3)), np.zeros((len(times), 3))

    def surface_velocity(self, times: np.ndarray) -> np.ndarray:
        """Velocity (k, 3) [m/s] of the surface along itself at `times` (k,) [s]."""
        return np.zeros((len(times), 3))

    @property
    def rotates(self) -> bool:
        """Whether the motion is a rotation; it then has `point_and_axis` and `angle_and_rate`."""
        return False

    @property
    def point_and_axis(self) -> tuple[np.ndarray, np.ndarray]:
        """A point (3,) [m] on the axis in the rest pose, and the axis (3,), a unit vector, right-handed."""
        raise NotImplementedError

    def angle_and_rate(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angle (k,) [rad] and angular velocity (k,) [rad/s] at `times` (k,) [s].

        The angular velocity is also that outside start <= t < end.
        """
        raise NotImplementedError

    def top_speed(self, reach: float) -> float:
        """Largest speed [m/s] of geometry that moves at most at a distance `reach` [m] from the axis."""
        return 0.0

    def travel(self, duration: float) -> float:
        """Largest displacement [m] of a translation within a duration [s]; 0 for other motions."""
        return self.top_speed(0.0) * min(duration, self.end_time - self.start_time)

    @property
    def surface_speed(self) -> float:
        """Largest speed [m/s] of the surface along itself."""
        return 0.0

    def controlled_speed(self, gravity_along: Callable[[Sequence[float]], float], distance: float) -> float:
        """Largest speed [m/s] of a motion by forces, within a `distance` [m]; 0 for other motions.

        `gravity_along`: largest component of gravity [m/s2] along a direction.
        """
        return 0.0

    @property
    def period(self) -> float:
        """Period [s]; infinite for motions without."""
        return inf

    @property
    def is_endless(self) -> bool:
        """Whether the motion carries the wall away until the run ends, without limits of its time."""
        return False

    def lift(self, up: np.ndarray, duration: float) -> float:
        """Largest height [m] along `up` (3,), a unit vector, by which the motion lifts particles in a
        duration [s]; infinite if it takes them to the top of the wall."""
        return inf

    @property
    def key_for_gravity(self) -> str | None:
        """Key that requires gravity; None without one."""
        return None

    @property
    def key_for_area(self) -> str | None:
        """Key that requires a wall with an area; None without one."""
        return None

    @property
    def file_name(self) -> str | None:
        """Path of the file that the motion reads; None without one."""
        return None

    def with_file(self, copies: Mapping[str, str]) -> "TimedMotion":
        """This motion with another path of its file, by path."""
        return self

    @property
    def is_table(self) -> bool:
        """Whether the motion follows the rows of a table."""
        return False

    @property
    def shortest_row(self) -> float:
        """Shortest time [s] between two rows of a table; infinite for other motions."""
        return inf

    def description(self) -> tuple[str, str] | None:
        """What `granflow explain` shows of a table: its last value, and its rows; None for other motions."""
        return None


Frequency = Annotated[q.Frequency | None, Field(description="frequency [Hz]", examples=["5 Hz"])]
AngularFrequency = Annotated[
    q.PositiveAngularVelocity | None,
    Field(description="angular frequency [rad/s], instead of frequency", examples=["31.4 rad/s"]),
]
"""Keys of the motions that are sinusoidal in time; one of them is given."""


def sinusoid(
    amplitude: float, rate: float, phase: float, elapsed: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A (sin(w t + phase) - sin(phase)) and its derivative by the elapsed time t (k,) [s].

    amplitude:  A
    rate:       angular frequency w [rad/s]
    """
    angle = rate * elapsed + phase
    return amplitude * (np.sin(angle) - np.sin(phase)), amplitude * rate * np.cos(angle)


def sinusoid_period(amplitude: float | None, rate: float | None) -> float:
    """2 pi / w [s]; infinite without motion (w = 0 or amplitude 0)."""
    return 2.0 * math.pi / rate if amplitude and rate else inf


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

    oscillates: ClassVar[bool] = True
    saved_numbers: ClassVar[Mapping[str, int]] = {
        "direction": 3,
        "amplitude": 1,
        "angular_frequency": 1,
        "phase": 1,
        "start": 1,
        "end": 1,
    }

    kind: Literal["vibration"] = Field("vibration", description="kind of motion")
    direction: q.Direction = Field(description="direction of the motion; its length does not matter")
    amplitude: q.UnscaledLength | None = Field(
        None, description="amplitude, half of the peak-to-peak value [m]", examples=["1 mm"]
    )
    frequency: Frequency = None
    angular_frequency: AngularFrequency = None
    gamma: q.Positive | None = Field(None, description="peak acceleration over the magnitude of gravity")
    phase: q.Angle = Field(
        0.0,
        description=(
            "phase at the start [rad]; 0: the wall starts at full speed from the center of the oscillation"
        ),
        examples=["90 deg"],
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

    @property
    def key_for_gravity(self) -> str | None:
        """See `TimedMotion`."""
        return None if self.gamma is None else "gamma"

    def amplitude_and_angular_frequency(self, gravity: Sequence[float]) -> tuple[float, float]:
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

    def _numbers(self, gravity: Sequence[float]) -> dict[str, Any]:
        amplitude, omega = self.amplitude_and_angular_frequency(gravity)
        return {
            "direction": _unit_vector(self.direction),
            "amplitude": amplitude,
            "frequency": None,
            "angular_frequency": omega,
            "gamma": None,
        }

    def displacement_and_rate(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `TimedMotion`; the displacement is continuous at the start."""
        assert self.amplitude is not None and self.angular_frequency is not None
        displacement, rate = sinusoid(self.amplitude, self.angular_frequency, self.phase, self.elapsed(times))
        rate = rate * self.is_running(times)
        direction = np.asarray(self.direction, dtype=np.float64)
        return np.outer(displacement, direction), np.outer(rate, direction)

    def top_speed(self, reach: float) -> float:
        """A w."""
        assert self.amplitude is not None and self.angular_frequency is not None
        return abs(self.amplitude * self.angular_frequency)

    def travel(self, duration: float) -> float:
        """Twice the amplitude."""
        assert self.amplitude is not None
        return 2.0 * abs(self.amplitude)

    def lift(self, up: np.ndarray, duration: float) -> float:
        """See `TimedMotion`."""
        return self.travel(duration) * abs(float(np.dot(self.direction, up)))

    @property
    def period(self) -> float:
        """2 pi / w [s]; infinite without motion (w = 0 or amplitude 0)."""
        return sinusoid_period(self.amplitude, self.angular_frequency)


class RampedMotion(TimedMotion):
    """A motion with a velocity or rate that is constant, or changes linearly during a ramp at the start and
    decreases linearly to 0 during a ramp at the end.
    """

    ramp_duration: q.PositiveTime | None = optional(
        "time from the start during which the velocity or rate changes linearly [s]",
        "no ramp",
        examples=["0.2 s"],
    )
    end_ramp_duration: q.PositiveTime | None = optional(
        "time before the end, or after the stages, during which the velocity or rate decreases linearly to 0 "
        "[s]",
        "sudden stop",
        examples=["0.2 s"],
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for a ramp at the end of a motion that does not end, or is shorter than its ramps."""
        yield from super().faults()
        if self.end_ramp_duration is None or self.stages is not None:
            return
        if self.end is None:
            yield Fault(("end_ramp_duration",), "the motion has no end; give end or stages, or remove it")
            return
        ramps = (self.ramp_duration or 0.0) + self.end_ramp_duration
        if ramps > self.end - self.start_time:
            longest = max(self.end - self.start_time - (self.ramp_duration or 0.0), 0.0)
            yield Fault(("end_ramp_duration",), f"the motion leaves {longest:g} s for this ramp")

    def _numbers(self, gravity: Sequence[float]) -> dict[str, Any]:
        return {
            "ramp_duration": self.ramp_duration or 0.0,
            "end_ramp_duration": self.end_ramp_duration or 0.0,
        }

    @property
    def run_out(self) -> float:
        """See `TimedMotion`."""
        return self.end_ramp_duration or 0.0

    def _course(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Time [s], lag [s], remaining and share (k,) that give the course of a velocity at `times` (k,) [s].

            v(t) = share [v - remaining (v - v0)],    integral of v = time v - lag (v - v0)

        Without a ramp at the end, time is the elapsed time and share 1. That ramp begins with the velocity of
        this moment, and is not longer than the motion.
        """
        end_ramp = min(self.run_out, max(self.end_time - self.start_time, 0.0))
        begin = self.end_time - end_ramp
        time = np.maximum(np.minimum(times, begin) - self.start_time, 0.0)
        lag, remaining = ramp(self.ramp_duration or 0.0, time)
        stopping, stopped = ramp(end_ramp, np.clip(times - begin, 0.0, end_ramp))
        share = np.ones(len(time))
        if end_ramp:
            time = time + stopping
            lag = lag + remaining * stopping
            share = stopped
        return time, lag, remaining, share

    def _ramp_faults(self, name: str) -> Iterator[Fault]:
        """Yield a fault for an initial value of the velocity `name` without ramp."""
        if getattr(self, f"initial_{name}") is not None and self.ramp_duration is None:
            yield missing(("ramp_duration",), f"the time during which initial_{name} changes to {name}")


class VelocityMotion(RampedMotion):
    """A velocity [m/s] with ramps."""

    saved_numbers: ClassVar[Mapping[str, int]] = {
        "velocity": 3,
        "start": 1,
        "end": 1,
        "initial_velocity": 3,
        "ramp_duration": 1,
        "end_ramp_duration": 1,
    }

    velocity: q.VelocityVector = Field(
        description="velocity [m/s], after the ramp if there is one", examples=[["0.5 m/s", 0, 0]]
    )
    initial_velocity: q.VelocityVector | None = optional(
        "with ramp_duration: velocity at the start [m/s]", "0", examples=[[0, 0, 0]]
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for an initial velocity without ramp."""
        yield from super().faults()
        yield from self._ramp_faults("velocity")

    def _numbers(self, gravity: Sequence[float]) -> dict[str, Any]:
        initial = {"initial_velocity": self.initial_velocity or (0.0, 0.0, 0.0)}
        return super()._numbers(gravity) | initial

    @property
    def velocities(self) -> np.ndarray:
        """Velocity (3,) [m/s] after the ramp, and at the start: (2, 3)."""
        return np.array([self.velocity, self.initial_velocity or (0.0, 0.0, 0.0)], dtype=np.float64)

    def _displacement_and_rate(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Integral (k, 3) [m] of the velocity, and the velocity (k, 3) [m/s] at `times` (k,) [s]."""
        velocity, initial = self.velocities
        change = velocity - initial
        time, lag, remaining, share = self._course(times)
        rate = share[:, None] * (velocity - np.outer(remaining, change))
        displacement = np.outer(time, velocity) - np.outer(lag, change)
        return displacement, self.is_running(times)[:, None] * rate

    @property
    def _top_speed(self) -> float:
        """Largest speed [m/s], at the start or at the end of the ramp."""
        ends = np.linalg.norm(self.velocities, axis=1)
        return float(ends.max()) if self.ramp_duration else float(ends[0])


class Translation(VelocityMotion):
    """Motion at a velocity [m/s] that is constant, or changes linearly during ramps at the start and at the
    end.

    >>> gf.Translation(velocity=[0, 0, "10 cm/s"], start="0.5 s")
    Translation(start=0.5, velocity=(0.0, 0.0, 0.1))
    """

    kind: Literal["translation"] = Field("translation", description="kind of motion")

    @property
    def is_endless(self) -> bool:
        """See `TimedMotion`."""
        return self.end is None and self.stages is None

    def lift(self, up: np.ndarray, duration: float) -> float:
        """See `TimedMotion`."""
        return max(float((self.velocities @ up).max()), 0.0) * min(duration, self.end_time - self.start_time)

    def displacement_and_rate(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `TimedMotion`."""
        return self._displacement_and_rate(times)

    def top_speed(self, reach: float) -> float:
        """|v|."""
        return self._top_speed


class SurfaceVelocity(VelocityMotion):
    """Velocity of the surface along itself, as of a conveyor belt: the surface moves, the shape of the wall
    does not.

    The velocity is given in the frame of the wall and rotates with it. At each contact the component in the
    contact plane acts, v - (v . n) n: friction drives the particles, and faces across the velocity are at
    rest.

    >>> gf.SurfaceVelocity(velocity=["1 m/s", 0, 0], ramp_duration="0.2 s").velocity
    (1.0, 0.0, 0.0)
    """

    is_belt: ClassVar[bool] = True

    kind: Literal["surface_velocity"] = Field("surface_velocity", description="kind of motion")

    def lift(self, up: np.ndarray, duration: float) -> float:
        """See `TimedMotion`; 0 if the belt is level or goes down."""
        velocities = self.velocities
        return inf if np.any(velocities @ up > LEVEL * np.linalg.norm(velocities, axis=1)) else 0.0

    def surface_velocity(self, times: np.ndarray) -> np.ndarray:
        """See `TimedMotion`."""
        return self._displacement_and_rate(times)[1]

    @property
    def surface_speed(self) -> float:
        """See `TimedMotion`."""
        return self._top_speed


class SteadyRotation(RampedMotion):
    """Rotation about an axis at a rate that is constant or changes linearly during ramps at the start and at
    the end: its angle at given times.
    """

    axis: q.Direction = Field(description="direction of the axis; its length does not matter")
    angular_velocity: q.AngularVelocity = Field(
        description="angular velocity [rad/s], such as 30 rpm; after the ramp if there is one"
    )
    initial_angular_velocity: q.AngularVelocity | None = optional(
        "with ramp_duration: angular velocity at the start [rad/s]", "0", examples=[0]
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for an initial angular velocity without ramp."""
        yield from super().faults()
        yield from self._ramp_faults("angular_velocity")

    def _numbers(self, gravity: Sequence[float]) -> dict[str, Any]:
        return super()._numbers(gravity) | {
            "axis": _unit_vector(self.axis),
            "initial_angular_velocity": self.initial_angular_velocity or 0.0,
        }

    @property
    def rotates(self) -> bool:
        """True."""
        return True

    def angle_and_rate(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `TimedMotion`."""
        final = self.angular_velocity
        change = final - (self.initial_angular_velocity or 0.0)
        time, lag, remaining, share = self._course(times)
        return final * time - change * lag, share * (final - change * remaining)

    @property
    def top_rate(self) -> float:
        """Largest magnitude of the angular velocity [rad/s]."""
        return max(abs(self.angular_velocity), abs(self.initial_angular_velocity or 0.0))

    @property
    def period(self) -> float:
        """2 pi / w [s] at the largest rate; infinite without motion."""
        return 2.0 * math.pi / self.top_rate if self.top_rate else inf


class Rotation(SteadyRotation):
    """Rotation about an axis, right-handed, at a rate that is constant or changes linearly during ramps at
    the start and at the end.

    The torque on a wall refers to `point` of its first rotation, which moves with the motions before it and
    with those by forces, unless the wall has a `torque_point`.

    >>> gf.Rotation(point=[0, 0, 0], axis=[0, 1, 0], angular_velocity="30 rpm").angular_velocity
    3.141592653589793
    """

    saved_numbers: ClassVar[Mapping[str, int]] = {
        "point": 3,
        "axis": 3,
        "angular_velocity": 1,
        "start": 1,
        "end": 1,
        "initial_angular_velocity": 1,
        "ramp_duration": 1,
        "end_ramp_duration": 1,
    }

    kind: Literal["rotation"] = Field("rotation", description="kind of motion")
    point: q.Point = Field(description="a point on the axis [m]")

    @property
    def point_and_axis(self) -> tuple[np.ndarray, np.ndarray]:
        """See `TimedMotion`."""
        return _point_and_axis(self.point, self.axis)

    def top_speed(self, reach: float) -> float:
        """|angular velocity| reach."""
        return self.top_rate * reach


class RockingRotation(TimedMotion):
    """Rotation to and fro about an axis, sinusoidal in time: its angle at given times."""

    oscillates: ClassVar[bool] = True

    axis: q.Direction = Field(description="direction of the axis; its length does not matter")
    amplitude: q.Angle = Field(
        description="amplitude, half of the angle from end to end [rad]", examples=["30 deg"]
    )
    frequency: Frequency = None
    angular_frequency: AngularFrequency = None
    phase: q.Angle = Field(
        0.0,
        description="phase at the start [rad]; 0: it starts at full rate from the center",
        examples=["90 deg"],
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless one of frequency and angular_frequency is given."""
        yield from super().faults()
        yield from frequency_faults(self.frequency, self.angular_frequency)

    def _numbers(self, gravity: Sequence[float]) -> dict[str, Any]:
        rate = angular_frequency_of(self.frequency, self.angular_frequency)
        return {"axis": _unit_vector(self.axis), "frequency": None, "angular_frequency": rate}

    @property
    def rotates(self) -> bool:
        """True."""
        return True

    def angle_and_rate(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `TimedMotion`."""
        assert self.angular_frequency is not None
        return sinusoid(self.amplitude, self.angular_frequency, self.phase, self.elapsed(times))

    @property
    def period(self) -> float:
        """2 pi / w [s]; infinite without motion."""
        return sinusoid_period(self.amplitude, self.angular_frequency)


class Oscillation(RockingRotation):
    """Rotation to and fro about an axis, sinusoidal in time t since the start [s], as of a rocking drum.

        angle:             amplitude * (sin(angular_frequency * t + phase) - sin(phase))
        angular velocity:  amplitude * angular_frequency * cos(angular_frequency * t + phase)

    The angle is continuous at the start; the angular velocity is too if phase is 90 deg or -90 deg. At the
    end the wall stops at its angle.

    >>> gf.Oscillation(point=[0, 0, 0], axis=[0, 1, 0], amplitude="30 deg", frequency="0.5 Hz").frequency
    0.5
    """

    saved_numbers: ClassVar[Mapping[str, int]] = {
        "point": 3,
        "axis": 3,
        "amplitude": 1,
        "angular_frequency": 1,
        "phase": 1,
        "start": 1,
        "end": 1,
    }

    kind: Literal["oscillation"] = Field("oscillation", description="kind of motion")
    point: q.Point = Field(description="a point on the axis [m]")

    @property
    def point_and_axis(self) -> tuple[np.ndarray, np.ndarray]:
        """See `TimedMotion`."""
        return _point_and_axis(self.point, self.axis)

    def top_speed(self, reach: float) -> float:
        """|A w| reach."""
        assert self.angular_frequency is not None
        return abs(self.amplitude * self.angular_frequency) * reach


def frequency_faults(frequency: float | None, angular_frequency: float | None) -> Iterator[Fault]:
    """Yield a fault unless one of the keys frequency and angular_frequency is given."""
    if frequency is not None and angular_frequency is not None:
        yield redundant("angular_frequency", "frequency")
    elif frequency is None and angular_frequency is None:
        yield missing(("frequency",), "frequency of the oscillation [Hz]")


def angular_frequency_of(frequency: float | None, angular_frequency: float | None) -> float:
    """Angular frequency [rad/s] from the one of both that is given."""
    if angular_frequency is not None:
        return angular_frequency
    assert frequency is not None
    return 2.0 * math.pi * frequency


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
        examples=["motion.csv"],
    )
    direction: q.Direction | None = Field(None, description="direction of displacements or velocities")
    point: q.Point | None = Field(None, description="with angles: a point on the axis [m]")
    axis: q.Direction | None = Field(None, description="with angles: direction of the axis, right-handed")
    times: _Column[q.Time] | None = Field(
        None,
        description="times [s], ascending; instead of a file, or from it",
        examples=[[0, "0.5 s", "1 s"]],
    )
    displacements: _Column[_Displacement] | None = Field(
        None, description="displacements along the direction [m]", examples=[[0, "4 mm", 0]]
    )
    velocities: _Column[q.Velocity] | None = Field(
        None, description="velocities along the direction [m/s]", examples=[[0, "20 mm/s", 0]]
    )
    angles: _Column[q.Angle] | None = Field(
        None, description="angles about the axis [rad]", examples=[[0, "30 deg", 0]]
    )
    angular_velocities: _Column[q.AngularVelocity] | None = Field(
        None, description="rates about the axis [rad/s]", examples=[[0, "30 rpm", 0]]
    )

    @property
    def column(self) -> str | None:
        """Name of the given column besides the times; None if it is not known yet, or several are given."""
        given = [name for name in TABLE_COLUMNS if getattr(self, name) is not None]
        return given[0] if len(given) == 1 else None

    @property
    def rotates(self) -> bool:
        """Whether the table contains angles or angular velocities, so that the axis is given."""
        return self.axis is not None

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
        elif self.column is not None and self.column.startswith("ang") == (self.direction is not None):
            needed = "direction" if self.direction is None else "point and axis"
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

    def _numbers(self, gravity: Sequence[float]) -> dict[str, Any]:
        if self.direction is not None:
            return {"direction": _unit_vector(self.direction)}
        assert self.axis is not None
        return {"axis": _unit_vector(self.axis)}

    @property
    def file_name(self) -> str | None:
        """See `TimedMotion`."""
        return self.file

    def with_file(self, copies: Mapping[str, str]) -> "TableMotion":
        """See `TimedMotion`."""
        return self if self.file is None else self.model_copy(update={"file": copies[self.file]})

    @property
    def is_table(self) -> bool:
        """True."""
        return True

    @cached_property
    def table(self) -> MotionTable:
        """The rows; the scene is resolved, so that the columns are known."""
        column = self.column
        assert column is not None and self.times is not None
        build = MotionTable.of_rates if "velocit" in column else MotionTable.of_values
        return build(self.times, getattr(self, column))

    def displacement_and_rate(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `TimedMotion`."""
        if self.rotates:
            return super().displacement_and_rate(times)
        direction = np.asarray(self.direction, dtype=np.float64)
        displacement, rate = self.table.at(self.elapsed(times))
        return np.outer(displacement, direction), np.outer(rate * self.is_running(times), direction)

    @property
    def point_and_axis(self) -> tuple[np.ndarray, np.ndarray]:
        """See `TimedMotion`."""
        assert self.point is not None and self.axis is not None
        return _point_and_axis(self.point, self.axis)

    def angle_and_rate(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `TimedMotion`."""
        return self.table.at(self.elapsed(times))

    def travel(self, duration: float) -> float:
        """See `TimedMotion`: largest displacement at a row, and what the wall can move between two rows."""
        table = self.table
        longest = float(np.diff(table.times).max())
        return 0.0 if self.rotates else float(np.abs(table.values).max()) + table.largest_rate * longest

    def top_speed(self, reach: float) -> float:
        """Largest rate of the table, times `reach` if it contains angles."""
        return self.table.largest_rate * (reach if self.rotates else 1.0)

    @property
    def shortest_row(self) -> float:
        """See `TimedMotion`."""
        return self.table.shortest_step

    def description(self) -> tuple[str, str] | None:
        """Last value; number of rows, duration, and largest velocity and acceleration."""
        table = self.table
        length = "rad" if self.rotates else "m"
        rows = f"{len(table.times)} rows from {table.times[0]:g} to {table.times[-1]:g} s"
        largest = (
            f"at most {table.largest_rate:.3g} {length}/s and {table.largest_change_of_rate:.3g} {length}/s2"
        )
        return f"{table.values[-1]:.4g} {length} at the end", f"{rows}, {largest}"


class WallContacts(NamedTuple):
    """Contacts of a layer of particles on a wall.

    contact_count:  of the layer
    stiffness:      [N/m] of one contact at the maximum impact velocity
    resistance:     C + K dt / 2 [N s/m] of one contact, with the largest tangent stiffness K and viscosity C
                    that it can have, see `NormalLaw.present_response`
    """

    contact_count: float
    stiffness: float
    resistance: float


Numbers = Mapping[str, float]
"""Numbers of a force-controlled motion by name, see `ForceControlledMotion.numbers`."""


class ForceControlledMotion(TimedMotion):
    """A motion that responds to the force of the particles on the wall. Base class of the kinds.

    The plan computes the `numbers` of the motion for its time step, refuses a motion that `instability`
    rejects, and passes the numbers to the device and to the methods below, which `granflow explain`, messages
    and totals call. Velocities and forces are along `direction`. The time integration
    (`engine.wall_dynamics`) is the same for all kinds: the velocity is half a step behind the position.

    follows_force:  whether the motion has a target force; then it has `approach` and the remedies below
    is_body:        whether the wall has a kinetic energy, and forces besides those of the particles; then it
                    has `build_other_force`, `other_force` and `kinetic_energy`
    slower:         what makes the wall slower, as a sentence
    """

    force_controlled: ClassVar[bool] = True
    is_body: ClassVar[bool] = False
    slower: ClassVar[str]

    direction: q.Direction

    def _numbers(self, gravity: Sequence[float]) -> dict[str, Any]:
        return {"direction": _unit_vector(self.direction)}

    def lift(self, up: np.ndarray, duration: float) -> float:
        """See `TimedMotion`; 0 for a wall that presses down or across."""
        return inf if float(np.dot(self.direction, up)) > LEVEL else 0.0

    def numbers(self, area: float, gravity: Sequence[float], layer: WallContacts, step: float) -> Numbers:
        """Numbers of the motion with a time `step` [s] by name, in SI units.

        `area` [m2] of the wall; 0 if it is infinite. `gravity` (3,) [m/s2]. `layer`: contacts of a layer of
        particles on the wall. One of the numbers is `force` [N], which the wall exerts on particles at rest.
        """
        raise NotImplementedError

    def instability(self, layer: WallContacts, step: float) -> tuple[str, str] | None:
        """Key that makes the motion unstable with a time `step` [s], and a sentence that begins behind the
        key; None for a stable motion."""
        raise NotImplementedError

    def build_velocity(self, numbers: SimpleNamespace) -> Callable[..., Any]:
        """Device function (velocity, force_on_wall, dt, is_first): velocity [m/s] at the next half step.

        `numbers`: for each name in `numbers` a device function () that reads the value. `velocity` [m/s]: at
        the last half step. `force_on_wall` [N]: of the particles. `is_first`: whether this is the first step
        of the motion, of which half a step is due.
        """
        raise NotImplementedError

    def velocity_at_positions(
        self, numbers: Numbers, velocity_half: float, force_on_wall: float, half_step: float
    ) -> float:
        """Velocity [m/s] at the time of the positions, `half_step` [s] after `velocity_half` [m/s]."""
        return velocity_half

    def build_other_force(self, numbers: SimpleNamespace) -> Callable[..., Any]:
        """Device function (velocity): force [N] on a body, besides that of the particles."""
        raise NotImplementedError

    def other_force(self, numbers: Numbers, velocity: float) -> float:
        """Force [N] on a body at a velocity [m/s], besides that of the particles."""
        raise NotImplementedError

    def kinetic_energy(self, numbers: Numbers, velocity: float) -> float:
        """Kinetic energy [J] of a body at a velocity [m/s]."""
        raise NotImplementedError

    def numbers_in_words(self, numbers: Numbers) -> Iterator[tuple[str, str]]:
        """Yield names and values with units of the numbers, for `granflow explain`."""
        yield from ()

    def approach(self, numbers: Numbers, error: float) -> tuple[float, str]:
        """Velocity [m/s] at an error [N] of the force, of either sign, and what limits it, in words."""
        raise NotImplementedError

    def remedy_off_target(self, numbers: Numbers, error: float, is_away: bool) -> str:
        """What removes an error [N] of the force at the end of a stage: "more time or ...".

        `is_away`: whether the wall does not touch the particles.
        """
        raise NotImplementedError

    def remedy_of_distance(self, numbers: Numbers, distance: float, duration: float) -> str:
        """Instruction with which the wall moves by `distance` [m] in `duration` [s] without contacts."""
        raise NotImplementedError


GAIN_SHARE = 0.2
"""Share of the force error that a servo corrects in one step, if all particles within reach are in
contact."""
MAX_GAIN = 2.0
"""This share at which the overshoot of a servo grows from step to step."""
VELOCITY_MARGIN = 1.2
"""Recommended over required velocity."""


class Servo(ForceControlledMotion):
    """A servo wall: its velocity follows the difference between prescribed and measured force.

        v = gain (F - f),      |v| <= velocity_max

    F: prescribed force, f: force of the wall on the particles [N], both along `direction`. Gravity does not
    act on it.

    >>> gf.Servo(direction=[0, 0, -1], pressure="2 kPa", velocity_max="1 m/s").pressure
    2000.0
    """

    follows_force: ClassVar[bool] = True
    slower: ClassVar[str] = "Lower its velocity_max."

    kind: Literal["servo"] = Field("servo", description="kind of motion")
    direction: q.Direction = Field(
        description="direction of the force on the particles; its length does not matter",
        examples=[[0, 0, -1]],
    )
    force: q.PositiveForce | None = Field(None, description="prescribed force on the particles [N]")
    pressure: q.Pressure | None = Field(
        None,
        description="prescribed pressure, force over the area of the wall [Pa]; instead of force",
        examples=["50 kPa"],
    )
    between: WallNames | None = optional(
        "with pressure: names of two or four walls, opposite ones in pairs; the pressure then refers to the "
        "section between them at present",
        "the area of this wall",
        examples=[["left", "right", "front", "back"]],
    )
    velocity_max: q.Speed = Field(description="largest speed of the wall [m/s]", examples=["0.1 m/s"])
    gain: q.VelocityPerForce | None = optional(
        "velocity over force difference [m/(s N)]", "from stiffness and time step"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly one of force and pressure is given."""
        yield from super().faults()
        if self.force is None and self.pressure is None:
            yield whole((), "has no prescribed force: give force or pressure")
        elif self.force is not None and self.pressure is not None:
            yield redundant("pressure", "force")
        if self.between is not None:
            if self.pressure is None:
                yield Fault(("between",), "it requires pressure; remove between")
            elif len(self.between) not in (2, 4) or len(set(self.between)) < len(self.between):
                yield Fault(
                    ("between",), "it has two or four different walls, such as [left, right, front, back]"
                )

    @property
    def key_for_area(self) -> str | None:
        """See `TimedMotion`."""
        return None if self.pressure is None or self.between else "pressure"

    def controlled_speed(self, gravity_along: Callable[[Sequence[float]], float], distance: float) -> float:
        """`velocity_max`."""
        return self.velocity_max

    def numbers(self, area: float, gravity: Sequence[float], layer: WallContacts, step: float) -> Numbers:
        """Target force F [N] at the start, gain [m/(s N)], lag [steps] with which the velocity follows the
        force error, and maximum velocity [m/s].

        Contacts of stiffness K change their force by K dt v = gain K dt (F - f) in a step: for gain K dt < 2
        the force error decreases in every step. The servo is a dashpot of 1/gain: it dissipates energy of the
        particles.

        With v' = v + (gain (F - f) - v) / (1 + lag), the characteristic equation on contacts of stiffness K
        and viscosity C

            z^2 - (1 + p - gain K dt / (1 + lag)) z + p = 0,     p = (lag - gain C) / (1 + lag)

        has both roots inside the unit circle for lag >= gain (C + K dt / 2), because then 0 <= p < 1 and
        2 + 2 p exceeds gain K dt / (1 + lag). Without lag the wall would overshoot at every step on contacts
        with gain C > 1: the force that it reacts to contains that of its own velocity.
        """
        gain = self._default_gain(layer, step) if self.gain is None else self.gain
        force = self.force
        if force is None:
            assert self.pressure is not None
            force = self.pressure * area
        return {
            "force": force,
            "gain": gain,
            "lag": gain * layer.contact_count * layer.resistance,
            "velocity_max": self.velocity_max,
        }

    @staticmethod
    def _default_gain(layer: WallContacts, step: float) -> float:
        return GAIN_SHARE / (layer.contact_count * layer.stiffness * step)

    def instability(self, layer: WallContacts, step: float) -> tuple[str, str] | None:
        """See `ForceControlledMotion`: a gain that overshoots."""
        max_gain = MAX_GAIN / (layer.stiffness * step)
        if self.gain is None or self.gain <= max_gain:
            return None
        return "gain", (
            f"is {self.gain:.3g} m/(s N), but from {max_gain:.3g} on the wall overshoots at every step of "
            f"{step:.3g} s. Without the key it is {self._default_gain(layer, step):.2g}."
        )

    def build_velocity(self, numbers: SimpleNamespace) -> Callable[..., Any]:
        """See `ForceControlledMotion`."""

        @ti.func
        def velocity_of_servo(velocity, force_on_wall, dt, is_first):
            error = numbers.force() + force_on_wall
            after = velocity + (numbers.gain() * error - velocity) / (1.0 + numbers.lag())
            return ti.max(ti.min(after, numbers.velocity_max()), -numbers.velocity_max())

        return velocity_of_servo

    def numbers_in_words(self, numbers: Numbers) -> Iterator[tuple[str, str]]:
        """See `ForceControlledMotion`."""
        yield "target force", f"{numbers['force']:.4g} N"
        yield "gain", f"{numbers['gain']:.3g} m/(s N)"
        yield "lag", f"{numbers['lag']:.3g} steps"
        yield "maximum velocity", f"{numbers['velocity_max']:.3g} m/s"

    def approach(self, numbers: Numbers, error: float) -> tuple[float, str]:
        """See `ForceControlledMotion`."""
        velocity = numbers["gain"] * abs(error)
        if velocity < self.velocity_max:
            force = "force" if error == numbers["force"] else "force error"
            return velocity, f"gain times {force}, less than velocity_max {self.velocity_max:.3g} m/s"
        return self.velocity_max, "velocity_max"

    def remedy_off_target(self, numbers: Numbers, error: float, is_away: bool) -> str:
        """See `ForceControlledMotion`."""
        if numbers["gain"] * abs(error) >= self.velocity_max:
            return "more time or a larger velocity_max"
        return (
            "more time, a larger gain or a higher target force" if is_away else "more time or a larger gain"
        )

    def remedy_of_distance(self, numbers: Numbers, distance: float, duration: float) -> str:
        """See `ForceControlledMotion`."""
        needed = VELOCITY_MARGIN * distance / duration
        free = numbers["gain"] * abs(numbers["force"])
        parts = []
        if needed > self.velocity_max:
            parts.append(f"set velocity_max to {needed:.2g} m/s or more")
        if needed > free:
            target = abs(numbers["force"]) * needed / free
            parts.append(f"raise gain or the target (to {target:.2g} N at this gain)")
        time = f"give it {VELOCITY_MARGIN * distance / min(free, self.velocity_max):.2g} s"
        text = f"{' and '.join(parts)}, {time}, or start it closer to the bed"
        if free < self.velocity_max:
            text += "; or approach by a translation, in a stage that ends at a force on the wall"
        return f"{text[0].upper()}{text[1:]}."


class FreeWall(ForceControlledMotion):
    """A free wall: a rigid body that contact forces, gravity and a given force move along one direction.

        M dv/dt = f + M g + force - damping v

    f: force of the particles on the wall [N], g: gravity [m/s2], both along `direction`. The wall starts at
    rest.

    >>> gf.FreeWall(direction=[0, 0, 1], mass="200 g").mass
    0.2
    """

    is_body: ClassVar[bool] = True
    slower: ClassVar[str] = "Increase its mass or damping."

    kind: Literal["free"] = Field("free", description="kind of motion")
    direction: q.Direction = Field(
        description="direction of the motion; its length does not matter", examples=[[0, 0, -1]]
    )
    mass: q.Mass = Field(description="mass of the wall [kg]")
    force: q.Force = Field(0.0, description="additional force along the direction [N]")
    damping: q.Damping = Field(0.0, description="viscous damping constant, force over velocity [kg/s]")

    def controlled_speed(self, gravity_along: Callable[[Sequence[float]], float], distance: float) -> float:
        """Speed of a free fall by the distance, with the given force."""
        acceleration = gravity_along(self.direction) + abs(self.force) / self.mass
        return float(np.sqrt(2.0 * acceleration * distance))

    def numbers(self, area: float, gravity: Sequence[float], layer: WallContacts, step: float) -> Numbers:
        """Given force and weight F [N], mass M [kg], damping [kg/s]."""
        weight = self.mass * float(np.dot(gravity, self.direction))
        return {"force": self.force + weight, "mass": self.mass, "damping": self.damping}

    def instability(self, layer: WallContacts, step: float) -> tuple[str, str] | None:
        """See `ForceControlledMotion`: a mass that is too small.

        A free wall of mass M on contacts of stiffness K and viscosity C is stable for M > (C + K dt / 2) dt /
        2. The least mass is twice as large, and at least K dt^2 [kg], with the contacts of a layer of
        particles.
        """
        min_mass = layer.contact_count * step * max(layer.resistance, layer.stiffness * step)
        if self.mass >= min_mass:
            return None
        return "mass", (
            f"is {self.mass:.3g} kg, but with contacts of all particles within reach the wall oscillates too "
            f"fast for a step of {step:.3g} s: set it to {min_mass:.2g} kg or more, or lower run.time_step."
        )

    def build_velocity(self, numbers: SimpleNamespace) -> Callable[..., Any]:
        """See `ForceControlledMotion`; the first kick is half a step."""

        @ti.func
        def velocity_of_free_wall(velocity, force_on_wall, dt, is_first):
            kick = dt / numbers.mass() * (numbers.force() + force_on_wall)
            if is_first:
                kick = 0.5 * kick
            drag = 0.5 * numbers.damping() * dt / numbers.mass()
            return ((1.0 - drag) * velocity + kick) / (1.0 + drag)

        return velocity_of_free_wall

    def velocity_at_positions(
        self, numbers: Numbers, velocity_half: float, force_on_wall: float, half_step: float
    ) -> float:
        """See `ForceControlledMotion`."""
        mass = numbers["mass"]
        drag = 0.5 * numbers["damping"] * half_step / mass
        kick = half_step / mass * (numbers["force"] + force_on_wall)
        return ((1.0 - drag) * velocity_half + kick) / (1.0 + drag)

    def build_other_force(self, numbers: SimpleNamespace) -> Callable[..., Any]:
        """See `ForceControlledMotion`."""

        @ti.func
        def other_force(velocity):
            return numbers.force() - numbers.damping() * velocity

        return other_force

    def other_force(self, numbers: Numbers, velocity: float) -> float:
        """See `ForceControlledMotion`."""
        return numbers["force"] - numbers["damping"] * velocity

    def kinetic_energy(self, numbers: Numbers, velocity: float) -> float:
        """See `ForceControlledMotion`."""
        return 0.5 * numbers["mass"] * velocity**2

    def numbers_in_words(self, numbers: Numbers) -> Iterator[tuple[str, str]]:
        """See `ForceControlledMotion`."""
        yield "mass", f"{numbers['mass']:.4g} kg"
        yield "force and weight", f"{numbers['force']:.4g} N"
        yield "damping", f"{numbers['damping']:.3g} kg/s"


MotionSpec = Annotated[
    Vibration | Translation | Rotation | Oscillation | TableMotion | SurfaceVelocity | Servo | FreeWall,
    choose_by_key("kind"),
]
"""Any kind of motion; the key `kind` selects it."""

ASSIGNABLE: tuple[type[TimedMotion], ...] = tuple(
    kind for kind in get_args(get_args(MotionSpec)[0]) if kind.saved_numbers
)
"""Kinds of motion that a program can assign to a wall; checkpoints contain them."""


class Placement(TimedMotion):
    """Pose that earlier motions have reached: p at rest is now at `rotation @ p + translation`.

    It is the first motion of a wall to which a program has assigned motions, and no part of a scene.

    rotation:     rows of the matrix
    translation:  [m]
    pivot:        [m], point of the wall at rest that a later rotation does not define
    """

    saved_numbers: ClassVar[Mapping[str, int]] = {
        "rotation": 9,
        "translation": 3,
        "pivot": 3,
        "start": 1,
        "end": 1,
    }

    kind: Literal["placement"] = "placement"
    rotation: tuple[tuple[float, ...], ...]
    translation: tuple[float, ...]
    pivot: tuple[float, ...]


MOTIONS: Mapping[str, type[TimedMotion]] = {
    **{kind.__name__: kind for kind in ASSIGNABLE},
    Placement.__name__: Placement,
}
"""Kinds of motion that checkpoints contain, by name."""


def _unit_vector(given: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in unit(given))
    return x, y, z


def _point_and_axis(point: Sequence[float], axis: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(point, dtype=np.float64), np.asarray(axis, dtype=np.float64)


# The pose of a wall with several motions, of which the first can be a placement.
#
# In the frame that the motions before move, a point at y is at R (y - P) + P + o in space, with the pivot P
# of the first rotation; P has the velocity v, the frame the angular velocity w. The next motion changes them,
# for a displacement d,
#
#     o += R d                        v += w x R d + R d'
#
# and for a rotation Q about the axis a through q with the rate r
#
#     o += R (1 - Q) (q - P)          v += w x R (1 - Q) (q - P) - r R a x R Q (q - P)
#     w += r R a                      R = R Q


def poses_at(motions: Sequence[TimedMotion], times: np.ndarray) -> Poses:
    """Pose of a wall at `times` (k,) [s], or at one time; the rest pose without motions.

    Force-controlled motions are ignored: the device integrates them. After a placement, the points of all
    motions are those of the placed wall.
    """
    placement = placement_of(motions)
    if placement is not None:
        return _placed(placement, poses_at(motions[1:], times), bool(rotations_of(motions)))
    times = np.atleast_1d(np.asarray(times, dtype=np.float64))
    offset, velocity, surface_velocity, angular_velocity = np.zeros((4, len(times), 3))
    rotation = np.broadcast_to(np.eye(3), (len(times), 3, 3)).copy()
    pivot = None
    for motion in motions:
        surface_velocity += motion.surface_velocity(times)
        if motion.rotates:
            point, axis = motion.point_and_axis
            angle, rate = motion.angle_and_rate(times)
            turn = rotation_matrices(axis, angle)
            turn_rate = np.outer(rate * motion.is_running(times), axis)
            if pivot is None:
                pivot, rotation, angular_velocity = point, turn, turn_rate
                continue
            arm = point - pivot
            turned_arm = turn @ arm
            shift = _turned(rotation, arm - turned_arm)
            turn_rate = _turned(rotation, turn_rate)
            offset += shift
            velocity += np.cross(angular_velocity, shift)
            velocity -= np.cross(turn_rate, _turned(rotation, turned_arm))
            angular_velocity = angular_velocity + turn_rate
            rotation = rotation @ turn
        else:
            displacement, rate = motion.displacement_and_rate(times)
            if pivot is not None:
                displacement = _turned(rotation, displacement)
                rate = _turned(rotation, rate) + np.cross(angular_velocity, displacement)
            offset += displacement
            velocity += rate
    turned = _turned(rotation, surface_velocity)
    return Poses(
        offset, rotation, velocity, angular_velocity, np.zeros(3) if pivot is None else pivot, turned
    )


def _turned(rotation: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors (k, 3) after rotations (k, 3, 3)."""
    return np.einsum("kij,kj->ki", rotation, vectors)


def placement_of(motions: Sequence[TimedMotion]) -> Placement | None:
    """The placement with which the motions begin; None without one."""
    return motions[0] if motions and isinstance(motions[0], Placement) else None


def _placed(placement: Placement, later: Poses, is_rotating: bool) -> Poses:
    """Poses of a placed wall that moves on.

        x = R (R0 p + t0 - q) + q + d,    pivot = R0^T (q - t0)

    later:        poses R, d of the motions after the placement, with their pivot q
    is_rotating:  the motions contain a rotation about q; without it, the pivot of the placement remains
    """
    rotation = np.array(placement.rotation)
    translation = np.array(placement.translation)
    pivot = rotation.T @ (later.pivot - translation) if is_rotating else np.array(placement.pivot)
    center = later.pivot if is_rotating else rotation @ pivot + translation
    turned = later.rotation @ rotation
    offset = later.offset + center - pivot
    return replace(later, offset=offset, rotation=turned, pivot=pivot)


def axis_points_at(motions: Sequence[TimedMotion], times: np.ndarray) -> np.ndarray:
    """Points (k, 3) [m] on the axis of the first rotation at `times` (k,) [s], moved by the motions before.

    Without a rotation after a placement that has turned the wall, the former pivot in the placed wall;
    without any rotation, the origin.
    """
    placement = placement_of(motions)
    point = np.zeros((len(times), 3))
    for motion in motions[1:] if placement is not None else motions:
        if motion.rotates:
            return point + motion.point_and_axis[0]
        point = point + motion.displacement_and_rate(times)[0]
    rotation = np.eye(3) if placement is None else np.array(placement.rotation)
    center = np.zeros(3)
    if placement is not None and not np.array_equal(rotation, np.eye(3)):
        center = rotation @ np.array(placement.pivot) + np.array(placement.translation)
    return np.broadcast_to(center, point.shape)


def placement_at(motions: Sequence[TimedMotion], time: float) -> Placement:
    """The pose of a wall with these motions at `time` [s], at which they end."""
    reached = poses_at(motions, np.array([time]))
    rotation = reached.rotation[0]
    pivot = reached.pivot
    translation = reached.offset[0] + pivot - rotation @ pivot
    return Placement.model_construct(
        rotation=tuple(tuple(map(float, row)) for row in rotation),
        translation=tuple(map(float, translation)),
        pivot=tuple(map(float, pivot)),
        start=0.0,
        end=inf,
    )


def rotations_of(motions: Sequence[TimedMotion]) -> list[TimedMotion]:
    """The rotations among the motions."""
    return [motion for motion in motions if motion.rotates]
