"""Contact output: one record per contact. Its arrays exist only if the scene requests contacts."""

from collections.abc import Callable

import numpy as np
import taichi as ti

from granflow.contact.complete_force import complete_force
from granflow.engine.field_block import FieldBlock
from granflow.engine.force.pair_kinematics import build_any_kinematics, build_pair_number
from granflow.engine.periodic_box import build_wrap_position
from granflow.engine.state import State
from granflow.engine.walls import WallGeometry, triangles_of, walls_of

AT_LIMIT = 1.0 - 1e-6
"""Share of the Coulomb limit above which a contact counts as sliding."""


def candidate_pairs(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All candidate pairs on the host; pairs across two chunks occur twice.

    Returns:  owner (p,), list index (p,) and partner (p,), int64; a negative partner is a wall, see `walls_of`
    """
    neighbors = state.neighbors
    begin, end = (f.to_numpy()[: state.count] for f in (neighbors.list_begin, neighbors.list_end))
    owner = np.repeat(np.arange(state.count), end - begin)
    first = np.repeat(begin - np.concatenate([[0], np.cumsum(end - begin)[:-1]]), end - begin)
    list_index = (first + np.arange(len(owner))).astype(np.int64)
    return owner, list_index, neighbors.partner.to_numpy()[list_index].astype(np.int64)


class ContactOutput:
    """Forces and overlaps of all contacts at the present positions; the contact histories do not change."""

    def __init__(self, state: State) -> None:
        self.state, self.block = state, FieldBlock()
        self.capacity = state.neighbors.capacity
        real = state.backend.real
        self.numbers = self.block.vector(real, self.capacity, count=len(QUANTITIES))
        self.force = self.block.vector(real, self.capacity)
        self.contact_point = self.block.vector(state.backend.position_real, self.capacity)
        self.block.finish()
        self._evaluate = _build_evaluate(state, self)

    def take(self, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """All contacts, each once, as in Snapshot.contacts, with n entries or (n, 3) arrays.

        arrays:   id (particles,) and position (particles, 3) [m] in device order
        Returns:  arrays by the names of CONTACT_QUANTITIES and the normal history
        """
        owner, list_index, partner, numbers = self._pairs()
        found = dict(zip(QUANTITIES, numbers.T, strict=True))
        normal_history = self._history(list_index, found["overlap"])
        loading = found["overlap"] >= normal_history["overlap_max"]
        other = np.maximum(partner, 0)
        with_wall = partner < 0
        wall, triangle = (np.full(len(partner), -1, np.int32) for _ in range(2))
        wall[with_wall] = walls_of(self.state, partner[with_wall])
        triangle[with_wall] = triangles_of(self.state, partner[with_wall])
        contact_point, force = self.contact_point.to_numpy()[list_index], self.force.to_numpy()[list_index]
        friction_limit, first = found.pop("friction_limit"), arrays["position"][owner]
        second = self.state.plan.periodic_box.at(self.state.clock.time).nearest_images(arrays["position"][other], first)
        return (
            found
            | normal_history
            | {
                "id_i": arrays["id"][owner].astype(np.int64),
                "id_j": np.where(with_wall, -1, arrays["id"][other]).astype(np.int64),
                "wall": wall,
                "triangle": triangle,
                "position_i": first,
                "position_j": np.where(with_wall[:, None], contact_point, second),
                "force": force.astype(float),
                "unloading": np.where(loading, 0, 1).astype(np.uint8),
                "sliding": ((friction_limit > 0.0) & (found["tangential_force"] >= AT_LIMIT * friction_limit)).astype(
                    np.uint8
                ),
            }
        )

    def _pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Owner, list index, partner (n,) and recorded quantities (n, 4) of all contacts, each pair once."""
        state = self.state
        if state.count:
            self._evaluate(state.count, state.clock.time_step)
        owner, list_index, partner = candidate_pairs(state)
        numbers = self.numbers.to_numpy()[list_index].astype(float)
        is_contact = ((partner < 0) | (partner > owner)) & (numbers[:, OVERLAP] > 0.0)
        return owner[is_contact], list_index[is_contact], partner[is_contact], numbers[is_contact]

    def _history(self, list_index: np.ndarray, overlap: np.ndarray) -> dict[str, np.ndarray]:
        """Maximum overlap [m] and restitution (n,) from the history; without a history, the overlap itself and 1."""
        names, history = self.state.plan.law.history_names, self.state.neighbors.history
        found = {"overlap_max": overlap, "restitution": np.ones(len(list_index))}
        for index, name in enumerate(names):
            if name in found:
                found[name] = history["normal"].to_numpy()[list_index, index].astype(float)
        return found


QUANTITIES = ("overlap", "normal_force", "tangential_force", "friction_limit")
"""Quantities that `_build_evaluate` records for each list entry, in N except for the overlap in m."""
OVERLAP, NORMAL, TANGENTIAL, LIMIT = range(len(QUANTITIES))


def _build_evaluate(state: State, output: ContactOutput) -> Callable[..., None]:
    """Kernel (count, time_step): evaluate all list entries at pose 0.

    Reads:   position, velocity, radius, mass, neighbor lists, history, walls
    Writes:  numbers, force, contact_point of `output`
    """
    plan, law, particles, neighbors = state.plan, state.plan.law, state.particles, state.neighbors
    real, history_size = state.backend.real, max(law.history_count, 1)
    any_kinematics, pair_number, geometry = (
        build_any_kinematics(state),
        build_pair_number(state),
        WallGeometry(state),
    )
    normal_force_of, numbers, wrap_position = complete_force(law), output.numbers, build_wrap_position(state)

    @ti.func
    def contact_point_of(i, j):
        """Contact point [m] with a wall; for particles the wrapped position of i."""
        contact_point = wrap_position(particles.position[i])
        if ti.static(plan.has_walls):
            if j < 0:
                gap, direction = geometry.closest(-1 - j, 0, contact_point)
                contact_point -= gap * direction
        return contact_point

    @ti.kernel
    def evaluate(count: ti.i32, dt: real):
        for i in range(count):
            for list_index in range(neighbors.list_begin[i], neighbors.list_end[i]):
                j = neighbors.partner[list_index]
                overlap, normal, rate, radius_eff, mass_eff = any_kinematics(i, j, 0, dt)
                numbers[list_index][OVERLAP] = overlap
                if overlap > 0.0:
                    constants = state.control.pair_constants[pair_number(i, j)]
                    normal_history = ti.Vector.zero(real, history_size)
                    if ti.static("normal" in neighbors.history):
                        normal_history = neighbors.history["normal"][list_index]
                    normal_load, _viscous, _m2 = normal_force_of(
                        constants, radius_eff, mass_eff, dt, overlap, rate, normal_history
                    )
                    force = normal_load * normal
                    numbers[list_index][NORMAL] = normal_load
                    numbers[list_index][TANGENTIAL] = 0.0
                    if ti.static(law.attracts):
                        normal_load += law.attraction(constants, radius_eff, overlap, normal_history)
                    numbers[list_index][LIMIT] = constants[plan.friction_index] * normal_load
                    output.contact_point[list_index] = contact_point_of(i, j)
                    if ti.static("tangential" in neighbors.history):
                        tangential_displacement = neighbors.history["tangential"][list_index]
                        stiffness = law.tangential_stiffness(constants, radius_eff, overlap, normal_history)
                        numbers[list_index][TANGENTIAL] = stiffness * ti.sqrt(
                            tangential_displacement.dot(tangential_displacement)
                        )
                        force -= stiffness * tangential_displacement
                    output.force[list_index] = force

    return evaluate
