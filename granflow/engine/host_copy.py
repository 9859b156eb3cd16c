"""Copies between device fields and the host: insertion, snapshots, checkpoints.

On a GPU, the `to_numpy` of Taichi compiles a kernel for each field and copies the whole capacity; it serves small
arrays only.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from granflow.engine.host_fields import components, memory_of
from granflow.engine.state import State
from granflow.fields import PARTICLE_QUANTITIES
from granflow.kernel_language import ti
from granflow.plan.device_arrays import particle_arrays, saved_arrays


class FieldTable:
    """Fields of the same length: copies selected entries of all fields to the host and back.

    fields:  scalar and vector fields by name; None is ignored

    On a CPU from and to their memory; on a GPU with one kernel: the reals form one table, in the widest of their types,
    which represents each exactly, and the integers another.
    """

    def __init__(self, fields: Mapping[str, Any]) -> None:
        self.fields = {name: field for name, field in fields.items() if field is not None}
        self._memory: dict[str, Any] = {name: memory_of(field) for name, field in self.fields.items()}
        self._in_memory = all(memory is not None for memory in self._memory.values())
        if not self._in_memory:
            self._build_tables()

    def _build_tables(self) -> None:
        """Assign columns of the two tables to the fields, and build the kernels."""
        by_type: dict[bool, list[Any]] = {False: [], True: []}
        self._columns: dict[str, tuple[bool, slice]] = {}
        for name, field in self.fields.items():
            is_integer = field.dtype == ti.i32
            first = len(by_type[is_integer])
            by_type[is_integer] += components(field)
            self._columns[name] = is_integer, slice(first, len(by_type[is_integer]))
        real = np.result_type(
            np.float32, *(ti.lang.util.to_numpy_type(component.dtype) for component in by_type[False])
        )
        self._types = {False: (len(by_type[False]), real), True: (len(by_type[True]), np.int32)}
        self._take, self._put = _build_take_and_put(by_type[False], by_type[True])

    def take(self, entries: np.ndarray | slice) -> dict[str, np.ndarray]:
        """Arrays (k,) or (k, components) by name in the types of the fields: the entries with these indices (k,)."""
        if self._in_memory:
            return {name: _copied_entries(memory, entries) for name, memory in self._memory.items()}
        entries = _indices(entries)
        tables = self._tables(len(entries))
        if len(entries):
            self._take(np.ascontiguousarray(entries, np.int32), tables[False], tables[True])
        found = {}
        for name, (is_integer, columns) in self._columns.items():
            part, field = tables[is_integer][:, columns], self.fields[name]
            shaped = part if hasattr(field, "n") else part[:, 0]
            found[name] = np.ascontiguousarray(shaped, ti.lang.util.to_numpy_type(field.dtype))
        return found

    def put(self, entries: np.ndarray | slice, arrays: Mapping[str, Any]) -> None:
        """Write arrays, as returned by `take`, or one number for all, to the entries with these indices (k,)."""
        if self._in_memory:
            for name, memory in self._memory.items():
                _put_entries(memory, entries, np.asarray(arrays[name]))
            return
        entries = _indices(entries)
        tables = self._tables(len(entries))
        for name, (is_integer, columns) in self._columns.items():
            values = np.asarray(arrays[name])
            tables[is_integer][:, columns] = values[:, None] if values.ndim == 1 else values
        if len(entries):
            self._put(np.ascontiguousarray(entries, np.int32), tables[False], tables[True])

    def _tables(self, count: int) -> dict[bool, np.ndarray]:
        """Tables of reals (False) and integers (True); at least one column, because Taichi refuses none."""
        return {key: np.zeros((count, max(width, 1)), dtype) for key, (width, dtype) in self._types.items()}


def _indices(entries: np.ndarray | slice) -> np.ndarray:
    """The indices (k,) of entries."""
    return np.arange(entries.start, entries.stop) if isinstance(entries, slice) else entries


def _copied_entries(memory: Any, entries: np.ndarray | slice) -> np.ndarray:
    """Contiguous copy of entries of a field; indices copy them anyway."""
    found = memory[entries]
    return np.array(found, order="C") if isinstance(entries, slice) else np.ascontiguousarray(found)


def _put_entries(memory: Any, entries: np.ndarray | slice, values: np.ndarray) -> None:
    """Write numbers (k,), vectors (k, components) or one number to entries of a field; numbers fill vectors."""
    memory[entries] = values[:, None] if values.ndim == 1 and memory.ndim == 2 else values


def _build_take_and_put(
    real_fields: Sequence[Any], integer_fields: Sequence[Any]
) -> tuple[Callable[..., None], Callable[..., None]]:
    """Kernels (entries, reals, integers): copy field entries to the tables (k, columns), and tables to the entries.

    real_fields, integer_fields:  scalar field of each column
    """
    external: Any = ti.types.ndarray()

    @ti.kernel
    def take(entries: external, reals: external, integers: external):
        for k in range(entries.shape[0]):
            i = entries[k]
            for c in ti.static(range(len(real_fields))):
                reals[k, c] = real_fields[c][i]
            for c in ti.static(range(len(integer_fields))):
                integers[k, c] = integer_fields[c][i]

    @ti.kernel
    def put(entries: external, reals: external, integers: external):
        for k in range(entries.shape[0]):
            i = entries[k]
            for c in ti.static(range(len(real_fields))):
                real_fields[c][i] = ti.cast(reals[k, c], real_fields[c].dtype)
            for c in ti.static(range(len(integer_fields))):
                integer_fields[c][i] = integers[k, c]

    return take, put


def consecutive(begin: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Numbers begin, begin + 1, ... of each list, one list after the other.

    begin, length:  (n,)
    Returns:        (sum of the lengths,)
    """
    before = np.cumsum(length) - length
    return np.repeat(begin - before, length) + np.arange(int(length.sum()))


def particle_table(state: State, names: tuple[str, ...]) -> FieldTable:
    """Table of these particle fields; those that the scene does not have are ignored."""
    return FieldTable({name: getattr(state.particles, name) for name in names})


def saved_particle_table(state: State) -> FieldTable:
    """Table of the particle fields that determine how a run continues."""
    return state.built(particle_table, tuple(saved_arrays(particle_arrays(state.plan))))


def list_table(state: State) -> FieldTable:
    """Table of the ranges of all neighbor lists."""
    return FieldTable({"begin": state.neighbors.list_begin, "end": state.neighbors.list_end})


def copy_to_host(
    state: State, names: tuple[str, ...], first: int = 0, last: int | None = None
) -> dict[str, np.ndarray]:
    """Host copies of particle fields.

    names:        fields; those that the scene does not have are absent in the result
    first, last:  index range, `last` exclusive (default: the particle count)
    Returns:      arrays (k,) or (k, 3) in the types of the fields
    """
    table = state.built(particle_table, names)
    return table.take(slice(first, state.count if last is None else last))


def append_particles(state: State, arrays: Mapping[str, np.ndarray]) -> None:
    """Append n particles behind the present ones, with empty neighbor lists: a deleted one may have had their entry.

    arrays:  arrays (n,) or (n, 3) by field, `id` included; fields without an array have their default, fields that the
             scene does not have are ignored. Velocities are half a step back.
    """
    table, count = saved_particle_table(state), len(arrays["id"])
    values = {name: arrays.get(name, PARTICLE_QUANTITIES[name].default) for name in table.fields}
    table.put(np.arange(state.count, state.count + count), values)
    if state.neighbors.history:
        state.built(list_table).put(np.arange(state.count, state.count + count), {"begin": 0, "end": 0})
    state.count += count
