"""The time of the two loops of a step in C++ (`loops.cpp`) on the particles and lists of a run: what a compiled
program with the same layout reaches on this processor."""

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from benchmark import cases

SOURCE = Path(__file__).with_name("loops.cpp")
OPTIONS = ("-std=c++17", "-O3", "-march=native", "-fopenmp", "-fno-math-errno", "-fno-trapping-math")
LAW = "hertz"
"""The contact model of the C++ program."""
PLACEMENT = {"OMP_PROC_BIND": "spread", "OMP_PLACES": "cores"}
"""Each thread has a core of its own, as the workers of granflow have."""
PARTICLE = ("position", "radius", "mass", "velocity", "angular_velocity", "velocity_synchronized")


def seconds(engine: Any, law: str, precision: str, threads: int) -> dict[str, float] | None:
    """Median time [s] of each loop in C++ at the state of an engine, in the working directory.

    None without a compiler, with another contact model or precision, or with ranks.
    """
    compiler = shutil.which("g++")
    if compiler is None or (law, precision) != (LAW, "f64") or engine.state.plan.has_ghosts:
        return None
    program = Path("loops").resolve()
    if not program.exists():
        subprocess.run([compiler, *OPTIONS, str(SOURCE), "-o", str(program)], check=True)
    data = Path("loops.bin")
    write(engine.state, data)
    command = [str(program), str(data), str(threads)]
    placed = os.environ | PLACEMENT
    done = subprocess.run(command, env=placed, capture_output=True, text=True, check=True)
    data.unlink()
    found = json.loads(done.stdout)
    return {"integration": found["integration"], "forces": found["forces"]}


def write(state: Any, path: Path) -> None:
    """Writes particles and lists, without wall contacts, in the order in which `loops.cpp` reads them."""
    count = state.count
    particles, neighbors = state.particles, state.neighbors

    def table(*names: str) -> np.ndarray:
        columns = [getattr(particles, name).to_numpy()[:count].reshape(count, -1) for name in names]
        return np.concatenate(columns, axis=1).astype(np.float64)

    begin, end = (each.to_numpy()[:count] for each in (neighbors.list_walls_end, neighbors.list_end))
    entries = int(end.max(initial=0))
    modulus, shear_modulus, viscosity = state.plan.pair_constants[0][:3]
    constants = [cases.TIME_STEP, modulus, shear_modulus, viscosity, cases.FRICTION]
    spring = neighbors.history["tangential"].to_numpy()[:entries, :3]
    with path.open("wb") as file:
        for array in (
            np.array([count, entries, state.plan.chunk_size], np.int64),
            np.array(constants, np.float64),
            table(*PARTICLE),
            table("position_at_rebuild", "reach"),
            np.ascontiguousarray(spring, np.float64),
            begin.astype(np.int32),
            end.astype(np.int32),
            neighbors.partner.to_numpy()[:entries].astype(np.int32),
        ):
            file.write(array.tobytes())
