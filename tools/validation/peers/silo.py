"""Flat-bottomed silo with a slot: mass flow rate."""

import numpy as np

from granflow import Scene
from validation.peers.case import PeerCase, plane, scene_of
from validation.peers.state import (
    Particles,
    box_lattice,
    discharge_figures,
    random_particles,
)

COUNT, WIDTH, DEPTH, SLOT = 1800, 0.04, 0.02, 0.016
"""Particles, horizontal sides of the silo, and width of the slot across it [m]."""
REACH, TOP = 0.05, 0.3
"""Distance to which the plates of the floor extend in x and y, and height of the region [m]."""
OPENING, END, TIME_STEP = 0.2, 0.7, 2e-5
"""Times [s] of the opening and of the end, and time step [s]."""
FLOW_TIMES = (0.3, 0.7)
"""Times [s] between which the flow is measured."""


def scene(start: Particles) -> Scene:
    """Four planes, two plates and a gate."""

    def plate(x: float) -> dict[str, object]:
        sides = [[REACH - 0.5 * SLOT, 0, 0], [0, 2.0 * REACH, 0]]
        return {"shape": "rectangle", "corner": [x, -REACH, 0], "sides": sides}

    walls = {
        "left": plate(-REACH),
        "right": plate(0.5 * SLOT),
        "x0": plane([-0.5 * WIDTH, 0, 0], [1, 0, 0]),
        "x1": plane([0.5 * WIDTH, 0, 0], [-1, 0, 0]),
        "y0": plane([0, 0, 0], [0, 1, 0]),
        "y1": plane([0, DEPTH, 0], [0, -1, 0]),
        "gate": plane([0, 0, 0], [0, 0, 1], stages=["fill"]),
    }
    return scene_of(
        "silo",
        start,
        walls,
        {"min": [-REACH, -REACH, -0.2], "max": [REACH, REACH, TOP]},
        stages=[{"name": "fill", "duration": OPENING}, {"name": "flow", "duration": END - OPENING}],
        run={"velocity_max": 3.0, "time_step": TIME_STEP, "precision": "f64"},
    )


def triangles() -> dict[str, np.ndarray]:
    """Both plates of the floor."""
    found = []
    for low, high in ((-REACH, -0.5 * SLOT), (0.5 * SLOT, REACH)):
        a = (low, -REACH, 0)
        b = (high, -REACH, 0)
        c = (high, REACH, 0)
        d = (low, REACH, 0)
        found += [[a, b, c], [a, c, d]]
    return {"floor.stl": np.array(found)}


SILO = PeerCase(
    "flat silo with a slot",
    lambda repeat: random_particles(box_lattice(COUNT, (-0.5 * WIDTH, 0.0), (WIDTH, DEPTH)), repeat),
    scene,
    ((-0.06, -0.06, -0.2), (0.06, 0.06, TOP)),
    TIME_STEP,
    (OPENING, *FLOW_TIMES),
    discharge_figures(OPENING, *FLOW_TIMES),
    "silo",
    {},
    triangles,
    repeats=8,
)
