"""One record per contact, for files. Its arrays exist only where contacts are asked for."""

from collections.abc import Callable

import numpy as np
import taichi as ti

from granflow.device.apart import build_inside
from granflow.device.encounter import build_either_encounter, build_pair_number
from granflow.device.state import Block, State
from granflow.device.walls import build_wall_geometry, triangles_of, walls_of
from granflow.laws.whole import whole_force

AT_LIMIT = 1.0 - 1e-6
"""Share of the Coulomb limit from which on a contact counts as sliding."""


def listed_pairs(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Owner, slot and partner (below 0: `walls_of`) of all in the rows; pairs across two chunks stand there twice."""
    contacts = state.contacts
    begin, end = (f.to_numpy()[: state.count] for f in (contacts.row_begin, contacts.row_end))
    owner = np.repeat(np.arange(state.count), end - begin)
    first = np.repeat(begin - np.concatenate([[0], np.cumsum(end - begin)[:-1]]), end - begin)
    slot = (first + np.arange(len(owner))).astype(np.int64)
    return owner, slot, contacts.partner.to_numpy()[slot].astype(np.int64)


class ContactRecords:
    """Forces and overlaps of all contacts, evaluated where the particles stand, histories left as they are."""

    def __init__(self, state: State) -> None:
        self.state, self.block = state, Block()
        self.capacity = state.contacts.capacity
        real = state.backend.real
        self.numbers = self.block.vector(real, self.capacity, count=len(RECORDED))
        self.force = self.block.vector(real, self.capacity)
        self.foot = self.block.vector(state.backend.position_real, self.capacity)
        self.block.finish()
        self._record = _build_record(state, self)

    def take(self, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Every contact once, as in Snapshot.contacts; `arrays` holds id and position in the device's order."""
        owner, slot, partner, numbers = self._pairs()
        found = dict(zip(RECORDED, numbers.T, strict=True))
        memory = self._memory(slot, found["overlap"])
        loading = found["overlap"] >= memory["overlap_max"]
        other = np.maximum(partner, 0)
        with_wall = partner < 0
        wall, triangle = (np.full(len(partner), -1, np.int32) for _ in range(2))
        wall[with_wall] = walls_of(self.state, partner[with_wall])
        triangle[with_wall] = triangles_of(self.state, partner[with_wall])
        foot, force = self.foot.to_numpy()[slot], self.force.to_numpy()[slot]
        cap, first = found.pop("friction_limit"), arrays["position"][owner]
        second = self.state.plan.border.at(self.state.clock.time).beside(arrays["position"][other], first)
        return found | memory | {
            "first_id": arrays["id"][owner].astype(np.int64),
            "second_id": np.where(with_wall, -1, arrays["id"][other]).astype(np.int64),
            "wall": wall,
            "triangle": triangle,
            "first_position": first,
            "second_position": np.where(with_wall[:, None], foot, second),
            "force": force.astype(float),
            "state": np.where(loading, 0, 1).astype(np.uint8),
            "sliding": ((cap > 0.0) & (found["tangential_force"] >= AT_LIMIT * cap)).astype(np.uint8),
        }  # fmt: skip

    def _pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Owner, slot, partner and recorded numbers of every contact, each pair once."""
        state = self.state
        if state.count:
            self._record(state.count, state.clock.time_step)
        owner, slot, partner = listed_pairs(state)
        numbers = self.numbers.to_numpy()[slot].astype(float)
        kept = ((partner < 0) | (partner > owner)) & (numbers[:, OVERLAP] > 0.0)
        return owner[kept], slot[kept], partner[kept], numbers[kept]

    def _memory(self, slot: np.ndarray, overlap: np.ndarray) -> dict[str, np.ndarray]:
        """Largest overlap and restitution that the law remembers; the overlap itself and 1 where it does not."""
        names, history = self.state.plan.law.history_names, self.state.contacts.history
        found = {"overlap_max": overlap, "restitution": np.ones(len(slot))}
        for index, name in enumerate(names):
            if name in found:
                found[name] = history["normal"].to_numpy()[slot, index].astype(float)
        return found


RECORDED = ("overlap", "normal_force", "tangential_force", "friction_limit")
OVERLAP, NORMAL, TANGENTIAL, LIMIT = range(len(RECORDED))


def _build_record(state: State, records: ContactRecords) -> Callable[..., None]:
    plan, law, particles, contacts = state.plan, state.plan.law, state.particles, state.contacts
    real, memory_size = state.backend.real, max(law.history_count, 1)
    encounter, pair_number, geometry = (
        build_either_encounter(state),
        build_pair_number(state),
        build_wall_geometry(state),
    )
    force_of, numbers, inside = whole_force(law), records.numbers, build_inside(state)

    @ti.func
    def foot_point(i, j):
        foot = inside(particles.position[i])
        if ti.static(plan.has_walls):
            if j < 0:
                gap, direction = geometry.closest(-1 - j, 0, foot)
                foot -= gap * direction
        return foot

    @ti.kernel
    def record(count: ti.i32, dt: real):
        for i in range(count):
            for slot in range(contacts.row_begin[i], contacts.row_end[i]):
                j = contacts.partner[slot]
                overlap, normal, rate, radius_eff, mass_eff = encounter(i, j, 0, dt)
                numbers[slot][OVERLAP] = overlap
                if overlap > 0.0:
                    constants = state.control.pair_constants[pair_number(i, j)]
                    memory = ti.Vector.zero(real, memory_size)
                    if ti.static("normal" in contacts.history):
                        memory = contacts.history["normal"][slot]
                    pressing, _viscous, _m2 = force_of(constants, radius_eff, mass_eff, dt, overlap, rate, memory)
                    force = pressing * normal
                    numbers[slot][NORMAL] = pressing
                    numbers[slot][TANGENTIAL] = 0.0
                    if ti.static(law.attracts):
                        pressing += law.attraction(constants, radius_eff, overlap, memory)
                    numbers[slot][LIMIT] = constants[plan.friction_index] * pressing
                    records.foot[slot] = foot_point(i, j)
                    if ti.static("lateral" in contacts.history):
                        slide = contacts.history["lateral"][slot]
                        stiffness = law.lateral_stiffness(constants, radius_eff, overlap, memory)
                        numbers[slot][TANGENTIAL] = stiffness * ti.sqrt(slide.dot(slide))
                        force -= stiffness * slide
                    records.force[slot] = force

    return record
