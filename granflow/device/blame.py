"""Who is behind a guard that tripped: found on the host from what stands on the device, after the run has stopped."""

from dataclasses import dataclass

import numpy as np

from granflow.device.drive import driven_offsets, driven_velocities
from granflow.device.fixed import free_shares
from granflow.device.guards import GUARD_LOST, GUARD_OVERLAP, GUARD_TRAVEL, GUARD_WALL, Pair, Party, Trip, trip_of
from granflow.device.records import listed_pairs
from granflow.device.state import State
from granflow.device.transfer import Transfer
from granflow.device.walls import walls_of
from granflow.laws import theory
from granflow.plan import Plan
from granflow.plan.plan import pair_material, solid
from granflow.plan.time_step import Meeting, stable_step
from granflow.walls.mesh import Mesh
from granflow.walls.mesh_contact import reference_contact
from granflow.walls.motion import pose

WANTED = ("id", "radius", "mass", "position", "position_at_search", "velocity", "force", "material", "fixed")

TINY = 1e-300
"""Mass [kg] of places that hold no particle yet."""


@dataclass(frozen=True)
class Near:
    """Near pairs, n of them, where they stand.

    Indices of owner and partner (-1 - wall), overlap over the smaller radius, approach and velocity of the partner's
    surface (n, 3) [m/s].
    """

    owner: np.ndarray
    partner: np.ndarray
    overlap: np.ndarray
    approach: np.ndarray
    surface: np.ndarray


def trip_behind(code: int, particle: int, state: State, transfer: Transfer, time: float, begun: bool) -> Trip:
    """The trip of a guard at `time` [s], with the pair most at fault if those that tripped it touch anything.

    `begun`: whether any step was taken, not only forces found where the particles begin.
    """
    if code == GUARD_WALL:
        return trip_of(code, _fastest_wall(state), None, state.clock.time_step, begun)
    there = transfer.taken(WANTED, 0, state.particles.capacity)
    there = {name: values.astype(float) if values.dtype.kind == "f" else values for name, values in there.items()}
    if code == GUARD_OVERLAP and begun:  # forces are of where the particles stand: a step ahead of the time
        mass = np.maximum(there["mass"], TINY)
        there["velocity"] += 0.5 * state.clock.time_step * there["force"] * (free_shares(there) / mass)[:, None]
        time += state.clock.time_step
    found = np.flatnonzero(there["id"] == particle)
    index = int(found[0])  # one that left the domain stands right behind the others
    party = _party(state.plan, there, index)
    near = _near_pairs(code, state, there, time)
    mine = (near.owner == index) | (near.partner == index)
    wanted = mine if code in (GUARD_LOST, GUARD_TRAVEL) else np.ones_like(mine)
    share = np.where(wanted & (near.overlap > 0.0), near.overlap, 0.0)
    pair = _pair(state.plan, there, near, int(share.argmax())) if share.any() else None
    return trip_of(code, party, pair, state.clock.time_step, begun)


def _fastest_wall(state: State) -> Party:
    """The driven wall that moves fastest."""
    velocities = driven_velocities(state)
    index = int(np.nan_to_num(np.linalg.norm(velocities, axis=1), nan=np.inf).argmax())
    wall = state.plan.walls[index]
    return Party(f"wall {wall.name}", state.plan.materials[wall.material], _vector(velocities[index]), None)


def _party(plan: Plan, there: dict[str, np.ndarray], index: int) -> Party:
    """One particle as messages name it."""
    velocity, material = there["velocity"][index], there["material"][index] if "material" in there else 0
    return Party(
        f"particle {there['id'][index]}", plan.materials[material], _vector(velocity), _vector(there["position"][index])
    )


def _vector(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _near_pairs(code: int, state: State, there: dict[str, np.ndarray], time: float) -> Near:
    """All listed pairs where they stand; after a jump, where they stood before it."""
    owner, _slot, partner = listed_pairs(state)
    position, velocity = there["position"], there["velocity"]
    if code in (GUARD_LOST, GUARD_TRAVEL):
        position = position - state.clock.time_step * velocity
        position = np.where(np.isfinite(position), position, there["position_at_search"])
    other = np.maximum(partner, 0)
    apart = position[owner] - state.plan.border.at(time).beside(position[other], position[owner])
    distance = np.linalg.norm(apart, axis=1)
    overlap = there["radius"][owner] + there["radius"][other] - distance
    normal = apart / np.maximum(distance, 1e-3 * there["radius"][owner])[:, None]
    moving, smaller = velocity[other], np.minimum(there["radius"][owner], there["radius"][other])
    face = -1 - partner
    partner[partner < 0] = -1 - walls_of(state, partner[partner < 0])
    for index in range(len(state.plan.walls)):
        of_wall = partner == -1 - index
        points = state.plan.border.wrapped(position[owner[of_wall]])
        gap, normal[of_wall], moving[of_wall] = _at_wall(state, index, face[of_wall], points, time)
        smaller[of_wall] = there["radius"][owner[of_wall]]
        overlap[of_wall] = smaller[of_wall] - gap
    approach = -np.sum((velocity[owner] - moving) * normal, axis=1)
    return Near(owner, partner, overlap / smaller, approach, moving)


def _at_wall(
    state: State, index: int, face: np.ndarray, points: np.ndarray, time: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gap (n,), normal (n, 3) and surface velocity (n, 3) of a wall, or of its faces (n,), at points (n, 3)."""
    shape, stand = state.plan.walls[index].shape, pose(state.wall_motions[index], np.array([time]))
    rotation, center = stand.rotation[0], stand.offset[0] + stand.pivot + driven_offsets(state)[index]
    velocity = stand.velocity[0] + driven_velocities(state)[index]
    local = (points - center) @ rotation + stand.pivot
    if isinstance(shape, Mesh):
        first = len(state.plan.walls) + state.plan.first_triangle(index)
        gap, normal = reference_contact(shape.links, face - first, local)
    else:
        gap, normal = shape.kind.reference_closest(local, shape.parameters)
    return gap, normal @ rotation.T, velocity + np.cross(stand.angular_velocity[0], points - center)


def _pair(plan: Plan, there: dict[str, np.ndarray], near: Near, worst: int) -> Pair:
    """The worst of the near pairs, and the longest step that is stable for it as it is now.

    impact^2 = approach^2 + (4/5) k d^2.5 / M        (elastic energy of a Hertz contact)
    """
    owner, partner = int(near.owner[worst]), int(near.partner[worst])
    first = _party(plan, there, owner)
    radius, mass = there["radius"][owner], there["mass"][owner]
    radius_eff, mass_eff, smaller = radius, mass, radius
    if partner >= 0:
        second = _party(plan, there, partner)
        radius_eff = radius * there["radius"][partner] / (radius + there["radius"][partner])
        both = {name: values[[owner, partner]] for name, values in there.items()}
        mass_eff = float(1.0 / (free_shares(both) / both["mass"]).sum())
        smaller = min(radius, there["radius"][partner])
    else:
        wall = plan.walls[-1 - partner]
        second = Party(f"wall {wall.name}", plan.materials[wall.material], _vector(near.surface[worst]), None)
    overlap, approach = float(near.overlap[worst]), float(near.approach[worst])
    material = pair_material(plan.scene, first.material, second.material)
    stiffness = theory.hertz_stiffness(material.modulus_eff, radius_eff)
    impact = float(np.hypot(approach, np.sqrt(0.8 * stiffness / mass_eff) * (overlap * smaller) ** 1.25))
    body = solid(plan.scene, first.material)
    meeting = Meeting("", material, radius_eff, mass_eff, radius, body, _contact_count(near, owner, partner))
    return Pair(first, second, overlap, approach, impact, stable_step(meeting, plan.law, impact))


def _contact_count(near: Near, *ends: int) -> int:
    """How many others the busier of the two touches."""
    touching = near.overlap > 0.0
    pairs = {(min(ends), max(ends)) for ends in zip(near.owner[touching], near.partner[touching], strict=True)}
    return max(sum(end in pair for pair in pairs) for end in ends if end >= 0)
