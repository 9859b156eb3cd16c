"""Saves and restores the device state that determines how a run continues, bit for bit.

The state holds the particles in their present order with velocities half a step behind, the neighbor lists with the
order of their entries (it is the order of the sums), the contact histories and the totals of the energy budget.
Saving rebuilds and evaluates nothing, so that a checkpoint does not influence the run. Capacities are not saved: a
neighbor list that is longer than the first estimate increases the capacity.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import taichi as ti
from taichi.lang.util import to_numpy_type

from granflow.engine.engine import Engine
from granflow.engine.wall_dynamics import load_wall_dynamics_state, wall_dynamics_state
from granflow.errors import GranflowError
from granflow.geometry.motion import Motion

SavedState = dict[str, Any]
"""Numbers, texts and numpy arrays in nested dictionaries."""

PARTICLE_FIELDS = (
    *(
        "id",
        "material",
        "fixed",
        "radius",
        "mass",
        "position",
        "velocity",
        "velocity_synchronized",
        "angular_velocity",
        "force",
        "torque",
    ),
    "position_at_rebuild",
)
"""Particle fields that a checkpoint contains, as far as the scene has them."""
COUNTS = ("inserted_count", "deleted_count", "deleted_mass", "inserted_energy", "removed_energy")
ACCOUNTING = (*COUNTS, "removed_kinetic_energy", "energy_put_in", "outlets")
"""Attributes of Accounting that a checkpoint contains."""
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


class EngineCheckpoint:
    """Saves the state of one engine and restores it into a new engine. Compiles its kernels at first use."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self._build_tables()

    def _build_tables(self) -> None:
        """Build the field tables; repeated after the engine has replaced fields by larger ones."""
        particles, neighbors = self.engine.state.particles, self.engine.state.neighbors
        self._growth_count = self.engine.timing.growth_count
        fields = {name: getattr(particles, name) for name in PARTICLE_FIELDS}
        self._particles = FieldTable({name: field for name, field in fields.items() if field is not None})
        lists = {"begin": neighbors.list_begin, "middle": neighbors.list_walls_end, "end": neighbors.list_end}
        self._lists = FieldTable(lists)
        flags = {"in_contact": neighbors.in_contact} if neighbors.history else {}
        self._entries = FieldTable({"partner": neighbors.partner, **flags, **neighbors.history})

    def state_dict(self) -> SavedState:
        """The state of the engine that determines how it continues, without the data of the scene.

        Nested dictionaries of numbers and numpy arrays; particle arrays (n,) or (n, 3) are in device order.
        """
        if self._growth_count != self.engine.timing.growth_count:
            self._build_tables()
        engine, state, accounting = self.engine, self.engine.state, self.engine.accounting
        by_id = {name: accounting.by_id(name, np.arange(accounting.inserted_count)) for name in ("material", "group")}
        return {
            "clock": state.clock.state_dict(),
            "steps_since_update": engine.steps_since_update,
            "steps_since_rebuild": engine.stepper.steps_since_rebuild,
            "particle_count": state.count,
            "walls_present": [bool(state.walls.present[index]) for index in range(len(engine.plan.walls))],
            "accounting": {name: getattr(accounting, name) for name in ACCOUNTING} | by_id,
            "clocks": {name: getattr(engine.timing, name) for name in CLOCKS},
            "particles": self._particles.take(np.arange(state.count)),
            "neighbors": self._neighbor_lists(),
            "wall_dynamics": {
                "controlled_motions": [controlled.key for controlled in engine.plan.controlled_motions],
                **wall_dynamics_state(state),
            },
            "energy_budget": {name: field.to_numpy() for name, field in self._energy_budget().items()},
        }

    def load_state_dict(self, saved: SavedState, motions: Sequence[Sequence[Motion]]) -> None:
        """Restore the saved state into a new engine.

        saved:    result of `state_dict`
        motions:  motions of each wall
        Raises:   GranflowError if the scene needs other arrays than the saved state has, or has other force-controlled
                  motions
        """
        engine, state, accounting = self.engine, self.engine.state, self.engine.accounting
        state.count = saved["particle_count"]
        self._load_neighbor_lists(_named(saved["neighbors"], ["list_length", "list_walls", *self._entries.fields]))
        self._particles.put(np.arange(state.count), _named(saved["particles"], self._particles.fields))
        energy_budget = self._energy_budget()
        for name, values in _named(saved["energy_budget"], energy_budget).items():
            energy_budget[name].from_numpy(values)
        self._load_wall_dynamics(saved["wall_dynamics"])
        for name in ACCOUNTING:
            setattr(accounting, name, saved["accounting"][name])
        for name in ("material", "group"):
            setattr(accounting, name, [saved["accounting"][name]])
        for name in CLOCKS:
            setattr(engine.timing, name, saved["clocks"][name])
        engine.stepper.steps_since_rebuild = saved["steps_since_rebuild"]
        state.clock.load_state_dict(saved["clock"])
        engine.set_walls(saved["walls_present"], motions)
        engine.mark_resumed(saved["steps_since_update"])

    def _energy_budget(self) -> dict[str, Any]:
        """Fields of the energy budget and of the wall forces by name."""
        control = self.engine.state.control
        fields = {"losses": control.losses, "boundary_work": control.boundary_work, "impulses": control.impulses}
        return {name: field for name, field in fields.items() if field is not None}

    def _load_wall_dynamics(self, saved: SavedState) -> None:
        """Restore the force-controlled walls. Raises GranflowError if their motions differ from those of the scene."""
        controlled_motions = [controlled.key for controlled in self.engine.plan.controlled_motions]
        if saved["controlled_motions"] != controlled_motions:
            before, now = (", ".join(each) or "none" for each in (saved["controlled_motions"], controlled_motions))
            raise GranflowError(
                f"The force-controlled wall motions are {before} in the checkpoint and {now} in the scene. A resumed "
                "run can change the parameters of such a motion but not add or remove one; use stages for that."
            )
        load_wall_dynamics_state(
            self.engine.state, {name: values for name, values in saved.items() if name != "controlled_motions"}
        )

    def _neighbor_lists(self) -> dict[str, np.ndarray]:
        """Length of each neighbor list (n,), number of its wall entries (n,), and the entries of all lists in order."""
        lists = self._lists.take(np.arange(self.engine.state.count))
        length = lists["end"] - lists["begin"]
        entries = self._entries.take(_consecutive(lists["begin"], length))
        return {"list_length": length, "list_walls": lists["middle"] - lists["begin"], **entries}

    def _load_neighbor_lists(self, saved: dict[str, np.ndarray]) -> None:
        """Write the lists one after the other into the segment of their chunk; increase the capacity if necessary."""
        state, length = self.engine.state, saved["list_length"].astype(np.int64)
        chunk = np.arange(state.count) // state.plan.chunk_size
        per_chunk = np.bincount(chunk, weights=length, minlength=1).astype(np.int64)
        if per_chunk.max() > state.neighbors.list_capacity_per_chunk:
            self.engine.stepper.grow_neighbor_lists(int(per_chunk.max()))
            self._build_tables()
        before_chunk = np.cumsum(per_chunk) - per_chunk
        begin = chunk * state.neighbors.list_capacity_per_chunk + np.cumsum(length) - length - before_chunk[chunk]
        lists = {"begin": begin, "middle": begin + saved["list_walls"], "end": begin + length}
        self._lists.put(np.arange(state.count), lists)
        self._entries.put(_consecutive(begin, length), saved)


def _consecutive(begin: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Numbers begin, begin + 1, ... of each list, one list after the other.

    begin, length:  (n,)
    Returns:        (sum of the lengths,)
    """
    before = np.cumsum(length) - length
    return np.repeat(begin - before, length) + np.arange(int(length.sum()))


def _named(saved: Mapping[str, np.ndarray], names: Sequence[str] | Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The arrays with these names. Raises GranflowError if an array is missing or unknown."""
    if set(saved) != set(names):
        present, needed = (", ".join(sorted(each)) or "none" for each in (saved, names))
        raise GranflowError(
            f"The checkpoint holds the arrays {present}, but this scene needs {needed}. Friction, rolling friction, "
            "the energy budget and wall forces cannot be switched on or off in a resumed run."
        )
    return dict(saved)


class FieldTable:
    """Fields of the same length: copies selected entries of all fields to the host and back.

    The reals form one table and the integers another, so that each direction takes one kernel per table.
    """

    def __init__(self, fields: Mapping[str, Any]) -> None:
        self.fields = dict(fields)
        reals = {name: field for name, field in fields.items() if field.dtype != ti.i32}
        integers = {name: field for name, field in fields.items() if field.dtype == ti.i32}
        self._halves = [_FieldTableHalf(half) for half in (reals, integers) if half]

    def take(self, entries: np.ndarray) -> dict[str, np.ndarray]:
        """Arrays (k,) or (k, components) by name: the entries with these indices (k,)."""
        found: dict[str, np.ndarray] = {}
        for half in self._halves:
            found |= half.take(np.ascontiguousarray(entries, np.int32))
        return found

    def put(self, entries: np.ndarray, arrays: Mapping[str, np.ndarray]) -> None:
        """Write these arrays, as returned by `take`, to the entries with these indices (k,)."""
        for half in self._halves:
            half.put(np.ascontiguousarray(entries, np.int32), arrays)


class _FieldTableHalf:
    """Fields that share a table: reals in the widest of their types, which represents each exactly, or integers."""

    def __init__(self, fields: dict[str, Any]) -> None:
        self._fields = fields
        self._dtype = np.result_type(*(to_numpy_type(field.dtype) for field in fields.values()))
        widths = [int(getattr(field, "n", 1)) for field in fields.values()]
        self._ends = np.cumsum(widths)
        self._take, self._put = _build_take_and_put(list(fields.values()), widths)

    def take(self, entries: np.ndarray) -> dict[str, np.ndarray]:
        """Arrays (k,) or (k, components) by name, in the types of the fields."""
        table = np.zeros((len(entries), self._ends[-1]), self._dtype)
        if len(entries):
            self._take(entries, table)
        parts = np.split(table, self._ends[:-1], axis=1)
        return {
            name: np.ascontiguousarray(part if hasattr(field, "n") else part[:, 0], to_numpy_type(field.dtype))
            for (name, field), part in zip(self._fields.items(), parts, strict=True)
        }

    def put(self, entries: np.ndarray, arrays: Mapping[str, np.ndarray]) -> None:
        """Write the arrays to the entries (k,) int32."""
        if len(entries):
            columns = [arrays[name].reshape(len(entries), -1) for name in self._fields]
            self._put(entries, np.concatenate(columns, axis=1).astype(self._dtype))


def _build_take_and_put(
    fields: Sequence[Any], widths: Sequence[int]
) -> tuple[Callable[..., None], Callable[..., None]]:
    """Kernels (entries, table): copy field entries to the table (k, columns), and the table to the entries.

    fields:  scalar or vector fields
    widths:  number of columns of each field
    """
    external: Any = ti.types.ndarray()
    vectors, firsts = [hasattr(field, "n") for field in fields], [sum(widths[:f]) for f in range(len(fields))]

    @ti.kernel
    def take(entries: external, table: external):
        for k in range(entries.shape[0]):
            for f in ti.static(range(len(fields))):
                if ti.static(vectors[f]):
                    for axis in ti.static(range(widths[f])):
                        table[k, firsts[f] + axis] = fields[f][entries[k]][axis]
                else:
                    table[k, firsts[f]] = fields[f][entries[k]]

    @ti.kernel
    def put(entries: external, table: external):
        for k in range(entries.shape[0]):
            for f in ti.static(range(len(fields))):
                if ti.static(vectors[f]):
                    for axis in ti.static(range(widths[f])):
                        fields[f][entries[k]][axis] = ti.cast(table[k, firsts[f] + axis], fields[f].dtype)
                else:
                    fields[f][entries[k]] = ti.cast(table[k, firsts[f]], fields[f].dtype)

    return take, put
