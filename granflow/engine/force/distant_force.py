"""Attraction of pairs without overlap, for cohesion models that act at a distance; no other scene compiles it.

Such a pair has no normal, tangential or rolling force. The contact history of the cohesion model is kept until the
model ends it or the distance exceeds its range; the histories of the other models end with the overlap.
"""

from typing import Any

from granflow.engine.force.liquid_transfer import build_return_liquid
from granflow.engine.force.pair_kinematics import build_effective, build_pair_constants
from granflow.engine.force.structs import build_slot_vector
from granflow.engine.neighbor.contact_history_entry import (
    IN_CONTACT,
    build_add_plastic_loss,
    build_end_contact,
    build_normal_loss,
    build_read_history,
    cohesive_contact,
)
from granflow.engine.state import State
from granflow.kernel_language import ti


def build_distant_force(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, list index, j, overlap, time_step) -> attraction [N] of a pair without overlap.

    with_wall:  True for walls (j < 0), False for particles
    overlap:    minus the distance of the surfaces [m], above minus the range

    Reads:   radius, mass, history, pair_constants, law_parameters
    Writes:  history, in_contact, losses, liquid_film
    """
    laws, neighbors = state.plan.laws, state.neighbors
    keeps_history = "cohesion" in neighbors.history
    vector_of = build_slot_vector(laws, "cohesion") if keeps_history else None
    read_history, effective, pair_constants = (
        build_read_history(state),
        build_effective(state, with_wall),
        build_pair_constants(state),
    )
    end_contact, add_plastic_loss = build_end_contact(state), build_add_plastic_loss(state)
    end_surface_contact, return_liquid = _build_end_surface_contact(state), build_return_liquid(state)

    @ti.func
    def distant_force(chunk, i, list_index, j, overlap, dt):
        constants, bodies, history = pair_constants(i, j), effective(i, j), read_history(list_index)
        contact = cohesive_contact(bodies, overlap, dt)
        attraction, history_new = laws.cohesion.force(constants.cohesion, contact, history.cohesion)
        energy_lost, is_kept = 0.0 * dt, False
        if ti.static(keeps_history):
            components = vector_of(history_new)
            is_kept = components[0] > 0.0
            if not is_kept:
                return_liquid(chunk, i, j, list_index)
            neighbors.history["cohesion"][list_index] = components
            if is_kept:
                neighbors.in_contact[list_index] = IN_CONTACT
                energy_lost = end_surface_contact(list_index, constants, bodies, dt)
        if not is_kept:
            energy_lost = end_contact(list_index, constants, bodies, dt)
        add_plastic_loss(chunk, j, energy_lost)
        return attraction

    return distant_force


def _build_end_surface_contact(state: State) -> Any:
    """Device function (list index, constants, bodies, time_step): end the contact of all models but cohesion.

    Returns the plastic work [J] of a contact whose overlap has ended in this step; 0 without the energy budget.

    Writes:  history
    """
    neighbors, energy_budget, normal_loss = state.neighbors, state.plan.features.energy_budget, build_normal_loss(state)
    names = [name for name in neighbors.history if name != "cohesion"]

    @ti.func
    def end_surface_contact(list_index, constants, bodies, dt):
        energy_lost = 0.0 * dt
        if ti.static(energy_budget):
            energy_lost = normal_loss(list_index, constants, bodies, dt)
        for name in ti.static(names):
            neighbors.history[name][list_index] = 0.0 * neighbors.history[name][list_index]
        return energy_lost

    return end_surface_contact


def build_in_range(state: State) -> Any:
    """Device function (i, j, overlap): true if the cohesion model acts at this overlap, which may be negative.

    Reads:  law_parameters
    """
    acts_at_distance, pair_constants = state.plan.laws.acts_at_distance, build_pair_constants(state)

    @ti.func
    def in_range(i, j, overlap):
        found = overlap > 0.0
        if ti.static(acts_at_distance):
            found = overlap > -pair_constants(i, j).cohesion.range
        return found

    return in_range
