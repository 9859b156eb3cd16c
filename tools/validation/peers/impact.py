"""Sphere that falls on a bed: depth of penetration."""

import numpy as np

from granflow import Scene
from validation.peers.case import PeerCase, plane, scene_of
from validation.peers.state import Frames, Particles, box_lattice, center, random_particles

COUNT, SIDE, TOP = 1600, 0.042, 0.4
"""Particles, side of the periodic box, and its height [m]."""
DIAMETER, HEIGHT, SPEED = 0.02, 0.385, -0.15
"""Diameter, initial height of the center [m], and upward velocity [m/s] of the sphere, which strikes at 2.5
m/s."""
TIME_STEP, BEFORE, END, FRAME = 2e-5, 0.24, 0.4, 2e-3
"""Time step [s]; time at which the bed is measured, end, and time between states [s]."""


def initial_state(repeat: int) -> Particles:
    """Loose lattice, and the sphere above it, as the last particle."""
    bed = random_particles(box_lattice(COUNT, (0.0, 0.0), (SIDE, SIDE)), repeat)
    return Particles(
        np.concatenate([bed.position, [[0.5 * SIDE, 0.5 * SIDE, HEIGHT]]]),
        np.concatenate([bed.velocity, [[0.0, 0.0, SPEED]]]),
        np.append(bed.diameter, DIAMETER),
    )


def scene(start: Particles) -> Scene:
    """A floor, periodic across."""
    domain = {"min": [0, 0, -0.01], "max": [SIDE, SIDE, TOP], "periodic": ["x", "y"], "on_exit": "error"}
    return scene_of(
        "impact",
        start,
        {"floor": plane([0, 0, 0], [0, 0, 1])},
        domain,
        run={"duration": END, "velocity_max": 3.0, "time_step": TIME_STEP, "precision": "f64"},
    )


def figures(frames: Frames) -> dict[str, float]:
    """Depth of the lowest point of the sphere below the surface, twice the height of the center of mass of
    the bed."""
    states = [frames[time] for time in sorted(frames)]
    sphere = int(np.argmax(states[0].diameter))
    bed = np.arange(len(states[0].diameter)) != sphere
    before = Particles(
        *(values[bed] for values in (states[0].position, states[0].velocity, states[0].diameter))
    )
    surface = 2.0 * float(center(before)[2])
    height = np.array([each.position[sphere, 2] - 0.5 * DIAMETER for each in states])
    return {
        "height of the bed before the impact [m]": surface,
        "largest depth of penetration [m]": surface - float(height.min()),
    }


REMARK = (
    "The largest depth is that after the bed has bounced; it differs by 6 % between fillings. Particles "
    "overlap by up to 23 % of their radius here"
)
"""Remark on this case."""
IMPACT = PeerCase(
    "impact of a sphere",
    initial_state,
    scene,
    ((0.0, 0.0, -0.01), (SIDE, SIDE, TOP)),
    TIME_STEP,
    np.arange(round(BEFORE / FRAME), round(END / FRAME) + 1) * FRAME,
    figures,
    "impact",
    repeats=16,
    remark=REMARK,
)
