"""Wall motion: records of plain numbers, and the pose of a wall at given times. numpy only.

A wall is in its rest pose until its first motion starts and keeps its pose when its last motion ends. Translations and
vibrations add; at most one rotation turns the wall, about an axis that translates with it.

Velocities can have a ramp: during `ramp_duration` T from the start of the motion they change linearly from an initial
value v0 to v,

    v(t) = v - (v - v0) max(1 - t/T, 0),    integral of v = v t - (v - v0) [T/2 - max(T - t, 0)^2 / (2 T)]
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from granflow.geometry.motion_table import TableRotation, TableTranslation


@dataclass(frozen=True)
class Vibration:
    """Sinusoidal displacement along a unit direction, measured from the rest pose.

        s(t) = A [sin(w (t - start) + phase) - sin(phase)]        start <= t < end

    The displacement is continuous at `start`; the center of the vibration is at -A sin(phase). The initial velocity is
    A w cos(phase), zero for a phase of pi/2 or -pi/2.

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
    """Motion of a wall by particle forces from `start` to `end` [s]; the displacement is integrated on the device."""

    start: float = 0.0
    end: float = inf


@dataclass(frozen=True)
class Placement:
    """Pose that earlier motions have reached: a point p of the wall at rest is at `rotation @ p + translation`.

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


Motion = Vibration | VelocityMotion | Rotation | TableTranslation | TableRotation | ForceControlled | Placement
"""Motion of a wall; a wall can have several, of which at most one is a rotation, and the first can be a placement."""


@dataclass(frozen=True)
class Poses:
    """Poses and velocities of a wall at k times, float64.

    offset:            (k, 3) [m], displacement of the pivot
    rotation:          (k, 3, 3)
    velocity:          (k, 3) [m/s] of the pivot
    angular_velocity:  (k, 3) [rad/s]
    pivot:             (3,) [m] in the rest pose; the point of the rotation, or the origin without rotation
    surface_velocity:  (k, 3) [m/s] of the surface along itself, in addition to the motion of the wall

    A point p of the wall at rest is at `rotation @ (p - pivot) + pivot + offset`. A point of the wall at x has the
    velocity `velocity + angular_velocity x (x - pivot - offset)`.
    """

    offset: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    pivot: np.ndarray
    surface_velocity: np.ndarray


def pose(motions: Sequence[Motion], times: np.ndarray) -> Poses:
    """Pose of a wall at `times` (k,) [s], or at one time; the rest pose without motions.

    Force-controlled motions are ignored: the device integrates them. After a placement, the points of all motions are
    those of the placed wall. Raises ValueError for two rotations.
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
    rotation, translation = np.array(placement.rotation), np.array(placement.translation)
    pivot = rotation.T @ (later.pivot - translation) if is_rotating else np.array(placement.pivot)
    center = later.pivot if is_rotating else rotation @ pivot + translation
    turned = later.rotation @ rotation
    offset = later.offset + center - pivot
    return replace(later, offset=offset, rotation=turned, pivot=pivot)


def placement_at(motions: Sequence[Motion], time: float) -> Placement:
    """The pose of a wall with these motions at `time` [s], at which they end."""
    reached = pose(motions, np.array([time]))
    rotation, pivot = reached.rotation[0], reached.pivot
    translation = reached.offset[0] + pivot - rotation @ pivot
    rows = tuple(tuple(map(float, row)) for row in rotation)
    return Placement(rows, tuple(map(float, translation)), tuple(map(float, pivot)))


def displacement_and_rate(
    motion: Vibration | VelocityMotion | TableTranslation, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (k, 3) [m] and velocity (k, 3) [m/s] of one motion at `times` (k,) [s].

    The velocity is zero outside start <= t < end.
    """
    time_active, running = elapsed(motion, times), is_running(motion, times)
    if isinstance(motion, VelocityMotion):
        velocity = np.asarray(motion.velocity, dtype=np.float64)
        change, (lag, remaining) = velocity - motion.initial_velocity, ramp(motion.ramp_duration, time_active)
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
    """Lag [s] behind a motion without ramp, and remaining share of the change of velocity, at elapsed times (k,) [s].

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
    """Rotation matrices (k, 3, 3), angular velocities (k, 3) [rad/s] and pivot (3,) [m] at `times` (k,) [s]."""
    if motion is None:
        return np.broadcast_to(np.eye(3), (len(times), 3, 3)).copy(), np.zeros((len(times), 3)), np.zeros(3)
    axis = np.asarray(motion.axis, dtype=np.float64)
    time_active = elapsed(motion, times)
    if isinstance(motion, TableRotation):
        angle, rate = motion.table.at(time_active)
    else:
        final, (lag, remaining) = motion.angular_velocity, ramp(motion.ramp_duration, time_active)
        change = final - motion.initial_angular_velocity
        angle, rate = final * time_active - change * lag, final - change * remaining
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
