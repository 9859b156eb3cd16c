"""Comparison with LIGGGHTS and LAMMPS from the same initial states: a bed that settles and collapses, and a hopper.

`tools/validation/run_peers.py` runs both codes with the inputs in that folder and stores their numbers in
`peers.json`, with version and date.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np

from granflow import Scene, Simulation
from granflow.studies.validation.case import ValidationCase

COUNT, SIDE, SPACING = 4000, 0.06, 4.45e-3
"""Particles, side [m] of the box, and spacing [m] of the initial lattice."""
SMALLEST, LARGEST, DENSITY = 3.6e-3, 4.4e-3, 2500.0
"""Diameters [m] and density [kg/m3]."""
SPEED, GRAVITY = 0.3, 9.81
"""Largest initial velocity component [m/s], and gravitational acceleration [m/s2]."""
ORIFICE, TUBE, CONE_HEIGHT, TOP = 0.012, 0.032, 0.02 * math.sqrt(3.0), 0.5
"""Radii [m] of orifice and tube, height [m] of the cone and top [m] of the tube of the hopper."""
OPENING, TIME_STEP = 0.3, 1e-5
"""Time [s] at which gate or plug opens, and time step [s]."""
ENDS = {"column": 0.5, "hopper": 0.9}
"""Durations [s] of the cases."""
FLOW_TIMES = (0.5, 0.9)
"""Times [s] between which the flow out of the hopper is measured."""
PERTURBATION, REPEATS = 1e-6, 3
"""Relative change of the initial velocities in repeated runs, and their number."""
MODEL_ERROR = 0.02
"""Difference between the codes for equal parameters: end of a contact with or without tension, walls of triangles."""
LAW = {"normal": "hertz", "rolling": "none"}
TANGENTIAL = {"law": "mindlin", "increments": "displacement", "unloading": "kept", "damping": 0.9258}
"""Law of LIGGGHTS and of `mindlin` in LAMMPS: damping over that of the normal force sqrt(4 G*/E*)."""


@dataclass(frozen=True)
class Particles:
    """Positions and velocities (n, 3) [m, m/s], and diameters (n,) [m]."""

    position: np.ndarray
    velocity: np.ndarray
    diameter: np.ndarray

    @property
    def mass(self) -> np.ndarray:
        """Masses (n,) [kg]."""
        return np.asarray(DENSITY * math.pi / 6.0 * self.diameter**3)


Frames = Mapping[float, Particles]
"""State by time [s], rounded to 0.1 s."""


def initial_state(case: str) -> Particles:
    """Loose lattice of particles with random velocities, in the box or in cone and tube of the hopper."""
    random = np.random.default_rng(12345)
    positions = _box_lattice() if case == "column" else _hopper_lattice()
    diameter = random.uniform(SMALLEST, LARGEST, COUNT)
    return Particles(positions, random.uniform(-SPEED, SPEED, (COUNT, 3)), diameter)


def _box_lattice() -> np.ndarray:
    """Positions (n, 3) [m] of a cubic lattice in the box, from below."""
    across = int((SIDE - 1.01 * LARGEST) / SPACING) + 1
    first, number = 0.5 * (SIDE - (across - 1) * SPACING), np.arange(COUNT)
    x, y, z = number % across, number // across % across, number // across**2
    return np.stack([first + SPACING * x, first + SPACING * y, 0.6 * LARGEST + SPACING * z], axis=1)


def _hopper_lattice() -> np.ndarray:
    """Positions (n, 3) [m] of a cubic lattice in cone and tube, from below."""
    grid = SPACING * np.arange(-8, 9)
    x, y, z = np.meshgrid(grid, grid, 0.6 * LARGEST + SPACING * np.arange(200), indexing="ij")
    inside = np.minimum(TUBE, ORIFICE + (TUBE - ORIFICE) * z / CONE_HEIGHT)
    margin = 0.55 * LARGEST / math.cos(math.pi / 6.0)
    chosen = np.hypot(x, y) < inside - margin
    points = np.stack([x[chosen], y[chosen], z[chosen]], axis=1)
    return np.asarray(points[np.argsort(points[:, 2], kind="stable")][:COUNT])


def peer_scene(case: str, start: Particles) -> Scene:
    """The scene of a case, with the numbers of the inputs of LIGGGHTS and LAMMPS."""
    group = {
        "material": "m", "diameter": start.diameter.tolist(), "velocity": start.velocity.tolist(),
        "insert": {"kind": "positions", "positions": start.position.tolist()},
    }  # fmt: skip
    return Scene.from_dict({
        "title": case, "gravity": [0, 0, -GRAVITY],
        "materials": {"m": {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": DENSITY}},
        "pairs": {"m-m": {"restitution": 0.5, "friction": 0.5}},
        "contact": LAW | {"tangential": TANGENTIAL},
        "walls": _box_walls() if case == "column" else _hopper_walls(),
        "particles": {"beads": group},
        "domain": {"min": [-0.1, -0.1, -0.2], "max": [1.0, 0.1, 1.0], "on_exit": "delete"},
        "stages": [
            {"name": "fill", "duration": OPENING}, {"name": "flow", "duration": ENDS[case] - OPENING},
        ],
        "run": {"velocity_max": 3.0, "time_step": TIME_STEP, "precision": "f64"},
        "numerics": {"max_overlap": 0.4}, "output": {"interval": 10.0},
    })  # fmt: skip


def _box_walls() -> dict[str, Any]:
    """Floor and four planes; the gate at x = SIDE opens."""

    def plane(point: list[float], normal: list[float], **more: Any) -> dict[str, Any]:
        return {"shape": "plane", "point": point, "normal": normal, "material": "m"} | more

    return {
        "floor": plane([0, 0, 0], [0, 0, 1]), "back": plane([0, 0, 0], [1, 0, 0]),
        "gate": plane([SIDE, 0, 0], [-1, 0, 0], stages=["fill"]),
        "left": plane([0, 0, 0], [0, 1, 0]), "right": plane([0, SIDE, 0], [0, -1, 0]),
    }  # fmt: skip


def _hopper_walls() -> dict[str, Any]:
    """Cone, tube, and a plane below that opens."""
    cone = {"shape": "cone", "from": [0, 0, 0], "to": [0, 0, CONE_HEIGHT], "radius_from": ORIFICE, "radius_to": TUBE}
    tube = {"shape": "cylinder", "from": [0, 0, CONE_HEIGHT], "to": [0, 0, TOP], "radius": TUBE}
    gate = {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1], "stages": ["fill"]}
    return {name: {"material": "m"} | wall for name, wall in (("cone", cone), ("tube", tube), ("gate", gate))}


def our_frames(case: str, repeat: int = 0) -> Frames:
    """States of a run, every 0.1 s from the opening; repeats start with perturbed velocities."""
    start, random = initial_state(case), np.random.default_rng(repeat)
    factor = 1.0 + PERTURBATION * (repeat > 0) * random.standard_normal(start.velocity.shape)
    simulation = Simulation(peer_scene(case, Particles(start.position, start.velocity * factor, start.diameter)))
    frames = {}
    for tenth in range(round(10 * OPENING), round(10 * ENDS[case]) + 1):
        simulation.run(until=0.1 * tenth)
        found = simulation.snapshot().particles
        frames[0.1 * tenth] = Particles(found["position"], found["velocity"], 2.0 * found["radius"])
    simulation.free()
    return frames


def figures(case: str, frames: Frames) -> dict[str, float]:
    """Numbers of a case that are compared, in SI units, by name."""
    states = {round(10 * time): state for time, state in frames.items()}
    if case == "hopper":
        first, last = (_mass_above(states[round(10 * time)]) for time in FLOW_TIMES)
        flow = (first - last) / (FLOW_TIMES[1] - FLOW_TIMES[0])
        return {"mass flow rate [kg/s]": flow, "height of the settled center of mass [m]": _center(states[3], 2)}
    energy = 0.5 * float(np.sum(states[4].mass[:, None] * states[4].velocity ** 2))
    return {
        "height of the settled center of mass [m]": _center(states[3], 2),
        "contacts per settled particle": _coordination(states[3]),
        "kinetic energy of translation 0.1 s after the opening [J]": energy,
        "distance of the center of mass from the wall after 0.1 s [m]": _center(states[4], 0),
        "distance of the center of mass from the wall after 0.2 s [m]": _center(states[5], 0),
        "height of the center of mass after 0.2 s [m]": _center(states[5], 2),
    }


def _center(state: Particles, axis: int) -> float:
    """Coordinate of the center of mass [m]."""
    return float(state.mass @ state.position[:, axis] / state.mass.sum())


def _mass_above(state: Particles) -> float:
    """Mass [kg] of particles with centers above the orifice; particles 0.2 m below it are deleted."""
    return float(state.mass[state.position[:, 2] > 0.0].sum())


def _coordination(state: Particles) -> float:
    """Mean number of overlapping particles per particle."""
    from scipy.spatial import cKDTree

    first, second = cKDTree(state.position).query_pairs(LARGEST, output_type="ndarray").T
    distance = np.linalg.norm(state.position[first] - state.position[second], axis=1)
    touches = distance < 0.5 * (state.diameter[first] + state.diameter[second])
    return 2.0 * float(touches.sum()) / len(state.diameter)


def stored_figures() -> dict[str, Any]:
    """Content of peers.json: for each code its version, the date of the run, and the figures by case."""
    text = (files("granflow.studies.validation") / "peers.json").read_text(encoding="utf-8")
    return dict(json.loads(text))


def peer_cases(case: str, repeats: int = REPEATS) -> list[ValidationCase]:
    """Figures of LIGGGHTS and LAMMPS and the means of repeated runs of granflow from the same initial state."""
    runs = [figures(case, our_frames(case, repeat)) for repeat in range(repeats)]
    return compared(case, runs, stored_figures())


def compared(case: str, runs: list[dict[str, float]], stored: Mapping[str, Any]) -> list[ValidationCase]:
    """Cases of each peer from the figures of repeated runs of granflow, and the stored figures of the peers."""
    found = []
    for name in runs[0]:
        values = np.array([run[name] for run in runs])
        mean, scatter = float(values.mean()), float(values.std(ddof=1))
        for peer, content in stored.items():
            reference = content["figures"][case][name]
            spread = scatter * math.sqrt(1.0 + 1.0 / len(runs)) / abs(reference)
            label, _, unit = name.partition(" [")
            found.append(
                ValidationCase(
                    f"LIGGGHTS and LAMMPS, {case}", f"{peer}: {label}", reference,
                    f"{content['version']}, run on {content['date']} from the same {COUNT} positions and velocities",
                    mean, unit.rstrip("]") or "1", MODEL_ERROR + 3.0 * spread,
                    f"{100 * MODEL_ERROR:g} % between implementations, and three standard deviations of the difference "
                    f"between one run and the mean of {len(runs)}; their velocities differ by {PERTURBATION:g}",
                )
            )  # fmt: skip
    return found
