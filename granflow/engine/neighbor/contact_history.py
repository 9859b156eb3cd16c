"""Contact history of one neighbor-list entry: read, written and cleared."""

from typing import Any

import taichi as ti

from granflow.engine.state import State

NO_CONTACT, IN_CONTACT, RELEASED = range(3)
"""State of a neighbor-list entry: no contact; in contact; or history that another entry may acquire in this step."""


def build_read_history(state: State) -> Any:
    """Device function (list index) -> (normal history, tangential and rolling displacement); absent ones are 0.

    normal:      (h,) in the order of `NormalLaw.history_names`, at least one component
    tangential:  3-vector [m]
    rolling:     3-vector [rad]; with CDT and the energy budget the torque of the previous step [N m]

    Reads:  history
    """
    history, real = state.neighbors.history, state.backend.real
    size = max(state.plan.law.history_count, 1)

    @ti.func
    def read_history(list_index):
        normal_history, tangential_displacement, rolling_displacement = (
            ti.Vector.zero(real, size),
            ti.Vector.zero(real, 3),
            ti.Vector.zero(real, 3),
        )
        if ti.static("normal" in history):
            normal_history = history["normal"][list_index]
        if ti.static("tangential" in history):
            tangential_displacement = history["tangential"][list_index]
        if ti.static("rolling" in history):
            rolling_displacement = history["rolling"][list_index]
        return normal_history, tangential_displacement, rolling_displacement

    return read_history


def build_write_history(state: State) -> Any:
    """Device function (list index, normal history, tangential and rolling displacement): write them; set IN_CONTACT.

    Writes:  history, in_contact
    """
    neighbors, history = state.neighbors, state.neighbors.history

    @ti.func
    def write_history(list_index, normal_history, tangential_displacement, rolling_displacement):
        if ti.static(len(history) > 0):
            neighbors.in_contact[list_index] = IN_CONTACT
        if ti.static("normal" in history):
            history["normal"][list_index] = normal_history
        if ti.static("tangential" in history):
            history["tangential"][list_index] = tangential_displacement
        if ti.static("rolling" in history):
            history["rolling"][list_index] = rolling_displacement

    return write_history


def build_end_contact(state: State) -> Any:
    """Device function (list index, constants, effective radius, effective mass, time_step): clear an open contact.

    Returns the plastic work [J] of a contact that has ended in this step; 0 without the energy budget.

    Writes:  history, in_contact
    """
    plan, law, neighbors = state.plan, state.plan.law, state.neighbors
    names = list(neighbors.history)

    @ti.func
    def end_contact(list_index, constants, radius_eff, mass_eff, dt):
        energy_lost = 0.0 * dt
        if ti.static(len(names) > 0):
            if neighbors.in_contact[list_index] != NO_CONTACT:
                if ti.static(plan.features.energy_budget and "normal" in names):
                    normal_history = neighbors.history["normal"][list_index]
                    energy_lost = law.lost_energy(constants, radius_eff, mass_eff, dt, 0.0 * radius_eff, normal_history)
                for name in ti.static(names):
                    neighbors.history[name][list_index] = 0.0 * neighbors.history[name][list_index]
                neighbors.in_contact[list_index] = NO_CONTACT
        return energy_lost

    return end_contact
