"""Contacts of the restitution 0 (Zhou 2011, Eq. 4 for e -> 0), where unloading is vertical; not from the paper.

In the limit a contact yields along k d^1.5 while its overlap d increases, and at d = dmax carries any force between 0
and k dmax^1.5 without moving: the force that the other forces W on the pair require, M d'' = W - F = 0. A contact is in
one of three states:

    yielding    F = min(k d^1.5, G),  G: force that stops the approach within this step, until it is the smaller one
    stopping    F = G, as long as the force exceeds the load of the pair
    supporting  F = P + K (d - dmax) + c d' >= 0, until it exceeds k d^1.5

The forces on the pair follow from its deceleration over the last step, D = M (d'(t - dt) - d'(t))/dt, as W = F(t - dt)
- D. The contact stops the pair where the velocity would change its sign at this deceleration, with

    G = P + (F(t - dt) - P) M d'/(D dt) >= 0,     P = max(2 W - F(t - dt), 0)

In an impact the contact itself decelerates the pair, alone (W = 0), or together with others that stop at the same time
(W < F/2): P is 0 and the velocity exactly 0 after this step, whatever the time step. Contacts that load each other more
strongly, as those of a particle in an acute wedge, stop within some steps, with a rebound of first order in the time
step. Under a load that changes slowly D is small, P = W, and the contact keeps its force: a bed that is loaded slowly
has the overlaps of Hertz contacts.

The support replaces the vertical line by one of the slope K, which passes through (dmax, P), with

    K = max(0.1 M/dt^2, 1.5 k sqrt(dmax)),     c = (1 - K dt^2/M) M/(4 dt)

It is never softer than the loading curve; its displacement under a load is of second order in the time step. A densely
packed bed, 4 (K dt^2/M + 2 c dt/M) < 4, is stable. A pair that separates from the support, but not from the overlap,
finds the line at dmax with P = 0, and is stopped there without rebound as in an impact.

All work of the force is lost. The contact accumulates it, mean of the forces at both ends of the step times the change
of the overlap, which is the change of the kinetic energy in the leapfrog scheme.
"""

from types import SimpleNamespace

import numpy as np

from granflow.contact.law import ContactState, HistoryField
from granflow.contact.material import PairMaterial
from granflow.device_functions import ti

SUPPORT_NUMBER = 0.1
"""Smallest K dt^2/M of the support."""

SUPPORT_DAMPING = 0.25
"""c dt/M of the support for K dt^2/M -> 0."""

SUPPORT_MODES = SUPPORT_NUMBER + 2.0 * SUPPORT_DAMPING * (1.0 - SUPPORT_NUMBER)
"""K dt^2/M + 2 c dt/M of the support: times the number of contacts that act on a mode, at most 4."""

YIELDING, STOPPING, SUPPORTING = 0.0, 1.0, 2.0
"""States of a contact, in the history field `recovery`."""

HISTORY = (
    HistoryField("support", "force of the support at the maximum overlap", "N"),
    HistoryField("force_before", "normal force one step before", "N"),
    HistoryField("rate_before", "overlap rate one step before", "m/s"),
    HistoryField("work", "work on the contact", "J"),
)
"""Further history of contacts in a scene with a pair of the restitution 0."""


def is_inelastic(pair: PairMaterial) -> bool:
    """Whether the restitution of a pair is the number 0."""
    return pair.restitution == 0.0


@ti.func
def inelastic_pair(constants):
    """Device form of `is_inelastic`: a pair with e(v) has a limit velocity, and the constant restitution 0."""
    return constants.restitution + constants.limit_velocity == 0.0


@ti.func
def stopping_force(mass_rate, rate, capacity, history):
    """G [N], the load P [N] that remains, and whether the force exceeds the load W of the pair.

    G is `capacity` where an approaching pair does not decelerate.

    mass_rate:  M/dt [kg/s]
    rate:       overlap rate at the half step [m/s]
    capacity:   k d^1.5 [N]
    """
    change = history.rate_before - rate
    decelerates = (change > 0.0) & (history.force_before > 0.0)
    load = ti.min(ti.max(history.force_before - 2.0 * mass_rate * change, 0.0), history.force_before)
    share = rate / ti.select(decelerates, change, 1.0)
    stopping = ti.max(load + share * (history.force_before - load), 0.0)
    force = ti.select(decelerates, stopping, ti.select(rate > 0.0, capacity, load))
    begins = history.overlap_max == 0.0
    return ti.select(begins, mass_rate * ti.max(rate, 0.0), force), load, decelerates


@ti.func
def inelastic_force(contact, k, rate, history):
    """Force [N] and history of an inelastic pair; `recovery` is its state: YIELDING, STOPPING or SUPPORTING.

    k:     Hertz stiffness [N/m^1.5]
    rate:  overlap rate at the half step [m/s]
    """
    overlap, mass_rate = contact.overlap, contact.mass_eff / contact.time_step
    largest = ti.max(overlap, history.overlap_max)
    capacity = k * ti.sqrt(largest) * largest
    stopping, load, decelerates = stopping_force(mass_rate, rate, capacity, history)
    yields = history.recovery == YIELDING
    stops = (history.recovery == STOPPING) & decelerates

    number = ti.max(1.5 * k * ti.sqrt(largest) * (contact.time_step / mass_rate), SUPPORT_NUMBER)
    stiffness = number * (mass_rate / contact.time_step)
    line = history.support + stiffness * (overlap - history.overlap_max)
    damping = SUPPORT_DAMPING * ti.max(1.0 - number, 0.0) * mass_rate
    held = ti.select(line > 0.0, ti.max(line + damping * rate, 0.0), 0.0)
    separates = (line <= 0.0) & (overlap < history.overlap_max)
    arrives = decelerates & (load == 0.0) & (history.support == 0.0)  # at the end of the line, and without load
    lands = arrives & (stopping < history.force_before) & ~stops

    trial = ti.select(yields | stops | lands, stopping, held)
    force = ti.min(trial, capacity)
    reloads = ~(stops | lands) & (trial >= capacity) & (overlap >= history.overlap_max)
    state = ti.select(stops, STOPPING, ti.select(reloads, YIELDING, SUPPORTING))
    state = ti.select(yields, ti.select(trial < capacity, STOPPING, YIELDING), state)

    history_new = history
    history_new.recovery = state
    history_new.overlap_max = ti.select(yields | (state == YIELDING), largest, history.overlap_max)
    anchored = stiffness * (history_new.overlap_max - overlap)
    support = ti.select(lands, anchored, ti.select(separates, 0.0, history.support))
    history_new.support = ti.select(yields | stops, load + anchored, support)
    travel = contact.time_step * ti.select(history.overlap_max == 0.0, ti.max(rate, 0.0), rate)
    history_new.work += 0.5 * (force + history.force_before) * travel
    history_new.force_before = force
    history_new.rate_before = rate
    return force, history_new


def reference_inelastic(contact: ContactState, k: float, rate: float) -> tuple[float, dict[str, float]]:
    """Reference implementation of `inelastic_force` in numpy: force [N] and changed history fields."""
    before: SimpleNamespace = contact.history
    mass, time_step, overlap = contact.mass_eff, contact.time_step, contact.overlap
    mass_rate, change = mass / time_step, before.rate_before - rate
    deceleration = mass_rate * change
    load = float(np.clip(before.force_before - 2.0 * deceleration, 0.0, before.force_before))
    if before.overlap_max == 0.0:
        stopping = mass_rate * max(rate, 0.0)
    elif deceleration > 0.0 and before.force_before > 0.0:
        stopping = max(load + rate / change * (before.force_before - load), 0.0)
    else:
        stopping = np.inf if rate > 0.0 else load
    largest = max(overlap, before.overlap_max)
    hertz = k * np.sqrt(largest) * largest
    number = max(1.5 * k * np.sqrt(largest) * (time_step / mass_rate), SUPPORT_NUMBER)
    stiffness = number * (mass_rate / time_step)
    force, state, largest_new = min(stopping, hertz), STOPPING, before.overlap_max
    if before.recovery == YIELDING:
        state, largest_new = STOPPING if stopping < hertz else YIELDING, largest
        support = load + stiffness * (largest - overlap)
    elif before.recovery == STOPPING and deceleration > 0.0 and before.force_before > 0.0:
        support = load + stiffness * (largest_new - overlap)
    else:
        depth = overlap - before.overlap_max
        elastic = before.support + stiffness * depth
        if 0.0 == before.support == load and deceleration > 0.0 and stopping < before.force_before:
            state, support = SUPPORTING, -stiffness * depth
        else:
            viscous = SUPPORT_DAMPING * max(1.0 - number, 0.0) * mass_rate * rate
            force = min(max(elastic + viscous, 0.0), hertz) if elastic > 0.0 else 0.0
            if force < hertz or depth < 0.0:
                state, support = SUPPORTING, 0.0 if elastic <= 0.0 and depth < 0.0 else before.support
            else:
                state, support, largest_new = YIELDING, before.support, largest
    travel = time_step * (max(rate, 0.0) if before.overlap_max == 0.0 else rate)
    return force, {
        "overlap_max": largest_new,
        "restitution": 0.0,
        "recovery": state,
        "support": support,
        "force_before": force,
        "rate_before": rate,
        "work": before.work + 0.5 * (force + before.force_before) * travel,
    }
