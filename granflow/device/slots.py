"""What one contact slot remembers: read, written and forgotten."""

from typing import Any

import taichi as ti

from granflow.device.state import State

APART, TOUCHING, LEFT = range(3)
"""A slot without contact, with one, and with the memory of one that another slot may take over in this step."""


def build_read(state: State) -> Any:
    """Device function (slot) -> (normal memory, lateral displacement, rolling angle); zeros where nothing is kept."""
    history, real = state.contacts.history, state.backend.real
    size = max(state.plan.law.history_count, 1)

    @ti.func
    def read(slot):
        memory, slide, angle = ti.Vector.zero(real, size), ti.Vector.zero(real, 3), ti.Vector.zero(real, 3)
        if ti.static("normal" in history):
            memory = history["normal"][slot]
        if ti.static("lateral" in history):
            slide = history["lateral"][slot]
        if ti.static("rolling" in history):
            angle = history["rolling"][slot]
        return memory, slide, angle

    return read


def build_write(state: State) -> Any:
    """Device function (slot, normal memory, lateral displacement, rolling angle): keep them; the slot is touching."""
    contacts, history = state.contacts, state.contacts.history

    @ti.func
    def write(slot, memory, slide, angle):
        if ti.static(len(history) > 0):
            contacts.touching[slot] = TOUCHING
        if ti.static("normal" in history):
            history["normal"][slot] = memory
        if ti.static("lateral" in history):
            history["lateral"][slot] = slide
        if ti.static("rolling" in history):
            history["rolling"][slot] = angle

    return write


def build_forget(state: State) -> Any:
    """Device function: empty a slot whose partners are apart; returns the plastic work of a contact that ended [J]."""
    plan, law, contacts = state.plan, state.plan.law, state.contacts
    names = list(contacts.history)

    @ti.func
    def forget(slot, constants, radius_eff, mass_eff, dt):
        lost = 0.0 * dt
        if ti.static(len(names) > 0):
            if contacts.touching[slot] != APART:
                if ti.static(plan.features.ledger and "normal" in names):
                    memory = contacts.history["normal"][slot]
                    lost = law.lost_energy(constants, radius_eff, mass_eff, dt, 0.0 * radius_eff, memory)
                for name in ti.static(names):
                    contacts.history[name][slot] = 0.0 * contacts.history[name][slot]
                contacts.touching[slot] = APART
        return lost

    return forget
