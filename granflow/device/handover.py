"""What a contact remembers goes along when it slides from one triangle of a mesh to the next.

The walls of a particle are gone through in three turns: contacts that there were before; then those that begin, which
may take over what a contact of the first turn has left; then what nobody took is forgotten.
"""

from typing import Any

import taichi as ti

from granflow.device.mesh import build_mesh_geometry
from granflow.device.slots import APART, LEFT, TOUCHING
from granflow.device.state import State
from granflow.device.walls import build_triangle_of, build_wall_geometry
from granflow.walls.shape import FAR_AWAY

TURNS = (TOUCHING, APART, LEFT)
"""Which slots have their turn one after the other."""


def hands_over(state: State) -> bool:
    """Whether contacts with walls can go on in another slot, and have something to bring there."""
    return state.plan.features.mesh_walls and bool(state.contacts.history)


def build_leave(state: State) -> Any:
    """Device function (i, slot, j, pose): leave a slot's memory for an heir; 1 if that is done.

    Done where a triangle no longer answers though the sphere still reaches it: another one does, then.

    Reads:   position, radius, mesh
    Writes:  touching
    """
    particles, contacts = state.particles, state.contacts
    way, triangle_of = _build_way(state), build_triangle_of(state)

    @ti.func
    def leave(i, slot, j, pose):
        left, t = 0, triangle_of(j)
        if t >= 0 and contacts.touching[slot] == TOUCHING:
            if way(i, t, pose).norm() < particles.radius[i]:
                contacts.touching[slot] = LEFT
                left = 1
        return left

    return leave


def build_inherit(state: State) -> Any:
    """Device function (i, slot, j, pose): a contact that begins takes over the memory left nearest to it on its wall.

    Reads:   position, contact rows, mesh
    Writes:  history, touching
    """
    contacts, mesh, real = state.contacts, state.mesh, state.backend.position_real
    way, triangle_of, names = _build_way(state), build_triangle_of(state), list(contacts.history)

    @ti.func
    def left_for(i, t, pose):
        found, nearest = -1, ti.cast(FAR_AWAY, real)
        for slot in range(contacts.row_begin[i], contacts.row_middle[i]):
            if contacts.touching[slot] == LEFT:
                other = triangle_of(contacts.partner[slot])
                if mesh.wall[other] == mesh.wall[t]:
                    apart = (way(i, other, pose) - way(i, t, pose)).norm()
                    if apart < nearest:
                        found, nearest = slot, apart
        return found

    @ti.func
    def inherit(i, slot, j, pose):
        t = triangle_of(j)
        if t >= 0 and contacts.touching[slot] == APART:
            source = left_for(i, t, pose)
            if source >= 0:
                for name in ti.static(names):
                    contacts.history[name][slot] = contacts.history[name][source]
                    contacts.history[name][source] = 0.0 * contacts.history[name][source]
                contacts.touching[source] = APART

    return inherit


def _build_way(state: State) -> Any:
    """Device function (i, triangle, pose): from the nearest point of the triangle to the particle, the wall at rest."""
    geometry, wall_geometry = build_mesh_geometry(state), build_wall_geometry(state)

    @ti.func
    def way(i, t, pose):
        return geometry.away(t, wall_geometry.to_rest(state.mesh.wall[t], pose, state.particles.position[i]))

    return way
