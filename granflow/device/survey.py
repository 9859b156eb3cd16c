"""What is measured for snapshots and never during a step: contact statistics, energies, records of contacts."""

from collections.abc import Callable
from typing import Any

import numpy as np
import taichi as ti

from granflow.device.encounter import build_encounter
from granflow.device.search import STRIDE
from granflow.device.state import Block, State

STATISTICS = ("contact_count", "overlap_sum", "overlap_largest", "elastic_energy", "plastic_dissipation")
COUNT, OVERLAP_SUM, OVERLAP_LARGEST, ELASTIC, PLASTIC = range(len(STATISTICS))


class Survey:
    """Kernels that look at every contact once, compiled when first used."""

    def __init__(self, state: State) -> None:
        self.state = state
        self.block = Block()
        self.statistics = self.block.vector(
            ti.f64 if state.backend.precision != "f32" else ti.f32, state.plan.chunk_capacity, count=len(STATISTICS)
        )
        self.block.finish()
        self._measure = _build_measure(state, self.statistics)

    def measure(self) -> dict[str, float]:
        """Contacts of all particles at pose 0; fills `coordination`."""
        state = self.state
        if not state.count:
            return dict.fromkeys(STATISTICS, 0.0)
        self._measure(state.chunk_count, state.count, state.plan.time_step)
        chunks = self.statistics.to_numpy()[: state.chunk_count]
        values = dict(zip(STATISTICS, chunks.sum(axis=0).tolist(), strict=True))
        values["overlap_largest"] = float(chunks[:, OVERLAP_LARGEST].max())
        return values


def build_weight(state: State) -> Any:
    """Device function: 1 for a pair that stands in one row, 1/2 for one that stands in two."""
    chunk_size = state.plan.chunk_size

    @ti.func
    def weight(i, j):
        share = 1.0
        if j >= 0 and i // chunk_size != j // chunk_size:
            share = 0.5
        return share

    return weight


def build_pair_number(state: State) -> Any:
    """Device function: row of the pair constants for particle i and partner j."""
    plan, particles, walls = state.plan, state.particles, state.walls
    features = plan.features

    @ti.func
    def pair_number(i, j):
        number = 0
        if ti.static(not features.one_material):
            number = particles.material[i] * plan.material_count
            if j >= 0:
                number += particles.material[j]
        if ti.static(plan.has_walls):
            if j < 0:
                number += walls.material[-1 - j]
        return number

    return pair_number


def _build_measure(state: State, statistics: Any) -> Callable[..., None]:
    plan, law, particles, contacts = state.plan, state.plan.law, state.particles, state.contacts
    real, chunk_size, size = state.backend.real, state.plan.chunk_size, len(STATISTICS)
    encounter, weight, pair_number = build_encounter(state), build_weight(state), build_pair_number(state)
    energies = build_energies(state)

    @ti.kernel
    def measure(chunks: ti.i32, count: ti.i32, dt: real):
        for i in range(count):
            particles.coordination[i] = 0
        for task in range(chunks * STRIDE):
            if task % STRIDE == 0:
                chunk = task // STRIDE
                found = ti.Vector.zero(statistics.dtype, size)
                for i in range(chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)):
                    for slot in range(contacts.row_begin[i], contacts.row_end[i]):
                        j = contacts.partner[slot]
                        overlap, _n, _m, _v, _r, _a, _b, radius_eff, mass_eff = encounter(i, j, 0, dt)
                        if overlap > 0.0:
                            share = weight(i, j)
                            relative = overlap / ti.min(2.0 * radius_eff, particles.radius[i])
                            elastic, plastic = energies(
                                slot, control.pair_constants[pair_number(i, j)], radius_eff, mass_eff, dt, overlap
                            )
                            found[COUNT] += share
                            found[OVERLAP_SUM] += share * relative
                            found[OVERLAP_LARGEST] = ti.max(found[OVERLAP_LARGEST], relative)
                            found[ELASTIC] += share * elastic
                            found[PLASTIC] += share * plastic
                            particles.coordination[i] += 1
                            if share == 1.0 and j >= 0:
                                particles.coordination[j] += 1
                statistics[chunk] = found

    control = state.control
    del law
    return measure


def build_energies(state: State) -> Any:
    """Device function: energy a contact can give back and energy it has taken for good [J]; 0 without the ledger."""
    plan, law, contacts = state.plan, state.plan.law, state.contacts
    ledger, memory_size = plan.features.ledger, max(state.plan.law.history_count, 1)
    real = state.backend.real

    @ti.func
    def energies(slot, constants, radius_eff, mass_eff, dt, overlap):
        elastic, plastic = 0.0 * overlap, 0.0 * overlap
        if ti.static(ledger):
            memory = ti.Vector.zero(real, memory_size)
            if ti.static("normal" in contacts.history):
                memory = contacts.history["normal"][slot]
            elastic += law.stored_energy(constants, radius_eff, mass_eff, dt, overlap, memory)
            plastic += law.lost_energy(constants, radius_eff, mass_eff, dt, overlap, memory)
            stiffness = law.lateral_stiffness(constants, radius_eff, overlap, memory)
            if ti.static("lateral" in contacts.history):
                slide = contacts.history["lateral"][slot]
                elastic += 0.5 * stiffness * slide.dot(slide)
            if ti.static("rolling" in contacts.history):
                angle = contacts.history["rolling"][slot]
                elastic += 0.5 * stiffness * radius_eff * radius_eff * angle.dot(angle)
        return elastic, plastic

    return energies


class ContactRecords:
    """One record per contact, for files; its arrays exist only where contacts are asked for."""

    def __init__(self, state: State) -> None:
        self.state, self.block = state, Block()
        real, size = state.backend.real, state.contacts.capacity
        self.overlap, self.normal_force = self.block.scalar(real, size), self.block.scalar(real, size)
        self.tangential_force, self.cap = self.block.scalar(real, size), self.block.scalar(real, size)
        self.normal = self.block.vector(real, size)
        self.block.finish()
        self._record = _build_record(state, self)

    def take(self) -> dict[str, np.ndarray]:
        """Every contact once, with the indices of its particles: arrays named as in Snapshot.contacts."""
        state, contacts = self.state, self.state.contacts
        if not state.count:
            return {"slot": np.zeros(0, np.int64), "i": np.zeros(0, np.int64), "j": np.zeros(0, np.int64)}
        self._record(state.chunk_count, state.count, state.plan.time_step)
        begin, end = (f.to_numpy()[: state.count] for f in (contacts.row_begin, contacts.row_end))
        owner = np.repeat(np.arange(state.count), end - begin)
        slot = np.concatenate([np.arange(b, e) for b, e in zip(begin, end, strict=True)])
        partner = contacts.partner.to_numpy()[slot].astype(np.int64)
        once = (partner < 0) | (partner > owner)
        kept = once & (self.overlap.to_numpy()[slot] > 0.0)
        return {"slot": slot[kept], "i": owner[kept], "j": partner[kept]}


def _build_record(state: State, records: ContactRecords) -> Callable[..., None]:
    plan, law, contacts, real = state.plan, state.plan.law, state.contacts, state.backend.real
    chunk_size, memory_size = plan.chunk_size, max(law.history_count, 1)
    encounter, pair_number = build_encounter(state), build_pair_number(state)

    @ti.kernel
    def record(chunks: ti.i32, count: ti.i32, dt: real):
        for i in range(count):
            for slot in range(contacts.row_begin[i], contacts.row_end[i]):
                j = contacts.partner[slot]
                overlap, normal, _m, _v, rate, _a, _b, radius_eff, mass_eff = encounter(i, j, 0, dt)
                records.overlap[slot] = overlap
                if overlap > 0.0:
                    constants = state.control.pair_constants[pair_number(i, j)]
                    memory = ti.Vector.zero(real, memory_size)
                    if ti.static("normal" in contacts.history):
                        memory = contacts.history["normal"][slot]
                    force, _viscous, _memory = law.force(
                        constants, radius_eff, mass_eff, dt, overlap, rate, memory
                    )
                    records.normal_force[slot] = force
                    records.normal[slot] = normal
                    records.tangential_force[slot] = 0.0
                    if ti.static("lateral" in contacts.history):
                        slide = contacts.history["lateral"][slot]
                        stiffness = law.lateral_stiffness(constants, radius_eff, overlap, memory)
                        records.tangential_force[slot] = stiffness * ti.sqrt(slide.dot(slide))
                        records.cap[slot] = constants[plan.friction_index] * force

    del chunk_size
    return record
