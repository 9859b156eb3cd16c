"""Column that settles and collapses, and hopper that is filled and opens."""

import math
from typing import Any

import numpy as np

from granflow import Scene
from validation.peers.case import LAW, PeerCase, plane
from validation.peers.state import (
    DENSITY,
    GRAVITY,
    LARGEST,
    SPACING,
    Frames,
    Particles,
    box_lattice,
    center,
    coordination,
    mass_above,
    perturbed,
    random_particles,
)

COUNT, SIDE = 4000, 0.06
"""Particles, and side [m] of the box."""
ORIFICE, TUBE, CONE_HEIGHT, TOP = 0.012, 0.032, 0.02 * math.sqrt(3.0), 0.5
"""Radii [m] of orifice and tube, height [m] of the cone and top [m] of the tube of the hopper."""
OPENING, TIME_STEP = 0.3, 1e-5
"""Time [s] at which gate or plug opens, and time step [s]."""
ENDS = {"column": 0.5, "hopper": 0.9}
"""Durations [s] of the cases."""
FLOW_TIMES = (0.5, 0.9)
"""Times [s] between which the flow out of the hopper is measured."""
SEGMENTS, RINGS = 64, 8
"""Triangles of the hopper around its axis, and rings of cone and tube."""
ENTERED = {"LIGGGHTS": 0.5, "LAMMPS": 0.36665}
"""Restitution that both codes are given for 0.5, with tension at the end of a contact."""
RUNS = 6
"""Runs of each code. Their velocities differ by a relative PERTURBATION; from fewer runs the scatter is not
known."""


def hopper_lattice() -> np.ndarray:
    """Positions (n, 3) [m] of a cubic lattice in cone and tube, from below."""
    grid = SPACING * np.arange(-8, 9)
    x, y, z = np.meshgrid(grid, grid, 0.6 * LARGEST + SPACING * np.arange(200), indexing="ij")
    inside = np.minimum(TUBE, ORIFICE + (TUBE - ORIFICE) * z / CONE_HEIGHT)
    margin = 0.55 * LARGEST / math.cos(math.pi / 6.0)
    chosen = np.hypot(x, y) < inside - margin
    points = np.stack([x[chosen], y[chosen], z[chosen]], axis=1)
    return np.asarray(points[np.argsort(points[:, 2], kind="stable")][:COUNT])


def bed_scene(name: str, walls: dict[str, Any], start: Particles) -> Scene:
    """The scene of a case, with the numbers of the inputs of LIGGGHTS and LAMMPS."""
    group = {
        "material": "m",
        "diameter": start.diameter.tolist(),
        "velocity": start.velocity.tolist(),
        "insert": {"kind": "positions", "positions": start.position.tolist()},
    }
    return Scene.from_dict(
        {
            "title": name,
            "gravity": [0, 0, -GRAVITY],
            "materials": {"m": {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": DENSITY}},
            "pairs": {"m-m": {"restitution": 0.5, "friction": 0.5}},
            "contact": LAW | {"rolling": "none"},
            "walls": {name: {"material": "m"} | wall for name, wall in walls.items()},
            "particles": {"beads": group},
            "domain": {"min": [-0.1, -0.1, -0.2], "max": [1.0, 0.1, 1.0], "on_exit": "delete"},
            "stages": [
                {"name": "fill", "duration": OPENING},
                {"name": "flow", "duration": ENDS[name] - OPENING},
            ],
            "run": {"velocity_max": 3.0, "time_step": TIME_STEP, "precision": "f64"},
            "numerics": {"max_overlap": 0.4},
            "output": {"interval": 10.0},
        }
    )


def box_walls() -> dict[str, Any]:
    """Floor and four planes; the gate at x = SIDE opens."""
    return {
        "floor": plane([0, 0, 0], [0, 0, 1]),
        "back": plane([0, 0, 0], [1, 0, 0]),
        "gate": plane([SIDE, 0, 0], [-1, 0, 0], stages=["fill"]),
        "left": plane([0, 0, 0], [0, 1, 0]),
        "right": plane([0, SIDE, 0], [0, -1, 0]),
    }


def hopper_walls() -> dict[str, Any]:
    """Cone, tube, and a plane below that opens."""
    return {
        "cone": {
            "shape": "cone",
            "from": [0, 0, 0],
            "to": [0, 0, CONE_HEIGHT],
            "radius_from": ORIFICE,
            "radius_to": TUBE,
        },
        "tube": {"shape": "cylinder", "from": [0, 0, CONE_HEIGHT], "to": [0, 0, TOP], "radius": TUBE},
        "gate": plane([0, 0, 0], [0, 0, 1], stages=["fill"]),
    }


def hopper_triangles() -> dict[str, np.ndarray]:
    """Cone and tube as triangles, with vertices on the circles."""
    angle = 2.0 * np.pi * np.arange(SEGMENTS + 1) / SEGMENTS
    heights = [*np.linspace(0.0, CONE_HEIGHT, RINGS), *np.linspace(CONE_HEIGHT, TOP, 3 * RINGS)[1:]]
    rings = []
    found = []
    for z in heights:
        radius = min(TUBE, ORIFICE + (TUBE - ORIFICE) * z / CONE_HEIGHT)
        rings.append(
            np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full_like(angle, z)], axis=1)
        )
    for low, high in zip(rings, rings[1:], strict=False):
        for i in range(SEGMENTS):
            found += [(low[i], low[i + 1], high[i + 1]), (low[i], high[i + 1], high[i])]
    return {"hopper.stl": np.array(found)}


def hopper_figures(frames: Frames) -> dict[str, float]:
    """Flow out of the hopper; particles 0.2 m below the orifice are deleted."""
    first, last = (mass_above(frames[time], 0.0) for time in FLOW_TIMES)
    return {
        "mass flow rate [kg/s]": (first - last) / (FLOW_TIMES[1] - FLOW_TIMES[0]),
        "height of the settled center of mass [m]": float(center(frames[OPENING])[2]),
    }


def column_figures(frames: Frames) -> dict[str, float]:
    """Settled bed, and its collapse."""
    settled, falling, last = (frames[time] for time in (OPENING, 0.4, 0.5))
    energy = 0.5 * float(np.sum(falling.mass[:, None] * falling.velocity**2))
    return {
        "height of the settled center of mass [m]": float(center(settled)[2]),
        "contacts per settled particle": coordination(settled),
        "kinetic energy of translation 0.1 s after the opening [J]": energy,
        "distance of the center of mass from the wall after 0.1 s [m]": float(center(falling)[0]),
        "distance of the center of mass from the wall after 0.2 s [m]": float(center(last)[0]),
        "height of the center of mass after 0.2 s [m]": float(center(last)[2]),
    }


COLUMN = PeerCase(
    "column",
    lambda repeat: perturbed(random_particles(box_lattice(COUNT, (0.0, 0.0), (SIDE, SIDE))), repeat),
    lambda start: bed_scene("column", box_walls(), start),
    ((-0.001, -0.001, -0.001), (0.9, 0.061, 0.9)),
    TIME_STEP,
    (OPENING, 0.4, 0.5),
    column_figures,
    "column",
    {"L": SIDE},
    equal_law=False,
    restitution=ENTERED,
    repeats=RUNS,
)
HOPPER = PeerCase(
    "hopper",
    lambda repeat: perturbed(random_particles(hopper_lattice()), repeat),
    lambda start: bed_scene("hopper", hopper_walls(), start),
    ((-0.05, -0.05, -0.2), (0.05, 0.05, 0.9)),
    TIME_STEP,
    (OPENING, *FLOW_TIMES),
    hopper_figures,
    "hopper",
    {},
    hopper_triangles,
    equal_law=False,
    restitution=ENTERED,
    repeats=RUNS,
    remark="LIGGGHTS has a hopper of 64-sided triangles",
)
