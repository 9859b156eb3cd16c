"""What on the device decides how a run goes on, out of it and back in, to the last bit.

Taken are the particles in their present order, with velocities half a step behind, the contact rows as they stand
(the order of partners is the order of sums), what contacts remember, and what the ledger has added up. Nothing is
searched or evaluated for it, so that a checkpoint leaves no trace in the run. Capacities are not kept: a row too long
for the first guess makes room for itself.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import taichi as ti
from taichi.lang.util import to_numpy_type

from granflow.device.drive import keep_drive, put_drive_back
from granflow.device.engine import Engine
from granflow.errors import GranflowError
from granflow.walls.motion import Motion

Kept = dict[str, Any]
"""Numbers, texts and numpy arrays in dictionaries within dictionaries."""

PARTICLE_FIELDS = (
    *("id", "material", "fixed", "radius", "mass", "position", "velocity", "velocity_now", "spin", "force", "torque"),
    "position_at_search",
)
COUNTS = ("inserted_count", "deleted_count", "deleted_mass", "brought_energy", "removed_energy")
BOOKS = (*COUNTS, "removed_kinetic_energy", "energy_put_in", "outlets")
CLOCKS = ("search", "advance", "sampled_forces", "sampled_motion", "search_count", "step_count", "particle_steps")


class EngineKeeper:
    """Takes one engine's state, and puts it into a new engine; compiles its kernels when they are first needed."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self._build_tables()

    def _build_tables(self) -> None:
        """Tables know the fields, which growing replaces."""
        particles, contacts = self.engine.state.particles, self.engine.state.contacts
        self._growth_count = self.engine.timing.growth_count
        fields = {name: getattr(particles, name) for name in PARTICLE_FIELDS}
        self._particles = Table({name: field for name, field in fields.items() if field is not None})
        rows = {"begin": contacts.row_begin, "middle": contacts.row_middle, "end": contacts.row_end}
        self._rows = Table(rows)
        remembered = {"touching": contacts.touching} if contacts.history else {}
        self._slots = Table({"partner": contacts.partner, **remembered, **contacts.history})

    def keep(self) -> Kept:
        """Everything of the engine that decides how it goes on; what the scene says is not in it."""
        if self._growth_count != self.engine.timing.growth_count:
            self._build_tables()
        engine, state, books = self.engine, self.engine.state, self.engine.books
        by_id = {name: books.by_id(name, np.arange(books.inserted_count)) for name in ("material", "group")}
        return {
            "clock": state.clock.keep(),
            "steps_since_look": engine.steps_since_look,
            "steps_since_search": engine.stepper.steps_since_search,
            "particle_count": state.count,
            "walls_present": [bool(state.walls.present[index]) for index in range(len(engine.plan.walls))],
            "books": {name: getattr(books, name) for name in BOOKS} | by_id,
            "clocks": {name: getattr(engine.timing, name) for name in CLOCKS},
            "particles": self._particles.take(np.arange(state.count)),
            "contacts": self._take_contacts(),
            "drive": {"drives": [drive.key for drive in engine.plan.drives], **keep_drive(state)},
            "ledger": {name: field.to_numpy() for name, field in self._ledger().items()},
        }

    def put_back(self, kept: Kept, motions: Sequence[Sequence[Motion]]) -> None:
        """Bring a new engine to where the kept one stood, given the motions of its walls.

        Raises GranflowError where it needs other arrays.
        """
        engine, state, books = self.engine, self.engine.state, self.engine.books
        state.count = kept["particle_count"]
        self._put_contacts(_named(kept["contacts"], ["row_length", "row_walls", *self._slots.fields]))
        self._particles.put(np.arange(state.count), _named(kept["particles"], self._particles.fields))
        ledger = self._ledger()
        for name, values in _named(kept["ledger"], ledger).items():
            ledger[name].from_numpy(values)
        self._put_drive_back(kept["drive"])
        for name in BOOKS:
            setattr(books, name, kept["books"][name])
        for name in ("material", "group"):
            setattr(books, name, [kept["books"][name]])
        for name in CLOCKS:
            setattr(engine.timing, name, kept["clocks"][name])
        engine.stepper.steps_since_search = kept["steps_since_search"]
        state.clock.put_back(kept["clock"])
        engine.set_walls(kept["walls_present"], motions)
        engine.go_on(kept["steps_since_look"])

    def _ledger(self) -> dict[str, Any]:
        """Fields of the energy ledger and of the loads on walls by name."""
        control = self.engine.state.control
        fields = {"losses": control.losses, "border_work": control.border_work, "impulses": control.impulses}
        return {name: field for name, field in fields.items() if field is not None}

    def _put_drive_back(self, kept: Kept) -> None:
        drives = [drive.key for drive in self.engine.plan.drives]
        if kept["drives"] != drives:
            before, now = (", ".join(each) or "none" for each in (kept["drives"], drives))
            raise GranflowError(
                f"The walls that grains move were {before} and would be {now}. In a run that goes on "
                "such a motion can get other numbers, but neither come nor go; let it start and end by stages."
            )
        put_drive_back(self.engine.state, {name: values for name, values in kept.items() if name != "drives"})

    def _take_contacts(self) -> dict[str, np.ndarray]:
        """Length of every row (n,), how many of it are walls (n,), and all slots row after row."""
        rows = self._rows.take(np.arange(self.engine.state.count))
        length = rows["end"] - rows["begin"]
        slots = self._slots.take(_consecutive(rows["begin"], length))
        return {"row_length": length, "row_walls": rows["middle"] - rows["begin"], **slots}

    def _put_contacts(self, kept: dict[str, np.ndarray]) -> None:
        """Rows one after the other in the segment of their chunk, which grows if it must."""
        state, length = self.engine.state, kept["row_length"].astype(np.int64)
        chunk = np.arange(state.count) // state.plan.chunk_size
        per_chunk = np.bincount(chunk, weights=length, minlength=1).astype(np.int64)
        if per_chunk.max() > state.contacts.slots_per_chunk:
            self.engine.stepper.grow(int(per_chunk.max()))
            self._build_tables()
        before_chunk = np.cumsum(per_chunk) - per_chunk
        begin = chunk * state.contacts.slots_per_chunk + np.cumsum(length) - length - before_chunk[chunk]
        rows = {"begin": begin, "middle": begin + kept["row_walls"], "end": begin + length}
        self._rows.put(np.arange(state.count), rows)
        self._slots.put(_consecutive(begin, length), kept)


def _consecutive(begin: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Numbers begin, begin + 1, ... of every row, one row after the other."""
    before = np.cumsum(length) - length
    return np.repeat(begin - before, length) + np.arange(int(length.sum()))


def _named(kept: Mapping[str, np.ndarray], names: Sequence[str] | Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The arrays of these names. Raises GranflowError if there are others, or not all."""
    if set(kept) != set(names):
        there, asked = (", ".join(sorted(each)) or "none" for each in (kept, names))
        raise GranflowError(
            f"The checkpoint holds the arrays {there}, but this scene needs {asked}. Friction, rolling friction, "
            "the energy ledger and wall loads cannot be switched on or off in a run that goes on."
        )
    return dict(kept)


class Table:
    """Fields of one length: some entries of all of them to the host and back, side by side, whole numbers apart."""

    def __init__(self, fields: Mapping[str, Any]) -> None:
        self.fields = dict(fields)
        reals = {name: field for name, field in fields.items() if field.dtype != ti.i32}
        wholes = {name: field for name, field in fields.items() if field.dtype == ti.i32}
        self._halves = [_Half(half) for half in (reals, wholes) if half]

    def take(self, entries: np.ndarray) -> dict[str, np.ndarray]:
        """Arrays (k,) or (k, numbers) by name: the entries of those indices (k,)."""
        found: dict[str, np.ndarray] = {}
        for half in self._halves:
            found |= half.take(np.ascontiguousarray(entries, np.int32))
        return found

    def put(self, entries: np.ndarray, arrays: Mapping[str, np.ndarray]) -> None:
        """Write those arrays to the entries of those indices (k,)."""
        for half in self._halves:
            half.put(np.ascontiguousarray(entries, np.int32), arrays)


class _Half:
    """Fields that share a table: reals in the widest of their types, which holds each exactly, or whole numbers."""

    def __init__(self, fields: dict[str, Any]) -> None:
        self._fields = fields
        self._dtype = np.result_type(*(to_numpy_type(field.dtype) for field in fields.values()))
        widths = [int(getattr(field, "n", 1)) for field in fields.values()]
        self._ends = np.cumsum(widths)
        self._take, self._put = _build_take_and_put(list(fields.values()), widths)

    def take(self, entries: np.ndarray) -> dict[str, np.ndarray]:
        table = np.zeros((len(entries), self._ends[-1]), self._dtype)
        if len(entries):
            self._take(entries, table)
        parts = np.split(table, self._ends[:-1], axis=1)
        return {
            name: np.ascontiguousarray(part if hasattr(field, "n") else part[:, 0], to_numpy_type(field.dtype))
            for (name, field), part in zip(self._fields.items(), parts, strict=True)
        }

    def put(self, entries: np.ndarray, arrays: Mapping[str, np.ndarray]) -> None:
        if len(entries):
            columns = [arrays[name].reshape(len(entries), -1) for name in self._fields]
            self._put(entries, np.concatenate(columns, axis=1).astype(self._dtype))


def _build_take_and_put(
    fields: Sequence[Any], widths: Sequence[int]
) -> tuple[Callable[..., None], Callable[..., None]]:
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
