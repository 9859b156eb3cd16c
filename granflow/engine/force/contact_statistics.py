"""Contact statistics and contact energies for snapshots; no step evaluates them."""

from collections.abc import Callable
from typing import Any

from granflow.engine.exact_sums import (
    SHARES,
    build_list_shares,
    carried,
    energy_words,
    exact_total,
    exact_totals,
    to_units,
)
from granflow.engine.field_block import FieldBlock
from granflow.engine.force.distant_force import build_in_range
from granflow.engine.force.liquid_transfer import transfers_liquid
from granflow.engine.force.pair_kinematics import build_any_kinematics, build_pair_constants
from granflow.engine.neighbor.contact_history_entry import build_read_history
from granflow.engine.state import State
from granflow.kernel_language import ti
from granflow.plan.sum_units import ENERGY

SUMS = ("contact_count", "overlap_sum")
"""Sums over contacts: count, overlap over the smaller radius."""
LIQUID_SUMS = ("liquid_film_volume", "liquid_bridge_volume")
"""Further sums with a model that transfers liquid: volumes [m3] of the films and of the bridges."""
COUNT, OVERLAP, FILMS, BRIDGES = range(len(SUMS) + len(LIQUID_SUMS))

ENERGIES = ("elastic_energy", "plastic_dissipation")
"""Sums of energies [J] over contacts."""

GPU_ROWS = 65_536
"""Largest number of rows of sums on a GPU, each of one thread."""

OVERLAP_UNIT = 2.0**-48
"""Unit of the sum of relative overlaps: a chunk can have 2^15 contacts."""


class ContactStatistics:
    """Kernels that evaluate each contact once; compiled at first use."""

    def __init__(self, state: State) -> None:
        self.state = state
        self.block, chunks = FieldBlock(state.backend), state.plan.capacities.chunks
        self._rows = chunks if state.backend.on_cpu else min(chunks, GPU_ROWS)
        self._names = (*SUMS, *LIQUID_SUMS) if transfers_liquid(state) else SUMS
        self.sums = self.block.vector(ti.i64, self._rows, count=len(self._names))
        self.energies = self.block.vector(ti.i64, self._rows, count=2 * len(ENERGIES))
        self.largest = self.block.scalar(state.backend.real, self._rows)
        self.block.finish()
        self._measure = _build_measure(state, self.sums, self.energies, self.largest)

    def measure(self, pose: int) -> dict[str, float]:
        """Statistics of all contacts; fills both contact counts.

        pose:  index of the wall poses at the present time, see `WallPoses.index_at`

        Returns SUMS, ENERGIES and `overlap_largest`, the maximum of the overlap over the smaller radius; LIQUID_SUMS
        with a model that transfers liquid.
        """
        state, ranks, chunks = self.state, self.state.ranks, self.state.chunk_count
        rows = min(chunks, self._rows)
        if chunks:
            self._measure(chunks, rows, state.count, pose, state.clock.time_step)
        words = ranks.total(self.sums.to_numpy()[:rows])
        units = (1.0, OVERLAP_UNIT, state.plan.liquid_unit, state.plan.liquid_unit)[: len(self._names)]
        sums = [exact_total(words[:, column]) / SHARES * each for column, each in enumerate(units)]
        unit = state.plan.sum_units.energy / SHARES
        energies = exact_totals(ranks.total(self.energies.to_numpy()[:rows]), unit)
        largest = ranks.largest(float(self.largest.to_numpy()[:rows].max(initial=0.0)))
        values = (*sums, *energies.tolist(), largest)
        return dict(zip((*self._names, *ENERGIES, "overlap_largest"), values, strict=True))


@ti.func
def particles_of_row(row, rows, chunks, size, count):
    """Number of particles of the chunks row, row + rows, ...; only the last chunk can be incomplete."""
    chunk_count = (chunks - row + rows - 1) // rows
    last = row + (chunk_count - 1) * rows
    return chunk_count * size - ti.max((last + 1) * size - count, 0)


def _build_measure(state: State, sums: Any, energy_sums: Any, largest: Any) -> Callable[..., None]:
    """Kernel (chunks, rows, count, pose, time_step): exact sums, energies and the largest relative overlap by row.

    A row is that of a chunk, or of every k-th one if there are k rows.

    Reads:   position, velocity, radius, mass, neighbor lists, history, walls
    Writes:  coordination_number, wall_contact_count, sums, energies, largest
    """
    particles, neighbors, has_walls = state.particles, state.neighbors, state.plan.features.walls
    real, chunk_size, sum_count = state.backend.real, state.parameter("chunk_size"), sums.n
    any_kinematics, list_shares, energies = build_any_kinematics(state), build_list_shares(state), build_energies(state)
    pair_constants, in_range, stride = build_pair_constants(state), build_in_range(state), state.stride
    per_unit, (with_film, with_bridge) = state.parameter("per_unit", ENERGY), _build_liquid_sums(state)

    @ti.kernel
    def measure(chunks: ti.i32, rows: ti.i32, count: ti.i32, pose: ti.i32, dt: real):
        for i in range(count):
            particles.coordination_number[i] = 0
            if ti.static(has_walls):
                particles.wall_contact_count[i] = 0
        for task in range(rows * stride):
            if task % stride == 0:
                row = task // stride
                found, overlap_largest = ti.Vector.zero(ti.i64, sum_count), ti.cast(0.0, real)
                low, high = ti.Vector.zero(ti.i64, 2), ti.Vector.zero(ti.i64, 2)
                per_joule, size = per_unit(), chunk_size()
                for k in range(particles_of_row(row, rows, chunks, size, count)):
                    chunk = row + k // size * rows
                    i = chunk * size + k % size
                    found = with_film(found, i)
                    for list_index in range(neighbors.list_begin[i], neighbors.list_end[i]):
                        j = neighbors.partner[list_index]
                        _normal, contact = any_kinematics(i, j, pose, dt)
                        shares = list_shares(chunk, j)
                        found = with_bridge(found, list_index, shares)
                        if in_range(i, j, contact.overlap):
                            elastic, plastic = energies(list_index, pair_constants(i, j), contact)
                            elastic_low, elastic_high = energy_words(per_joule * elastic)
                            plastic_low, plastic_high = energy_words(per_joule * plastic)
                            low += shares * ti.Vector([elastic_low, plastic_low])
                            high += shares * ti.Vector([elastic_high, plastic_high])
                        if contact.overlap > 0.0:
                            radius_min = particles.radius[i]
                            if j >= 0:
                                radius_min = ti.min(radius_min, particles.radius[j])
                            relative = contact.overlap / radius_min
                            found[COUNT] += shares
                            found[OVERLAP] += shares * to_units(relative / OVERLAP_UNIT)
                            overlap_largest = ti.max(overlap_largest, relative)
                            if j >= 0:
                                particles.coordination_number[i] += 1
                                if shares == SHARES:
                                    particles.coordination_number[j] += 1
                            elif ti.static(has_walls):
                                particles.wall_contact_count[i] += 1
                sums[row], largest[row] = found, overlap_largest
                energy_sums[row] = carried(ti.Vector([low[0], low[1], high[0], high[1]]), 2)

    return measure


def _build_liquid_sums(state: State) -> tuple[Any, Any]:
    """Device functions (sums, i) and (sums, list index, shares) -> sums with the film of i, or with a bridge.

    Films are in half units: those that bridges return.

    Reads:  liquid_film, history
    """
    liquid, particles, history = transfers_liquid(state), state.particles, state.neighbors.history
    unit = state.parameter("liquid_unit") if liquid else None

    @ti.func
    def with_film(sums, i):
        result = sums
        if ti.static(liquid):
            result[FILMS] += to_units(SHARES * particles.liquid_film[i] / unit())
        return result

    @ti.func
    def with_bridge(sums, list_index, shares):
        result = sums
        if ti.static(liquid):
            result[BRIDGES] += shares * to_units(history["cohesion"][list_index][0] / unit())
        return result

    return with_film, with_bridge


def build_energies(state: State) -> Any:
    """Device function (list index, constants, contact): stored and lost energy [J]; 0 without the energy budget.

    The stored energy includes that of the tangential, rolling, twisting and cohesion models; the lost energy is the
    plastic work.

    Reads:  history
    """
    laws, energy_budget, read_history = state.plan.laws, state.plan.features.energy_budget, build_read_history(state)

    @ti.func
    def with_surface_energy(normal_energy, constants, contact, history):
        """The stored energy [J] with that of the tangential, rolling and twisting models."""
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
        if ti.static(laws.has_twisting):
            stored += laws.twisting.stored_energy(constants.twisting, surface, history.twisting)
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
