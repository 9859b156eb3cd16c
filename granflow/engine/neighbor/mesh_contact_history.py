"""Transfers the contact history if a contact slides from one triangle of a mesh to the next.

The wall entries of a particle are evaluated in three passes: existing contacts; then new contacts, which may acquire
the history that a contact of the first pass released; then the released entries, whose remaining history is cleared.
"""

from typing import Any

from granflow.engine.force.pair_kinematics import build_pair_constants
from granflow.engine.mesh import from_nearest
from granflow.engine.neighbor.contact_history_entry import IN_CONTACT, NO_CONTACT, RELEASED
from granflow.engine.state import State
from granflow.engine.walls import WallGeometry
from granflow.geometry.shape import FAR_AWAY
from granflow.kernel_language import ti

CONTACT_ORDER = (IN_CONTACT, NO_CONTACT, RELEASED)
"""State of the entries evaluated in each pass."""


def transfers_history(state: State) -> bool:
    """True if wall contacts can move to another list entry and have a history to transfer."""
    return state.plan.features.mesh_walls and bool(state.neighbors.history)


def build_release_history(state: State) -> Any:
    """Device function (i, list index, j, pose): release the history of an entry for another entry; 1 if released.

    The history is released if the triangle no longer owns the contact although the sphere still reaches it: another
    triangle owns it now.

    Reads:   position, radius, mesh
    Writes:  in_contact
    """
    particles, neighbors = state.particles, state.neighbors
    separation, wall_count = _build_separation(state), state.parameter("wall_count")
    acts_at_distance, pair_constants = state.plan.laws.acts_at_distance, build_pair_constants(state)

    @ti.func
    def release_history(i, list_index, j, pose):
        released, t = 0, -1 - j - wall_count()
        if t >= 0 and neighbors.in_contact[list_index] == IN_CONTACT:
            reach = particles.radius[i]
            if ti.static(acts_at_distance):
                reach += pair_constants(i, j).cohesion.range
            if separation(i, t, pose).norm() < reach:
                neighbors.in_contact[list_index] = RELEASED
                released = 1
        return released

    return release_history


def build_acquire_history(state: State) -> Any:
    """Device function (i, list index, j, pose): a new contact acquires the nearest released history on its wall.

    The distance is that between the nearest points of the two triangles. The history moves: the source entry is
    cleared.

    Reads:   position, neighbor lists, mesh
    Writes:  history, in_contact
    """
    neighbors, mesh, real = state.neighbors, state.mesh, state.backend.position_real
    separation, wall_count, names = _build_separation(state), state.parameter("wall_count"), list(neighbors.history)

    @ti.func
    def released_near(i, t, pose):
        """List index of the nearest released history on the wall of triangle t; -1 if none."""
        found, nearest = -1, ti.cast(FAR_AWAY, real)
        # A sphere has few wall entries, so that a search among all of them is cheap.
        for list_index in range(neighbors.list_begin[i], neighbors.list_walls_end[i]):
            if neighbors.in_contact[list_index] == RELEASED:
                other = -1 - neighbors.partner[list_index] - wall_count()
                if mesh.wall[other] == mesh.wall[t]:
                    distance = (separation(i, other, pose) - separation(i, t, pose)).norm()
                    if distance < nearest:
                        found, nearest = list_index, distance
        return found

    @ti.func
    def acquire_history(i, list_index, j, pose):
        t = -1 - j - wall_count()
        if t >= 0 and neighbors.in_contact[list_index] == NO_CONTACT:
            source = released_near(i, t, pose)
            if source >= 0:
                for name in ti.static(names):
                    neighbors.history[name][list_index] = neighbors.history[name][source]
                    neighbors.history[name][source] = 0.0 * neighbors.history[name][source]
                neighbors.in_contact[source], neighbors.in_contact[list_index] = NO_CONTACT, IN_CONTACT

    return acquire_history


def _build_separation(state: State) -> Any:
    """Device function (i, triangle, pose): vector [m] from the nearest point of the triangle to particle i.

    The vector is in the frame of the wall at rest.
    """
    geometry, mesh, position = WallGeometry(state), state.mesh, state.particles.position

    @ti.func
    def separation(i, t, pose):
        return from_nearest(mesh, t, geometry.to_wall_frame(mesh.wall[t], pose, position[i]))

    return separation
