"""Transfers the contact history if a contact passes from one face to another, of the same wall or of another one.

The history belongs to the contact point: a contact that slides over an edge, from one wall to the next, or across a
periodic boundary, continues. The wall entries of a particle are evaluated in three passes: existing contacts; then new
contacts, which may acquire the history that a contact of the first pass released; then the released entries, whose
remaining history is cleared.
"""

from typing import Any

from granflow.engine.force.pair_kinematics import build_pair_constants
from granflow.engine.neighbor.contact_history_entry import IN_CONTACT, NO_CONTACT, RELEASED
from granflow.engine.state import State
from granflow.engine.walls import WallGeometry
from granflow.kernel_language import ti

CONTACT_ORDER = (IN_CONTACT, NO_CONTACT, RELEASED)
"""State of the entries evaluated in each pass."""


def transfers_history(state: State) -> bool:
    """True if wall contacts can pass to another list entry and have a history to transfer."""
    features = state.plan.features
    return (features.mesh_walls or features.joined_walls) and bool(state.neighbors.history)


def build_release_history(state: State) -> Any:
    """Device function (i, list index, j, pose): release the history of an entry for another entry; 1 if released.

    The history is released if the face no longer has the contact although the sphere still reaches it: another face has
    the contact now.

    Reads:   position, radius, walls, mesh
    Writes:  in_contact
    """
    particles, neighbors, geometry = state.particles, state.neighbors, WallGeometry(state)
    acts_at_distance, pair_constants = state.plan.laws.acts_at_distance, build_pair_constants(state)

    @ti.func
    def release_history(i, list_index, j, pose):
        released = 0
        if neighbors.in_contact[list_index] == IN_CONTACT:
            reach = particles.radius[i]
            if ti.static(acts_at_distance):
                reach += pair_constants(i, j).cohesion.range
            if geometry.from_surface(-1 - j, pose, particles.position[i]).norm() < reach:
                neighbors.in_contact[list_index] = RELEASED
                released = 1
        return released

    return release_history


def build_acquire_history(state: State) -> Any:
    """Device function (i, list index, j, pose): a new contact acquires the nearest released history.

    The distance is that between the nearest points of the two faces, at most one radius: a contact with the other side
    of a corner is another contact. The history moves: the source entry is cleared.

    Reads:   position, radius, neighbor lists, walls, mesh
    Writes:  history, in_contact
    """
    particles, neighbors, geometry = state.particles, state.neighbors, WallGeometry(state)
    names = list(neighbors.history)

    @ti.func
    def released_near(i, j, pose):
        """List index of the nearest released history; -1 if none."""
        found, nearest, position = -1, particles.radius[i], particles.position[i]
        from_nearest, is_known = 0.0 * position, 0
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
                            from_nearest, is_known = separation, 1
                        elif (separation - from_nearest).norm() < nearest:
                            found, nearest = list_index, (separation - from_nearest).norm()
        return found

    @ti.func
    def acquire_history(i, list_index, j, pose):
        if neighbors.in_contact[list_index] == NO_CONTACT:
            source = released_near(i, j, pose)
            if source >= 0:
                for name in ti.static(names):
                    neighbors.history[name][list_index] = neighbors.history[name][source]
                    neighbors.history[name][source] = 0.0 * neighbors.history[name][source]
                neighbors.in_contact[source], neighbors.in_contact[list_index] = NO_CONTACT, IN_CONTACT

    return acquire_history
