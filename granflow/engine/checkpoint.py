"""Saves and restores the device state that determines how a run continues, bit for bit.

The state consists of the particles with velocities half a step behind, the histories of their contacts, and
sums; all in the order of the ids, so that it does not depend on threads, chunks or MPI ranks. Saving rebuilds
and evaluates nothing, so that a checkpoint does not influence the run. Restoring repeats the last rebuild of
the neighbor lists, with the positions of that time: the next one is then due at the same step as in the run
that continues without interruption.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np

from granflow.engine.engine import Engine, host_particles
from granflow.engine.state import NO_CHANGES, OneProcess
from granflow.errors import GranflowError
from granflow.io.checkpoint import RankFile
from granflow.plan.arrays import particle_arrays, saved_arrays, structure_of, sum_arrays, wall_dynamics_arrays
from granflow.plan.plan import Plan
from granflow.scene.blocks.motions import TimedMotion

SavedState = dict[str, Any]
"""Numbers, texts and numpy arrays in nested dictionaries."""
CLOCKS = (
    "neighbor_list",
    "advance",
    "sampled_forces",
    "sampled_integration",
    "rebuild_count",
    "step_count",
    "particle_steps",
)
"""Attributes of Timing that a checkpoint contains."""


class RankFileWriter(Protocol):
    """Writes the particles of MPI ranks; each rank has a copy."""

    def write(self, rank: int, count: int, saved: SavedState) -> dict[str, Any]:
        """Write `saved_particles` of a rank, which are `count`; returns the entry of the checkpoint.

        Raises OSError.
        """


def saved_state(engine: Engine) -> SavedState:
    """The state of the engine that determines how it continues, without the data of the scene.

    Nested dictionaries of numbers and numpy arrays; particle arrays (n,) or (n, 3) in the order of the ids;
    contacts as `Histories`, with histories by the slots of the contact models. On MPI ranks, the particles of
    the root only.
    """
    return saved_sums_and_clocks(engine) | saved_particles(engine)


def saved_sums_and_clocks(engine: Engine) -> SavedState:
    """The part of `saved_state` without the particles and their contacts."""
    state = engine.state
    return {
        "clock": state.clock.state_dict(),
        "clock_at_rebuild": None if engine.is_changed else engine.stepper.clock_at_rebuild,
        "steps_since_update": engine.steps_since_update,
        "overlap_limit": engine.overlap_limit,
        "particle_count": engine.particle_count,
        "walls_present": [bool(state.walls.present[index]) for index in range(len(engine.plan.walls))],
        "accounting": engine.accounting.state_dict(),
        "clocks": {name: getattr(engine.timing, name) for name in CLOCKS},
        **engine.saved_sums(),
    }


def saved_particles(engine: Engine, kept: bool = False) -> SavedState:
    """Particles and contacts of this rank, in the order of the ids, as in `saved_state`.

    kept:  those of `keep_particles` instead of the present ones
    """
    found = engine.kept_particles if kept else engine.saved_particles()
    assert found is not None
    particles = found.by_id()
    contacts = particles.histories
    return {
        "particles": particles.arrays,
        "contacts": {"count": contacts.count, "partner": contacts.partner, **contacts.values},
    }


def restore_state(
    engine: Engine,
    saved: SavedState,
    motions: Sequence[Sequence[TimedMotion]],
    files: Sequence[RankFile] = (),
) -> None:
    """Restore a state into a new engine.

    saved:    result of `saved_state`. Without `clock_at_rebuild`, a rebuild must follow after a change
    motions:  motions of each wall
    files:    of MPI ranks, with further particles
    Raises:   GranflowError if the scene needs other arrays than the saved state has, or has other
              force-controlled motions, or a file is invalid
    """
    rest = {name: value for name, value in saved.items() if name not in ("particles", "contacts")}
    engine.restore(rest, host_particles(engine.state, saved), motions, files)
    for name in CLOCKS:
        setattr(engine.timing, name, saved["clocks"][name])


def keep_particles(engine: Engine) -> None:
    """Keep a copy of the particles on the host of each MPI rank, for a later checkpoint of this state."""
    engine.on_each_rank(_keep_particles)


def _keep_particles(engine: Engine, _rank: int) -> None:
    engine.kept_particles = engine.saved_particles()


def rank_file_entries(engine: Engine, writer: RankFileWriter, kept: bool = False) -> list[dict[str, Any]]:
    """Let all MPI ranks but the root write their particles; returns the entries of the checkpoint.

    kept:    those of `keep_particles` instead of the present ones
    Raises:  OSError
    """
    entries = engine.on_each_rank(partial(_write_rank_file, writer=writer, kept=kept))
    return [entry for entry in entries if entry is not None]


def _write_rank_file(engine: Engine, rank: int, writer: RankFileWriter, kept: bool) -> dict[str, Any] | None:
    """Write the particles of this rank; the checkpoint itself contains those of the root."""
    if not rank:
        return None
    saved = saved_particles(engine, kept)
    return writer.write(rank, len(saved["particles"]["id"]), saved)


# Moves a run to an engine with another plan: larger capacity, more features, or other walls.


def with_plan(engine: Engine, plan: Plan) -> Engine:
    """An engine that continues with another plan: the same one if its kernels and capacities suffice.

    plan:  equal to that of the engine in time step, chunk size, materials and contact laws; its walls are
           those of the engine, changed, and others behind them

    Otherwise the given engine is freed, and kernels are compiled as necessary. The run continues with the
    same bits.
    """
    same_size = plan.particle_capacity == engine.plan.particle_capacity
    same_walls = len(plan.walls) == len(engine.plan.walls)
    if same_size and same_walls and structure_of(plan) == structure_of(engine.plan):
        engine.plan = engine.state.plan = engine.stability_monitor.plan = plan
        engine.state.walls.fill_joints(plan)
        return engine
    refuse_changes(engine)
    saved = saved_state(engine)
    motions = engine.state.wall_motions
    gravity_course = engine.state.gravity_course
    backend = engine.state.backend
    saved["contacts"]["partner"] = renumbered(saved["contacts"]["partner"], engine.plan, plan)
    saved["walls_present"] += [False] * (len(plan.walls) - len(engine.plan.walls))
    motions = (*motions, *((),) * (len(plan.walls) - len(motions)))
    engine.free()
    moved = Engine(plan, backend)
    moved.set_gravity(gravity_course)
    restore_state(moved, _fitted(saved, plan), motions)
    moved.take_over(engine)
    return moved


def renumbered(partner: np.ndarray, before: Plan, now: Plan) -> np.ndarray:
    """Numbers of contact partners (m,) in another plan, with the walls of the plan `before` and others.

    Walls w have the number -1 - w, triangles follow the walls: -1 - (number of walls) - t. Particles are at
    least 0.
    """
    first_triangle = -1 - len(before.walls)
    return np.where(partner <= first_triangle, partner - (len(now.walls) - len(before.walls)), partner)


def refuse_changes(engine: Engine) -> None:
    """Raise GranflowError if the engine is that of an MPI rank."""
    if not isinstance(engine.state.ranks, OneProcess):
        raise GranflowError(NO_CHANGES)


def _fitted(saved: dict[str, Any], plan: Plan) -> dict[str, Any]:
    """The saved state with the arrays of another plan.

    New arrays are zero, longer ones are padded with zeros.
    """
    particles, sums, dynamics = (
        saved_arrays(arrays)
        for arrays in (particle_arrays(plan), sum_arrays(plan), wall_dynamics_arrays(plan))
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
