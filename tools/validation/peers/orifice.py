"""Cylindrical silo with a round orifice in its flat floor: mass flow rate."""

import numpy as np

from granflow import Scene
from validation.peers.case import PeerCase, plane, scene_of
from validation.peers.state import (
    LARGEST,
    SPACING,
    Particles,
    discharge_figures,
    random_particles,
)

COUNT, SILO_RADIUS, ORIFICE_RADIUS = 4000, 0.036, 0.014
"""Particles, and radii of silo and orifice [m], those of the scene `flat_silo` with an orifice of 28 mm."""
FLOOR_RADIUS, TOP = 0.04, 0.2
"""Outer radius of the floor, and height of the region [m]."""
OPENING, END, TIME_STEP = 0.25, 0.85, 2e-5
"""Times [s] of the opening and of the end, and time step [s]."""
FLOW_TIMES = (0.35, 0.85)
"""Times [s] between which the flow is measured."""
SEGMENTS, RINGS = 64, 8
"""Triangles of the floor around its axis, and rings; the polygon of the orifice is 0.16 % smaller than the
circle."""


def lattice() -> np.ndarray:
    """Positions (n, 3) [m] of a cubic lattice in the silo, from below."""
    grid = SPACING * np.arange(-8, 9)
    x, y, z = np.meshgrid(grid, grid, 0.6 * LARGEST + SPACING * np.arange(60), indexing="ij")
    chosen = np.hypot(x, y) < SILO_RADIUS - 0.55 * LARGEST
    points = np.stack([x[chosen], y[chosen], z[chosen]], axis=1)
    return np.asarray(points[np.argsort(points[:, 2], kind="stable")][:COUNT])


def scene(start: Particles) -> Scene:
    """Floor with a hole, silo, and a plane below that opens."""
    walls = {
        "floor": {
            "shape": "disc",
            "center": [0, 0, 0],
            "normal": [0, 0, 1],
            "radius": FLOOR_RADIUS,
            "hole_radius": ORIFICE_RADIUS,
        },
        "silo": {"shape": "cylinder", "from": [0, 0, 0], "to": [0, 0, TOP], "radius": SILO_RADIUS},
        "gate": plane([0, 0, 0], [0, 0, 1], stages=["fill"]),
    }
    side = 1.2 * FLOOR_RADIUS
    return scene_of(
        "orifice",
        start,
        walls,
        {"min": [-side, -side, -0.2], "max": [side, side, TOP]},
        stages=[{"name": "fill", "duration": OPENING}, {"name": "flow", "duration": END - OPENING}],
        run={"velocity_max": 3.0, "time_step": TIME_STEP, "precision": "f64"},
    )


def triangles() -> dict[str, np.ndarray]:
    """The floor, with vertices on the circles."""
    angle = 2.0 * np.pi * np.arange(SEGMENTS + 1) / SEGMENTS
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    rings = [radius * circle for radius in np.linspace(ORIFICE_RADIUS, FLOOR_RADIUS, RINGS)]
    found = []
    for inner, outer in zip(rings, rings[1:], strict=False):
        for i in range(SEGMENTS):
            found += [(inner[i], outer[i], outer[i + 1]), (inner[i], outer[i + 1], inner[i + 1])]
    return {"floor.stl": np.array(found)}


ORIFICE = PeerCase(
    "flat silo with a round orifice",
    lambda repeat: random_particles(lattice(), repeat),
    scene,
    ((-0.06, -0.06, -0.2), (0.06, 0.06, TOP)),
    TIME_STEP,
    (OPENING, *FLOW_TIMES),
    discharge_figures(OPENING, *FLOW_TIMES),
    "orifice",
    {},
    triangles,
    repeats=6,
    remark="LIGGGHTS has a floor of 64-sided triangles; LAMMPS 29 Sep 2021 has no wall with a hole",
)
