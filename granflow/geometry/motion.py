"""Wall motion: records of plain numbers, and the pose of a wall at given times. numpy only.

A wall is in its rest pose until its first motion starts and keeps its pose when its last motion ends.
Translations and vibrations add; at most one rotation turns the wall, about an axis that translates with it.

Velocities can have a ramp: during `ramp_duration` T from the start of the motion they change linearly from an
initial value v0 to v,

    v(t) = v - (v - v0) max(1 - t/T, 0),    integral of v = v t - (v - v0) [T/2 - max(T - t, 0)^2 / (2 T)]
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np

# The motions.


@dataclass(frozen=True)
class Vibration:
    """Sinusoidal displacement along a unit direction, measured from the rest pose.

        s(t) = A [sin(w (t - start) + phase) - sin(phase)]        start <= t < end

    The displacement is continuous at `start`; the center of the vibration is at -A sin(phase). The initial
    velocity is A w cos(phase), zero for a phase of pi/2 or -pi/2.

    direction:          unit vector
    amplitude:          A [m]
    angular_frequency:  w [rad/s]
    phase:              [rad]
    start, end:         [s]
    """

    direction: tuple[float, float, float]
    amplitude: float
    angular_frequency: float
    phase: float = 0.0
    start: float = 0.0
    end: float = inf


@dataclass(frozen=True)
class VelocityMotion:
    """A `velocity` [m/s] from `start` to `end` [s], constant after the ramp."""

    velocity: tuple[float, float, float]
    start: float = 0.0
    end: float = inf
    initial_velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ramp_duration: float = 0.0


class Translation(VelocityMotion):
    """Translation with the velocity."""


class SurfaceVelocity(VelocityMotion):
    """Velocity of the surface of a wall along itself, as of a belt; the wall does not move.

    It is given in the frame of the wall; at a contact, its component in the contact plane acts.
    """


@dataclass(frozen=True)
class Rotation:
    """Rotation about an axis, active from `start` to `end` [s], at a constant rate after the ramp.

    point:             [m], point on the axis in the rest pose
    axis:              unit vector; the rotation is right-handed
    angular_velocity:  [rad/s]
    """

    point: tuple[float, float, float]
    axis: tuple[float, float, float]
    angular_velocity: float
    start: float = 0.0
    end: float = inf
    initial_angular_velocity: float = 0.0
    ramp_duration: float = 0.0


@dataclass(frozen=True)
class ForceControlled:
    """Motion of a wall by particle forces from `start` to `end` [s].

    The displacement is integrated on the device.
    """

    start: float = 0.0
    end: float = inf


@dataclass(frozen=True)
class Placement:
    """Pose that earlier motions have reached: p at rest is now at `rotation @ p + translation`.

    rotation:     rows of the matrix
    translation:  [m]
    pivot:        [m], point of the wall at rest that a later rotation does not define
    start, end:   [s], always
    """

    rotation: tuple[tuple[float, ...], ...]
    translation: tuple[float, ...]
    pivot: tuple[float, ...]
    start: float = 0.0
    end: float = inf


# Motion from a table: a displacement or an angle between rows, with a continuous rate.
#
# Between two rows the value is a cubic polynomial with given values and rates at both rows (Hermite):
#
#     y(u) = y0 + u [h r0 + u (c + u d)],    u = (t - t0) / h
#     c = 3 (y1 - y0) - h (2 r0 + r1),       d = h (r0 + r1) - 2 (y1 - y0)
#
# Before the first and after the last row, value and rate are those of rest.


@dataclass(frozen=True, eq=False)
class MotionTable:
    """Rows of a table: ascending times (n,) [s], values (n,) [m or rad], rates (n,) [m/s or rad/s].

    n is at least 2.
    """

    times: np.ndarray
    values: np.ndarray
    rates: np.ndarray
    _quadratic: np.ndarray = field(init=False)
    _cubic: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        steps = np.diff(self.times)
        changes = np.diff(self.values)
        first, last = self.rates[:-1], self.rates[1:]
        object.__setattr__(self, "_quadratic", 3.0 * changes - steps * (2.0 * first + last))
        object.__setattr__(self, "_cubic", steps * (first + last) - 2.0 * changes)

    @classmethod
    def of_values(cls, times: Sequence[float], values: Sequence[float]) -> "MotionTable":
        """The table of values (n,), with the rates of a monotone interpolation (Fritsch & Butland 1984).

        Between rows the value stays between those of the rows: it does not overshoot.
        """
        from scipy.interpolate import PchipInterpolator

        x = np.asarray(times, dtype=float)
        y = np.asarray(values, dtype=float)
        return cls(x, y - y[0], np.asarray(PchipInterpolator(x, y).derivative()(x)))

    @classmethod
    def of_rates(cls, times: Sequence[float], rates: Sequence[float]) -> "MotionTable":
        """The table of rates (n,), which are linear between rows; the values are their integrals."""
        x = np.asarray(times, dtype=float)
        r = np.asarray(rates, dtype=float)
        return cls(x, np.concatenate([[0.0], np.cumsum(0.5 * np.diff(x) * (r[1:] + r[:-1]))]), r)

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Value and rate (k,) at times (k,) [s] after the start of the motion."""
        row = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        step = np.diff(self.times)[row]
        rate = self.rates[row]
        c = self._quadratic[row]
        d = self._cubic[row]
        u = np.clip((times - self.times[row]) / step, 0.0, 1.0)
        value = self.values[row] + u * (step * rate + u * (c + u * d))
        inside = (times >= self.times[0]) & (times < self.times[-1])
        return value, inside * (rate + u * (2.0 * c + 3.0 * u * d) / step)

    @property
    def largest_rate(self) -> float:
        """Largest magnitude of the rate: at a row, or between rows at u = -c / (3 d)."""
        rates = self.rates
        c = self._quadratic
        d = self._cubic
        u = np.where(d == 0.0, 0.0, -c / np.where(d == 0.0, 1.0, 3.0 * d))
        between = rates[:-1] + u * (2.0 * c + 3.0 * u * d) / np.diff(self.times)
        return float(max(np.abs(rates).max(), np.abs(between[(u > 0.0) & (u < 1.0)]).max(initial=0.0)))

    @property
    def largest_change_of_rate(self) -> float:
        """Largest magnitude of the time derivative of the rate, without jumps.

        The rate is linear between rows.
        """
        ends = np.stack([2.0 * self._quadratic, 2.0 * self._quadratic + 6.0 * self._cubic])
        return float(np.abs(ends / np.diff(self.times) ** 2).max())

    @property
    def shortest_step(self) -> float:
        """Shortest time between two rows [s]."""
        return float(np.diff(self.times).min())


@dataclass(frozen=True)
class TableTranslation:
    """Translation along a unit direction by the displacement of a table [m], from `start` to `end` [s]."""

    direction: tuple[float, float, float]
    table: MotionTable
    start: float = 0.0
    end: float = inf


@dataclass(frozen=True)
class TableRotation:
    """Rotation about an axis by the angle of a table [rad], from `start` to `end` [s].

    point:  [m], point on the axis in the rest pose
    axis:   unit vector; the rotation is right-handed
    """

    point: tuple[float, float, float]
    axis: tuple[float, float, float]
    table: MotionTable
    start: float = 0.0
    end: float = inf


Motion = (
    Vibration | VelocityMotion | Rotation | TableTranslation | TableRotation | ForceControlled | Placement
)
"""Motion of a wall; a wall can have several, of which at most one is a rotation, and the first can be a
placement."""


# The pose of a wall.


@dataclass(frozen=True)
class Poses:
    """Poses and velocities of a wall at k times, float64.

    offset:            (k, 3) [m], displacement of the pivot
    rotation:          (k, 3, 3)
    velocity:          (k, 3) [m/s] of the pivot
    angular_velocity:  (k, 3) [rad/s]
    pivot:             (3,) [m] in the rest pose; the point of the rotation, or the origin without rotation
    surface_velocity:  (k, 3) [m/s] of the surface along itself, in addition to the motion of the wall

    A point p of the wall at rest is at `rotation @ (p - pivot) + pivot + offset`. A point of the wall at x
    has the velocity `velocity + angular_velocity x (x - pivot - offset)`.
    """

    offset: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    pivot: np.ndarray
    surface_velocity: np.ndarray


def pose(motions: Sequence[Motion], times: np.ndarray) -> Poses:
    """Pose of a wall at `times` (k,) [s], or at one time; the rest pose without motions.

    Force-controlled motions are ignored: the device integrates them. After a placement, the points of all
    motions are those of the placed wall. Raises ValueError for two rotations.
    """
    if motions and isinstance(motions[0], Placement):
        return _placed(motions[0], pose(motions[1:], times), single_rotation(motions) is not None)
    times = np.atleast_1d(np.asarray(times, dtype=np.float64))
    offset, velocity, surface_velocity = np.zeros((3, len(times), 3))
    for motion in motions:
        if isinstance(motion, Vibration | VelocityMotion | TableTranslation):
            displacement, rate = displacement_and_rate(motion, times)
            if isinstance(motion, SurfaceVelocity):
                surface_velocity += rate
            else:
                offset += displacement
                velocity += rate
    rotation, angular_velocity, pivot = rotation_of(single_rotation(motions), times)
    turned = np.einsum("kij,kj->ki", rotation, surface_velocity)
    return Poses(offset, rotation, velocity, angular_velocity, pivot, turned)


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


def placement_at(motions: Sequence[Motion], time: float) -> Placement:
    """The pose of a wall with these motions at `time` [s], at which they end."""
    reached = pose(motions, np.array([time]))
    rotation = reached.rotation[0]
    pivot = reached.pivot
    translation = reached.offset[0] + pivot - rotation @ pivot
    rows = tuple(tuple(map(float, row)) for row in rotation)
    return Placement(rows, tuple(map(float, translation)), tuple(map(float, pivot)))


def displacement_and_rate(
    motion: Vibration | VelocityMotion | TableTranslation, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (k, 3) [m] and velocity (k, 3) [m/s] of one motion at `times` (k,) [s].

    The velocity is zero outside start <= t < end.
    """
    time_active = elapsed(motion, times)
    running = is_running(motion, times)
    if isinstance(motion, VelocityMotion):
        velocity = np.asarray(motion.velocity, dtype=np.float64)
        change = velocity - motion.initial_velocity
        lag, remaining = ramp(motion.ramp_duration, time_active)
        rate = velocity - np.outer(remaining, change)
        return np.outer(time_active, velocity) - np.outer(lag, change), running[:, None] * rate
    direction = np.asarray(motion.direction, dtype=np.float64)
    if isinstance(motion, TableTranslation):
        displacement, rate = motion.table.at(time_active)
        return np.outer(displacement, direction), np.outer(rate * running, direction)
    angle = motion.angular_frequency * time_active + motion.phase
    displacement = motion.amplitude * (np.sin(angle) - np.sin(motion.phase))
    rate = motion.amplitude * motion.angular_frequency * np.cos(angle) * running
    return np.outer(displacement, direction), np.outer(rate, direction)


def ramp(duration: float, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lag [s] behind a motion without ramp, and remaining share of the change, at elapsed times (k,) [s].

        T/2 - max(T - t, 0)^2 / (2 T)  and  max(1 - t/T, 0)

    Both are 0 without ramp (T = 0).
    """
    if not duration:
        return np.zeros(len(time)), np.zeros(len(time))
    remaining = np.maximum(1.0 - time / duration, 0.0)
    return 0.5 * duration * (1.0 - remaining**2), remaining


def rotation_of(
    motion: Rotation | TableRotation | None, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotation matrices (k, 3, 3), angular velocities (k, 3) [rad/s], pivot (3,) [m] at `times` (k,)."""
    if motion is None:
        return np.broadcast_to(np.eye(3), (len(times), 3, 3)).copy(), np.zeros((len(times), 3)), np.zeros(3)
    axis = np.asarray(motion.axis, dtype=np.float64)
    time_active = elapsed(motion, times)
    if isinstance(motion, TableRotation):
        angle, rate = motion.table.at(time_active)
    else:
        final = motion.angular_velocity
        lag, remaining = ramp(motion.ramp_duration, time_active)
        change = final - motion.initial_angular_velocity
        angle = final * time_active - change * lag
        rate = final - change * remaining
    angular_velocity = np.outer(rate * is_running(motion, times), axis)
    return rotation_matrices(axis, angle), angular_velocity, np.asarray(motion.point, dtype=np.float64)


def rotation_matrices(axis: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotation matrices about an axis (Rodrigues).

        I + sin(a) K + (1 - cos(a)) K K        K the cross product matrix of the axis

    axis:     (3,) unit vector
    angles:   (k,) [rad]
    Returns:  (k, 3, 3); 1 - cos(a) is evaluated as 2 sin^2(a/2), which is accurate for small angles
    """
    cross = np.cross(axis, np.eye(3)).T
    half_sine = np.sin(angles / 2)[:, None, None]
    return np.eye(3) + np.sin(angles)[:, None, None] * cross + 2 * half_sine**2 * (cross @ cross)


def elapsed(motion: Motion, times: np.ndarray) -> np.ndarray:
    """Elapsed time (k,) [s] of a motion: 0 before its start, constant after its end."""
    return np.maximum(np.minimum(times, motion.end) - motion.start, 0.0)


def is_running(motion: Motion, times: np.ndarray) -> np.ndarray:
    """Whether (k,) the motion is active at each time (k,) [s]: start <= t < end."""
    return (motion.start <= times) & (times < motion.end)


def single_rotation(motions: Sequence[Motion]) -> Rotation | TableRotation | None:
    """The rotation among the motions, or None. Raises ValueError for more than one."""
    rotations = [motion for motion in motions if isinstance(motion, Rotation | TableRotation)]
    if len(rotations) > 1:
        raise ValueError("A wall can have at most one rotation.")
    return rotations[0] if rotations else None


# Upper bounds of the speed of moving walls.


def speed_bound(motions: Sequence[Motion], reach: float) -> float:
    """Upper bound [m/s] of the speed of any point of the wall, as if all motions were active simultaneously.

    The sum of |velocity| of translations, A w of vibrations and |angular velocity| `reach` of the rotation,
    with the largest distance [m] from its axis of geometry that moves (`catalog.reach_about`).
    Force-controlled motions and surface velocities are ignored.
    """
    bound = 0.0
    for motion in motions:
        if isinstance(motion, Translation):
            bound += top_speed(motion)
        elif isinstance(motion, Vibration):
            bound += abs(motion.amplitude * motion.angular_frequency)
        elif isinstance(motion, Rotation):
            bound += max(abs(motion.angular_velocity), abs(motion.initial_angular_velocity)) * reach
        elif isinstance(motion, TableTranslation | TableRotation):
            bound += motion.table.largest_rate * (1.0 if isinstance(motion, TableTranslation) else reach)
    return bound


def top_speed(motion: VelocityMotion) -> float:
    """Largest speed [m/s] of the motion, at the start or at the end of its ramp."""
    ends = np.linalg.norm([motion.velocity, motion.initial_velocity], axis=1)
    return float(ends.max()) if motion.ramp_duration else float(ends[0])
