"""Moves a run to an engine with another plan: larger capacity, more features, or other walls."""

from typing import Any

import numpy as np

from granflow.engine.checkpoint import restore_state, saved_state
from granflow.engine.engine import Engine
from granflow.engine.ranks import NO_CHANGES, OneProcess
from granflow.errors import GranflowError
from granflow.plan.device_arrays import particle_arrays, saved_arrays, sum_arrays, wall_dynamics_arrays
from granflow.plan.plan import Plan
from granflow.plan.structure import structure_of


def with_plan(engine: Engine, plan: Plan) -> Engine:
    """An engine that continues with another plan: the same one if its kernels and capacities suffice.

    plan:  equal to that of the engine in time step, chunk size, materials and contact laws; its walls are those of the
           engine, changed, and others behind them

    Otherwise the given engine is freed, and kernels are compiled as necessary. The run continues with the same bits.
    """
    same_size = plan.particle_capacity == engine.plan.particle_capacity
    same_walls = len(plan.walls) == len(engine.plan.walls)
    if same_size and same_walls and structure_of(plan) == structure_of(engine.plan):
        engine.plan = engine.state.plan = engine.stability_monitor.plan = plan
        engine.state.walls.fill_joints(plan)
        return engine
    refuse_changes(engine)
    saved, motions, backend = saved_state(engine), engine.state.wall_motions, engine.state.backend
    saved["contacts"]["partner"] = renumbered(saved["contacts"]["partner"], engine.plan, plan)
    saved["walls_present"] += [False] * (len(plan.walls) - len(engine.plan.walls))
    motions = (*motions, *((),) * (len(plan.walls) - len(motions)))
    engine.free()
    moved = Engine(plan, backend)
    restore_state(moved, _fitted(saved, plan), motions)
    moved.take_over(engine)
    return moved


def renumbered(partner: np.ndarray, before: Plan, now: Plan) -> np.ndarray:
    """Numbers of contact partners (m,) in another plan, whose walls are those of the plan `before` and others.

    Walls w have the number -1 - w, triangles follow the walls: -1 - (number of walls) - t. Particles are at least 0.
    """
    first_triangle = -1 - len(before.walls)
    return np.where(partner <= first_triangle, partner - (len(now.walls) - len(before.walls)), partner)


def refuse_changes(engine: Engine) -> None:
    """Raise GranflowError if the engine is that of an MPI rank."""
    if not isinstance(engine.state.ranks, OneProcess):
        raise GranflowError(NO_CHANGES)


def _fitted(saved: dict[str, Any], plan: Plan) -> dict[str, Any]:
    """The saved state with the arrays of another plan: new ones are zero, longer ones are padded with zeros."""
    particles, sums, dynamics = (
        saved_arrays(arrays) for arrays in (particle_arrays(plan), sum_arrays(plan), wall_dynamics_arrays(plan))
    )
    count = saved["particle_count"]
    fitted = {"particles": {}, "energy_budget": {}, "wall_dynamics": dict(saved["wall_dynamics"])}
    for name, array in particles.items():
        zeros = np.zeros((count, *array.full_shape[1:]))
        fitted["particles"][name] = saved["particles"].get(name, zeros)
    for name, array in sums.items():
        fitted["energy_budget"][name] = _padded(saved["energy_budget"].get(name), array.full_shape[1:])
    if plan.controlled_motions:
        for name, array in dynamics.items():
            shape = array.shape[1:] if array.by_chunk else array.shape
            fitted["wall_dynamics"][name] = _padded(saved["wall_dynamics"][name], shape)
    return saved | fitted


def _padded(values: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    """The values with zeros up to the shape; zeros of int64 without values."""
    padded = np.zeros(shape, np.int64 if values is None else values.dtype)
    if values is not None:
        padded[tuple(slice(length) for length in values.shape)] = values
    return padded
