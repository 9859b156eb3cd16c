"""Periodic slice of a rotating drum, with and without rolling friction: angle of the surface."""

import math

import numpy as np

from granflow import Scene
from validation.peers.case import FRICTION, LAW, RESTITUTION, PeerCase, scene_of
from validation.peers.state import (
    GRAVITY,
    SPACING,
    Frames,
    Particles,
    center,
    random_particles,
)

COUNT, RADIUS, WIDTH, LAYERS = 720, 0.04, 0.02, 4
"""Particles, radius and width [m] of the drum, and layers of the initial lattice along the width."""
ROTATION = math.pi
"""Angular velocity [rad/s] about -z, 30 revolutions per minute."""
TIME_STEP, START, END, FRAME = 2e-5, 0.7, 1.5, 0.01
"""Time step [s]; start and end of the measurement, and time between states [s]."""
ROLLING_FRICTION = 0.1
"""Rolling friction of particles and shell."""


def initial_state(repeat: int) -> Particles:
    """The lowest layers of a cubic lattice in the drum."""
    grid = SPACING * (np.arange(-9, 9) + 0.5)
    x, y, z = np.meshgrid(grid, grid, WIDTH * (np.arange(LAYERS) + 0.5) / LAYERS, indexing="ij")
    points = np.stack([x, y, z], axis=-1)[np.hypot(x, y) < RADIUS - 2.5e-3]
    return random_particles(points[np.argsort(points[:, 1], kind="stable")][:COUNT], repeat)


def scene(start: Particles, rolling_friction: float) -> Scene:
    """A cylinder around the z axis, periodic along it."""
    turning = {"kind": "rotation", "point": [0, 0, 0], "axis": [0, 0, 1], "angular_velocity": -ROTATION}
    shell = {"shape": "cylinder", "from": [0, 0, 0], "to": [0, 0, WIDTH], "radius": RADIUS, "motion": turning}
    side = 1.1 * RADIUS
    domain = {"min": [-side, -side, 0], "max": [side, side, WIDTH], "periodic": ["z"], "on_exit": "error"}
    pair = {"restitution": RESTITUTION, "friction": FRICTION, "rolling_friction": rolling_friction}
    return scene_of(
        "drum",
        start,
        {"shell": shell},
        domain,
        gravity=[0, -GRAVITY, 0],
        pairs={"m-m": pair},
        contact=LAW | {"rolling": "epsd"},
        run={"duration": END, "velocity_max": 1.5, "time_step": TIME_STEP, "precision": "f64"},
    )


def figures(frames: Frames) -> dict[str, float]:
    """Mean angle of the surface: that of the line from the axis to the center of mass to the vertical."""
    centers = np.array([center(frames[time]) for time in sorted(frames)])
    angle = np.degrees(np.arctan2(np.abs(centers[:, 0]), -centers[:, 1]))
    distance = np.hypot(centers[:, 0], centers[:, 1])
    return {
        "angle of the surface [deg]": float(angle.mean()),
        "distance of the center of mass from the axis [m]": float(distance.mean()),
    }


def drum_case(name: str, rolling_friction: float, remark: str = "") -> PeerCase:
    """Case with a rolling friction."""
    side = 1.1 * RADIUS
    return PeerCase(
        name,
        initial_state,
        lambda start: scene(start, rolling_friction),
        ((-side, -side, 0.0), (side, side, WIDTH)),
        TIME_STEP,
        np.arange(round(START / FRAME), round(END / FRAME) + 1) * FRAME,
        figures,
        "drum",
        {"mu_roll": rolling_friction, "rotation": ROTATION},
        remark=remark,
    )


CURVATURE = (
    "LAMMPS takes the curvature of the shell into account, 1.3 % of the stiffness of its contacts; LIGGGHTS "
    "and granflow do not. Wall velocity in LIGGGHTS: that at the particle centers, corrected on average"
)
"""Remark on both drums."""
DRUMS = (
    drum_case("drum without rolling friction", 0.0, CURVATURE),
    drum_case(
        "drum with rolling friction",
        ROLLING_FRICTION,
        f"{CURVATURE}. Rolling stiffness: that of the tangential spring in LIGGGHTS (epsd2) and granflow, "
        "2000 N/m in LAMMPS (sds)",
    ),
)
"""Both drums."""
