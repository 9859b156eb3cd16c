"""Contact output: one record per contact. Its arrays exist only if the scene requests contacts."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from granflow.engine.field_block import FieldBlock
from granflow.engine.force.pair_force import build_normal_force
from granflow.engine.force.pair_kinematics import build_any_kinematics, build_pair_constants
from granflow.engine.host_copy import FieldTable, consecutive, list_table
from granflow.engine.neighbor.contact_history_entry import build_read_history
from granflow.engine.neighbor.history_transfer import vector_components
from granflow.engine.periodic_box import build_wrap_position
from granflow.engine.state import State
from granflow.engine.walls import WallGeometry, triangles_of, walls_of
from granflow.kernel_language import ti

AT_LIMIT = 1.0 - 1e-6
"""Share of the Coulomb limit above which a contact counts as sliding."""


def candidate_pairs(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All candidate pairs on the host; pairs across two chunks occur twice.

    Returns:  owner (p,), list index (p,) and partner (p,), int64; a negative partner is a wall, see `walls_of`
    """
    rows = state.built(list_table).take(slice(0, state.count))
    begin, end = rows["begin"], rows["end"]
    owner, list_index = np.repeat(np.arange(state.count), end - begin), consecutive(begin, end - begin).astype(np.int64)
    return owner, list_index, state.built(_partner_table).take(list_index)["partner"].astype(np.int64)


def _position_table(state: State) -> FieldTable:
    """Table of the positions of all particles."""
    return FieldTable({"position": state.particles.position})


def _partner_table(state: State) -> FieldTable:
    """Table of the partners of all list entries."""
    return FieldTable({"partner": state.neighbors.partner})


class ContactOutput:
    """Forces and overlaps of all contacts at the present positions; the contact histories do not change."""

    def __init__(self, state: State) -> None:
        self.state, self.block = state, FieldBlock(state.backend)
        self.capacity = state.capacities.list_entries
        real = state.backend.real
        self.numbers = self.block.vector(real, self.capacity, count=len(QUANTITIES))
        self.force = self.block.vector(real, self.capacity)
        self.contact_point = self.block.vector(state.backend.position_real, self.capacity)
        self.block.finish()
        recorded = {"numbers": self.numbers, "force": self.force, "contact_point": self.contact_point}
        self._table = FieldTable(recorded | state.neighbors.history)
        self._evaluate = _build_evaluate(state, self)

    def take(self, ids: np.ndarray, pose: int) -> dict[str, np.ndarray]:
        """All contacts, each once, as in Snapshot.contacts, with n entries or (n, 3) arrays.

        ids:      (particles,) of all particles that lists can contain, in device order
        pose:     index of the wall poses at the present time, see `WallPoses.index_at`
        Returns:  arrays by the names of CONTACT_QUANTITIES and the normal history; the particle with the lower id is
                  the first of a contact, and contacts are in the order of the ids; on MPI ranks, those of all ranks on
                  the root
        """
        found = self.state.ranks.gathered(self._of_this_process(ids, pose))
        order = np.lexsort([found[name] for name in ("triangle", "wall", "id_j", "id_i")])
        return {name: values[order] for name, values in found.items()}

    def _of_this_process(self, ids: np.ndarray, pose: int) -> dict[str, np.ndarray]:
        """As `take`, in any order, without those that another rank takes."""
        state, owner, partner, entries = self.state, *self._pairs(ids, pose)
        found = dict(zip(QUANTITIES, entries["numbers"].T.astype(float), strict=True))
        normal_history = self._history(entries, found["overlap"])
        loading = found["overlap"] >= normal_history["overlap_max"]
        other, with_wall = np.maximum(partner, 0), partner < 0
        wall, triangle = (np.full(len(partner), -1, np.int32) for _ in range(2))
        wall[with_wall] = walls_of(state, partner[with_wall])
        triangle[with_wall] = triangles_of(state, partner[with_wall])
        box = state.plan.periodic_box.at(state.clock.time)
        position = box.wrap(state.built(_position_table).take(slice(0, len(ids)))["position"].astype(float))
        friction_limit, first = found.pop("friction_limit"), position[owner]
        second = box.nearest_images(position[other], first)
        sliding = (friction_limit > 0.0) & (found["tangential_force"] >= AT_LIMIT * friction_limit)
        return (
            found
            | normal_history
            | {
                "id_i": ids[owner].astype(np.int64),
                "id_j": np.where(with_wall, -1, ids[other]).astype(np.int64),
                "wall": wall,
                "triangle": triangle,
                "position_i": first,
                "position_j": np.where(with_wall[:, None], entries["contact_point"], second),
                "force": entries["force"].astype(float),
                "unloading": np.where(loading, 0, 1).astype(np.uint8),
                "sliding": sliding.astype(np.uint8),
            }
        )

    def _pairs(self, ids: np.ndarray, pose: int) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Owner and partner (n,) of all contacts, each pair once, and the arrays of their list entries.

        Of a pair in two lists, that of the particle with the lower id counts. A pair in one list is turned if its owner
        has the higher id: forces and vectors of the history change their sign.
        """
        state = self.state
        if state.count:
            self._evaluate(state.count, pose, state.clock.time_step)
        owner, list_index, partner = candidate_pairs(state)
        entries, size = self._table.take(list_index), state.plan.chunk_size
        id_partner = np.where(partner < 0, np.iinfo(np.int32).max, ids[np.maximum(partner, 0)])
        counts = (ids[owner] < id_partner) | (owner // size == partner // size)
        is_contact = counts & (entries["numbers"][:, OVERLAP] > 0.0)
        owner, partner, turned = (each[is_contact] for each in (owner, partner, ids[owner] > id_partner))
        entries = {name: each[is_contact] for name, each in entries.items()}
        owner, partner = np.where(turned, partner, owner), np.where(turned, owner, partner)
        entries["force"][turned] *= -1.0
        for slot in state.neighbors.history:
            entries[slot][turned] *= np.where(vector_components(state, slot), -1, 1).astype(entries[slot].dtype)
        # -0.0 + 0.0 is 0.0: the sign of a zero depends on the list that contains the pair.
        return owner, partner, {name: each + 0.0 for name, each in entries.items()}

    def _history(self, entries: Mapping[str, np.ndarray], overlap: np.ndarray) -> dict[str, np.ndarray]:
        """Maximum overlap [m] and restitution (n,), without a history the overlap itself and 1, and shown histories.

        Fields of other models than the normal one have the slot as prefix.
        """
        found = {"overlap_max": overlap, "restitution": np.ones(len(overlap))}
        for slot, fields in self.state.plan.laws.history.items():
            begin = 0
            for each in fields:
                if each.in_output:
                    columns = entries[slot][:, begin : begin + each.size]
                    name = each.name if slot == "normal" else f"{slot}_{each.name}"
                    found[name] = (columns if each.size > 1 else columns[:, 0]).astype(float)
                begin += each.size
        return found


QUANTITIES = ("overlap", "normal_force", "tangential_force", "friction_limit")
"""Quantities that `_build_evaluate` records for each list entry, in N except for the overlap in m."""
OVERLAP, NORMAL, TANGENTIAL, LIMIT = range(len(QUANTITIES))


def _build_evaluate(state: State, output: ContactOutput) -> Callable[..., None]:
    """Kernel (count, pose, time_step): evaluate all list entries.

    Reads:   position, velocity, radius, mass, neighbor lists, history, walls
    Writes:  numbers, force, contact_point of `output`
    """
    particles, neighbors, real = state.particles, state.neighbors, state.backend.real
    any_kinematics, read_history = build_any_kinematics(state), build_read_history(state)
    pair_constants = build_pair_constants(state)
    normal_force_of, surface_forces = build_normal_force(state.plan.laws, False), _build_surface_forces(state)
    numbers, contact_point_of = output.numbers, _build_contact_point(state)

    @ti.kernel
    def evaluate(count: ti.i32, pose: ti.i32, dt: real):
        for i in range(count):
            for list_index in range(neighbors.list_begin[i], neighbors.list_end[i]):
                j = neighbors.partner[list_index]
                normal, contact = any_kinematics(i, j, pose, dt)
                numbers[list_index][OVERLAP] = contact.overlap
                if contact.overlap > 0.0:
                    constants = pair_constants(i, j)
                    history = read_history(list_index)
                    normal_force, load, _viscous, _new = normal_force_of(constants, contact, history)
                    tangential, size, limit = surface_forces(constants, contact, load, history, particles.velocity[i])
                    numbers[list_index][NORMAL] = normal_force
                    numbers[list_index][TANGENTIAL] = size
                    numbers[list_index][LIMIT] = limit
                    output.contact_point[list_index] = contact_point_of(i, j, pose)
                    output.force[list_index] = normal_force * normal + tangential

    return evaluate


def _build_contact_point(state: State) -> Any:
    """Device function (i, j, pose): contact point [m] with a wall; for particles the wrapped position of i.

    Reads:  position, walls
    """
    geometry, wrap_position = WallGeometry(state), build_wrap_position(state)

    @ti.func
    def contact_point_of(i, j, pose):
        contact_point = wrap_position(state.particles.position[i])
        if ti.static(state.plan.has_walls):
            if j < 0:
                gap, direction = geometry.closest(-1 - j, pose, contact_point)
                contact_point -= gap * direction
        return contact_point

    return contact_point_of


def _build_surface_forces(state: State) -> Any:
    """Device function (constants, contact, load, history, a vector): tangential force [N], its size and limit [N].

    The vector gives the type of the force; without a tangential model all are 0.
    """
    laws = state.plan.laws

    @ti.func
    def surface_forces(constants, contact, load, history, vector):
        force, size, limit = 0.0 * vector, 0.0 * load, 0.0 * load
        if ti.static(laws.has_tangential):
            surface = ti.Struct(
                radius_eff=contact.radius_eff,
                normal_load=load,
                stiffness=laws.normal.tangential_stiffness(constants.normal, contact, history.normal),
            )
            force, size = laws.tangential.present_force(constants.tangential, surface, history.tangential)
            limit = laws.tangential.limit(constants.tangential, surface)
        return force, size, limit

    return surface_forces
