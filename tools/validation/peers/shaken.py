"""Bed in a box that vibrates vertically: power drawn, granular temperature and height."""

import math

import numpy as np

from granflow import Scene
from validation.peers.case import PeerCase, plane, scene_of
from validation.peers.state import (
    GRAVITY,
    Frames,
    Particles,
    box_lattice,
    center,
    random_particles,
)

COUNT, SIDE, TOP = 1500, 0.04, 0.16
"""Particles, side and height [m] of the box."""
GAMMA, FREQUENCY = 3.0, 25.0
"""Peak acceleration over gravity, and frequency [Hz]."""
AMPLITUDE = GAMMA * GRAVITY / (2.0 * math.pi * FREQUENCY) ** 2
"""Amplitude [m]."""
TIME_STEP, SAMPLES = 2e-5, 40
"""Time step [s], and states per period."""
PERIODS, TRANSIENT, INTERVAL = 44, 8, 2
"""Periods of a run, those that do not count, and those of an interval."""


def scene(start: Particles) -> Scene:
    """Five planes that vibrate together."""
    shaking = {"kind": "vibration", "direction": [0, 0, 1], "gamma": GAMMA, "frequency": FREQUENCY}
    faces: dict[str, tuple[list[float], list[float]]] = {
        "floor": ([0, 0, 0], [0, 0, 1]),
        "left": ([0, 0, 0], [1, 0, 0]),
        "right": ([SIDE, 0, 0], [-1, 0, 0]),
        "front": ([0, 0, 0], [0, 1, 0]),
        "back": ([0, SIDE, 0], [0, -1, 0]),
    }
    return scene_of(
        "shaken box",
        start,
        {name: plane(*face, motion=shaking) for name, face in faces.items()},
        {"min": [-0.01, -0.01, -0.02], "max": [SIDE + 0.01, SIDE + 0.01, TOP], "on_exit": "error"},
        run={
            "duration": PERIODS / FREQUENCY,
            "velocity_max": 1.5,
            "time_step": TIME_STEP,
            "precision": "f64",
        },
    )


def times() -> np.ndarray:
    """Times [s] of the compared states."""
    return np.arange(TRANSIENT * SAMPLES, PERIODS * SAMPLES + 1) / (SAMPLES * FREQUENCY)


def figures(frames: Frames) -> dict[str, np.ndarray]:
    """Means over intervals of two periods.

    The walls exert the vertical force M (g + dv/dt) on a bed with the mean velocity v, and have equal
    velocities A w cos(w t): their power is the product, here by the midpoint rule over 1/40 of a period
    (error 0.1 % in all codes).
    """
    states = [frames[time] for time in sorted(frames)]
    time = np.array(sorted(frames))
    mass = float(states[0].mass.sum())
    velocity = np.array([each.mass @ each.velocity / mass for each in states])
    vibration = 2.0 * math.pi * FREQUENCY
    wall = AMPLITUDE * vibration * np.cos(0.5 * vibration * (time[1:] + time[:-1]))
    power = mass * (GRAVITY + np.diff(velocity[:, 2]) / np.diff(time)) * wall
    square = [
        each.mass @ np.sum((each.velocity - mean) ** 2, axis=1)
        for each, mean in zip(states, velocity, strict=True)
    ]
    height = np.array([center(each)[2] for each in states])
    series = {
        "power of the walls [W]": power,
        "granular temperature [m2/s2]": np.array(square[1:]) / (3.0 * mass),
        "mean height of the center of mass [m]": height[1:],
    }
    return {name: each.reshape(-1, INTERVAL * SAMPLES).mean(axis=1) for name, each in series.items()}


def triangles() -> dict[str, np.ndarray]:
    """Floor and four sides of the box."""
    low = np.array([[0, 0, 0], [SIDE, 0, 0], [SIDE, SIDE, 0], [0, SIDE, 0]])
    high = low + [0, 0, TOP]
    sides = [np.array([low[i], low[i - 1], high[i - 1], high[i]]) for i in range(4)]
    return {
        "box.stl": np.array([face[corners] for face in (low, *sides) for corners in ([0, 1, 2], [0, 2, 3])])
    }


SHAKEN = PeerCase(
    "shaken box",
    lambda repeat: random_particles(box_lattice(COUNT, (0.0, 0.0), (SIDE, SIDE)), repeat),
    scene,
    ((-0.01, -0.01, -0.02), (SIDE + 0.01, SIDE + 0.01, TOP)),
    TIME_STEP,
    times(),
    figures,
    "shaken",
    {"A": AMPLITUDE},
    triangles,
    repeats=1,
)
