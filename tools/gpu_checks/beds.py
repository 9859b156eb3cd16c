"""Beds of any size without settling them, and engines that hold them.

A bed of some thousand particles settles on the CPU under gravity; a larger bed consists of mirror images of
it (see `benchmark.cases.tiled`). Contacts per particle, overlaps and disorder are therefore those of a
settled bed at each size; only the share of particles near a side wall differs. A lattice would have 12
contacts, or 6 in regular order.
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from benchmark import ours
from benchmark.cases import Case, tiled

SETTLED = {False: 10_000, True: 1_000}
"""Particles of the settled bed, for a full and for a quick run."""
LAW = "hertz"


def relax(count: int, path: str) -> None:
    """Job of a subprocess: settles `count` particles in a box and writes them to a file."""
    ours.relax(count, path, threads=None)


def bed(path: str, count: int) -> Case:
    """About `count` particles: the settled bed at `path`, or mirror images of it."""
    relaxed = Case.load(Path(path))
    return relaxed if count <= relaxed.count else tiled(relaxed, count)


def plan_of(case: Case, precision: str, on_gpu: bool, law: str = LAW, skin: str = "auto") -> Any:
    """Plan of a bed between four walls and a floor."""
    from granflow.load import load_scene
    from granflow.plan.build import plan_for

    with tempfile.TemporaryDirectory() as folder:
        scene_file = Path(folder) / "bed.yaml"
        scene_file.write_text(ours.scene_text(case, law, precision, skin))
        return plan_for(load_scene(scene_file), on_gpu=on_gpu)


def engine_for(
    case: Case, arch: str, precision: str, velocity: np.ndarray | None = None, chunk_size: int | None = None
) -> Any:
    """Engine with a bed before the first step, forces computed; velocities (n, 3) [m/s], or at rest."""
    from granflow.engine.backend import start
    from granflow.engine.engine import Engine
    from granflow.particles.group import ParticleData

    backend = start(arch, precision)  # type: ignore[arg-type]
    plan = plan_of(case, precision, not backend.on_cpu)
    if chunk_size is not None:
        plan = replace(plan, chunk_size=chunk_size)
    engine = Engine(plan, backend)
    zeros = np.zeros((case.count, 3))
    zero_indices = np.zeros(case.count, np.int32)
    velocities = zeros if velocity is None else velocity
    engine.insert(
        ParticleData(case.position, velocities, zeros, 0.5 * case.diameter, zero_indices, zero_indices)
    )
    engine.set_walls([True] * len(plan.walls), [()] * len(plan.walls))
    engine.refresh()
    return engine
