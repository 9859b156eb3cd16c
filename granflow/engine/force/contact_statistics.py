"""Contact statistics and contact energies for snapshots; no step evaluates them."""

from collections.abc import Callable
from typing import Any

import taichi as ti

from granflow.engine.field_block import FieldBlock
from granflow.engine.force.pair_kinematics import build_any_kinematics, build_pair_number, build_weight
from granflow.engine.state import State

STATISTICS = ("contact_count", "overlap_sum", "overlap_largest", "elastic_energy", "plastic_dissipation")
"""Totals over contacts: count, sum and maximum of the overlap over the smaller radius, energies [J]."""
COUNT, OVERLAP_SUM, OVERLAP_LARGEST, ELASTIC, PLASTIC = range(len(STATISTICS))


class ContactStatistics:
    """Kernels that evaluate each contact once; compiled at first use."""

    def __init__(self, state: State) -> None:
        self.state = state
        self.block = FieldBlock()
        self.statistics = self.block.vector(
            ti.f64 if state.backend.precision != "f32" else ti.f32, state.plan.chunk_capacity, count=len(STATISTICS)
        )
        self.block.finish()
        self._measure = _build_measure(state, self.statistics)

    def measure(self) -> dict[str, float]:
        """Statistics of all contacts at pose 0 by the names of STATISTICS; fills `coordination_number`."""
        state = self.state
        if not state.count:
            return dict.fromkeys(STATISTICS, 0.0)
        self._measure(state.chunk_count, state.count, state.clock.time_step)
        chunks = self.statistics.to_numpy()[: state.chunk_count]
        values = dict(zip(STATISTICS, chunks.sum(axis=0).tolist(), strict=True))
        values["overlap_largest"] = float(chunks[:, OVERLAP_LARGEST].max())
        return values


def _build_measure(state: State, statistics: Any) -> Callable[..., None]:
    """Kernel (chunks, count, time_step): statistics of each chunk; a pair in two lists counts half in each.

    Reads:   position, velocity, radius, mass, neighbor lists, history, walls
    Writes:  coordination_number, statistics
    """
    particles, neighbors, control = state.particles, state.neighbors, state.control
    real, chunk_size, size = state.backend.real, state.plan.chunk_size, len(STATISTICS)
    any_kinematics, weight, pair_number = build_any_kinematics(state), build_weight(state), build_pair_number(state)
    energies, stride = build_energies(state), state.stride

    @ti.kernel
    def measure(chunks: ti.i32, count: ti.i32, dt: real):
        for i in range(count):
            particles.coordination_number[i] = 0
        for task in range(chunks * stride):
            if task % stride == 0:
                chunk = task // stride
                found = ti.Vector.zero(statistics.dtype, size)
                for i in range(chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)):
                    for list_index in range(neighbors.list_begin[i], neighbors.list_end[i]):
                        j = neighbors.partner[list_index]
                        overlap, _normal, _rate, radius_eff, mass_eff = any_kinematics(i, j, 0, dt)
                        if overlap > 0.0:
                            share = weight(i, j)
                            radius_min = particles.radius[i]
                            if j >= 0:
                                radius_min = ti.min(radius_min, particles.radius[j])
                            relative = overlap / radius_min
                            elastic, plastic = energies(
                                list_index, control.pair_constants[pair_number(i, j)], radius_eff, mass_eff, dt, overlap
                            )
                            found[COUNT] += share
                            found[OVERLAP_SUM] += share * relative
                            found[OVERLAP_LARGEST] = ti.max(found[OVERLAP_LARGEST], relative)
                            found[ELASTIC] += share * elastic
                            found[PLASTIC] += share * plastic
                            particles.coordination_number[i] += 1
                            if share == 1.0 and j >= 0:
                                particles.coordination_number[j] += 1
                statistics[chunk] = found

    return measure


def build_energies(state: State) -> Any:
    """Device function: elastic and dissipated energy [J] of a contact; 0 without the energy budget.

    Arguments: list index, pair constants, effective radius [m], effective mass [kg], time step [s], overlap [m]. The
    elastic energy includes the tangential and the EPSD rolling spring; the dissipated energy is the plastic work.

    Reads:  history
    """
    plan, law, neighbors = state.plan, state.plan.law, state.neighbors
    energy_budget, history_size = plan.features.energy_budget, max(state.plan.law.history_count, 1)
    real = state.backend.real

    @ti.func
    def energies(list_index, constants, radius_eff, mass_eff, dt, overlap):
        elastic, plastic = 0.0 * overlap, 0.0 * overlap
        if ti.static(energy_budget):
            normal_history = ti.Vector.zero(real, history_size)
            if ti.static("normal" in neighbors.history):
                normal_history = neighbors.history["normal"][list_index]
            elastic += law.stored_energy(constants, radius_eff, mass_eff, dt, overlap, normal_history)
            plastic += law.lost_energy(constants, radius_eff, mass_eff, dt, overlap, normal_history)
            stiffness = law.tangential_stiffness(constants, radius_eff, overlap, normal_history)
            if ti.static("tangential" in neighbors.history):
                tangential_displacement = neighbors.history["tangential"][list_index]
                elastic += 0.5 * stiffness * tangential_displacement.dot(tangential_displacement)
            if ti.static(plan.features.rolling == "epsd"):
                rolling_displacement = neighbors.history["rolling"][list_index]
                elastic += 0.5 * stiffness * radius_eff * radius_eff * rolling_displacement.dot(rolling_displacement)
        return elastic, plastic

    return energies
