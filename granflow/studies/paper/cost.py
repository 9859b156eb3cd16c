"""Cost per contact of each contact model relative to Hertz: all models in one process, alternating, repeated."""

from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from granflow import ParticleData, Scene, Simulation
from granflow.studies.paper.cases import PAPER_CASES
from granflow.studies.paper.comparison import CandidateModel

SIDE = 16
"""Particles along an edge of the lattice."""
CONTACTS = 3 * SIDE**2 * (SIDE - 1)
"""Number of contacts of the lattice."""

REPEATS = 15
"""Number of timings of each contact model."""

STEPS = 60
"""Number of steps per timing."""
TIME_STEP = 1e-12
"""Time step [s], so short that the lattice does not change, while particles approach and separate."""
CLOSENESS = 0.9999
"""Distance of neighboring particles over the diameter."""
BASE = "hertz"
"""Contact model to which times are relative."""


@dataclass(frozen=True)
class Cost:
    """Time per step relative to the Hertz model: median and quartiles; time per contact and step [ns]."""

    median: float
    low: float
    high: float
    nanoseconds: float


def costs(candidate_models: Mapping[str, CandidateModel]) -> dict[str, Cost]:
    """Measure the time per step of all models on the same compressed lattice, alternating, REPEATS times.

    The result is relative to BASE, which must be among the models; median and quartiles over the repeats.
    """
    simulations = {name: _simulation(model) for name, model in candidate_models.items()}
    for simulation in simulations.values():
        simulation.step(STEPS)
    times = {name: np.array([]) for name in simulations}
    for _ in range(REPEATS):
        for name, simulation in simulations.items():
            times[name] = np.append(times[name], _timed(simulation))
    for simulation in simulations.values():
        simulation.free()
    found = {}
    for name, seconds in times.items():
        low, median, high = np.percentile(seconds / times[BASE], (25, 50, 75))
        found[name] = Cost(median, low, high, 1e9 * float(np.median(seconds)) / (STEPS * CONTACTS))
    return found


def _timed(simulation: Simulation) -> float:
    """Wall time [s] of STEPS steps."""
    start = perf_counter()
    simulation.step(STEPS)
    return perf_counter() - start


def _simulation(model: CandidateModel) -> Simulation:
    """Cubic lattice of overlapping particles of the first material, with velocities of both signs.

    SIDE^3 particles at CLOSENESS diameters; loading and unloading contacts occur with equal frequency.
    """
    case, strength, restitution = PAPER_CASES[0], model.yield_strengths[0], model.restitutions[0]
    count, reach = SIDE**3, case.diameter * (SIDE + 1)
    low, high = [-case.diameter] * 3, [reach] * 3
    scene = Scene.from_dict({
        "title": "Lattice for timing of contacts",
        "gravity": [0, 0, 0],
        "materials": {"steel": {**case.material, **({"yield_strength": strength} if strength else {})}},
        "pairs": {"steel-steel": {"friction": 0} | ({} if restitution is None else {"restitution": restitution})},
        "contact": {"normal": model.normal, "tangential": "none", "rolling": "none"},
        "particles": {"lattice": {
            "material": "steel", "diameter": case.diameter, "count": count,
            "insert": {"kind": "lattice", "region": {"box": {"min": low, "max": high}}},
        }},
        "domain": {"min": low, "max": high, "on_exit": "error"},
        "run": {"duration": 1.0, "time_step": TIME_STEP, "velocity_max": 1.0, "precision": "f64"},
        "output": {"interval": 1.0},
    })  # fmt: skip
    axis = CLOSENESS * case.diameter * np.arange(SIDE)
    positions = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    velocities = np.random.default_rng(1).uniform(-1.0, 1.0, positions.shape)
    numbers, radii = np.zeros(count, dtype=np.int32), np.full(count, 0.5 * case.diameter)
    particles = ParticleData(positions, velocities, np.zeros_like(positions), radii, numbers, numbers)
    return Simulation(scene, particles=particles)
