"""What a contact of each law costs beside one of Hertz: all laws in one process, in turn, many times over."""

from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from granflow.device.backend import Backend
from granflow.device.engine import Engine
from granflow.plan import plan_for
from granflow.scene import Scene
from granflow.scene.generate import initial_particles
from granflow.study.paper.cases import PAPER_CASES
from granflow.study.paper.comparison import CandidateModel

SIDE = 16
"""Grains along an edge of the lattice that is timed."""
CONTACTS = 3 * SIDE**2 * (SIDE - 1)
REPEATS = 15
STEPS = 60
"""Of each timing."""
TIME_STEP = 1e-12
"""So short [s] that the lattice stays as it is; grains approach and part all the same."""
CLOSENESS = 0.9999
"""Distance of neighbors over the diameter."""
BASE = "hertz"


@dataclass(frozen=True)
class Cost:
    """Time of a step with this law over one with Hertz: median and quartiles; nanoseconds per contact and step."""

    median: float
    low: float
    high: float
    nanoseconds: float


def costs(candidate_models: Mapping[str, CandidateModel], backend: Backend, repeats: int = REPEATS) -> dict[str, Cost]:
    """Time every law on the same compressed lattice, one after the other, `repeats` times; Hertz is the measure."""
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
    start = perf_counter()
    engine.advance(STEPS)
    engine.synchronized(("mass", "velocity", "force"))
    return perf_counter() - start


def _engine(model: CandidateModel, backend: Backend) -> Engine:
    scene = Scene.model_validate(_lattice(model, backend.precision))
    plan = plan_for(scene, on_gpu=not backend.on_cpu)
    engine = Engine(plan, backend)
    engine.insert(initial_particles(scene))
    engine.set_walls([], [])
    engine.refresh()
    return engine


def _lattice(model: CandidateModel, precision: str) -> dict[str, Any]:
    """A cubic lattice of the first material, neighbors pressed together, with velocities of either sign."""
    case, random = PAPER_CASES[0], np.random.default_rng(1)
    axis = CLOSENESS * case.diameter * np.arange(SIDE)
    positions = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    strength = model.yield_strengths[0]
    reach = case.diameter * (SIDE + 1)
    return {
        "title": "A lattice to time contacts on",
        "gravity": [0, 0, 0],
        "materials": {"steel": {**case.material, **({"yield_strength": strength} if strength else {})}},
        "pairs": {"steel-steel": {"restitution": model.restitutions[0], "friction": 0}},
        "contact": {"normal": model.normal, "tangential": "none", "rolling": "none"},
        "particles": {"grains": {
            "material": "steel", "diameter": case.diameter,
            "velocity": random.uniform(-1.0, 1.0, positions.shape).tolist(),
            "insert": {"kind": "positions", "positions": positions.tolist()},
        }},
        "domain": {"min": [-case.diameter] * 3, "max": [reach] * 3, "on_exit": "error"},
        "run": {"duration": 1.0, "time_step": TIME_STEP, "velocity_max": 1.0, "precision": precision},
        "output": {"interval": 1.0},
    }  # fmt: skip
