"""Contacts between grains by the batch, for CPUs: gather numbers into columns, do the arithmetic, hand out the forces.

The loop over the columns has no branch and no indirect address, so the compiler does four (float64) or eight (float32)
contacts in one instruction. Around it stand loops with the indirect addresses and the branches. A batch is a few rows,
so that the columns stay in the cache.
"""

from typing import Any

import taichi as ti

from granflow.device.apart import build_apart, build_drift
from granflow.device.encounter import build_border_work, build_effective, build_pair_number, build_weight
from granflow.device.fixed import build_felt_mass
from granflow.device.guards import GUARD_OVERLAP
from granflow.device.pair import build_meet, build_respond, build_touches, half_of_both
from granflow.device.slots import build_forget, build_read
from granflow.device.state import DAMPING, FRICTION, LANES, PLASTIC, ROLLING, State

BATCH = 128
"""Contacts from which on no further row joins a batch."""


@ti.func
def put(columns: ti.template(), worker, entry, vector):
    """Write a vector into columns, a number into each."""
    for k in ti.static(range(len(columns))):
        columns[k][worker, entry] = vector[k]


def build_batched_forces(state: State) -> Any:
    """Device function (worker, chunk, first, last, pose, time_step): add contacts between grains, rows first..last.

    Reads:   position, velocity, velocity_now, spin, radius, mass, contact rows
    Writes:  force, torque, history, losses, guard, the worker's batch
    """
    find, gather, respond, hand_out = _build_find(state), _build_gather(state), _build_respond(state), _build_out(state)

    @ti.func
    def batched_forces(worker, chunk, first, last, pose, dt):
        i = first
        while i < last:
            found = 0
            while i < last and found < BATCH:
                found = find(worker, chunk, i, found, pose, dt)
                i += 1
            gather(worker, found, pose, dt)
            respond(worker, (found + LANES - 1) // LANES * LANES, dt)
            hand_out(worker, chunk, found, first, last, pose, dt)

    return batched_forces


def _build_find(state: State) -> Any:
    """Device function: enter the touching partners of one row; returns where the entries end."""
    plan, particles, contacts, control, batch = state.plan, state.particles, state.contacts, state.control, state.batch
    real, remembers = state.backend.real, bool(contacts.history)
    touches, forget, pair_number = build_touches(real), build_forget(state), build_pair_number(state)
    effective, weight, apart = build_effective(state, False), build_weight(state), build_apart(state)

    @ti.func
    def part(chunk, slot, i, j, dt):
        radius_eff, mass_eff, _inertia = effective(i, j)
        lost = forget(slot, control.pair_constants[pair_number(i, j)], radius_eff, mass_eff, dt)
        if ti.static(plan.features.ledger):
            control.losses[chunk][PLASTIC] = control.losses[chunk][PLASTIC] + weight(i, j) * lost

    @ti.func
    def check_overlap(i, square, reach, smaller):
        deepest = reach - plan.overlap_limit * smaller
        if square < deepest * deepest:
            ti.atomic_max(control.guard[0], GUARD_OVERLAP)
            ti.atomic_min(control.guard_particle[0], particles.id[i])

    @ti.func
    def find(worker, chunk, i, begin, pose, dt):
        position, radius = particles.position[i], particles.radius[i]
        end = begin
        for slot in range(contacts.row_middle[i], contacts.row_end[i]):
            j = contacts.partner[slot]
            between = ti.cast(apart(position, particles.position[j], pose), real)
            radius_partner = particles.radius[j]
            batch.slot[worker, end] = slot
            batch.owner[worker, end] = i
            batch.partner[worker, end] = j
            batch.radius_partner[worker, end] = radius_partner
            for axis in ti.static(range(3)):
                batch.apart[axis][worker, end] = between[axis]
            square, reach = between.dot(between), radius + radius_partner
            near = touches(square, reach)
            end += ti.cast(near, ti.i32)
            check_overlap(i, square, reach, ti.select(radius < radius_partner, radius, radius_partner))
            if ti.static(remembers):
                if contacts.touching[slot] == 1 and not near:
                    part(chunk, slot, i, j, dt)
        return end

    return find


def _build_gather(state: State) -> Any:
    """Device function: velocities, masses and histories of the entries, into columns."""
    plan, particles, control, batch = state.plan, state.particles, state.control, state.batch
    law, features = plan.law, plan.features
    read, pair_number, prepares = build_read(state), build_pair_number(state), law.prepare is not None
    drift = build_drift(state)
    felt_mass = build_felt_mass(state)

    @ti.func
    def prepared(constants, worker, entry, i, j, late, now, memory, dt):
        """The branches of the law."""
        apart = ti.Vector([batch.apart[0][worker, entry], batch.apart[1][worker, entry], batch.apart[2][worker, entry]])
        distance = ti.sqrt(apart.dot(apart))
        radius, radius_partner = particles.radius[i], particles.radius[j]
        rate = -now.dot(1.0 / distance * apart)
        return law.prepare(
            constants, half_of_both(radius, radius_partner), half_of_both(felt_mass(i), felt_mass(j)), dt,
            radius + radius_partner - distance, rate, memory
        )  # fmt: skip

    @ti.func
    def gather(worker, end, pose, dt):
        for entry in range(end):
            i, j, slot = batch.owner[worker, entry], batch.partner[worker, entry], batch.slot[worker, entry]
            batch.radius[worker, entry] = particles.radius[i]
            late = particles.velocity[i] - particles.velocity[j] - drift(i, j, pose)
            now = late
            put(batch.late, worker, entry, late)
            if ti.static(features.rate_dependent):
                now = particles.velocity_now[i] - particles.velocity_now[j] - drift(i, j, pose)
                put(batch.now, worker, entry, now)
            batch.mass[worker, entry] = felt_mass(i)
            batch.mass_partner[worker, entry] = felt_mass(j)
            if ti.static(features.rotation):
                put(batch.spin, worker, entry, particles.spin[i])
                put(batch.spin_partner, worker, entry, particles.spin[j])
            memory, slide, angle = read(slot)
            number = pair_number(i, j)
            if ti.static(prepares):
                memory = prepared(control.pair_constants[number], worker, entry, i, j, late, now, memory, dt)
            if ti.static(not features.one_material):
                put(batch.constants, worker, entry, control.pair_constants[number])
            put(batch.memory, worker, entry, memory)
            put(batch.slide, worker, entry, slide)
            put(batch.angle, worker, entry, angle)

    return gather


def _build_respond(state: State) -> Any:
    """Function (worker, end, time_step): the arithmetic of all entries, column to column, results in place of inputs.

    A function of its own for the compiler, which gives up on the loop where it stands amid all the others.
    """
    plan, control, batch, real = state.plan, state.control, state.batch, state.backend.real
    features, size, constant_count = plan.features, max(plan.law.history_count, 1), plan.pair_constants.shape[1]
    meet, response = build_meet(plan), build_respond(plan, True)

    @ti.func
    def get(columns: ti.template(), worker, entry, count: ti.template()):
        vector = ti.Vector.zero(real, count)
        for k in ti.static(range(len(columns))):
            vector[k] = columns[k][worker, entry]
        return vector

    @ti.func
    def effective(worker, entry):
        radius, radius_partner = batch.radius[worker, entry], batch.radius_partner[worker, entry]
        mass, mass_partner = batch.mass[worker, entry], batch.mass_partner[worker, entry]
        inertia, inertia_partner = 0.4 * mass * radius * radius, 0.4 * mass_partner * radius_partner * radius_partner
        return (
            half_of_both(radius, radius_partner), half_of_both(mass, mass_partner),
            half_of_both(inertia, inertia_partner)
        )  # fmt: skip

    @ti.func
    def see(worker, entry, dt):
        return meet(
            batch.radius[worker, entry], batch.radius_partner[worker, entry], get(batch.apart, worker, entry, 3),
            get(batch.late, worker, entry, 3), get(batch.now, worker, entry, 3), dt
        )  # fmt: skip

    @ti.real_func
    def respond(worker: ti.i32, end: ti.i32, dt: real):
        shared = control.pair_constants[0]
        for entry in range(end):
            constants = shared
            if ti.static(not features.one_material):
                constants = get(batch.constants, worker, entry, constant_count)
            overlap, normal, middle, across, late_rate, rate, arm, arm_partner = see(worker, entry, dt)
            radius_eff, mass_eff, inertia_eff = effective(worker, entry)
            spin, spin_partner = get(batch.spin, worker, entry, 3), get(batch.spin_partner, worker, entry, 3)
            memory, slide = get(batch.memory, worker, entry, size), get(batch.slide, worker, entry, 3)
            angle = get(batch.angle, worker, entry, 3)
            force, torque, torque_partner, memory, slide, angle, friction_loss, rolling_loss, damping_loss = response(
                constants, radius_eff, mass_eff, inertia_eff, overlap, normal, middle, across, late_rate, rate, arm,
                arm_partner, spin, spin_partner, memory, slide, angle, dt
            )  # fmt: skip
            put(batch.apart, worker, entry, force)
            put(batch.spin, worker, entry, torque)
            put(batch.spin_partner, worker, entry, torque_partner)
            put(batch.memory, worker, entry, memory)
            put(batch.slide, worker, entry, slide)
            put(batch.angle, worker, entry, angle)
            if ti.static(features.ledger):
                put(batch.losses, worker, entry, ti.Vector([friction_loss, rolling_loss, damping_loss]))

    return respond


def _build_out(state: State) -> Any:
    """Device function: forces to both partners, if the second is of this chunk, and histories back to their slots."""
    plan, particles, contacts, control, batch = state.plan, state.particles, state.contacts, state.control, state.batch
    features, history = plan.features, contacts.history
    weight, enter_border_work = build_weight(state), build_border_work(state)

    @ti.func
    def vector_of(columns: ti.template(), worker, entry):
        return ti.Vector([columns[0][worker, entry], columns[1][worker, entry], columns[2][worker, entry]])

    @ti.func
    def keep(worker, entry, slot):
        if ti.static(len(history) > 0):
            contacts.touching[slot] = 1
        if ti.static("normal" in history):
            for k in ti.static(range(len(batch.memory))):
                history["normal"][slot][k] = batch.memory[k][worker, entry]
        if ti.static("lateral" in history):
            history["lateral"][slot] = vector_of(batch.slide, worker, entry)
        if ti.static("rolling" in history):
            history["rolling"][slot] = vector_of(batch.angle, worker, entry)

    @ti.func
    def enter_losses(worker, chunk, i, j, entry):
        share = weight(i, j)
        for k, loss in ti.static(enumerate((FRICTION, ROLLING, DAMPING))):
            control.losses[chunk][loss] = control.losses[chunk][loss] + share * batch.losses[k][worker, entry]

    @ti.func
    def hand_out(worker, chunk, end, first, last, pose, dt):
        for entry in range(end):
            i, j = batch.owner[worker, entry], batch.partner[worker, entry]
            force = vector_of(batch.apart, worker, entry)
            particles.force[i] = particles.force[i] + force
            if ti.static(features.rotation):
                particles.torque[i] = particles.torque[i] + vector_of(batch.spin, worker, entry)
            if j >= first and j < last:
                particles.force[j] = particles.force[j] - force
                if ti.static(features.rotation):
                    particles.torque[j] = particles.torque[j] + vector_of(batch.spin_partner, worker, entry)
            keep(worker, entry, batch.slot[worker, entry])
            if ti.static(features.ledger):
                enter_losses(worker, chunk, i, j, entry)
                if ti.static(features.shear):
                    enter_border_work(chunk, i, j, force, pose, dt)

    return hand_out
