"""What the host measures of all contacts, for snapshots and limits; no time step evaluates it.

ContactOutput        one record per contact; its arrays exist only if the scene requests contacts
ContactStatistics    numbers of contacts, overlaps and energies, summed over all contacts
MaxImpactVelocity    the largest velocity of an impact, from which an adaptive time step follows

Each has a kernel over the entries of the neighbor lists that is compiled at its first use, and reads contact
histories without changing them.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from granflow.contact.law import AT_LIMIT
from granflow.engine.box import DeviceBox
from granflow.engine.fields import FieldBlock
from granflow.engine.history import ContactHistory, cohesive_contact, vector_components
from granflow.engine.host import FieldTable, consecutive, list_table
from granflow.engine.pair import Pair, PairForce, member, no_contact, normal_contact
from granflow.engine.state import State
from granflow.engine.sums import (
    SHARES,
    build_list_shares,
    carried,
    energy_words,
    exact_total,
    exact_totals,
    to_units,
)
from granflow.engine.walls import WallGeometry, triangles_of, walls_of
from granflow.kernel_language import ti
from granflow.plan.sum_units import UNIT_ENERGY

# One record per contact


class ContactOutput:
    """Forces and overlaps of all contacts at the present positions, and of separated pairs with an
    attraction; the contact histories do not change."""

    def __init__(self, state: State) -> None:
        self.state = state
        self.block = FieldBlock(state.backend)
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
        Returns:  arrays by the names of CONTACT_QUANTITIES and the normal history; the particle with the
                  lower id is the first of a contact, and contacts are in the order of the ids; on MPI ranks,
                  those of all ranks on the root
        """
        found = self.state.ranks.gathered(self._of_this_process(ids, pose))
        order = np.lexsort([found[name] for name in ("triangle", "wall", "id_j", "id_i")])
        return {name: values[order] for name, values in found.items()}

    def _of_this_process(self, ids: np.ndarray, pose: int) -> dict[str, np.ndarray]:
        """As `take`, in any order, without those that another rank takes."""
        state = self.state
        owner, partner, entries = self._pairs(ids, pose)
        found = dict(zip(QUANTITIES, entries["numbers"].T.astype(float), strict=True))
        normal_history = self._history(entries, found["overlap"])
        loading = found["overlap"] >= normal_history["overlap_max"]
        other = np.maximum(partner, 0)
        with_wall = partner < 0
        wall = np.full(len(partner), -1, np.int32)
        wall[with_wall] = walls_of(state, partner[with_wall])
        triangle = np.full(len(partner), -1, np.int32)
        triangle[with_wall] = triangles_of(state, partner[with_wall])
        box = state.periodic_box
        position = box.wrap(state.built(_position_table).take(slice(0, len(ids)))["position"].astype(float))
        friction_limit = found.pop("friction_limit")
        first = position[owner]
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

        Of a pair in two lists, that of the particle with the lower id counts. A pair in one list is turned if
        its owner has the higher id: forces and vectors of the history change their sign.
        """
        state = self.state
        if state.count:
            self._evaluate(state.count, pose, state.clock.time_step)
        owner, list_index, partner = candidate_pairs(state)
        entries = self._table.take(list_index)
        size = state.plan.chunk_size
        id_partner = np.where(partner < 0, np.iinfo(np.int32).max, ids[np.maximum(partner, 0)])
        counts = (ids[owner] < id_partner) | (owner // size == partner // size)
        acts = entries["numbers"][:, OVERLAP] > 0.0
        if state.plan.laws.cohesion_at_distance:
            acts |= (entries["force"] != 0.0).any(axis=1)
        is_contact = counts & acts
        turned = (ids[owner] > id_partner)[is_contact]
        owner = owner[is_contact]
        partner = partner[is_contact]
        entries = {name: each[is_contact] for name, each in entries.items()}
        owner, partner = np.where(turned, partner, owner), np.where(turned, owner, partner)
        entries["force"][turned] *= -1.0
        for slot in state.neighbors.history:
            entries[slot][turned] *= np.where(vector_components(state, slot), -1, 1).astype(
                entries[slot].dtype
            )
        # -0.0 + 0.0 is 0.0: the sign of a zero depends on the list that contains the pair.
        return owner, partner, {name: each + 0.0 for name, each in entries.items()}

    def _history(self, entries: Mapping[str, np.ndarray], overlap: np.ndarray) -> dict[str, np.ndarray]:
        """Maximum overlap [m] and restitution (n,), and shown histories.

        Without a history they are the overlap itself and 1.

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


def _position_table(state: State) -> FieldTable:
    """Table of the positions of all particles."""
    return FieldTable({"position": state.particles.position})


QUANTITIES = ("overlap", "normal_force", "tangential_force", "friction_limit")
"""Quantities that `_build_evaluate` records for each list entry, in N except for the overlap in m."""
OVERLAP, NORMAL, TANGENTIAL, LIMIT = range(len(QUANTITIES))


def _build_evaluate(state: State, output: ContactOutput) -> Callable[..., None]:
    """Kernel (count, pose, time_step): evaluate all list entries.

    Reads:   velocity, neighbor lists; as `AnyContact`
    Writes:  numbers, force, contact_point of `output`
    """
    particles = state.particles
    neighbors = state.neighbors
    real = state.backend.real
    contacts = state.built(AnyContact)
    histories = state.built(ContactHistory)
    pair_force = PairForce(state.plan.laws, state.plan.features.rotation, False)
    numbers = output.numbers
    laws = state.plan.laws
    cohesion: Any = laws.cohesion

    @ti.kernel
    def evaluate(count: ti.i32, pose: ti.i32, dt: real):
        for i in range(count):
            for list_index in range(neighbors.list_begin[i], neighbors.list_end[i]):
                j = neighbors.partner[list_index]
                kinematics = contacts.kinematics(i, j, pose, dt)
                normal = kinematics.normal
                contact = normal_contact(contacts.bodies(i, j), kinematics, dt)
                numbers[list_index][OVERLAP] = contact.overlap
                if contact.overlap > 0.0:
                    constants = contacts.constants(i, j)
                    history = histories.read(list_index)
                    normal_force, load, _viscous, new = pair_force.normal_force(constants, contact, history)
                    tangential, size, limit = contacts.surface_forces(
                        constants, contact, load, history, particles.velocity[i]
                    )
                    if ti.static(laws.has_viscous_cohesion):
                        rotations = contacts.angular_velocities(i, j, pose)
                        liquid = pair_force.viscous_force(constants, contact, new, kinematics, rotations)
                        normal_force += liquid.normal_force
                        tangential += liquid.force - liquid.normal_force * normal
                    numbers[list_index][NORMAL] = normal_force
                    numbers[list_index][TANGENTIAL] = size
                    numbers[list_index][LIMIT] = limit
                    output.contact_point[list_index] = contacts.point(i, j, pose)
                    output.force[list_index] = normal_force * normal + tangential
                elif ti.static(laws.cohesion_at_distance):
                    numbers[list_index][NORMAL] = 0.0 * contact.overlap
                    numbers[list_index][TANGENTIAL] = 0.0 * contact.overlap
                    numbers[list_index][LIMIT] = 0.0 * contact.overlap
                    output.force[list_index] = 0.0 * normal
                    if contacts.pair.in_range(i, j, contact.overlap):
                        constants = contacts.constants(i, j)
                        history = histories.read(list_index)
                        separated = cohesive_contact(contacts.bodies(i, j), contact.overlap, dt)
                        attraction, bond = cohesion.force(constants.cohesion, separated, history.cohesion)
                        normal_force = -attraction
                        tangential = 0.0 * normal
                        if ti.static(laws.has_viscous_cohesion):
                            history.cohesion = bond
                            rotations = contacts.angular_velocities(i, j, pose)
                            liquid = pair_force.viscous_force(
                                constants, separated, history, kinematics, rotations
                            )
                            normal_force += liquid.normal_force
                            tangential += liquid.force - liquid.normal_force * normal
                        numbers[list_index][NORMAL] = normal_force
                        output.contact_point[list_index] = contacts.point(i, j, pose)
                        output.force[list_index] = normal_force * normal + tangential

    return evaluate


# Sums over all contacts

SUMS = ("contact_count", "overlap_sum")
"""Sums over contacts: count, overlap over the smaller radius."""
LIQUID_SUMS = ("liquid_film_volume", "liquid_bridge_volume")
"""Further sums with a model that transfers liquid: volumes [m3] of the films and of the bridges."""
COUNT, OVERLAP_SUM, FILMS, BRIDGES = range(len(SUMS) + len(LIQUID_SUMS))
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
        self.block = FieldBlock(state.backend)
        chunks = state.plan.capacities.chunks
        self._rows = chunks if state.backend.on_cpu else min(chunks, GPU_ROWS)
        self._names = (*SUMS, *LIQUID_SUMS) if state.plan.features.liquid_transfer else SUMS
        self.sums = self.block.vector(ti.i64, self._rows, count=len(self._names))
        self.energies = self.block.vector(ti.i64, self._rows, count=2 * len(ENERGIES))
        self.largest = self.block.scalar(state.backend.real, self._rows)
        self.block.finish()
        self._measure = _build_measure(state, self.sums, self.energies, self.largest)

    def measure(self, pose: int) -> dict[str, float]:
        """Statistics of all contacts; fills both contact counts.

        pose:  index of the wall poses at the present time, see `WallPoses.index_at`

        Returns SUMS, ENERGIES and `overlap_largest`, the maximum of the overlap over the smaller radius;
        LIQUID_SUMS with a model that transfers liquid.
        """
        state = self.state
        ranks = state.ranks
        chunks = state.chunk_count
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


def _build_measure(state: State, sums: Any, energy_sums: Any, largest: Any) -> Callable[..., None]:
    """Kernel (chunks, rows, count, pose, time_step): sums, energies and largest relative overlap by row.

    A row is that of a chunk, or of every k-th one if there are k rows.

    Reads:   radius, liquid_film, neighbor lists; as `AnyContact`
    Writes:  coordination_number, wall_contact_count, sums, energies, largest
    """
    particles = state.particles
    neighbors = state.neighbors
    has_walls = state.plan.features.walls
    real = state.backend.real
    chunk_size = state.parameter("chunk_size")
    sum_count = sums.n
    contacts = state.built(AnyContact)
    list_shares = build_list_shares(state)
    stride = state.stride
    high_words_per_joule = state.parameter("per_unit", UNIT_ENERGY)
    liquid = state.plan.features.liquid_transfer
    cohesion_history: Any = state.neighbors.history.get("cohesion")
    liquid_unit = state.parameter("liquid_unit") if liquid else None

    @ti.kernel
    def measure(chunks: ti.i32, rows: ti.i32, count: ti.i32, pose: ti.i32, dt: real):
        for i in range(count):
            particles.coordination_number[i] = 0
            if ti.static(has_walls):
                particles.wall_contact_count[i] = 0
        for task in range(rows * stride):
            if task % stride == 0:
                row = task // stride
                found = ti.Vector.zero(ti.i64, sum_count)
                overlap_largest = ti.cast(0.0, real)
                low = ti.Vector.zero(ti.i64, 2)
                high = ti.Vector.zero(ti.i64, 2)
                scale = high_words_per_joule()
                size = chunk_size()
                for k in range(particles_of_row(row, rows, chunks, size, count)):
                    chunk = row + k // size * rows
                    i = chunk * size + k % size
                    if ti.static(liquid):  # in half units: those that bridges return
                        found[FILMS] += to_units(SHARES * particles.liquid_film[i] / liquid_unit())
                    for list_index in range(neighbors.list_begin[i], neighbors.list_end[i]):
                        j = neighbors.partner[list_index]
                        contact = normal_contact(
                            contacts.bodies(i, j), contacts.kinematics(i, j, pose, dt), dt
                        )
                        shares = list_shares(chunk, j)
                        if ti.static(liquid):
                            bridge = cohesion_history[list_index][0] / liquid_unit()
                            found[BRIDGES] += shares * to_units(bridge)
                        if contacts.pair.in_range(i, j, contact.overlap):
                            elastic, plastic = contacts.energies(
                                list_index, contacts.constants(i, j), contact
                            )
                            elastic_low, elastic_high = energy_words(scale * elastic)
                            plastic_low, plastic_high = energy_words(scale * plastic)
                            low += shares * ti.Vector([elastic_low, plastic_low])
                            high += shares * ti.Vector([elastic_high, plastic_high])
                        if contact.overlap > 0.0:
                            radius_min = particles.radius[i]
                            if j >= 0:
                                radius_min = ti.min(radius_min, particles.radius[j])
                            relative = contact.overlap / radius_min
                            found[COUNT] += shares
                            found[OVERLAP_SUM] += shares * to_units(relative / OVERLAP_UNIT)
                            overlap_largest = ti.max(overlap_largest, relative)
                            if j >= 0:
                                particles.coordination_number[i] += 1
                                if shares == SHARES:
                                    particles.coordination_number[j] += 1
                            elif ti.static(has_walls):
                                particles.wall_contact_count[i] += 1
                sums[row] = found
                largest[row] = overlap_largest
                energy_sums[row] = carried(ti.Vector([low[0], low[1], high[0], high[1]]), 2)

    return measure


@ti.func
def particles_of_row(row, rows, chunks, size, count):
    """Number of particles of the chunks row, row + rows, ...; only the last chunk can be incomplete."""
    chunk_count = (chunks - row + rows - 1) // rows
    last = row + (chunk_count - 1) * rows
    return chunk_count * size - ti.max((last + 1) * size - count, 0)


# Largest impact velocity


class MaxImpactVelocity:
    """Evaluates all candidate pairs and walls. The result is a maximum, independent of threads and order."""

    def __init__(self, state: State) -> None:
        self.state = state
        self.block = FieldBlock(state.backend)
        self._squares = self.block.scalar(state.backend.real, state.plan.capacities.chunks)
        self.block.finish()
        self._scan = _build_scan(state, self._squares)

    def measure(self) -> float:
        """Largest impact velocity [m/s] of all candidate pairs, with the elastic energy of overlaps.

        On MPI ranks, of those of all ranks.
        """
        state = self.state
        largest = 0.0
        if state.count:
            self._scan(state.chunk_count, state.count, state.clock.time_step)
            largest = float(np.sqrt(self._squares.to_numpy()[: state.chunk_count].max()))
        return state.ranks.largest(largest)


def _build_scan(state: State, squares: Any) -> Any:
    """Kernel (chunks, count, time_step): largest squared impact velocity [m2/s2] of each chunk.

    Reads:   neighbor lists; as `Impacts`
    Writes:  squares
    """
    neighbors = state.neighbors
    stride = state.stride
    real = state.backend.real
    chunk_size = state.parameter("chunk_size")
    impacts = Impacts(state)

    @ti.kernel
    def scan(chunks: ti.i32, count: ti.i32, dt: real):
        for task in range(chunks * stride):
            if task % stride == 0:
                chunk = task // stride
                largest = ti.cast(0.0, real)
                for i in range(chunk * chunk_size(), ti.min((chunk + 1) * chunk_size(), count)):
                    for list_index in range(neighbors.list_begin[i], neighbors.list_end[i]):
                        j = neighbors.partner[list_index]
                        largest = ti.max(largest, impacts.velocity_squared(i, j, dt))
                squares[chunk] = largest

    return scan


class Impacts:
    """Impact velocities of pairs. Walls are at pose 0, with their velocities in the next step: motions can
    begin now. Velocities of particles are half a step behind the positions.

    Reads:  position, velocity, radius; as `AnyContact` and `WallGeometry`
    """

    def __init__(self, state: State) -> None:
        self.particles = state.particles
        self.real = state.backend.real
        self.has_walls = state.plan.features.walls
        self.contacts = state.built(AnyContact)
        self.geometry = state.built(WallGeometry)

    @ti.func
    def velocity_squared(self, i, j, dt):
        """Squared impact velocity [m2/s2] with the kinetic and the elastic energy of a pair.

            v^2 = d'^2 + 4 k d^2.5 / (5 M)        (Zhou 2011, Eq. 5)

        For a pair without overlap v is the approach velocity, 0 if the pair separates.
        """
        overlap, rate = self._overlap_and_rate(i, j, dt)
        found = ti.max(rate, 0.0) ** 2
        if overlap > 0.0:
            bodies = self.contacts.bodies(i, j)
            constants = self.contacts.constants(i, j)
            k = 4.0 / 3.0 * constants.normal.modulus_eff * ti.sqrt(bodies.radius_eff)
            found = rate * rate + 0.8 * k * overlap * overlap * ti.sqrt(overlap) / bodies.mass_eff
        return found

    @ti.func
    def _overlap_and_rate(self, i, j, dt):
        """Overlap [m], negative for a gap, and overlap rate [m/s] of a pair."""
        position = self.particles.position[i]
        velocity = self.particles.velocity[i]
        radius = self.particles.radius[i]
        overlap = 0.0 * radius
        rate = 0.0 * radius
        if j >= 0:
            branch = self.contacts.pair.branch(position, j, 0)
            kinematics = self.contacts.pair.spheres(i, j, branch, 0, dt)
            overlap = kinematics.overlap
            rate = kinematics.overlap_rate_half
        elif ti.static(self.has_walls):
            gap, normal = self.geometry.contact(-1 - j, 0, position)
            wall_velocity = self.geometry.velocity_in_step(-1 - j, 0, 1, position)
            overlap = ti.cast(radius - gap, self.real)
            rate = -(velocity - ti.cast(wall_velocity, self.real)).dot(ti.cast(normal, self.real))
        return overlap, rate


# Parts of several of them: the candidate pairs, and one contact


def candidate_pairs(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All candidate pairs on the host; pairs across two chunks occur twice.

    Returns:  owner (p,), list index (p,) and partner (p,), int64; a negative partner is a wall, see
              `walls_of`
    """
    rows = state.built(list_table).take(slice(0, state.count))
    begin = rows["begin"]
    lengths = rows["end"] - begin
    owner = np.repeat(np.arange(state.count), lengths)
    list_index = consecutive(begin, lengths).astype(np.int64)
    return owner, list_index, state.built(_partner_table).take(list_index)["partner"].astype(np.int64)


def _partner_table(state: State) -> FieldTable:
    """Table of the partners of all list entries."""
    return FieldTable({"partner": state.neighbors.partner})


class AnyContact:
    """Device functions of the contact of particle i with any partner j, where speed does not matter.

    `pose` is the index of the poses of the walls, `dt` the time step [s]; `constants` are those of all slots.

    Reads:  as `Pair`; history
    """

    def __init__(self, state: State) -> None:
        self.particles = state.particles
        self.laws = state.plan.laws
        self.has_walls = state.plan.features.walls
        self.energy_budget = state.plan.features.energy_budget
        self.histories = state.built(ContactHistory)
        self.geometry = state.built(WallGeometry)
        self.box = state.built(DeviceBox)
        self.pair = state.built(Pair, False)
        self.wall_pair = state.built(Pair, True)
        self.constants = self.pair.constants

    @ti.func
    def bodies(self, i, j):
        """Effective radius, mass and inertia, as of `Pair.bodies`."""
        found = self.wall_pair.bodies(i, j)
        if j >= 0:
            found = self.pair.bodies(i, j)
        return found

    @ti.func
    def kinematics(self, i, j, pose, dt):
        """Kinematics, as of `Pair`."""
        found = no_contact(0.0 * self.particles.radius[i], self.particles.velocity[i])
        if j >= 0:
            found = self.pair.kinematics(i, j, pose, dt)
        elif ti.static(self.has_walls):
            found = self.wall_pair.kinematics(i, j, pose, dt)
        return found

    @ti.func
    def angular_velocities(self, i, j, pose):
        """Angular velocities, as of `Pair`."""
        found = self.wall_pair.angular_velocities(i, j, pose)
        if j >= 0:
            found = self.pair.angular_velocities(i, j, pose)
        return found

    @ti.func
    def point(self, i, j, pose):
        """Contact point [m] with a wall; for particles the wrapped position of i."""
        contact_point = self.box.wrap_position(self.particles.position[i])
        if ti.static(self.has_walls):
            if j < 0:
                gap, direction = self.geometry.contact(-1 - j, pose, contact_point)
                contact_point -= gap * direction
        return contact_point

    @ti.func
    def surface_forces(self, constants, contact, load, history, vector):
        """Tangential force, its size and its limit [N]; all are 0 without a tangential model.

        vector:  gives the type of the force
        """
        force = 0.0 * vector
        size = 0.0 * load
        limit = 0.0 * load
        if ti.static(self.laws.has_tangential):
            surface = ti.Struct(
                radius_eff=contact.radius_eff,
                normal_load=load,
                stiffness=self.laws.normal.tangential_stiffness(constants.normal, contact, history.normal),
            )
            force, size = self.laws.tangential.present_force(
                constants.tangential, surface, history.tangential
            )
            limit = self.laws.tangential.limit(constants.tangential, surface)
        return force, size, limit

    @ti.func
    def energies(self, list_index, constants, contact):
        """Stored energy of all models and plastic work [J]; both are 0 without the energy budget."""
        stored = 0.0 * contact.overlap
        lost = 0.0 * contact.overlap
        if ti.static(self.energy_budget):
            history = self.histories.read(list_index)
            if contact.overlap > 0.0:
                stored = self.laws.normal.stored_energy(constants.normal, contact, history.normal)
                lost = self.laws.normal.lost_energy(constants.normal, contact, history.normal)
            if ti.static(self.laws.has_cohesion):
                stored += self.laws.cohesion.stored_energy(constants.cohesion, contact, history.cohesion)
                lost += self.laws.cohesion.lost_energy(constants.cohesion, contact, history.cohesion)
            if contact.overlap > 0.0:
                surface = ti.Struct(
                    radius_eff=contact.radius_eff,
                    mass_eff=contact.mass_eff,
                    overlap=contact.overlap,
                    stiffness=self.laws.normal.tangential_stiffness(
                        constants.normal, contact, history.normal
                    ),
                )
                for slot, law in ti.static(self.laws.on_surface):
                    stored += law.stored_energy(member(constants, slot), surface, member(history, slot))
        return stored, lost
