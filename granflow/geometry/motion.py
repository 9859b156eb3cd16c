"""Wall motion: records of plain numbers, and the pose of a wall at given times. numpy only.

A wall is in its rest pose until its first motion starts and keeps its pose when its last motion ends. Translations and
vibrations add; at most one rotation turns the wall, about an axis that translates with it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np


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
class Translation:
    """Translation with a constant `velocity` [m/s] from `start` to `end` [s]."""

    velocity: tuple[float, float, float]
    start: float = 0.0
    end: float = inf


@dataclass(frozen=True)
class Rotation:
    """Rotation about an axis at a constant rate, active from `start` to `end` [s].

    point:             [m], point on the axis in the rest pose
    axis:              unit vector; the rotation is right-handed
    angular_velocity:  [rad/s]
    """

    point: tuple[float, float, float]
    axis: tuple[float, float, float]
    angular_velocity: float
    start: float = 0.0
    end: float = inf


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


Motion = Vibration | Translation | Rotation | ForceControlled | Placement
"""Motion of a wall; a wall can have several, of which at most one is a rotation, and the first can be a placement."""


@dataclass(frozen=True)
class Poses:
    """Poses and velocities of a wall at k times, float64.

    offset:            (k, 3) [m], displacement of the pivot
    rotation:          (k, 3, 3)
    velocity:          (k, 3) [m/s] of the pivot
    angular_velocity:  (k, 3) [rad/s]
    pivot:             (3,) [m] in the rest pose; the point of the rotation, or the origin without rotation

    A point p of the wall at rest is at `rotation @ (p - pivot) + pivot + offset`. A point of the wall at x has the
    velocity `velocity + angular_velocity x (x - pivot - offset)`.
    """

    offset: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    pivot: np.ndarray


def pose(motions: Sequence[Motion], times: np.ndarray) -> Poses:
    """Pose of a wall at `times` (k,) [s], or at one time; the rest pose without motions.

    Force-controlled motions are ignored: the device integrates them. After a placement, the points of all motions are
    those of the placed wall. Raises ValueError for two rotations.
    """
    if motions and isinstance(motions[0], Placement):
        return _placed(motions[0], pose(motions[1:], times), single_rotation(motions) is not None)
    times = np.atleast_1d(np.asarray(times, dtype=np.float64))
    offset = np.zeros((len(times), 3))
    velocity = np.zeros((len(times), 3))
    for motion in motions:
        if not isinstance(motion, Rotation | ForceControlled | Placement):
            displacement, rate = displacement_and_rate(motion, times)
            offset += displacement
            velocity += rate
    rotation, angular_velocity, pivot = rotation_of(single_rotation(motions), times)
    return Poses(offset, rotation, velocity, angular_velocity, pivot)


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
    return Poses(later.offset + center - pivot, turned, later.velocity, later.angular_velocity, pivot)


def placement_at(motions: Sequence[Motion], time: float) -> Placement:
    """The pose of a wall with these motions at `time` [s], at which they end."""
    reached = pose(motions, np.array([time]))
    rotation, pivot = reached.rotation[0], reached.pivot
    translation = reached.offset[0] + pivot - rotation @ pivot
    rows = tuple(tuple(map(float, row)) for row in rotation)
    return Placement(rows, tuple(map(float, translation)), tuple(map(float, pivot)))


def displacement_and_rate(motion: Vibration | Translation, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (k, 3) [m] and velocity (k, 3) [m/s] of one motion at `times` (k,) [s].

    The velocity is zero outside start <= t < end.
    """
    time_active, running = elapsed(motion, times), is_running(motion, times)
    if isinstance(motion, Translation):
        velocity = np.asarray(motion.velocity, dtype=np.float64)
        return np.outer(time_active, velocity), np.outer(running, velocity)
    direction = np.asarray(motion.direction, dtype=np.float64)
    angle = motion.angular_frequency * time_active + motion.phase
    displacement = motion.amplitude * (np.sin(angle) - np.sin(motion.phase))
    rate = motion.amplitude * motion.angular_frequency * np.cos(angle) * running
    return np.outer(displacement, direction), np.outer(rate, direction)


def rotation_of(motion: Rotation | None, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotation matrices (k, 3, 3), angular velocities (k, 3) [rad/s] and pivot (3,) [m] at `times` (k,) [s]."""
    if motion is None:
        return np.broadcast_to(np.eye(3), (len(times), 3, 3)).copy(), np.zeros((len(times), 3)), np.zeros(3)
    axis = np.asarray(motion.axis, dtype=np.float64)
    rotation = rotation_matrices(axis, motion.angular_velocity * elapsed(motion, times))
    angular_velocity = np.outer(motion.angular_velocity * is_running(motion, times), axis)
    return rotation, angular_velocity, np.asarray(motion.point, dtype=np.float64)


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


def single_rotation(motions: Sequence[Motion]) -> Rotation | None:
    """The rotation among the motions, or None. Raises ValueError for more than one."""
    rotations = [motion for motion in motions if isinstance(motion, Rotation)]
    if len(rotations) > 1:
        raise ValueError("A wall can have at most one rotation.")
    return rotations[0] if rotations else None


def speed_bound(motions: Sequence[Motion], reach: float) -> float:
    """Upper bound [m/s] of the speed of any point of the wall, as if all motions were active simultaneously.

    The sum of |velocity| of translations, A w of vibrations and |angular velocity| `reach` of the rotation, with the
    largest distance [m] from its axis of geometry that moves (`catalog.reach_about`). Force-controlled motions are
    ignored.
    """
    bound = 0.0
    for motion in motions:
        if isinstance(motion, Translation):
            bound += float(np.linalg.norm(motion.velocity))
        elif isinstance(motion, Vibration):
            bound += abs(motion.amplitude * motion.angular_frequency)
        elif isinstance(motion, Rotation):
            bound += abs(motion.angular_velocity) * reach
    return bound
