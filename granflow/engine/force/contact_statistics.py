"""Contact statistics and contact energies for snapshots; no step evaluates them."""

from collections.abc import Callable
from typing import Any

import numpy as np

from granflow.engine.force.distant_force import build_in_range
from granflow.engine.force.pair_kinematics import build_any_kinematics, build_pair_constants, build_weight
from granflow.engine.neighbor.contact_history import build_read_history
from granflow.engine.state import State
from granflow.kernel_language import ti

STATISTICS = ("contact_count", "overlap_sum", "overlap_largest", "elastic_energy", "plastic_dissipation")
"""Totals over contacts: count, sum and maximum of the overlap over the smaller radius, energies [J]."""
COUNT, OVERLAP_SUM, OVERLAP_LARGEST, ELASTIC, PLASTIC = range(len(STATISTICS))


class ContactStatistics:
    """Kernels that evaluate each contact once; compiled at first use."""

    def __init__(self, state: State) -> None:
        self.state = state
        self._measure = _build_measure(state)

    def measure(self, pose: int) -> dict[str, float]:
        """Statistics of all contacts by the names of STATISTICS; fills both contact counts.

        pose:  index of the wall poses at the present time, see `Stepper.place_walls`
        """
        state = self.state
        if not state.count:
            return dict.fromkeys(STATISTICS, 0.0)
        chunks = np.empty(
            (state.chunk_count, len(STATISTICS)), np.float32 if state.backend.precision == "f32" else float
        )
        self._measure(state.chunk_count, state.count, pose, state.clock.time_step, chunks)
        values = dict(zip(STATISTICS, chunks.sum(axis=0).tolist(), strict=True))
        values["overlap_largest"] = float(chunks[:, OVERLAP_LARGEST].max())
        return values


def _build_measure(state: State) -> Callable[..., None]:
    """Kernel (chunks, count, pose, time_step, statistics): statistics (chunks, len(STATISTICS)) of each chunk.

    A pair in two lists counts half in each.

    Reads:   position, velocity, radius, mass, neighbor lists, history, walls
    Writes:  coordination_number, wall_contact_count, statistics
    """
    particles, neighbors, has_walls = state.particles, state.neighbors, state.plan.features.walls
    real, chunk_size, size = state.backend.real, state.parameter("chunk_size"), len(STATISTICS)
    any_kinematics, weight, energies = build_any_kinematics(state), build_weight(state), build_energies(state)
    pair_constants, in_range, stride = build_pair_constants(state), build_in_range(state), state.stride

    real_sum = ti.f32 if state.backend.precision == "f32" else ti.f64
    external: Any = ti.types.ndarray()

    @ti.kernel
    def measure(chunks: ti.i32, count: ti.i32, pose: ti.i32, dt: real, statistics: external):
        for i in range(count):
            particles.coordination_number[i] = 0
            if ti.static(has_walls):
                particles.wall_contact_count[i] = 0
        for task in range(chunks * stride):
            if task % stride == 0:
                chunk = task // stride
                found = ti.Vector.zero(real_sum, size)
                for i in range(chunk * chunk_size(), ti.min((chunk + 1) * chunk_size(), count)):
                    for list_index in range(neighbors.list_begin[i], neighbors.list_end[i]):
                        j = neighbors.partner[list_index]
                        _normal, contact = any_kinematics(i, j, pose, dt)
                        if in_range(i, j, contact.overlap):
                            share, constants = weight(chunk, j), pair_constants(i, j)
                            elastic, plastic = energies(list_index, constants, contact)
                            found[ELASTIC] += share * elastic
                            found[PLASTIC] += share * plastic
                        if contact.overlap > 0.0:
                            share = weight(chunk, j)
                            radius_min = particles.radius[i]
                            if j >= 0:
                                radius_min = ti.min(radius_min, particles.radius[j])
                            relative = contact.overlap / radius_min
                            found[COUNT] += share
                            found[OVERLAP_SUM] += share * relative
                            found[OVERLAP_LARGEST] = ti.max(found[OVERLAP_LARGEST], relative)
                            if j >= 0:
                                particles.coordination_number[i] += 1
                                if share == 1.0:
                                    particles.coordination_number[j] += 1
                            elif ti.static(has_walls):
                                particles.wall_contact_count[i] += 1
                for c in ti.static(range(size)):
                    statistics[chunk, c] = found[c]

    return measure


def build_energies(state: State) -> Any:
    """Device function (list index, constants, contact): stored and lost energy [J]; 0 without the energy budget.

    The stored energy includes that of the tangential, rolling and cohesion models; the lost energy is the plastic work.

    Reads:  history
    """
    laws, energy_budget, read_history = state.plan.laws, state.plan.features.energy_budget, build_read_history(state)

    @ti.func
    def with_surface_energy(normal_energy, constants, contact, history):
        """The stored energy [J] with that of the tangential and the rolling model."""
        stored = normal_energy
        surface = ti.Struct(
            radius_eff=contact.radius_eff,
            mass_eff=contact.mass_eff,
            overlap=contact.overlap,
            stiffness=laws.normal.tangential_stiffness(constants.normal, contact, history.normal),
        )
        if ti.static(laws.has_tangential):
            stored += laws.tangential.stored_energy(constants.tangential, surface, history.tangential)
        if ti.static(laws.has_rolling):
            stored += laws.rolling.stored_energy(constants.rolling, surface, history.rolling)
        return stored

    @ti.func
    def energies(list_index, constants, contact):
        stored, lost = 0.0 * contact.overlap, 0.0 * contact.overlap
        if ti.static(energy_budget):
            history = read_history(list_index)
            if contact.overlap > 0.0:
                stored = laws.normal.stored_energy(constants.normal, contact, history.normal)
                lost = laws.normal.lost_energy(constants.normal, contact, history.normal)
            if ti.static(laws.has_cohesion):
                stored += laws.cohesion.stored_energy(constants.cohesion, contact, history.cohesion)
                lost += laws.cohesion.lost_energy(constants.cohesion, contact, history.cohesion)
            if contact.overlap > 0.0:
                stored = with_surface_energy(stored, constants, contact, history)
        return stored, lost

    return energies
