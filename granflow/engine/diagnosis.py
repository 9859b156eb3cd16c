"""Diagnoses an aborted run on the host: finds the particles or walls that exceeded the limit."""

from dataclasses import dataclass

import numpy as np

from granflow.engine.abort_bodies import Body, ContactPair
from granflow.engine.force.contact_output import candidate_pairs
from granflow.engine.frozen_masks import mobility_mask
from granflow.engine.host_copy import copy_to_host
from granflow.engine.limits import (
    ABORT_DISPLACEMENT,
    ABORT_FORCE,
    ABORT_NOT_FINITE,
    ABORT_OVERLAP,
    ABORT_REASONS,
    ABORT_WALL,
    Change,
    Diagnosis,
)
from granflow.engine.state import State
from granflow.engine.wall_dynamics import controlled_displacements, controlled_velocities
from granflow.engine.walls import walls_of
from granflow.geometry.mesh.contact import reference_contact
from granflow.geometry.mesh.mesh import Mesh
from granflow.geometry.motion import pose
from granflow.plan.forecast.contact import TouchingPair, impact_velocity
from granflow.plan.plan import Plan
from granflow.plan.time_step import PairCase, stable_step

FIELDS = ("id", "radius", "mass", "position", "position_at_rebuild", "velocity", "force", "material", "fixed", "clump")
"""Particle fields that the diagnosis reads."""

TINY_MASS = 1e-300
"""Mass [kg] of unused array entries."""


@dataclass(frozen=True)
class CandidatePairs:
    """The n candidate pairs at their positions.

    owner:     (n,) particle index
    partner:   (n,) particle index, or -1 - wall index
    overlap:   (n,) over the smaller radius, negative for a gap
    approach:  (n,) approach velocity [m/s] along the normal
    surface:   (n, 3) velocity of the partner's surface [m/s]
    """

    owner: np.ndarray
    partner: np.ndarray
    overlap: np.ndarray
    approach: np.ndarray
    surface: np.ndarray


@np.errstate(all="ignore")  # velocities may be infinite
def diagnose(code: int, particle: int, state: State, time: float, step_taken: bool, change: Change | None) -> Diagnosis:
    """Diagnosis of an abort, with the contact pair of the largest overlap; None without a contact.

    code:        abort code, see `limits`
    particle:    id of the particle that exceeded the limit; unused for walls
    time:        simulated time [s]
    step_taken:  true if a step was taken; false if only the initial forces were computed
    change:      insertion or change of walls since which no step was taken, or None

    Runs on the host in float64. For a position that is not finite or a displacement above its limit, only contacts of
    this particle one step earlier are considered.
    """
    if code == ABORT_WALL:
        return Diagnosis(ABORT_REASONS[code], _fastest_wall(state), None, state.clock.time_step, step_taken, None)
    arrays = copy_to_host(state, FIELDS, 0, state.capacities.particles)
    arrays = {name: values.astype(float) if values.dtype.kind == "f" else values for name, values in arrays.items()}
    if code == ABORT_OVERLAP and step_taken and change is None:
        # The forces belong to the present positions, one step ahead of the time.
        mass = np.maximum(arrays["mass"], TINY_MASS)
        arrays["velocity"] += 0.5 * state.clock.time_step * arrays["force"] * (mobility_mask(arrays) / mass)[:, None]
        time += state.clock.time_step
    found = np.flatnonzero(arrays["id"] == particle)
    index = int(found[0])  # a deleted particle is directly behind the others
    body = _body(state.plan, arrays, index)
    candidates = _candidate_pairs(code, state, arrays, time)
    involved = (candidates.owner == index) | (candidates.partner == index)
    considered = involved if code in (ABORT_NOT_FINITE, ABORT_DISPLACEMENT, ABORT_FORCE) else np.ones_like(involved)
    share = np.where(considered & (candidates.overlap > 0.0), candidates.overlap, 0.0)
    pair = _contact_pair(state.plan, arrays, candidates, int(share.argmax())) if share.any() else None
    return Diagnosis(ABORT_REASONS[code], body, pair, state.clock.time_step, step_taken, change)


def _fastest_wall(state: State) -> Body:
    """The force-controlled wall with the highest velocity."""
    velocities = controlled_velocities(state)
    index = int(np.nan_to_num(np.linalg.norm(velocities, axis=1), nan=np.inf).argmax())
    wall = state.plan.walls[index]
    return Body(f"wall {wall.name}", state.plan.materials[wall.material], _vector(velocities[index]), None)


def _body(plan: Plan, arrays: dict[str, np.ndarray], index: int) -> Body:
    """One particle as messages describe it; `index` in device order."""
    velocity, material = arrays["velocity"][index], arrays["material"][index] if "material" in arrays else 0
    clump = arrays["clump"][index] if "clump" in arrays else -1
    return Body(
        f"particle {arrays['id'][index]}{f' of clump {clump}' if clump >= 0 else ''}",
        plan.materials[material],
        _vector(velocity),
        _vector(arrays["position"][index]),
    )


def _vector(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _candidate_pairs(code: int, state: State, arrays: dict[str, np.ndarray], time: float) -> CandidatePairs:
    """All candidate pairs at their present positions; after a jump, at the positions before it."""
    owner, _list_index, partner = candidate_pairs(state)
    position, velocity = arrays["position"], arrays["velocity"]
    if code in (ABORT_NOT_FINITE, ABORT_DISPLACEMENT, ABORT_FORCE):
        position = position - state.clock.time_step * velocity
        position = np.where(np.isfinite(position), position, arrays["position_at_rebuild"])
    partner_index = np.maximum(partner, 0)
    branch = position[owner] - state.plan.periodic_box.at(time).nearest_images(position[partner_index], position[owner])
    distance = np.linalg.norm(branch, axis=1)
    overlap = arrays["radius"][owner] + arrays["radius"][partner_index] - distance
    normal = branch / np.maximum(distance, 1e-3 * arrays["radius"][owner])[:, None]
    surface_velocity, smaller = (
        velocity[partner_index],
        np.minimum(arrays["radius"][owner], arrays["radius"][partner_index]),
    )
    face = -1 - partner
    partner[partner < 0] = -1 - walls_of(state, partner[partner < 0])
    for index in range(len(state.plan.walls)):
        of_wall = partner == -1 - index
        points = state.plan.periodic_box.wrap(position[owner[of_wall]])
        gap, normal[of_wall], surface_velocity[of_wall] = _wall_gaps(state, index, face[of_wall], points, time)
        smaller[of_wall] = arrays["radius"][owner[of_wall]]
        overlap[of_wall] = smaller[of_wall] - gap
    approach = -np.sum((velocity[owner] - surface_velocity) * normal, axis=1)
    return CandidatePairs(owner, partner, overlap / smaller, approach, surface_velocity)


def _wall_gaps(
    state: State, index: int, face: np.ndarray, points: np.ndarray, time: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gap and surface velocity of a wall.

    index:    wall index
    face:     (n,) wall index, or wall count + triangle index
    points:   (n, 3) [m], inside the periodic box
    time:     [s]
    Returns:  gap (n,) [m] or FAR_AWAY, unit normal (n, 3), velocity (n, 3) [m/s]
    """
    shape, wall_pose = state.plan.walls[index].shape, pose(state.wall_motions[index], np.array([time]))
    rotation, center = (
        wall_pose.rotation[0],
        wall_pose.offset[0] + wall_pose.pivot + controlled_displacements(state)[index],
    )
    velocity = wall_pose.velocity[0] + controlled_velocities(state)[index]
    local = (points - center) @ rotation + wall_pose.pivot
    if isinstance(shape, Mesh):
        first = len(state.plan.walls) + state.plan.first_triangle(index)
        gap, normal = reference_contact(shape.adjacency, face - first, local)
    else:
        gap, normal = shape.kind.reference_closest(local, shape.parameters)
    return gap, normal @ rotation.T, velocity + np.cross(wall_pose.angular_velocity[0], points - center)


def _contact_pair(plan: Plan, arrays: dict[str, np.ndarray], candidates: CandidatePairs, worst: int) -> ContactPair:
    """The worst candidate pair, and the longest time step that is stable for its present state."""
    owner, partner = int(candidates.owner[worst]), int(candidates.partner[worst])
    first = _body(plan, arrays, owner)
    radius, mass = float(arrays["radius"][owner]), float(arrays["mass"][owner])
    radius_eff, mass_eff, smaller = radius, mass, radius
    if partner >= 0:
        second = _body(plan, arrays, partner)
        radius_eff = radius * arrays["radius"][partner] / (radius + arrays["radius"][partner])
        both = {name: values[[owner, partner]] for name, values in arrays.items()}
        mass_eff = float(1.0 / (mobility_mask(both) / both["mass"]).sum())
        smaller = min(radius, float(arrays["radius"][partner]))
    else:
        wall = plan.walls[-1 - partner]
        second = Body(f"wall {wall.name}", plan.materials[wall.material], _vector(candidates.surface[worst]), None)
    overlap, approach = float(candidates.overlap[worst]), float(candidates.approach[worst])
    material = plan.pair_materials[first.material, second.material]
    touching = TouchingPair("", (first.material, second.material), material, smaller, radius_eff, mass_eff)
    velocity = impact_velocity(plan.laws, touching, overlap * smaller, approach)
    material_solid = plan.solids[first.material]
    pair_case = PairCase(
        "", material, radius_eff, mass_eff, radius, smaller, material_solid, _contact_count(candidates, owner, partner)
    )
    stable = stable_step(pair_case, plan.law, velocity)
    return ContactPair(
        first, second, overlap, approach, velocity, stable, smaller, radius_eff, mass_eff,
        _weight_pressure(plan, arrays),
    )  # fmt: skip


def _weight_pressure(plan: Plan, arrays: dict[str, np.ndarray]) -> float:
    """Pressure [Pa] of the weight of all mobile particles, those not inserted yet included, on the present bed.

    The section of the bed is that of its bounding box across gravity; 0 without gravity or mobile particles.
    """
    gravity, mobile = np.array(plan.gravity), (mobility_mask(arrays) > 0.0) & (arrays["mass"] > TINY_MASS)
    magnitude = float(np.linalg.norm(gravity))
    if not magnitude or not mobile.any():
        return 0.0
    reach = np.where(mobile, arrays["radius"], 0.0)[mobile, None]
    size = (arrays["position"][mobile] + reach).max(axis=0) - (arrays["position"][mobile] - reach).min(axis=0)
    section = np.abs(gravity) / magnitude @ [size[1] * size[2], size[2] * size[0], size[0] * size[1]]
    planned = sum(group.sphere_count for group in plan.groups if not group.fixed) / mobile.sum()
    return float(magnitude * arrays["mass"][mobile].sum() * planned / section)


def _contact_count(candidates: CandidatePairs, *ends: int) -> int:
    """Number of contacts of the body that has more, of `ends` (negative: wall, not counted)."""
    touching = candidates.overlap > 0.0
    pairs = {
        (min(ends), max(ends)) for ends in zip(candidates.owner[touching], candidates.partner[touching], strict=True)
    }
    return max(sum(end in pair for pair in pairs) for end in ends if end >= 0)
