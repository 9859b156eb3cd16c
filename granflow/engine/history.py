"""Contact history: what the contact models remember of a contact from one step to the next.

It is stored per neighbor-list entry, by slot (normal, tangential, rolling, twisting, cohesion) as a vector of
components; the models get it as structs (`contact_structs.py`). `in_contact` is the state of the entry. A
step reads the history, writes the new one, and ends the contact if the pair has separated.

A history outlives its entry in two cases: a contact that slides from one face of the walls to another takes
it along, and a neighbor-list rebuild saves the histories before it sorts the particles and restores them in
the new lists.
"""

from typing import Any

from granflow.engine.contact_structs import build_read_slots, build_slot_vector, member
from granflow.engine.neighbor.phases import is_count
from granflow.engine.pair import build_pair_constants
from granflow.engine.state import State
from granflow.engine.sums import add_energy, build_list_shares
from granflow.engine.walls import WallGeometry
from granflow.kernel_language import ti
from granflow.plan.sum_units import LOSS_PLASTIC, LOSSES, UNIT_ENERGY

NO_CONTACT, IN_CONTACT, RELEASED = range(3)
"""State of a neighbor-list entry: no contact; in contact; or history that another entry may acquire in this
step."""


# One entry: read, write, end


def build_read_history(state: State) -> Any:
    """Device function (list index) -> struct of slots, each a struct of the history fields of its model.

    Reads:  history
    """
    stored = state.neighbors.history

    @ti.func
    def read_vector(slot: ti.template(), list_index, _):
        return stored[slot][list_index]

    read_slots = build_read_slots(state.plan.laws, read_vector, stored)

    @ti.func
    def read_history(list_index):
        return read_slots(list_index, 0)

    return read_history


def build_write_history(state: State) -> Any:
    """Device function (list index, history struct): write the history; set IN_CONTACT.

    Writes:  history, in_contact
    """
    neighbors = state.neighbors
    stored = state.neighbors.history
    slots = [(slot, build_slot_vector(state.plan.laws, slot)) for slot in stored]

    @ti.func
    def write_history(list_index, history):
        if ti.static(len(slots) > 0):
            neighbors.in_contact[list_index] = IN_CONTACT
        for slot, vector_of in ti.static(slots):
            stored[slot][list_index] = vector_of(member(history, slot))

    return write_history


def build_end_contact(state: State) -> Any:
    """Device function (list index, constants, bodies, dt): clear an open contact.

    Returns the plastic work [J] of a contact that has ended in this step; 0 without the energy budget.

    Writes:  history, in_contact
    """
    laws = state.plan.laws
    neighbors = state.neighbors
    names = list(state.neighbors.history)
    energy_budget = state.plan.features.energy_budget
    read_history = build_read_history(state)
    normal_loss = build_normal_loss(state)

    @ti.func
    def lost_energy(list_index, constants, bodies, dt):
        energy = normal_loss(list_index, constants, bodies, dt)
        if ti.static("cohesion" in names):
            overlap = 0.0 * bodies.radius_eff
            if ti.static(laws.acts_at_distance):
                overlap = -constants.cohesion.range
            contact = cohesive_contact(bodies, overlap, dt)
            energy += laws.cohesion.lost_energy(
                constants.cohesion, contact, read_history(list_index).cohesion
            )
        return energy

    @ti.func
    def end_contact(list_index, constants, bodies, dt):
        energy_lost = 0.0 * dt
        if ti.static(len(names) > 0):
            if neighbors.in_contact[list_index] != NO_CONTACT:
                if ti.static(energy_budget):
                    energy_lost = lost_energy(list_index, constants, bodies, dt)
                for name in ti.static(names):
                    neighbors.history[name][list_index] = 0.0 * neighbors.history[name][list_index]
                neighbors.in_contact[list_index] = NO_CONTACT
        return energy_lost

    return end_contact


def build_normal_loss(state: State) -> Any:
    """Device function (list index, constants, bodies, dt) -> plastic work [J] of a contact whose
    overlap ends.

    A bond without overlap has an empty history of the normal model, of which models with stored stiffness
    make 0/0.

    Reads:  history
    """
    law = state.plan.laws.normal
    neighbors = state.neighbors
    read_history = build_read_history(state)
    has_history = "normal" in neighbors.history
    with_bonds = state.plan.laws.acts_at_distance

    @ti.func
    def normal_loss(list_index, constants, bodies, dt):
        energy = 0.0 * dt
        nothing = 0.0 * bodies.radius_eff
        if ti.static(has_history):
            has_overlapped = True
            if ti.static(with_bonds):
                has_overlapped = ti.abs(neighbors.history["normal"][list_index]).max() > 0.0
            if has_overlapped:
                contact = ti.Struct(
                    radius_eff=bodies.radius_eff,
                    mass_eff=bodies.mass_eff,
                    time_step=dt,
                    overlap=nothing,
                    overlap_rate=nothing,
                )
                energy = law.lost_energy(constants.normal, contact, read_history(list_index).normal)
        return energy

    return normal_loss


@ti.func
def cohesive_contact(bodies, overlap, dt):
    """The struct `contact` of cohesion models, for a pair whose overlap [m] is constant during the step."""
    return ti.Struct(
        radius_eff=bodies.radius_eff,
        mass_eff=bodies.mass_eff,
        time_step=dt,
        overlap=overlap,
        overlap_rate=0.0 * overlap,
    )


def build_add_plastic_loss(state: State) -> Any:
    """Device function (chunk, j, energy [J]): add the plastic work of a contact that has ended.

    Writes:  losses
    """
    control = state.control
    list_shares = build_list_shares(state)
    energy_budget = state.plan.features.energy_budget
    high_words_per_joule = state.parameter("per_unit", UNIT_ENERGY)
    loss_count = len(LOSSES)

    @ti.func
    def add_plastic_loss(chunk, j, energy_lost):
        if ti.static(energy_budget):
            value = high_words_per_joule() * energy_lost
            add_energy(control.losses, chunk, LOSS_PLASTIC, loss_count, list_shares(chunk, j), value)

    return add_plastic_loss


# Transfer of the history if a contact passes from one face to another, of the same wall or of another one
#
# The history belongs to the contact point: a contact that slides over an edge, from one wall to the next, or
# across a periodic boundary, continues. The wall entries of a particle are evaluated in three passes:
# existing contacts; then new contacts, which may acquire the history that a contact of the first pass
# released; then the released entries, whose remaining history is cleared.

CONTACT_ORDER = (IN_CONTACT, NO_CONTACT, RELEASED)
"""State of the entries evaluated in each pass."""


def transfers_history(state: State) -> bool:
    """True if wall contacts can pass to another list entry and have a history to transfer."""
    features = state.plan.features
    return (features.mesh_walls or features.joined_walls) and bool(state.neighbors.history)


def build_release_history(state: State) -> Any:
    """Device function (i, list index, j, pose): release the history of an entry for another entry; 1 if
    released.

    The history is released if the face no longer has the contact although the sphere still reaches it:
    another face has the contact now.

    Reads:   position, radius, walls, mesh
    Writes:  in_contact
    """
    particles = state.particles
    neighbors = state.neighbors
    geometry = WallGeometry(state)
    acts_at_distance = state.plan.laws.acts_at_distance
    pair_constants = build_pair_constants(state)

    @ti.func
    def release_history(i, list_index, j, pose):
        released = 0
        if neighbors.in_contact[list_index] == IN_CONTACT:
            largest_distance = particles.radius[i]
            if ti.static(acts_at_distance):
                largest_distance += pair_constants(i, j).cohesion.range
            if geometry.from_surface(-1 - j, pose, particles.position[i]).norm() < largest_distance:
                neighbors.in_contact[list_index] = RELEASED
                released = 1
        return released

    return release_history


def build_acquire_history(state: State) -> Any:
    """Device function (i, list index, j, pose): a new contact acquires the nearest released history.

    The distance is that between the nearest points of the two faces, at most one radius: a contact with the
    other side of a corner is another contact. The history moves: the source entry is cleared.

    Reads:   position, radius, neighbor lists, walls, mesh
    Writes:  history, in_contact
    """
    particles = state.particles
    neighbors = state.neighbors
    geometry = WallGeometry(state)
    names = list(neighbors.history)

    @ti.func
    def released_near(i, j, pose):
        """List index of the nearest released history; -1 if none."""
        found = -1
        nearest = particles.radius[i]
        position = particles.position[i]
        from_nearest = 0.0 * position
        is_known = 0
        # A sphere has few wall entries, so that a search among all of them is cheap.
        for list_index in range(neighbors.list_begin[i], neighbors.list_walls_end[i]):
            if neighbors.in_contact[list_index] == RELEASED:
                for side in range(2):  # this face, then the other: `from_surface` is compiled once
                    if side == 1 or is_known == 0:
                        face = -1 - j
                        if side == 1:
                            face = -1 - neighbors.partner[list_index]
                        separation = geometry.from_surface(face, pose, position)
                        if side == 0:
                            from_nearest = separation
                            is_known = 1
                        elif (separation - from_nearest).norm() < nearest:
                            found = list_index
                            nearest = (separation - from_nearest).norm()
        return found

    @ti.func
    def acquire_history(i, list_index, j, pose):
        if neighbors.in_contact[list_index] == NO_CONTACT:
            source = released_near(i, j, pose)
            if source >= 0:
                for name in ti.static(names):
                    neighbors.history[name][list_index] = neighbors.history[name][source]
                    neighbors.history[name][source] = 0.0 * neighbors.history[name][source]
                neighbors.in_contact[source] = NO_CONTACT
                neighbors.in_contact[list_index] = IN_CONTACT

    return acquire_history


# Neighbor-list rebuild: saved before the particles are sorted, restored for each new list entry


def vector_components(state: State, slot: str) -> list[bool]:
    """For each component of a history, whether it is one of a vector: it changes its sign with the order of a
    pair."""
    return [each.size > 1 for each in state.plan.laws.history[slot] for _ in range(each.size)]


def build_save_history(state: State) -> Any:
    """Device function (chunk, first, end): copy history entries of a chunk to `saved` for `restore_history`.

    Entries beyond the capacity of a segment are not saved, and the host repeats the rebuild with a larger
    capacity (`list_length_needed`, see `neighbor.list.TOO_LONG`). If each particle is a chunk, it reserves
    its entries by an atomic addition: their places depend on the threads, and nothing depends on their
    places.

    On MPI ranks the partner is saved by its id: ghosts have other indices afterwards.

    Reads:   neighbor lists, in_contact, history, id
    Writes:  saved, partner_saved, list_begin_before, list_end_before, list_length_needed
    """
    neighbors = state.neighbors
    names = list(state.neighbors.history)
    has_ghosts = state.plan.has_ghosts
    saved_capacity = state.parameter("saved_capacity")
    one_segment = state.plan.chunk_size == 1

    @ti.func
    def entries_in_contact(i):
        count = 0
        list_index = neighbors.list_begin[i]
        while (list_index < neighbors.list_end[i]) & is_count(count):
            count += ti.cast(neighbors.in_contact[list_index] == IN_CONTACT, ti.i32)
            list_index += 1
        return count

    @ti.func
    def save_entry(list_index, saved_index):
        partner = neighbors.partner[list_index]
        if ti.static(has_ghosts):
            if partner >= 0:
                partner = state.particles.id[partner]
        neighbors.partner_saved[saved_index] = partner
        for name in ti.static(names):
            neighbors.saved[name][saved_index] = neighbors.history[name][list_index]

    @ti.func
    def save_history(chunk, first, end):
        begin = chunk * saved_capacity()
        limit = saved_capacity()
        if ti.static(one_segment):
            begin = ti.atomic_add(state.control.list_length_needed[0], entries_in_contact(first))
        else:
            limit += begin
        saved_index = begin
        i = first
        while (i < end) & is_count(saved_index):
            neighbors.list_begin_before[i] = saved_index
            list_index = neighbors.list_begin[i]
            while (list_index < neighbors.list_end[i]) & is_count(saved_index):
                if neighbors.in_contact[list_index] == IN_CONTACT:
                    if saved_index < limit:
                        save_entry(list_index, saved_index)
                    saved_index += 1
                list_index += 1
            neighbors.list_end_before[i] = saved_index
            i += 1
        if ti.static(not one_segment):
            ti.atomic_max(state.control.list_length_needed[0], saved_index - begin)

    return save_history


def build_restore_history(state: State) -> Any:
    """Device function (list index, i, j): copy the history of a pair from before the sort to its new list
    entry.

    If the pair was in the list of the partner, vectors change their sign. Without a saved history all values
    are zero. On MPI ranks the histories are saved with the ids of the partners, and the range of each
    particle at its new index; the range of a ghost that this rank has owned is that of before.

    Reads:   order, id, saved, partner_saved
    Writes:  history, in_contact
    """
    neighbors = state.neighbors
    source_of = _build_source(state)
    names = list(state.neighbors.history)
    components = [
        (name, k, changes_sign)
        for name in names
        for k, changes_sign in enumerate(vector_components(state, name))
    ]

    @ti.func
    def restore_history(list_index, i, j):
        source, sign = source_of(i, j)
        neighbors.in_contact[list_index] = NO_CONTACT
        if source >= 0:
            neighbors.in_contact[list_index] = IN_CONTACT
            for name, k, changes_sign in ti.static(components):
                value = neighbors.saved[name][source][k]
                if ti.static(changes_sign):
                    value = sign * value
                neighbors.history[name][list_index][k] = value
        else:
            for name, k, _ in ti.static(components):
                neighbors.history[name][list_index][k] = 0.0

    return restore_history


def _build_source(state: State) -> Any:
    """Device function (i, j): index of the saved history of a pair, -1 if none, and the sign of its vectors.

    Reads:   order, id, partner_saved
    """
    neighbors = state.neighbors
    sorting = state.cell_sort
    chunk_size = state.parameter("chunk_size")

    @ti.func
    def find_saved(row, partner):
        """Index in `saved` of a partner of the particle `row`; -1 if none."""
        found = -1
        list_index = neighbors.list_begin_before[row]
        while (found < 0) & (list_index < neighbors.list_end_before[row]):
            if neighbors.partner_saved[list_index] == partner:
                found = list_index
            list_index += 1
        return found

    @ti.func
    def find_either(row, partner, row_other, partner_other, has_other):
        """Search of the list of one particle, then of the other one; one call of `find_saved`, compiled
        once."""
        source = -1
        sign = 1.0
        row_now = row
        partner_now = partner
        attempt = 0
        while (source < 0) & (attempt <= has_other):
            if attempt == 1:
                sign = -1.0
                row_now = row_other
                partner_now = partner_other
            source = find_saved(row_now, partner_now)
            attempt += 1
        return source, sign

    @ti.func
    def source_before_sort(i, j):
        i_before = sorting.order[i]
        j_before = j
        same_chunk = 0
        if j >= 0:
            j_before = sorting.order[j]
            same_chunk = ti.cast(i_before // chunk_size() == j_before // chunk_size(), ti.i32)
        return find_either(i_before, j_before, j_before, i_before, same_chunk)

    @ti.func
    def source_by_id(i, j):
        """As `source_before_sort`, on MPI ranks."""
        partner = j
        is_particle = ti.cast(j >= 0, ti.i32)
        if j >= 0:
            partner = state.particles.id[j]
        return find_either(i, partner, j, state.particles.id[i], is_particle)

    return source_by_id if state.plan.has_ghosts else source_before_sort
