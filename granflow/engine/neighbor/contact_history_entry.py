"""Contact history of one neighbor-list entry: read, written and cleared."""

from typing import Any

from granflow.engine.exact_sums import add_energy, build_list_shares
from granflow.engine.force.structs import build_read_slots, build_slot_vector, member
from granflow.engine.state import State
from granflow.kernel_language import ti
from granflow.plan.chunk_sums import LOSSES, PLASTIC
from granflow.plan.sum_units import ENERGY

NO_CONTACT, IN_CONTACT, RELEASED = range(3)
"""State of a neighbor-list entry: no contact; in contact; or history that another entry may acquire in this step."""


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
    neighbors, stored = state.neighbors, state.neighbors.history
    slots = [(slot, build_slot_vector(state.plan.laws, slot)) for slot in stored]

    @ti.func
    def write_history(list_index, history):
        if ti.static(len(slots) > 0):
            neighbors.in_contact[list_index] = IN_CONTACT
        for slot, vector_of in ti.static(slots):
            stored[slot][list_index] = vector_of(member(history, slot))

    return write_history


def build_normal_loss(state: State) -> Any:
    """Device function (list index, constants, bodies, time_step) -> plastic work [J] of a contact whose overlap ends.

    A bond without overlap has an empty history of the normal model, of which models with stored stiffness make 0/0.

    Reads:  history
    """
    law, neighbors, read_history = state.plan.laws.normal, state.neighbors, build_read_history(state)
    has_history, with_bonds = "normal" in neighbors.history, state.plan.laws.acts_at_distance

    @ti.func
    def normal_loss(list_index, constants, bodies, dt):
        energy, nothing = 0.0 * dt, 0.0 * bodies.radius_eff
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


def build_end_contact(state: State) -> Any:
    """Device function (list index, constants, bodies, time_step): clear an open contact.

    Returns the plastic work [J] of a contact that has ended in this step; 0 without the energy budget.

    Writes:  history, in_contact
    """
    laws, neighbors, names = state.plan.laws, state.neighbors, list(state.neighbors.history)
    energy_budget, read_history = state.plan.features.energy_budget, build_read_history(state)
    normal_loss = build_normal_loss(state)

    @ti.func
    def lost_energy(list_index, constants, bodies, dt):
        energy = normal_loss(list_index, constants, bodies, dt)
        if ti.static("cohesion" in names):
            overlap = 0.0 * bodies.radius_eff
            if ti.static(laws.acts_at_distance):
                overlap = -constants.cohesion.range
            contact = cohesive_contact(bodies, overlap, dt)
            energy += laws.cohesion.lost_energy(constants.cohesion, contact, read_history(list_index).cohesion)
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


def build_add_plastic_loss(state: State) -> Any:
    """Device function (chunk, j, energy [J]): add the plastic work of a contact that has ended.

    Writes:  losses
    """
    control, list_shares, energy_budget = state.control, build_list_shares(state), state.plan.features.energy_budget
    per_unit, loss_count = state.parameter("per_unit", ENERGY), len(LOSSES)

    @ti.func
    def add_plastic_loss(chunk, j, energy_lost):
        if ti.static(energy_budget):
            value = per_unit() * energy_lost
            add_energy(control.losses, chunk, PLASTIC, loss_count, list_shares(chunk, j), value)

    return add_plastic_loss
