"""Contact history: what the contact models remember of a contact from one step to the next.

It is stored per neighbor-list entry, by slot (normal, tangential, rolling, twisting, cohesion) as a vector of
components; the models get it as structs (`pair.ModelStructs`). `in_contact` is the state of the entry. A
step reads the history, writes the new one, and ends the contact if the pair has separated.

A history outlives its entry in two cases: a contact that slides from one face of the walls to another takes
it along, and a neighbor-list rebuild saves the histories before it sorts the particles and restores them in
the new lists.
"""

from granflow.engine.neighbor.phases import is_count
from granflow.engine.pair import ModelStructs, Pair, member
from granflow.engine.state import State
from granflow.engine.sums import add_energy, build_list_shares
from granflow.engine.walls import WallGeometry
from granflow.kernel_language import ti
from granflow.plan.sum_units import LOSS_PLASTIC, LOSSES, UNIT_ENERGY

NO_CONTACT, IN_CONTACT, RELEASED = range(3)
"""State of a neighbor-list entry: no contact; in contact; or history that another entry may acquire in this
step."""


# One entry: read, write, end


class ContactHistory:
    """Reads, writes and ends the history of a neighbor-list entry.

    In methods, `constants` and `bodies` are those of the pair, see `pair.py`; a history is a struct of slots,
    each a struct of the history fields of its model.

    Reads:   history, in_contact
    Writes:  history, in_contact, losses
    """

    def __init__(self, state: State) -> None:
        self.laws = state.plan.laws
        self.energy_budget = state.plan.features.energy_budget
        self.neighbors = state.neighbors
        self.stored = state.neighbors.history
        self.names = list(self.stored)
        self.structs = ModelStructs(self.laws)
        self.losses = state.control.losses
        self.list_shares = build_list_shares(state)
        self.high_words_per_joule = state.parameter("per_unit", UNIT_ENERGY)

    @ti.func
    def read(self, list_index):
        """The history of an entry."""
        return self.structs.histories(self._vector, list_index, 0)

    @ti.func
    def _vector(self, slot: ti.template(), list_index, _):
        return self.stored[slot][list_index]

    @ti.func
    def write(self, list_index, history):
        """Write the history; set IN_CONTACT."""
        if ti.static(len(self.names) > 0):
            self.neighbors.in_contact[list_index] = IN_CONTACT
        for slot in ti.static(self.names):
            self.stored[slot][list_index] = self.structs.vector(slot, member(history, slot))

    @ti.func
    def end(self, list_index, constants, bodies, dt):
        """Clear an open contact.

        Returns the plastic work [J] of a contact that has ended in this step; 0 without the energy budget.
        """
        energy_lost = 0.0 * dt
        if ti.static(len(self.names) > 0):
            if self.neighbors.in_contact[list_index] != NO_CONTACT:
                if ti.static(self.energy_budget):
                    energy_lost = self._lost_energy(list_index, constants, bodies, dt)
                for name in ti.static(self.names):
                    self.stored[name][list_index] = 0.0 * self.stored[name][list_index]
                self.neighbors.in_contact[list_index] = NO_CONTACT
        return energy_lost

    @ti.func
    def _lost_energy(self, list_index, constants, bodies, dt):
        energy = self.normal_loss(list_index, constants, bodies, dt)
        if ti.static("cohesion" in self.names):
            overlap = 0.0 * bodies.radius_eff
            if ti.static(self.laws.cohesion_at_distance):
                overlap = -constants.cohesion.range
            contact = cohesive_contact(bodies, overlap, dt)
            energy += self.laws.cohesion.lost_energy(
                constants.cohesion, contact, self.read(list_index).cohesion
            )
        return energy

    @ti.func
    def normal_loss(self, list_index, constants, bodies, dt):
        """Plastic work [J] of a contact whose overlap ends.

        A bond without overlap has an empty history of the normal model, of which models with stored stiffness
        make 0/0.
        """
        energy = 0.0 * dt
        nothing = 0.0 * bodies.radius_eff
        if ti.static("normal" in self.names):
            has_overlapped = True
            if ti.static(self.laws.cohesion_at_distance):
                has_overlapped = ti.abs(self.stored["normal"][list_index]).max() > 0.0
            if has_overlapped:
                contact = ti.Struct(
                    radius_eff=bodies.radius_eff,
                    mass_eff=bodies.mass_eff,
                    time_step=dt,
                    overlap=nothing,
                    overlap_rate=nothing,
                )
                energy = self.laws.normal.lost_energy(constants.normal, contact, self.read(list_index).normal)
        return energy

    @ti.func
    def add_plastic_loss(self, chunk, j, energy_lost):
        """Add the plastic work [J] of a contact with j that has ended."""
        if ti.static(self.energy_budget):
            value = self.high_words_per_joule() * energy_lost
            terms = ti.static(len(LOSSES))
            add_energy(self.losses, chunk, LOSS_PLASTIC, terms, self.list_shares(chunk, j), value)


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


class HistoryTransfer:
    """Moves the history of a wall contact from one entry of a particle to another one.

    Reads:   position, radius, material, neighbor lists, walls, mesh, pair_constants, law_parameters
    Writes:  history, in_contact
    """

    def __init__(self, state: State) -> None:
        self.particles = state.particles
        self.neighbors = state.neighbors
        self.stored = state.neighbors.history
        self.names = list(self.stored)
        self.geometry = state.built(WallGeometry)
        self.cohesion_at_distance = state.plan.laws.cohesion_at_distance
        self.pair = state.built(Pair, True)

    @ti.func
    def release(self, i, list_index, j, pose):
        """Release the history of an entry for another entry; 1 if released.

        It is released if the face no longer has the contact although the sphere still reaches it: another
        face has the contact now.
        """
        released = 0
        if self.neighbors.in_contact[list_index] == IN_CONTACT:
            largest_distance = self.particles.radius[i]
            if ti.static(self.cohesion_at_distance):
                largest_distance += self.pair.constants(i, j).cohesion.range
            if self.geometry.from_nearest(-1 - j, pose, self.particles.position[i]).norm() < largest_distance:
                self.neighbors.in_contact[list_index] = RELEASED
                released = 1
        return released

    @ti.func
    def acquire(self, i, list_index, j, pose):
        """A new contact acquires the nearest released history.

        The distance is that between the nearest points of the two faces, at most one radius: a contact with
        the other side of a corner is another contact. The history moves: the source entry is cleared.
        """
        if self.neighbors.in_contact[list_index] == NO_CONTACT:
            source = self._released_near(i, j, pose)
            if source >= 0:
                for name in ti.static(self.names):
                    self.stored[name][list_index] = self.stored[name][source]
                    self.stored[name][source] = 0.0 * self.stored[name][source]
                self.neighbors.in_contact[source] = NO_CONTACT
                self.neighbors.in_contact[list_index] = IN_CONTACT

    @ti.func
    def _released_near(self, i, j, pose):
        """List index of the nearest released history; -1 if none."""
        found = -1
        nearest = self.particles.radius[i]
        position = self.particles.position[i]
        from_nearest = 0.0 * position
        is_known = 0
        # A sphere has few wall entries, so that a search among all of them is cheap.
        for list_index in range(self.neighbors.list_begin[i], self.neighbors.list_walls_end[i]):
            if self.neighbors.in_contact[list_index] == RELEASED:
                for side in range(2):  # this face, then the other: `from_nearest` is compiled once
                    if side == 1 or is_known == 0:
                        face = -1 - j
                        if side == 1:
                            face = -1 - self.neighbors.partner[list_index]
                        separation = self.geometry.from_nearest(face, pose, position)
                        if side == 0:
                            from_nearest = separation
                            is_known = 1
                        elif (separation - from_nearest).norm() < nearest:
                            found = list_index
                            nearest = (separation - from_nearest).norm()
        return found


# Neighbor-list rebuild: saved before the particles are sorted, restored for each new list entry


def vector_components(state: State, slot: str) -> list[bool]:
    """For each component of a history, whether it is one of a vector: it changes its sign with the order of a
    pair."""
    return [each.size > 1 for each in state.plan.laws.history[slot] for _ in range(each.size)]


class SavedHistory:
    """Saves the histories before a sort of the particles, and restores them in the new lists.

    On MPI ranks the partner is saved by its id: ghosts have other indices afterwards. The range of saved
    histories of each particle is then at its new index; that of a ghost that this rank has owned is that of
    before.

    Reads:   neighbor lists, in_contact, history, id, order, saved, partner_saved
    Writes:  saved, partner_saved, list_begin_before, list_end_before, list_length_needed, history, in_contact
    """

    def __init__(self, state: State) -> None:
        self.neighbors = state.neighbors
        self.stored = state.neighbors.history
        self.saved = state.neighbors.saved
        self.names = list(self.stored)
        self.components = [
            (name, k, changes_sign)
            for name in self.names
            for k, changes_sign in enumerate(vector_components(state, name))
        ]
        self.id = state.particles.id
        self.order = state.cell_sort.order
        self.list_length_needed = state.control.list_length_needed
        self.has_ghosts = state.plan.has_ghosts
        self.one_segment = state.plan.chunk_size == 1
        self.chunk_size = state.parameter("chunk_size")
        self.saved_capacity = state.parameter("saved_capacity")
        self.source_of = self._source_by_id if self.has_ghosts else self._source_before_sort

    @ti.func
    def save(self, chunk, first, end):
        """Copy the history entries of the particles `first` to `end`, exclusive, of a chunk.

        Entries beyond the capacity of a segment are not saved, and the host repeats the rebuild with a larger
        capacity (`list_length_needed`, see `neighbor.list.TOO_LONG`). If each particle is a chunk, it
        reserves its entries by an atomic addition: their places depend on the threads, and nothing depends on
        their places.
        """
        begin = chunk * self.saved_capacity()
        limit = self.saved_capacity()
        if ti.static(self.one_segment):
            begin = ti.atomic_add(self.list_length_needed[0], self._entries_in_contact(first))
        else:
            limit += begin
        saved_index = begin
        i = first
        while (i < end) & is_count(saved_index):
            self.neighbors.list_begin_before[i] = saved_index
            list_index = self.neighbors.list_begin[i]
            while (list_index < self.neighbors.list_end[i]) & is_count(saved_index):
                if self.neighbors.in_contact[list_index] == IN_CONTACT:
                    if saved_index < limit:
                        self._save_entry(list_index, saved_index)
                    saved_index += 1
                list_index += 1
            self.neighbors.list_end_before[i] = saved_index
            i += 1
        if ti.static(not self.one_segment):
            ti.atomic_max(self.list_length_needed[0], saved_index - begin)

    @ti.func
    def _entries_in_contact(self, i):
        count = 0
        list_index = self.neighbors.list_begin[i]
        while (list_index < self.neighbors.list_end[i]) & is_count(count):
            count += ti.cast(self.neighbors.in_contact[list_index] == IN_CONTACT, ti.i32)
            list_index += 1
        return count

    @ti.func
    def _save_entry(self, list_index, saved_index):
        partner = self.neighbors.partner[list_index]
        if ti.static(self.has_ghosts):
            if partner >= 0:
                partner = self.id[partner]
        self.neighbors.partner_saved[saved_index] = partner
        for name in ti.static(self.names):
            self.saved[name][saved_index] = self.stored[name][list_index]

    @ti.func
    def restore(self, list_index, i, j):
        """Copy the history of a pair from before the sort to its new list entry.

        If the pair was in the list of the partner, vectors change their sign. Without a saved history all
        values are zero.
        """
        source, sign = self.source_of(i, j)
        self.neighbors.in_contact[list_index] = NO_CONTACT
        if source >= 0:
            self.neighbors.in_contact[list_index] = IN_CONTACT
            for name, k, changes_sign in ti.static(self.components):
                value = self.saved[name][source][k]
                if ti.static(changes_sign):
                    value = sign * value
                self.stored[name][list_index][k] = value
        else:
            for name, k, _ in ti.static(self.components):
                self.stored[name][list_index][k] = 0.0

    @ti.func
    def _source_before_sort(self, i, j):
        """Index of the saved history of a pair, -1 if none, and the sign of its vectors."""
        i_before = self.order[i]
        j_before = j
        same_chunk = 0
        if j >= 0:
            j_before = self.order[j]
            same_chunk = ti.cast(i_before // self.chunk_size() == j_before // self.chunk_size(), ti.i32)
        return self._find_either(i_before, j_before, j_before, i_before, same_chunk)

    @ti.func
    def _source_by_id(self, i, j):
        """As `_source_before_sort`, on MPI ranks."""
        partner = j
        is_particle = ti.cast(j >= 0, ti.i32)
        if j >= 0:
            partner = self.id[j]
        return self._find_either(i, partner, j, self.id[i], is_particle)

    @ti.func
    def _find_either(self, row, partner, row_other, partner_other, has_other):
        """Search of the list of one particle, then of the other one; one call of `_find_saved`, compiled
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
            source = self._find_saved(row_now, partner_now)
            attempt += 1
        return source, sign

    @ti.func
    def _find_saved(self, row, partner):
        """Index in `saved` of a partner of the particle `row`; -1 if none."""
        found = -1
        list_index = self.neighbors.list_begin_before[row]
        while (found < 0) & (list_index < self.neighbors.list_end_before[row]):
            if self.neighbors.partner_saved[list_index] == partner:
                found = list_index
            list_index += 1
        return found
