"""First part of a batch of contacts: the overlapping pairs of a few neighbor lists; pairs apart one at a time."""

from typing import Any

from granflow.engine.exact_sums import build_to_grid
from granflow.engine.force.batch_columns import build_add_to_sums
from granflow.engine.force.distant_force import build_distant_force
from granflow.engine.force.liquid_transfer import build_return_liquid
from granflow.engine.force.pair_force import (
    build_in_contact,
)
from granflow.engine.force.pair_kinematics import (
    build_boundary_work,
    build_effective,
    build_pair_constants,
)
from granflow.engine.limits import ABORT_OVERLAP
from granflow.engine.neighbor.contact_history_entry import build_add_plastic_loss, build_end_contact
from granflow.engine.periodic_box import build_minimum_image
from granflow.engine.state import State
from granflow.kernel_language import ti
from granflow.plan.sum_units import FORCE


def build_collect(state: State) -> Any:
    """Device function that adds the contacts of one neighbor list to the batch.

    Arguments: worker, chunk, i, first entry of the batch, first and last particle of the chunk, pose, time step.

    Returns the end of the entries. Candidate pairs without contact are overwritten by the next entry; open contacts
    end.

    Reads:   position, radius, neighbor lists, in_contact
    Writes:  list_index, owner, partner, branch of the batch; history, in_contact, losses, abort; with a model that acts
             at a distance, sums
    """
    particles, neighbors, control, batch = state.particles, state.neighbors, state.control, state.batch
    real, has_history = state.backend.real, bool(neighbors.history)
    in_contact, end_contact = build_in_contact(real), build_end_contact(state)
    effective, minimum_image = build_effective(state, False), build_minimum_image(state)
    pair_constants, add_plastic_loss = build_pair_constants(state), build_add_plastic_loss(state)
    max_overlap, acts_at_distance = state.parameter("max_overlap"), state.plan.laws.acts_at_distance
    attract = _build_attract(state) if acts_at_distance else None

    @ti.func
    def end_lost_contact(chunk, list_index, i, j, dt):
        energy_lost = end_contact(list_index, pair_constants(i, j), effective(i, j), dt)
        add_plastic_loss(chunk, j, energy_lost)

    @ti.func
    def check_overlap(i, square, reach, overlap_limit):
        distance_limit = reach - overlap_limit
        if square < distance_limit * distance_limit:
            ti.atomic_max(control.abort[0], ABORT_OVERLAP)
            ti.atomic_min(control.abort_particle[0], particles.id[i])

    @ti.func
    def collect(worker, chunk, i, begin, first, last, pose, dt):
        position, radius, overlap_ratio = particles.position[i], particles.radius[i], max_overlap()
        end = begin
        for list_index in range(neighbors.list_walls_end[i], neighbors.list_end[i]):
            j = neighbors.partner[list_index]
            branch = ti.cast(minimum_image(position, particles.position[j], pose), real)
            radius_partner = particles.radius[j]
            batch.list_index[worker, end] = list_index
            batch.owner[worker, end] = i
            batch.partner[worker, end] = j
            batch.radius_partner[worker, end] = radius_partner
            for axis in ti.static(range(3)):
                batch.branch[axis][worker, end] = branch[axis]
            square, reach = branch.dot(branch), radius + radius_partner
            near = in_contact(square, reach)
            end += ti.cast(near, ti.i32)
            radius_min = ti.select(radius < radius_partner, radius, radius_partner)
            check_overlap(i, square, reach, overlap_ratio * radius_min)
            if ti.static(acts_at_distance):
                if not near:
                    attract(worker, chunk, i, j, list_index, branch, reach, first, last, pose, dt)
            elif ti.static(has_history):
                if neighbors.in_contact[list_index] == 1 and not near:
                    end_lost_contact(chunk, list_index, i, j, dt)
        return end

    return collect


def _build_attract(state: State) -> Any:
    """Device function: attraction of a pair without overlap, one at a time; ends the contact beyond the range.

    Arguments: worker, chunk, i, j, list index, branch vector and sum of the radii [m], first and last particle of the
    chunk, pose, time step. The force is rounded for the exact sums.

    Reads:   radius, mass, history, pair_constants, law_parameters
    Writes:  sums of the batch, history, in_contact, losses, boundary_work, liquid_film
    """
    features, to_grid, shift = (
        state.plan.features,
        build_to_grid(state.backend.real),
        state.parameter("shift", FORCE),
    )
    add_to_sums, return_liquid = build_add_to_sums(state), build_return_liquid(state)
    distant_force, add_boundary_work = build_distant_force(state, False), build_boundary_work(state)
    end_contact, add_plastic_loss = build_end_contact(state), build_add_plastic_loss(state)
    pair_constants, effective, has_history = (
        build_pair_constants(state),
        build_effective(state, False),
        bool(state.neighbors.history),
    )

    @ti.func
    def attract(worker, chunk, i, j, list_index, branch, contact_distance, first, last, pose, dt):
        distance = ti.sqrt(branch.dot(branch))
        constants = pair_constants(i, j)
        if distance < contact_distance + constants.cohesion.range:
            overlap = ti.min(contact_distance - distance, 0.0)
            attraction = distant_force(chunk, i, list_index, j, overlap, dt)
            force = to_grid(-attraction / distance * branch, shift())
            added = ti.cast(force, ti.f64)
            add_to_sums(worker, i, first, 0, added)
            if j >= first and j < last:
                add_to_sums(worker, j, first, 0, -added)
            if ti.static(features.energy_budget and features.lees_edwards):
                add_boundary_work(chunk, i, j, force, pose, dt)
        elif ti.static(has_history):
            return_liquid(chunk, i, j, list_index)
            add_plastic_loss(chunk, j, end_contact(list_index, constants, effective(i, j), dt))

    return attract
