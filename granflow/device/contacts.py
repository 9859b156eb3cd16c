"""Contact forces of one chunk of particles: normal law, friction, rolling, energy ledger, each only if needed."""

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
    def lateral(slot, constants, stiffness, share, normal_force, middle, slide, twist):
        carried = carried_displacement(history[slot], middle, twist)
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
    def rolling(slot, constants, stiffness, share, normal_force, radius_eff, inertia_eff, middle, rate, twist, dt):
        across = rate - rate.dot(middle) * middle
        arm = constants[plan.rolling_index] * radius_eff
        torque = 0.0 * across
        lost = 0.0 * dt
        if ti.static(epsd):
            carried = carried_displacement(history[slot], middle, twist)
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


def build_surface(state: State) -> Any:
    """Device function: tangential force, rolling torque and their losses of one contact.

    Returns (tangential force on i, rolling torque on i, loss by friction, loss by rolling).
    """
    plan, law, particles = state.plan, state.plan.law, state.particles
    features = plan.features
    lateral, rolling = build_lateral(state), build_rolling(state)

    @ti.func
    def partner_spin(i, j):
        spin = 0.0 * particles.spin[i]
        if j >= 0:
            spin = particles.spin[j]
        return spin

    @ti.func
    def inertia_eff(i, j):
        own = 0.4 * particles.mass[i] * particles.radius[i] * particles.radius[i]
        result = own
        if j >= 0:
            other = 0.4 * particles.mass[j] * particles.radius[j] * particles.radius[j]
            result = own * other / (own + other)
        return result

    @ti.func
    def surface(i, j, slot, dt, constants, memory, overlap, middle, late, arm, arm_partner, radius_eff, normal_force):
        spin, other = particles.spin[i], partner_spin(i, j)
        rate = -late.dot(middle)
        stiffness = law.lateral_stiffness(constants, radius_eff, overlap, memory)
        share = 0.0 * stiffness + 1.0
        if ti.static(law.lateral_grows):
            share = ti.sqrt(ti.max(overlap - dt * rate, 0.0) / overlap)
        slip = late + rate * middle - (arm * spin + arm_partner * other).cross(middle)
        twist = 0.5 * dt * (spin + other).dot(middle)
        force, torque = 0.0 * late, 0.0 * late
        friction_loss, rolling_loss = 0.0 * dt, 0.0 * dt
        if ti.static(features.friction):
            force, friction_loss = lateral(slot, constants, stiffness, share, normal_force, middle, dt * slip, twist)
        if ti.static(features.rolling != "none"):
            torque, rolling_loss = rolling(
                slot, constants, stiffness, share, normal_force, radius_eff, inertia_eff(i, j), middle,
                spin - other, twist, dt
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


def build_forces(state: State) -> Any:
    """Device function (chunk, count, pose, time_step): force and torque on the particles of one chunk.

    Reads:   position, velocity, velocity_now, spin, radius, mass, contact rows, walls
    Writes:  force, torque, history, losses, guard
    """
    plan, law, particles, contacts, control = (
        state.plan, state.plan.law, state.particles, state.contacts, state.control
    )  # fmt: skip
    features, real, chunk_size = plan.features, state.backend.real, plan.chunk_size
    gravity = [float(g) for g in plan.gravity]
    memory_size = max(law.history_count, 1)
    encounter, surface, forget = build_encounter(state), build_surface(state), build_forget(state)
    pair_number, weight = build_pair_number(state), build_weight(state)
    geometry, shared_chunks, loss_count = build_wall_geometry(state), plan.chunk_size > 1, len(LOSSES)

    @ti.func
    def start_chunk(first, last):
        for i in range(first, last):
            particles.force[i] = particles.mass[i] * ti.Vector(gravity, dt=real)
            if ti.static(features.rotation):
                particles.torque[i] *= 0.0

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
    def wall_work(i, j, pose, force, dt):
        work = 0.0 * dt
        if ti.static(features.moving_walls):
            if j < 0:
                velocity = geometry.surface_velocity(-1 - j, pose, particles.position[i])
                work = dt * force.dot(ti.cast(velocity, real))
        return work

    @ti.func
    def react(j, first, last, force, torque):
        if ti.static(shared_chunks):
            if j >= first and j < last:
                particles.force[j] -= force
                if ti.static(features.rotation):
                    particles.torque[j] += torque

    @ti.func
    def forces(chunk, count, pose, dt):
        first, last = chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)
        start_chunk(first, last)
        losses = ti.Vector.zero(ti.f64, loss_count)
        for i in range(first, last):
            total, total_torque = 0.0 * particles.velocity[i], 0.0 * particles.velocity[i]
            for slot in range(contacts.row_begin[i], contacts.row_end[i]):
                j = contacts.partner[slot]
                overlap, normal, middle, late, rate, arm, arm_partner, radius_eff, mass_eff = encounter(i, j, pose, dt)
                constants = control.pair_constants[pair_number(i, j)]
                if overlap > 0.0:
                    check_overlap(i, overlap, radius_eff)
                    normal_force, viscous, memory = law.force(
                        constants, radius_eff, mass_eff, dt, overlap, rate, normal_memory(slot)
                    )
                    if ti.static("normal" in contacts.history):
                        contacts.history["normal"][slot] = memory
                    force, spin_torque, other_torque = normal_force * normal, 0.0 * normal, 0.0 * normal
                    friction_loss, rolling_loss = 0.0 * dt, 0.0 * dt
                    if ti.static(features.rotation):
                        tangential, torque, friction_loss, rolling_loss = surface(
                            i, j, slot, dt, constants, memory, overlap, middle, late, arm, arm_partner,
                            radius_eff, normal_force
                        )  # fmt: skip
                        force += tangential
                        moment = normal.cross(tangential)
                        spin_torque, other_torque = torque - arm * moment, -torque - arm_partner * moment
                    total += force
                    total_torque += spin_torque
                    react(j, first, last, force, other_torque)
                    if ti.static(features.ledger):
                        share = weight(i, j)
                        losses[FRICTION] += share * friction_loss
                        losses[ROLLING] += share * rolling_loss
                        losses[DAMPING] += share * viscous * rate * dt
                        losses[WALL_WORK] += wall_work(i, j, pose, force, dt)
                else:
                    lost = forget(slot, i, j, constants, dt)
                    if ti.static(features.ledger):
                        losses[PLASTIC] += weight(i, j) * lost
            particles.force[i] += total
            if ti.static(features.rotation):
                particles.torque[i] += total_torque
        if ti.static(features.ledger):
            control.losses[chunk] += losses

    return forces
