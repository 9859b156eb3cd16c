"""Contact forces of one chunk of particles: normal law, friction, rolling, energy ledger, each only if needed.

Sums are written `a[i] = a[i] + b`: Taichi makes `a[i] += b` on a field an atomic operation, which costs more than the
whole contact law and is not needed within a chunk.
"""

from typing import Any

import taichi as ti

from granflow.device.encounter import build_encounter, build_pair_number, build_weight
from granflow.device.guards import GUARD_OVERLAP
from granflow.device.state import LOSSES, State
from granflow.device.walls import build_wall_geometry
from granflow.laws.mindlin import carried_displacement, elastic_plastic_spring, spring_loss
from granflow.laws.rolling import directional_torque

PLASTIC, FRICTION, ROLLING, DAMPING, WALL_WORK = range(len(LOSSES))


def build_lateral(state: State) -> Any:
    """Device function: tangential force on i of one contact [N] and the energy lost in this step [J]."""
    plan, history = state.plan, state.contacts.history.get("lateral")

    @ti.func
    def lateral(slot, constants, stiffness, share, normal_force, normal, middle, slide):
        carried = carried_displacement(history[slot], normal, middle)
        cap = constants[plan.friction_index] * normal_force
        force, kept = elastic_plastic_spring(stiffness, share, cap, carried, slide)
        history[slot] = kept
        lost = 0.0 * stiffness
        if ti.static(plan.features.ledger):
            lost = spring_loss(stiffness, share, carried, slide, force, kept)
        return force, lost

    return lateral


def build_rolling(state: State) -> Any:
    """Device function: rolling torque on i of one contact [N m] and the energy lost in this step [J]."""
    plan, history = state.plan, state.contacts.history.get("rolling")
    epsd = plan.features.rolling == "epsd"

    @ti.func
    def rolling(slot, constants, stiffness, share, normal_force, radius_eff, inertia_eff, normal, middle, rate, dt):
        across = rate - rate.dot(normal) * normal
        arm = constants[plan.rolling_index] * radius_eff
        torque = 0.0 * across
        lost = 0.0 * dt
        if ti.static(epsd):
            carried = carried_displacement(history[slot], normal, middle)
            spring = stiffness * radius_eff * radius_eff
            torque, kept = elastic_plastic_spring(spring, share, arm * normal_force, carried, dt * across)
            history[slot] = kept
            if ti.static(plan.features.ledger):
                lost = spring_loss(spring, share, carried, dt * across, torque, kept)
        else:
            mu = constants[plan.rolling_index]
            torque = directional_torque(radius_eff, mu, normal_force, across, inertia_eff, dt)
            lost = -dt * torque.dot(across)
        return torque, lost

    return rolling


def build_surface(state: State, with_wall: bool) -> Any:
    """Device function: tangential force, rolling torque and their losses of one contact.

    Returns (tangential force on i, rolling torque on i, loss by friction, loss by rolling).
    """
    plan, law, particles = state.plan, state.plan.law, state.particles
    features = plan.features
    lateral, rolling = build_lateral(state), build_rolling(state)

    @ti.func
    def partner_spin(i, j, pose):
        spin = 0.0 * particles.spin[i]
        if ti.static(not with_wall):
            spin = particles.spin[j]
        elif ti.static(features.moving_walls):
            spin = ti.cast(state.walls.spin[pose, -1 - j], state.backend.real)
        return spin

    @ti.func
    def inertia_eff(i, j):
        own = 0.4 * particles.mass[i] * particles.radius[i] * particles.radius[i]
        result = own
        if ti.static(not with_wall):
            other = 0.4 * particles.mass[j] * particles.radius[j] * particles.radius[j]
            result = own * other / (own + other)
        return result

    @ti.func
    def surface(
        i, j, pose, slot, dt, constants, memory, overlap, normal, middle, across, late_rate, arm, arm_partner,
        radius_eff, normal_force
    ):  # fmt: skip
        spin, other = particles.spin[i], partner_spin(i, j, pose)
        stiffness = law.lateral_stiffness(constants, radius_eff, overlap, memory)
        share = 0.0 * stiffness + 1.0
        if ti.static(law.lateral_grows):
            share = ti.sqrt(ti.max(overlap - dt * late_rate, 0.0) / overlap)
        slip = across - (arm * spin + arm_partner * other).cross(normal)
        force, torque = 0.0 * across, 0.0 * across
        friction_loss, rolling_loss = 0.0 * dt, 0.0 * dt
        if ti.static(features.friction):
            force, friction_loss = lateral(slot, constants, stiffness, share, normal_force, normal, middle, dt * slip)
        if ti.static(features.rolling != "none"):
            torque, rolling_loss = rolling(
                slot, constants, stiffness, share, normal_force, radius_eff, inertia_eff(i, j), normal,
                middle, spin - other, dt
            )  # fmt: skip
        return force, torque, friction_loss, rolling_loss

    return surface


def build_forget(state: State) -> Any:
    """Device function: empty a slot whose partners are apart; returns the plastic work of a contact that ended [J]."""
    plan, law, particles, contacts = state.plan, state.plan.law, state.particles, state.contacts
    others = [name for name in contacts.history if name != "normal"]

    @ti.func
    def forget(slot, i, j, constants, dt):
        lost = 0.0 * dt
        if ti.static("normal" in contacts.history):
            memory = contacts.history["normal"][slot]
            if memory[0] > 0.0:
                if ti.static(plan.features.ledger):
                    radius_eff, mass_eff = particles.radius[i], particles.mass[i]
                    if j >= 0:
                        radius_eff *= particles.radius[j] / (particles.radius[i] + particles.radius[j])
                        mass_eff *= particles.mass[j] / (particles.mass[i] + particles.mass[j])
                    lost = law.lost_energy(constants, radius_eff, mass_eff, dt, 0.0 * radius_eff, memory)
                contacts.history["normal"][slot] = 0.0 * memory
                for name in ti.static(others):
                    contacts.history[name][slot] = 0.0 * contacts.history[name][slot]
        else:
            for name in ti.static(others):
                held = contacts.history[name][slot]
                if held.dot(held) > 0.0:
                    contacts.history[name][slot] = 0.0 * held
        return lost

    return forget


def build_contact(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, slot, j, pose, time_step) -> (force on i, torque on i, torque on j) of one slot."""
    plan, law, particles, contacts, control = (
        state.plan, state.plan.law, state.particles, state.contacts, state.control
    )  # fmt: skip
    features, real = plan.features, state.backend.real
    memory_size = max(law.history_count, 1)
    encounter, surface, forget = build_encounter(state, with_wall), build_surface(state, with_wall), build_forget(state)
    pair_number, weight = build_pair_number(state), build_weight(state)
    geometry = build_wall_geometry(state)

    @ti.func
    def normal_memory(slot):
        memory = ti.Vector.zero(real, memory_size)
        if ti.static("normal" in contacts.history):
            memory = contacts.history["normal"][slot]
        return memory

    @ti.func
    def check_overlap(i, overlap, radius_eff):
        if overlap > plan.overlap_limit * ti.min(2.0 * radius_eff, particles.radius[i]):
            ti.atomic_max(control.guard[0], GUARD_OVERLAP)
            ti.atomic_min(control.guard_particle[0], particles.id[i])

    @ti.func
    def wall_work(i, j, pose, force, torque, dt):
        work = 0.0 * dt
        if ti.static(with_wall and features.moving_walls):
            velocity = geometry.surface_velocity(-1 - j, pose, particles.position[i])
            turning = state.walls.spin[pose, -1 - j]
            work = dt * (force.dot(ti.cast(velocity, real)) + torque.dot(ti.cast(turning, real)))
        return work

    @ti.func
    def contact(chunk, i, slot, j, pose, dt):
        force, torque, torque_partner = (
            0.0 * particles.velocity[i],
            0.0 * particles.velocity[i],
            0.0 * particles.velocity[i],
        )
        overlap, normal, middle, across, late_rate, rate, arm, arm_partner, radius_eff, mass_eff = encounter(
            i, j, pose, dt
        )
        constants = control.pair_constants[pair_number(i, j)]
        if overlap > 0.0:
            check_overlap(i, overlap, radius_eff)
            normal_force, viscous, memory = law.force(
                constants, radius_eff, mass_eff, dt, overlap, rate, normal_memory(slot)
            )
            if ti.static("normal" in contacts.history):
                contacts.history["normal"][slot] = memory
            force = normal_force * normal
            pressing = normal_force
            if ti.static(law.attracts):
                pressing += law.attraction(constants, radius_eff, overlap, memory)
            friction_loss, rolling_loss = 0.0 * dt, 0.0 * dt
            if ti.static(features.rotation):
                tangential, rolling, friction_loss, rolling_loss = surface(
                    i, j, pose, slot, dt, constants, memory, overlap, normal, middle, across, late_rate, arm,
                    arm_partner, radius_eff, pressing
                )  # fmt: skip
                force += tangential
                moment = normal.cross(tangential)
                torque, torque_partner = rolling - arm * moment, -rolling - arm_partner * moment
            if ti.static(features.ledger):
                share = weight(i, j)
                control.losses[chunk][FRICTION] = control.losses[chunk][FRICTION] + share * friction_loss
                control.losses[chunk][ROLLING] = control.losses[chunk][ROLLING] + share * rolling_loss
                control.losses[chunk][DAMPING] = control.losses[chunk][DAMPING] + share * viscous * rate * dt
                control.losses[chunk][WALL_WORK] = control.losses[chunk][WALL_WORK] + wall_work(
                    i, j, pose, force, torque, dt
                )
        else:
            lost = forget(slot, i, j, constants, dt)
            if ti.static(features.ledger):
                control.losses[chunk][PLASTIC] = control.losses[chunk][PLASTIC] + weight(i, j) * lost
        return force, torque, torque_partner

    return contact


def build_forces(state: State) -> Any:
    """Device function (chunk, count, pose, time_step): force and torque on the particles of one chunk.

    Reads:   position, velocity, velocity_now, spin, radius, mass, contact rows, walls
    Writes:  force, torque, history, losses, guard
    """
    plan, particles, contacts = state.plan, state.particles, state.contacts
    features, real, chunk_size = plan.features, state.backend.real, plan.chunk_size
    gravity, shared_chunks = [float(g) for g in plan.gravity], plan.chunk_size > 1
    grain_contact = build_contact(state, False)
    wall_contact = build_contact(state, True) if plan.has_walls else None

    @ti.func
    def start_chunk(first, last):
        for i in range(first, last):
            particles.force[i] = particles.mass[i] * ti.Vector(gravity, dt=real)
            if ti.static(features.rotation):
                particles.torque[i] = 0.0 * particles.torque[i]

    @ti.func
    def react(j, first, last, force, torque):
        if ti.static(shared_chunks):
            if j >= first and j < last:
                particles.force[j] = particles.force[j] - force
                if ti.static(features.rotation):
                    particles.torque[j] = particles.torque[j] + torque

    @ti.func
    def forces(chunk, count, pose, dt):
        first, last = chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)
        start_chunk(first, last)
        for i in range(first, last):
            total, total_torque = 0.0 * particles.velocity[i], 0.0 * particles.velocity[i]
            if ti.static(plan.has_walls):
                for slot in range(contacts.row_begin[i], contacts.row_middle[i]):
                    force, torque, _other = wall_contact(chunk, i, slot, contacts.partner[slot], pose, dt)
                    total, total_torque = total + force, total_torque + torque
            for slot in range(contacts.row_middle[i], contacts.row_end[i]):
                j = contacts.partner[slot]
                force, torque, other = grain_contact(chunk, i, slot, j, pose, dt)
                total, total_torque = total + force, total_torque + torque
                react(j, first, last, force, other)
            particles.force[i] = particles.force[i] + total
            if ti.static(features.rotation):
                particles.torque[i] = particles.torque[i] + total_torque

    return forces
