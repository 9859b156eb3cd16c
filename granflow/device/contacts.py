"""Contact forces of one chunk of particles: walls one contact at a time, grains in batches where a CPU does the work.

Sums are written `a[i] = a[i] + b`: Taichi makes `a[i] += b` on a field an atomic operation, which costs more than the
whole contact law and is not needed within a chunk.
"""

from typing import Any

import taichi as ti

from granflow.device.batch import build_batched_forces
from granflow.device.drive import build_enter_push
from granflow.device.encounter import (
    build_border_work,
    build_effective,
    build_encounter,
    build_pair_number,
    build_weight,
)
from granflow.device.guards import GUARD_OVERLAP
from granflow.device.handover import TURNS, build_inherit, build_leave, hands_over
from granflow.device.loads import build_enter_load
from granflow.device.pair import build_respond
from granflow.device.slots import build_forget, build_read, build_write
from granflow.device.state import DAMPING, FRICTION, PLASTIC, ROLLING, WALL_WORK, State
from granflow.device.walls import build_wall_geometry, build_wall_of


def build_contact(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, slot, j, pose, time_step) -> (force on i, torque on i) of one slot."""
    plan, particles, control = state.plan, state.particles, state.control
    features, real = plan.features, state.backend.real
    encounter, effective = build_encounter(state, with_wall), build_effective(state, with_wall)
    pair_number, weight, geometry = build_pair_number(state), build_weight(state), build_wall_geometry(state)
    enter_border_work = build_border_work(state)
    wall_of, handing = build_wall_of(state), with_wall and hands_over(state)
    leave, inherit = (build_leave(state), build_inherit(state)) if handing else (None, None)
    respond, read, write, forget = (
        build_respond(plan, False),
        build_read(state),
        build_write(state),
        build_forget(state),
    )
    measured = with_wall and features.loads
    enter_load = build_enter_load(state) if measured else None
    driven = with_wall and features.driven_walls
    _forget, enter_push = build_enter_push(state) if driven else (None, None)

    @ti.func
    def partner_spin(i, j, pose):
        spin = 0.0 * particles.velocity[i]
        if ti.static(features.rotation and not with_wall):
            spin = particles.spin[j]
        elif ti.static(features.rotation and features.moving_walls):
            spin = ti.cast(state.walls.spin[pose, wall_of(j)], real)
        return spin

    @ti.func
    def own_spin(i):
        spin = 0.0 * particles.velocity[i]
        if ti.static(features.rotation):
            spin = particles.spin[i]
        return spin

    @ti.func
    def check_overlap(i, j, overlap):
        smaller = particles.radius[i]
        if ti.static(not with_wall):
            smaller = ti.min(smaller, particles.radius[j])
        if overlap > plan.overlap_limit * smaller:
            ti.atomic_max(control.guard[0], GUARD_OVERLAP)
            ti.atomic_min(control.guard_particle[0], particles.id[i])

    @ti.func
    def wall_work(i, j, pose, force, torque, dt):
        work = 0.0 * dt
        if ti.static(with_wall and features.moving_walls):
            velocity = geometry.given_velocity(-1 - j, pose, particles.position[i])
            turning = state.walls.spin[pose, wall_of(j)]
            work = dt * (force.dot(ti.cast(velocity, real)) + torque.dot(ti.cast(turning, real)))
        return work

    @ti.func
    def enter_losses(chunk, share, friction_loss, rolling_loss, damping_loss, work):
        losses = control.losses[chunk]
        losses[FRICTION] += share * friction_loss
        losses[ROLLING] += share * rolling_loss
        losses[DAMPING] += share * damping_loss
        losses[WALL_WORK] += work
        control.losses[chunk] = losses

    @ti.func
    def enter_books(chunk, i, j, pose, normal, force, torque, friction_loss, rolling_loss, damping_loss, dt):
        if ti.static(features.ledger):
            work = wall_work(i, j, pose, force, torque, dt)
            enter_losses(chunk, weight(i, j), friction_loss, rolling_loss, damping_loss, work)
            if ti.static(features.shear and not with_wall):
                enter_border_work(chunk, i, j, force, pose, dt)
        if ti.static(driven):
            enter_push(chunk, wall_of(j), force)
        if ti.static(measured):
            enter_load(chunk, wall_of(j), i, normal, force, torque, dt)

    @ti.func
    def contact(chunk, i, slot, j, pose, dt):
        force, torque = 0.0 * particles.velocity[i], 0.0 * particles.velocity[i]
        overlap, normal, middle, across, late_rate, rate, arm, arm_partner = encounter(i, j, pose, dt)
        constants = control.pair_constants[pair_number(i, j)]
        radius_eff, mass_eff, inertia_eff = effective(i, j)
        if overlap > 0.0:
            check_overlap(i, j, overlap)
            if ti.static(handing):
                inherit(i, slot, j, pose)
            memory, slide, angle = read(slot)
            force, torque, _reaction, memory, slide, angle, friction_loss, rolling_loss, damping_loss = respond(
                constants, radius_eff, mass_eff, inertia_eff, overlap, normal, middle, across, late_rate, rate, arm,
                arm_partner, own_spin(i), partner_spin(i, j, pose), memory, slide, angle, dt
            )  # fmt: skip
            write(slot, memory, slide, angle)
            enter_books(chunk, i, j, pose, normal, force, torque, friction_loss, rolling_loss, damping_loss, dt)
        else:
            lost, left = 0.0 * dt, 0
            if ti.static(handing):
                left = leave(i, slot, j, pose)
            if left == 0:
                lost = forget(slot, constants, radius_eff, mass_eff, dt)
            if ti.static(features.ledger):
                control.losses[chunk][PLASTIC] = control.losses[chunk][PLASTIC] + weight(i, j) * lost
        return force, torque

    return contact


def build_forces(state: State) -> Any:
    """Device function (worker, chunk, count, pose, time_step): force and torque on the particles of one chunk.

    Reads:   position, velocity, velocity_now, spin, radius, mass, contact rows, walls
    Writes:  force, torque, history, losses, impulses, push, guard
    """
    plan, particles, contacts = state.plan, state.particles, state.contacts
    features, real, chunk_size = plan.features, state.backend.real, plan.chunk_size
    gravity, batched = [float(g) for g in plan.gravity], state.batch is not None
    batched_forces = build_batched_forces(state) if batched else None
    grain_contact = None if batched else build_contact(state, False)
    wall_contact = build_contact(state, True) if plan.has_walls else None
    turns = len(TURNS) if hands_over(state) else 1

    @ti.func
    def is_next(slot, turn):
        chosen = 1
        if ti.static(turns > 1):
            chosen = ti.cast(contacts.touching[slot] == ti.Vector(TURNS)[turn], ti.i32)
        return chosen

    driven = features.driven_walls
    forget_pushes, _enter = build_enter_push(state) if driven else (None, None)

    @ti.func
    def own_forces(chunk, i, pose, dt):
        """Weight, walls, and where nothing is batched the other grains."""
        force = particles.mass[i] * ti.Vector(gravity, dt=real)
        torque = 0.0 * force
        if ti.static(plan.has_walls):
            for turn in range(turns):
                for slot in range(contacts.row_begin[i], contacts.row_middle[i]):
                    if is_next(slot, turn) == 1:
                        more, turning = wall_contact(chunk, i, slot, contacts.partner[slot], pose, dt)
                        force, torque = force + more, torque + turning
        if ti.static(not batched):
            for slot in range(contacts.row_middle[i], contacts.row_end[i]):
                more, turning = grain_contact(chunk, i, slot, contacts.partner[slot], pose, dt)
                force, torque = force + more, torque + turning
        particles.force[i] = force
        if ti.static(features.rotation):
            particles.torque[i] = torque

    @ti.func
    def forces(worker, chunk, count, pose, dt):
        first, last = chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)
        if ti.static(driven):
            forget_pushes(chunk)
        for i in range(first, last):
            own_forces(chunk, i, pose, dt)
        if ti.static(batched):
            batched_forces(worker, chunk, first, last, pose, dt)

    return forces
