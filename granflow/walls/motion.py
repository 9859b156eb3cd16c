"""How walls move: records of plain numbers, and where that puts a wall at given times. numpy only.

A wall rests where the scene put it until its first motion starts, and stays where it is when its last one
ends. Translations and vibrations add; at most one rotation turns the wall, about an axis that moves along.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np


@dataclass(frozen=True)
class Vibration:
    """Sinusoidal displacement along a unit direction, measured from the rest pose.

        s(t) = A [sin(w (t - start) + phase) - sin(phase)]        start <= t < end

    so that nothing jumps at `start`; the center of the vibration is at -A sin(phase). The velocity starts at
    A w cos(phase): with a phase of a quarter turn (pi/2 or -pi/2) it starts from rest.
    """

    direction: tuple[float, float, float]
    amplitude: float
    angular_frequency: float
    phase: float = 0.0
    start: float = 0.0
    end: float = inf


@dataclass(frozen=True)
class Translation:
    """Constant velocity [m/s] from `start` to `end`."""

    velocity: tuple[float, float, float]
    start: float = 0.0
    end: float = inf


@dataclass(frozen=True)
class Rotation:
    """Turning about the axis through `point` along the unit vector `axis` at a constant rate [rad/s]."""

    point: tuple[float, float, float]
    axis: tuple[float, float, float]
    angular_velocity: float
    start: float = 0.0
    end: float = inf


@dataclass(frozen=True)
class ForceControlled:
    """A wall that the grains' forces move from `start` to `end`: its displacement is found step by step, not here."""

    start: float = 0.0
    end: float = inf


Motion = Vibration | Translation | Rotation | ForceControlled


@dataclass(frozen=True)
class Poses:
    """Where a wall is at k times and how it moves there.

    A point p of the wall at rest is at `rotation @ (p - pivot) + pivot + offset`; a point of the wall now at
    x moves at `velocity + angular_velocity x (x - pivot - offset)`.
    """

    offset: np.ndarray  # (k, 3) [m]
    rotation: np.ndarray  # (k, 3, 3)
    velocity: np.ndarray  # (k, 3) [m/s] of the pivot
    angular_velocity: np.ndarray  # (k, 3) [rad/s]
    pivot: np.ndarray  # (3,) [m] at rest


def pose(motions: Sequence[Motion], times: np.ndarray) -> Poses:
    """The pose a wall has at each time (k,) [s]; at rest without motions. ValueError for two rotations.

    What a driven wall has moved is not in it.
    """
    times = np.atleast_1d(np.asarray(times, dtype=np.float64))
    offset = np.zeros((len(times), 3))
    velocity = np.zeros((len(times), 3))
    for motion in motions:
        if not isinstance(motion, Rotation | ForceControlled):
            displacement, rate = displacement_and_rate(motion, times)
            offset += displacement
            velocity += rate
    rotation, angular_velocity, pivot = rotation_of(single_rotation(motions), times)
    return Poses(offset, rotation, velocity, angular_velocity, pivot)


def displacement_and_rate(motion: Vibration | Translation, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (k, 3) [m] and velocity (k, 3) [m/s] of one motion without rotation."""
    clock, running = elapsed(motion, times), is_running(motion, times)
    if isinstance(motion, Translation):
        velocity = np.asarray(motion.velocity, dtype=np.float64)
        return np.outer(clock, velocity), np.outer(running, velocity)
    direction = np.asarray(motion.direction, dtype=np.float64)
    angle = motion.angular_frequency * clock + motion.phase
    displacement = motion.amplitude * (np.sin(angle) - np.sin(motion.phase))
    rate = motion.amplitude * motion.angular_frequency * np.cos(angle) * running
    return np.outer(displacement, direction), np.outer(rate, direction)


def rotation_of(motion: Rotation | None, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotation matrices (k, 3, 3), angular velocities (k, 3) [rad/s] and pivot (3,) [m]."""
    if motion is None:
        return np.broadcast_to(np.eye(3), (len(times), 3, 3)).copy(), np.zeros((len(times), 3)), np.zeros(3)
    axis = np.asarray(motion.axis, dtype=np.float64)
    rotation = rotation_matrices(axis, motion.angular_velocity * elapsed(motion, times))
    angular_velocity = np.outer(motion.angular_velocity * is_running(motion, times), axis)
    return rotation, angular_velocity, np.asarray(motion.point, dtype=np.float64)


def rotation_matrices(axis: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotations (k, 3, 3) by angles (k,) about a unit axis: I + sin(a) K + (1 - cos(a)) K K (Rodrigues)."""
    cross = np.cross(axis, np.eye(3)).T
    half_sine = np.sin(angles / 2)[:, None, None]
    return np.eye(3) + np.sin(angles)[:, None, None] * cross + 2 * half_sine**2 * (cross @ cross)


def elapsed(motion: Motion, times: np.ndarray) -> np.ndarray:
    """Time (k,) [s] the motion has been running: 0 before its start, constant after its end."""
    return np.maximum(np.minimum(times, motion.end) - motion.start, 0.0)


def is_running(motion: Motion, times: np.ndarray) -> np.ndarray:
    """Whether the motion runs at each time: start <= t < end."""
    return (motion.start <= times) & (times < motion.end)


def single_rotation(motions: Sequence[Motion]) -> Rotation | None:
    """The one rotation among the motions, or None. ValueError if there are several."""
    rotations = [motion for motion in motions if isinstance(motion, Rotation)]
    if len(rotations) > 1:
        raise ValueError("A wall can have at most one rotation.")
    return rotations[0] if rotations else None


def speed_bound(motions: Sequence[Motion], reach: float) -> float:
    """Largest speed [m/s] at which any point of the wall's geometry ever moves, as if all motions ran at once.

    Driven motions are not counted.

    `reach` is the largest distance [m] from the rotation's axis of geometry that moves when turning
    (`catalog.reach_about`); it does not matter without a rotation.
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
