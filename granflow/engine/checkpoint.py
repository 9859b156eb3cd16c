"""Saves and restores the device state that determines how a run continues, bit for bit.

The state holds the particles in their present order with velocities half a step behind, the neighbor lists, the contact
histories and the sums of the energy budget.
Saving rebuilds and evaluates nothing, so that a checkpoint does not influence the run. Capacities are not saved: a
neighbor list that is longer than the first estimate increases the capacity.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from granflow.engine.engine import Engine
from granflow.engine.host_copy import FieldTable, consecutive, saved_particle_table
from granflow.engine.state import State
from granflow.errors import GranflowError
from granflow.geometry.motion import Motion
from granflow.plan.device_arrays import saved_arrays, sum_arrays, wall_dynamics_arrays

SavedState = dict[str, Any]
"""Numbers, texts and numpy arrays in nested dictionaries."""

CLOCKS = {
    "neighbor_list": float,
    "advance": float,
    "sampled_forces": float,
    "sampled_integration": float,
    "rebuild_count": int,
    "step_count": int,
    "particle_steps": int,
}
"""Attributes of Timing that a checkpoint contains, with their types."""


class EngineCheckpoint:
    """Saves the state of one engine and restores it into a new engine. Compiles its kernels at first use."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine

    def state_dict(self) -> SavedState:
        """The state of the engine that determines how it continues, without the data of the scene.

        Nested dictionaries of numbers and numpy arrays; particle arrays (n,) or (n, 3) are in device order.
        """
        engine, state = self.engine, self.engine.state
        return {
            "clock": state.clock.state_dict(),
            "steps_since_update": engine.steps_since_update,
            "steps_since_rebuild": engine.stepper.steps_since_rebuild,
            "particle_count": state.count,
            "walls_present": [bool(state.walls.present[index]) for index in range(len(engine.plan.walls))],
            "accounting": engine.accounting.state_dict(),
            "clocks": {name: getattr(engine.timing, name) for name in CLOCKS},
            "particles": saved_particle_table(state).take(slice(0, state.count)),
            "neighbors": self._neighbor_lists(),
            "wall_dynamics": {
                "controlled_motions": [controlled.key for controlled in engine.plan.controlled_motions],
                **{name: field.to_numpy() for name, field in self._wall_dynamics().items()},
            },
            "energy_budget": {name: field.to_numpy() for name, field in self._sums().items()},
        }

    def load_state_dict(self, saved: SavedState, motions: Sequence[Sequence[Motion]]) -> None:
        """Restore the saved state into a new engine.

        saved:    result of `state_dict`
        motions:  motions of each wall
        Raises:   GranflowError if the scene needs other arrays than the saved state has, or has other force-controlled
                  motions
        """
        engine, state = self.engine, self.engine.state
        state.count = saved["particle_count"]
        self._load_neighbor_lists(saved["neighbors"])
        particles = saved_particle_table(state)
        particles.put(np.arange(state.count), _named(saved["particles"], particles.fields))
        self._load_sums(self._sums(), saved["energy_budget"])
        self._load_wall_dynamics(saved["wall_dynamics"])
        engine.accounting.load_state_dict(saved["accounting"])
        for name in CLOCKS:
            setattr(engine.timing, name, saved["clocks"][name])
        engine.stepper.steps_since_rebuild = saved["steps_since_rebuild"]
        state.clock.load_state_dict(saved["clock"])
        engine.set_walls(saved["walls_present"], motions)
        engine.mark_resumed(saved["steps_since_update"])

    def _sums(self) -> dict[str, Any]:
        """Fields of the energy budget and of the wall forces by name."""
        return {name: getattr(self.engine.state.control, name) for name in saved_arrays(sum_arrays(self.engine.plan))}

    def _wall_dynamics(self) -> dict[str, Any]:
        """Fields of the force-controlled walls by name; empty without such walls."""
        state = self.engine.state
        names = saved_arrays(wall_dynamics_arrays(state.plan)) if state.wall_dynamics is not None else ()
        return {name: getattr(state.wall_dynamics, name) for name in names}

    def _load_wall_dynamics(self, saved: SavedState) -> None:
        """Restore the force-controlled walls. Raises GranflowError if their motions differ from those of the scene."""
        controlled_motions = [controlled.key for controlled in self.engine.plan.controlled_motions]
        if saved["controlled_motions"] != controlled_motions:
            before, now = (", ".join(each) or "none" for each in (saved["controlled_motions"], controlled_motions))
            raise GranflowError(
                f"The force-controlled wall motions are {before} in the checkpoint and {now} in the scene. A resumed "
                "run can change the parameters of such a motion but not add or remove one; use stages for that."
            )
        self._load_sums(self._wall_dynamics(), {name: saved[name] for name in saved if name != "controlled_motions"})

    @staticmethod
    def _load_sums(fields: Mapping[str, Any], saved: Mapping[str, np.ndarray]) -> None:
        """Write saved arrays to whole fields. Raises GranflowError if an array is missing or unknown."""
        for name, values in _named(saved, fields).items():
            fields[name].from_numpy(values)

    def _neighbor_lists(self) -> dict[str, np.ndarray]:
        """Length of each neighbor list (n,), number of its wall entries (n,), and the entries of all lists in order."""
        state = self.engine.state
        lists = state.built(_list_table).take(slice(0, state.count))
        length = lists["end"] - lists["begin"]
        entries = state.built(_entry_table).take(consecutive(lists["begin"], length))
        return {"list_length": length, "list_walls": lists["middle"] - lists["begin"], **entries}

    def _load_neighbor_lists(self, saved: dict[str, np.ndarray]) -> None:
        """Write the lists one after the other into the segment of their chunk; increase the capacity if necessary."""
        state = self.engine.state
        _named(saved, ["list_length", "list_walls", *state.built(_entry_table).fields])
        length = saved["list_length"].astype(np.int64)
        chunk = np.arange(state.count) // state.plan.chunk_size
        per_chunk = np.bincount(chunk, weights=length, minlength=1).astype(np.int64)
        if per_chunk.max() > state.capacities.list_entries_per_chunk:
            self.engine.stepper.grow_neighbor_lists(int(per_chunk.max()))
        before_chunk = np.cumsum(per_chunk) - per_chunk
        begin = chunk * state.capacities.list_entries_per_chunk + np.cumsum(length) - length - before_chunk[chunk]
        lists = {"begin": begin, "middle": begin + saved["list_walls"], "end": begin + length}
        state.built(_list_table).put(np.arange(state.count), lists)
        state.built(_entry_table).put(consecutive(begin, length), saved)


def _list_table(state: State) -> FieldTable:
    """Table of the ranges of the neighbor lists: begin, end of the walls, end."""
    neighbors = state.neighbors
    return FieldTable({"begin": neighbors.list_begin, "middle": neighbors.list_walls_end, "end": neighbors.list_end})


def _entry_table(state: State) -> FieldTable:
    """Table of the list entries: partner, state and history."""
    neighbors = state.neighbors
    return FieldTable({"partner": neighbors.partner, "in_contact": neighbors.in_contact, **neighbors.history})


def _named(saved: Mapping[str, np.ndarray], names: Sequence[str] | Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The arrays with these names. Raises GranflowError if an array is missing or unknown."""
    if set(saved) != set(names):
        present, needed = (", ".join(sorted(each)) or "none" for each in (saved, names))
        raise GranflowError(
            f"The checkpoint holds the arrays {present}, but this scene needs {needed}. Friction, rolling friction, "
            "the energy budget and wall forces cannot be switched on or off in a resumed run."
        )
    return dict(saved)
