"""What is measured for snapshots and never during a step: contact statistics and energies."""

from collections.abc import Callable
from typing import Any

import taichi as ti

from granflow.device.encounter import build_either_encounter, build_pair_number, build_weight
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
        self._measure(state.chunk_count, state.count, state.clock.time_step)
        chunks = self.statistics.to_numpy()[: state.chunk_count]
        values = dict(zip(STATISTICS, chunks.sum(axis=0).tolist(), strict=True))
        values["overlap_largest"] = float(chunks[:, OVERLAP_LARGEST].max())
        return values


def _build_measure(state: State, statistics: Any) -> Callable[..., None]:
    particles, contacts, control = state.particles, state.contacts, state.control
    real, chunk_size, size = state.backend.real, state.plan.chunk_size, len(STATISTICS)
    encounter, weight, pair_number = build_either_encounter(state), build_weight(state), build_pair_number(state)
    energies, stride = build_energies(state), state.stride

    @ti.kernel
    def measure(chunks: ti.i32, count: ti.i32, dt: real):
        for i in range(count):
            particles.coordination[i] = 0
        for task in range(chunks * stride):
            if task % stride == 0:
                chunk = task // stride
                found = ti.Vector.zero(statistics.dtype, size)
                for i in range(chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)):
                    for slot in range(contacts.row_begin[i], contacts.row_end[i]):
                        j = contacts.partner[slot]
                        overlap, _normal, _rate, radius_eff, mass_eff = encounter(i, j, 0, dt)
                        if overlap > 0.0:
                            share = weight(i, j)
                            smaller = particles.radius[i]
                            if j >= 0:
                                smaller = ti.min(smaller, particles.radius[j])
                            relative = overlap / smaller
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
            if ti.static(plan.features.rolling == "epsd"):
                angle = contacts.history["rolling"][slot]
                elastic += 0.5 * stiffness * radius_eff * radius_eff * angle.dot(angle)
        return elastic, plastic

    return energies
