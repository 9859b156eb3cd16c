"""Cost per contact of each contact model relative to Hertz: all models in one process, alternating, repeated."""

from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from granflow.engine.backend import Backend
from granflow.engine.engine import Engine
from granflow.load import Scene
from granflow.particles.generate import initial_particles
from granflow.plan.build import plan_for
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


def costs(candidate_models: Mapping[str, CandidateModel], backend: Backend, repeats: int = REPEATS) -> dict[str, Cost]:
    """Measure the time per step of all models on the same compressed lattice, alternating, `repeats` times.

    The result is relative to BASE, which must be among the models; median and quartiles over the repeats.
    """
    engines = {name: _engine(model, backend) for name, model in candidate_models.items()}
    for engine in engines.values():
        engine.advance(STEPS)
    times = {name: np.array([]) for name in engines}
    for _ in range(repeats):
        for name, engine in engines.items():
            times[name] = np.append(times[name], _timed(engine))
    for engine in engines.values():
        engine.free()
    found = {}
    for name, seconds in times.items():
        low, median, high = np.percentile(seconds / times[BASE], (25, 50, 75))
        found[name] = Cost(median, low, high, 1e9 * float(np.median(seconds)) / (STEPS * CONTACTS))
    return found


def _timed(engine: Engine) -> float:
    """Wall time [s] of STEPS steps, until the device has finished."""
    start = perf_counter()
    engine.advance(STEPS)
    engine.synchronized(("mass", "velocity", "force"))
    return perf_counter() - start


def _engine(model: CandidateModel, backend: Backend) -> Engine:
    """Engine with the lattice for a model, ready to run."""
    scene = Scene.from_dict(_lattice(model, backend.precision))
    plan = plan_for(scene, on_gpu=not backend.on_cpu)
    engine = Engine(plan, backend)
    engine.insert(initial_particles(scene))
    engine.set_walls([], [])
    engine.refresh()
    return engine


def _lattice(model: CandidateModel, precision: str) -> dict[str, Any]:
    """Cubic lattice of overlapping particles of the first material, with velocities of both signs.

    SIDE^3 particles at CLOSENESS diameters; loading and unloading contacts occur with equal frequency.
    """
    case, random = PAPER_CASES[0], np.random.default_rng(1)
    axis = CLOSENESS * case.diameter * np.arange(SIDE)
    positions = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    strength = model.yield_strengths[0]
    reach = case.diameter * (SIDE + 1)
    return {
        "title": "Lattice for timing of contacts",
        "gravity": [0, 0, 0],
        "materials": {"steel": {**case.material, **({"yield_strength": strength} if strength else {})}},
        "pairs": {"steel-steel": {"restitution": model.restitutions[0], "friction": 0}},
        "contact": {"normal": model.normal, "tangential": "none", "rolling": "none"},
        "particles": {"lattice": {
            "material": "steel", "diameter": case.diameter,
            "velocity": random.uniform(-1.0, 1.0, positions.shape).tolist(),
            "insert": {"kind": "positions", "positions": positions.tolist()},
        }},
        "domain": {"min": [-case.diameter] * 3, "max": [reach] * 3, "on_exit": "error"},
        "run": {"duration": 1.0, "time_step": TIME_STEP, "velocity_max": 1.0, "precision": precision},
        "output": {"interval": 1.0},
    }  # fmt: skip
