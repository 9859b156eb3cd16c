"""Particles and their contact histories on the host: numpy arrays that are copied from the device and back.

`FieldTable` copies selected entries of several fields at once; all other parts use it. `copy_to_host` and
`append_particles` serve snapshots and insertion, `HistoryTable` and `HostParticles` checkpoints and the
migration between MPI ranks. Changes from Python and the arrays of inserted particles follow at the end.

On a GPU, the `to_numpy` of Taichi compiles a kernel for each field and copies the whole capacity; it serves
small arrays only.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from granflow.engine.clumps import angular_momentum, arms
from granflow.engine.codes import REMOVED_BELOW
from granflow.engine.fields import components, memory_of
from granflow.engine.history import IN_CONTACT, vector_components
from granflow.engine.state import Arrays, State
from granflow.fields import PARTICLE_QUANTITIES
from granflow.geometry.clump import product
from granflow.geometry.periodic_box import PeriodicBox
from granflow.geometry.sphere import sphere_mass, sphere_volume
from granflow.kernel_language import ti
from granflow.particles.group import ParticleData
from granflow.plan.arrays import particle_arrays, saved_arrays
from granflow.plan.plan import Plan


class FieldTable:
    """Fields of the same length: copies selected entries of all fields to the host and back.

    fields:  scalar and vector fields by name; None is ignored

    On a CPU from and to their memory; on a GPU with one kernel: the reals form one table, in the widest of
    their types, which represents each exactly, and the integers another.
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
        """Arrays (k,) or (k, components) by name in the types of the fields: entries (k,) of them."""
        if self._in_memory:
            return {name: _copied_entries(memory, entries) for name, memory in self._memory.items()}
        entries = _indices(entries)
        tables = self._tables(len(entries))
        if len(entries):
            self._take(np.ascontiguousarray(entries, np.int32), tables[False], tables[True])
        found = {}
        for name, (is_integer, columns) in self._columns.items():
            part = tables[is_integer][:, columns]
            field = self.fields[name]
            shaped = part if hasattr(field, "n") else part[:, 0]
            found[name] = np.ascontiguousarray(shaped, ti.lang.util.to_numpy_type(field.dtype))
        return found

    def put(self, entries: np.ndarray | slice, arrays: Mapping[str, Any]) -> None:
        """Write arrays, as returned by `take`, or one number for all, to the entries (k,)."""
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
    """Write numbers (k,), vectors (k, components) or one number to entries of a field.

    Numbers fill all components of vectors.
    """
    memory[entries] = values[:, None] if values.ndim == 1 and memory.ndim == 2 else values


def _build_take_and_put(
    real_fields: Sequence[Any], integer_fields: Sequence[Any]
) -> tuple[Callable[..., None], Callable[..., None]]:
    """Kernels (entries, reals, integers): copy entries to the tables (k, columns), and tables to entries.

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
    """Append n particles behind the present ones, with empty neighbor lists.

    A deleted particle may have had their entry.

    arrays:  arrays (n,) or (n, 3) by field, `id` included; fields without an array have their default, fields
             that the scene does not have are ignored. Velocities are half a step back.
    """
    table = saved_particle_table(state)
    count = len(arrays["id"])
    values = {name: arrays.get(name, PARTICLE_QUANTITIES[name].default) for name in table.fields}
    table.put(np.arange(state.count, state.count + count), values)
    if state.neighbors.history:
        state.built(list_table).put(np.arange(state.count, state.count + count), {"begin": 0, "end": 0})
    state.count += count


# Contact histories by particle id: in checkpoints, and for particles that migrate between MPI ranks.

WITHOUT_HISTORY = -1
"""Row of a particle without contact history, see `HistoryTable.write`."""
NOT_TAKEN = -1
"""Place of a particle that is not selected."""


@dataclass(frozen=True)
class Histories:
    """Contact histories of n particles with m contacts, particle by particle, as each sees them.

    count:    (n,) number of contacts of each particle
    partner:  (m,) int32, id of the other particle, or a negative number of a wall or triangle
    values:   by slot of the contact models (m, components)
    """

    count: np.ndarray
    partner: np.ndarray
    values: dict[str, np.ndarray]

    def of(self, rows: np.ndarray) -> "Histories":
        """The histories of the particles with these indices (k,), in this order."""
        entries = self._contacts_of(rows)
        values = self.values
        return Histories(
            self.count[rows], self.partner[entries], {slot: values[slot][entries] for slot in values}
        )

    def _contacts_of(self, rows: np.ndarray) -> np.ndarray:
        """Index of each contact of particles (k,), one particle after the other."""
        return consecutive((np.cumsum(self.count) - self.count)[rows], self.count[rows])

    @property
    def owner(self) -> np.ndarray:
        """Index (m,) of the particle of each contact."""
        return np.repeat(np.arange(len(self.count)), self.count)

    def by_partner(self) -> "Histories":
        """The histories with the contacts of each particle in the order of the partners."""
        entries = np.lexsort((self.partner, self.owner))
        values = {slot: each[entries] for slot, each in self.values.items()}
        return Histories(self.count, self.partner[entries], values)


@dataclass(frozen=True)
class ListedHistories(Histories):
    """Histories as the neighbor lists contain them.

    A pair within a chunk is in the list of one of both particles only.

    ids:      (n,) int32, of the particles
    once:     (k,) contacts that are in the list of one of both particles only
    other:    (k,) index of the partner of each of these
    vectors:  by slot (components,), whether a component is that of a vector, which has the other sign for the
              partner
    """

    ids: np.ndarray
    once: np.ndarray
    other: np.ndarray
    vectors: dict[str, list[bool]]

    def of(self, rows: np.ndarray) -> Histories:
        """The histories of the particles with these indices (k,), in this order.

        They have both sides of each pair.
        """
        place = np.full(len(self.count), NOT_TAKEN)
        place[rows] = np.arange(len(rows))
        direct = self._contacts_of(rows)
        mirrored = np.flatnonzero(place[self.other] != NOT_TAKEN)
        once = self.once[mirrored]
        owner = self.owner
        row = np.concatenate([place[owner[direct]], place[self.other[mirrored]]])
        by_row = np.argsort(row, kind="stable")
        partner = np.concatenate([self.partner[direct], self.ids[owner[once]]])[by_row]
        values = {}
        for slot, each in self.values.items():
            opposite = np.where(self.vectors[slot], -1.0, 1.0).astype(each.dtype) * each[once]
            values[slot] = np.concatenate([each[direct], opposite])[by_row]
        return Histories(np.bincount(row, minlength=len(rows)), partner, values)


def joined_histories(parts: list[Histories]) -> Histories:
    """The histories of several parts, one part after the other; those of one part are not copied."""
    filled = [part for part in parts if len(part.count)] or parts[:1]
    if len(filled) == 1:
        return filled[0]
    return Histories(
        np.concatenate([part.count for part in filled]),
        np.concatenate([part.partner for part in filled]),
        {slot: np.concatenate([part.values[slot] for part in filled]) for slot in filled[0].values},
    )


class HistoryTable:
    """Reads the histories of the owned particles from the neighbor lists, and writes them for the next lists.

    Without ranks all particles are owned.
    """

    def __init__(self, state: State) -> None:
        self._state = state

    def read(self, ids: np.ndarray, count: int) -> Histories:
        """Histories of all contacts of the owned particles; arguments as for `listed`."""
        return self.listed(ids, count).of(np.arange(count))

    def listed(self, ids: np.ndarray, count: int) -> ListedHistories:
        """Histories of all contacts in the neighbor lists of the owned particles.

        ids:    (k,) of the owned particles and the ghosts by index, at the time of the lists
        count:  number of particles, of which those behind the owned ones have no contacts yet
        """
        state = self._state
        none = np.zeros(0, np.int64)
        if not state.neighbors.history:
            return ListedHistories(np.zeros(count, np.int64), np.zeros(0, np.int32), {}, ids, none, none, {})
        owner, index, values = self._touching()
        size = state.plan.chunk_size
        once = np.flatnonzero((index >= 0) & (owner // size == index // size))
        partner = np.where(index < 0, index, ids[np.maximum(index, 0)]).astype(np.int32)
        vectors = {slot: vector_components(state, slot) for slot in values}
        return ListedHistories(
            np.bincount(owner, minlength=count), partner, values, ids, once, index[once], vectors
        )

    def _touching(self) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Index of the owner and the partner (m,) of each list entry in contact, and the histories."""
        state = self._state
        ranges = state.built(list_table).take(slice(0, state.count))
        begin = ranges["begin"].astype(np.int64)
        length = ranges["end"] - ranges["begin"]
        list_index = consecutive(begin, length)
        touches = np.flatnonzero(state.built(_state_table).take(list_index)["in_contact"] == IN_CONTACT)
        owner = np.repeat(np.arange(len(begin)), length)[touches]
        entries = state.built(_contact_table).take(list_index[touches])
        return owner, entries.pop("partner").astype(np.int64), entries

    def write_lists(self, histories: Histories, ids: np.ndarray) -> None:
        """Write neighbor lists that contain the contacts only, from which a rebuild takes the histories.

        ids:  (n,) of all particles by index, in ascending order

        The capacity must suffice, see `longest_segment`.
        """
        state = self._state
        owner = histories.owner
        segment = self._segments(len(ids))
        before = np.cumsum(histories.count) - histories.count
        in_segment = before - before[segment * state.plan.chunk_size]
        begin = segment * state.capacities.list_entries_per_segment + in_segment
        ranges = {"begin": begin, "end": begin + histories.count}
        state.built(list_table).put(np.arange(len(ids)), ranges)
        if not state.neighbors.history:
            return
        entry = begin[owner] + np.arange(len(owner)) - before[owner]
        partner = np.where(histories.partner < 0, histories.partner, np.searchsorted(ids, histories.partner))
        in_contact = np.full(len(entry), IN_CONTACT, np.int32)
        entries = {"partner": partner.astype(np.int32), "in_contact": in_contact} | histories.values
        state.built(_entry_table).put(entry, entries)

    def longest_segment(self, histories: Histories) -> int:
        """Largest number of contacts of the particles of a segment of the neighbor lists."""
        segments = self._segments(len(histories.count))
        return int(np.bincount(segments, weights=histories.count, minlength=1).max())

    def _segments(self, count: int) -> np.ndarray:
        """Segment (count,) of each particle; see `NeighborList`."""
        size = self._state.plan.chunk_size
        return np.arange(count) // size if size > 1 else np.zeros(count, np.int64)

    def write(self, parts: Sequence[Histories], rows: np.ndarray) -> None:
        """Write histories where a rank looks for them when it fills neighbor lists.

        parts:  histories, counted one part after the other
        rows:   (k,) for each particle by index, which of the histories it has; WITHOUT_HISTORY if none
        """
        state = self._state
        first = 0
        if not state.neighbors.history:
            return
        count = np.concatenate(
            [*(part.count for part in parts), [0]]
        )  # the last one is that of WITHOUT_HISTORY
        end = np.cumsum(count)
        state.built(_range_table).put(slice(0, len(rows)), {"begin": (end - count)[rows], "end": end[rows]})
        for part in parts:
            last = first + len(part.partner)
            state.built(_saved_table).put(slice(first, last), {"partner": part.partner} | part.values)
            first = last

    def clear(self, rows: slice) -> None:
        """Let particles have no histories where a rank looks for them."""
        if self._state.neighbors.history:
            self._state.built(_range_table).put(rows, {"begin": 0, "end": 0})


def _state_table(state: State) -> FieldTable:
    """Table of the contact state of all list entries."""
    return FieldTable({"in_contact": state.neighbors.in_contact})


def _contact_table(state: State) -> FieldTable:
    """Table of the partners and histories of all list entries."""
    return FieldTable({"partner": state.neighbors.partner, **state.neighbors.history})


def _entry_table(state: State) -> FieldTable:
    """Table of all list entries."""
    neighbors = state.neighbors
    return FieldTable({"partner": neighbors.partner, "in_contact": neighbors.in_contact, **neighbors.history})


def _range_table(state: State) -> FieldTable:
    """Table of the ranges of the saved histories of each particle."""
    return FieldTable({"begin": state.neighbors.list_begin_before, "end": state.neighbors.list_end_before})


def _saved_table(state: State) -> FieldTable:
    """Table of the saved histories and their partners."""
    return FieldTable({"partner": state.neighbors.partner_saved} | state.neighbors.saved)


# Particles on the host, with their contact histories: for checkpoints, and for migration between MPI ranks.

PRESENT = {"position": "present_position", "clump_position": "present_clump_position"}
"""Names of the present positions while the fields contain earlier ones."""


@dataclass(frozen=True)
class HostParticles:
    """n particles.

    arrays:     saved fields (n, ...) by name
    histories:  of these particles
    """

    arrays: Arrays
    histories: Histories

    @property
    def count(self) -> int:
        """Number n of particles."""
        return len(self.arrays["id"])

    def of(self, rows: np.ndarray) -> "HostParticles":
        """The particles with these indices (k,), in this order."""
        return HostParticles(
            {name: values[rows] for name, values in self.arrays.items()}, self.histories.of(rows)
        )

    def by_id(self) -> "HostParticles":
        """The particles in the order of their ids, the contacts of each in the order of the partners."""
        ordered = self.of(np.argsort(self.arrays["id"]))
        return replace(ordered, histories=ordered.histories.by_partner())

    def at_rebuild(self, periodic_box: PeriodicBox) -> "HostParticles":
        """The particles at their positions at the last rebuild, in the box; `at_present` is the inverse."""
        arrays = self.arrays
        earlier = {"position": periodic_box.wrap(arrays["position_at_rebuild"])}
        if "clump_position" in arrays:
            earlier["clump_position"] = arrays["clump_position_at_rebuild"]
        present = {PRESENT[name]: arrays[name] for name in earlier}
        return replace(self, arrays=arrays | earlier | present)


def at_present(arrays: Arrays) -> Arrays:
    """Arrays of particles of `HostParticles.at_rebuild`, at their present positions."""
    return arrays | {name: arrays[saved] for name, saved in PRESENT.items() if saved in arrays}


def joined_arrays(parts: list[Arrays]) -> Arrays:
    """Arrays (n, ...) of several parts, one part after the other; all parts have the same names.

    If one part only has rows, its arrays are not copied.
    """
    filled = [part for part in parts if any(map(len, part.values()))] or parts[:1]
    if len(filled) == 1:
        return filled[0]
    return {name: np.concatenate([part[name] for part in filled]) for name in parts[0]}


def joined_particles(parts: list[HostParticles]) -> HostParticles:
    """The particles of several parts, one part after the other."""
    histories = joined_histories([part.histories for part in parts])
    return HostParticles(joined_arrays([part.arrays for part in parts]), histories)


# Particles that change during a run from Python: read in the order of ids, written and removed.
#
# `Engine.begin_change` precedes each change, `Engine.refresh` follows the last one.


def present_indices(state: State) -> np.ndarray:
    """Device indices (n,) of the particles in the order of their ids, without those that are removed."""
    arrays = copy_to_host(state, ("id", "radius"))
    order = np.argsort(arrays["id"], kind="stable")
    return order[arrays["radius"][order] > REMOVED_BELOW]


def write_particles(state: State, indices: np.ndarray, arrays: Mapping[str, np.ndarray]) -> None:
    """Write particle fields.

    indices:  device indices (k,)
    arrays:   arrays (k,) or (k, 3) by field; velocities are at the time of the positions
    """
    values = dict(arrays)
    for name in ("velocity", "angular_velocity"):
        if name in arrays and getattr(state.particles, f"{name}_synchronized") is not None:
            values[f"{name}_synchronized"] = arrays[name]
    state.built(particle_table, tuple(values)).put(indices, values)


def remove_particles(state: State, indices: np.ndarray) -> None:
    """Mark particles with these device indices (k,) for deletion at the next neighbor-list rebuild."""
    radius = copy_to_host(state, ("radius",))["radius"][indices]
    write_particles(state, indices, {"radius": -radius})


# Arrays of inserted particles.


def new_particle_arrays(plan: Plan, new: ParticleData, first_id: int) -> Arrays:
    """Arrays (k,) or (k, 3) by particle field for new particles, with ids from `first_id`.

    Velocities are at the time of the positions; materials are numbers of the plan. Each clump is one particle
    of `new` and several rows of the arrays, see `sphere_rows`.
    """
    density = _densities(plan)
    count = len(new)
    numbers = {name: number for number, name in enumerate(plan.materials)}
    material = np.array([numbers.get(name, 0) for name in plan.scene.materials])
    fixed = np.array([group.spec.fixed for group in plan.groups])
    arrays = {
        "id": first_id + np.arange(count),
        "material": material[new.material],
        "fixed": fixed[new.group].astype(np.int32),
        "attached_to": np.array(plan.attached_walls, np.int32)[new.group],
        "radius": new.radius,
        "mass": sphere_mass(new.radius, density[new.material]),
        "position": new.position,
        "position_at_rebuild": new.position,
        "velocity": new.velocity,
        "angular_velocity": new.angular_velocity,
        "group": new.group,
    }
    for name, values in (plan.initial_values | plan.initial_sources).items():
        of_group = np.array(values)[new.group]
        given = new.initial_values.get(name, np.full(count, np.nan))
        arrays[name] = np.where(np.isnan(given), of_group, given)
    for name, held in plan.held_values.items():
        of_wall = np.array([np.nan if each is None else each for each in held])[new.group]
        arrays[name] = np.where(np.isnan(of_wall), arrays[name], of_wall)
    if plan.features.liquid_transfer:
        arrays["liquid_film"] = _films(plan, new.group, sphere_volume(new.radius))
    return _sphere_arrays(plan, new, arrays, first_id) if plan.features.clumps else arrays


def _films(plan: Plan, group: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """Volumes (k,) [m3] of the films of new particles, whole units.

    group, volume:  (k,) number of the group, and volume [m3] of each particle or share of a sphere in a clump
    """
    content = np.array([group.spec.liquid_content or 0.0 for group in plan.groups])
    films: np.ndarray = np.rint(content[group] * volume / plan.liquid_unit) * plan.liquid_unit
    return films


def sphere_rows(plan: Plan, new: ParticleData) -> np.ndarray:
    """Row (k,) in `new` of each of the k spheres: that of its clump, or its own."""
    sizes = np.array([group.spec.shape.sphere_count for group in plan.groups])
    return np.repeat(np.arange(len(new)), sizes[new.group])


def _densities(plan: Plan) -> np.ndarray:
    """Densities [kg/m3] of the materials of the scene."""
    return np.array([each.density for each in plan.scene.materials.values()])


def _sphere_arrays(plan: Plan, new: ParticleData, bodies: Arrays, first_id: int) -> Arrays:
    """Arrays (k,) or (k, 3) of the spheres of all clumps, and of single spheres.

    bodies:  arrays (n,) or (n, 3) with a row per clump or single sphere
    """
    row = sphere_rows(plan, new)
    size = np.bincount(row, minlength=len(new))
    first = np.cumsum(size) - size
    member = np.arange(len(row)) - first[row]
    count = len(row)
    arrays = {name: values[row] for name, values in bodies.items()}
    arrays |= {"id": first_id + np.arange(count), "clump": np.full(count, -1), "clump_size": size[row]}
    arrays |= {"clump_mass": arrays["mass"].copy(), "orientation": np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))}
    arrays |= {name: np.zeros((count, 3)) for name in ("clump_inertia", "clump_offset")}
    arrays["exposed_share"] = np.ones(count)
    for number, group in enumerate(plan.groups):
        own = np.flatnonzero(new.group[row] == number)
        body = group.spec.shape.body
        if body is not None and len(own):
            assert new.orientation is not None
            arrays["clump"][own] = first_id + first[row[own]]
            density = _densities(plan)[new.material[row[own]]]
            for name, values in body.sphere_arrays(density, member[own]).items():
                arrays[name][own] = values
            arrays["orientation"][own] = product(new.orientation[row[own]], body.principal_axes)
            for name in plan.initial_sources:
                arrays[name][own] *= body.volume_share[member[own]]
            if "liquid_film" in arrays:
                volumes = body.sphere_volumes[member[own]]
                arrays["liquid_film"][own] = _films(plan, new.group[row[own]], volumes)
    return arrays | _motion_of_spheres(arrays)


def _motion_of_spheres(arrays: Arrays) -> Arrays:
    """Positions and velocities of spheres, from those of the clumps in the same arrays."""
    arm = arms(arrays)
    position = arrays["position"] + arm
    return {
        "position": position,
        "position_at_rebuild": position,
        "velocity": arrays["velocity"] + np.cross(arrays["angular_velocity"], arm),
        "clump_position": arrays["position"],
        "clump_position_at_rebuild": arrays["position"],
        "clump_velocity": arrays["velocity"],
        "clump_angular_momentum": angular_momentum(arrays),
    }
