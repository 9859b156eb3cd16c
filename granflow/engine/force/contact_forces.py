"""Contact forces on one chunk of particles: wall contacts one at a time, particle contacts in batches on a CPU.

Sums are written `a[i] = a[i] + b`: Taichi compiles `a[i] += b` on a field to an atomic operation, which costs more than
the whole contact model and is not needed within a chunk.
"""

from typing import Any

import taichi as ti

from granflow.engine.force.pair_force import build_pair_force
from granflow.engine.force.pair_kinematics import (
    build_boundary_work,
    build_effective,
    build_pair_kinematics,
    build_pair_number,
    build_weight,
)
from granflow.engine.force.simd_pair_force import build_batched_forces
from granflow.engine.force.wall_forces import build_add_impulse
from granflow.engine.limits import ABORT_OVERLAP
from granflow.engine.neighbor.contact_history import build_end_contact, build_read_history, build_write_history
from granflow.engine.neighbor.mesh_contact_history import (
    CONTACT_ORDER,
    build_acquire_history,
    build_release_history,
    transfers_history,
)
from granflow.engine.state import State
from granflow.engine.wall_dynamics import build_add_wall_force
from granflow.engine.walls import WallGeometry, build_wall_of
from granflow.plan.chunk_sums import DAMPING, FRICTION, PLASTIC, ROLLING, WALL_WORK


def build_contact(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, list index, j, pose, time_step) -> (force [N], torque [N m]) on i of one contact.

    with_wall:  True for walls (j < 0), False for particles

    Without overlap it ends the contact and clears its history; its plastic work is added to the losses.

    Reads:   position, velocity, velocity_synchronized, angular_velocity, radius, mass, history, walls
    Writes:  history, in_contact, losses, boundary_work, impulses, wall_force, abort, abort_particle
    """
    plan, particles, control = state.plan, state.particles, state.control
    features, real = plan.features, state.backend.real
    pair_kinematics, effective = build_pair_kinematics(state, with_wall), build_effective(state, with_wall)
    pair_number, weight, geometry = build_pair_number(state), build_weight(state), WallGeometry(state)
    add_boundary_work = build_boundary_work(state)
    wall_of, transfers = build_wall_of(state), with_wall and transfers_history(state)
    release_history, acquire_history = (
        (build_release_history(state), build_acquire_history(state)) if transfers else (None, None)
    )
    pair_force, read_history, write_history, end_contact = (
        build_pair_force(plan, False),
        build_read_history(state),
        build_write_history(state),
        build_end_contact(state),
    )
    measured = with_wall and features.wall_forces
    add_impulse = build_add_impulse(state) if measured else None
    force_controlled = with_wall and features.force_controlled_walls
    _clear, add_wall_force = build_add_wall_force(state) if force_controlled else (None, None)

    @ti.func
    def angular_velocity_of_partner(i, j, pose):
        angular_velocity = 0.0 * particles.velocity[i]
        if ti.static(features.rotation and not with_wall):
            angular_velocity = particles.angular_velocity[j]
        elif ti.static(features.rotation and features.moving_walls):
            angular_velocity = ti.cast(state.walls.angular_velocity[pose, wall_of(j)], real)
        return angular_velocity

    @ti.func
    def angular_velocity_of(i):
        angular_velocity = 0.0 * particles.velocity[i]
        if ti.static(features.rotation):
            angular_velocity = particles.angular_velocity[i]
        return angular_velocity

    @ti.func
    def check_overlap(i, j, overlap):
        radius_min = particles.radius[i]
        if ti.static(not with_wall):
            radius_min = ti.min(radius_min, particles.radius[j])
        if overlap > plan.max_overlap * radius_min:
            ti.atomic_max(control.abort[0], ABORT_OVERLAP)
            ti.atomic_min(control.abort_particle[0], particles.id[i])

    @ti.func
    def wall_work(i, j, pose, force, torque, dt):
        """Work of the wall motion on particle i in this step [J]; prescribed motions only."""
        work = 0.0 * dt
        if ti.static(with_wall and features.moving_walls):
            velocity = geometry.prescribed_velocity(-1 - j, pose, particles.position[i])
            angular_velocity = state.walls.angular_velocity[pose, wall_of(j)]
            work = dt * (force.dot(ti.cast(velocity, real)) + torque.dot(ti.cast(angular_velocity, real)))
        return work

    @ti.func
    def add_losses(chunk, share, friction_loss, rolling_loss, damping_loss, work):
        losses = control.losses[chunk]
        losses[FRICTION] += share * friction_loss
        losses[ROLLING] += share * rolling_loss
        losses[DAMPING] += share * damping_loss
        losses[WALL_WORK] += work
        control.losses[chunk] = losses

    @ti.func
    def add_to_accounting(chunk, i, j, pose, normal, force, torque, friction_loss, rolling_loss, damping_loss, dt):
        if ti.static(features.energy_budget):
            work = wall_work(i, j, pose, force, torque, dt)
            add_losses(chunk, weight(i, j), friction_loss, rolling_loss, damping_loss, work)
            if ti.static(features.lees_edwards and not with_wall):
                add_boundary_work(chunk, i, j, force, pose, dt)
        if ti.static(force_controlled):
            add_wall_force(chunk, wall_of(j), force)
        if ti.static(measured):
            add_impulse(chunk, wall_of(j), i, normal, force, torque, dt)

    @ti.func
    def contact(chunk, i, list_index, j, pose, dt):
        force, torque = 0.0 * particles.velocity[i], 0.0 * particles.velocity[i]
        overlap, normal, normal_half, velocity_tangential, overlap_rate_half, rate, arm, arm_partner = pair_kinematics(
            i, j, pose, dt
        )
        constants = control.pair_constants[pair_number(i, j)]
        radius_eff, mass_eff, inertia_eff = effective(i, j)
        if overlap > 0.0:
            check_overlap(i, j, overlap)
            if ti.static(transfers):
                acquire_history(i, list_index, j, pose)
            normal_history, tangential_displacement, rolling_displacement = read_history(list_index)
            (
                force,
                torque,
                _reaction,
                normal_history,
                tangential_displacement,
                rolling_displacement,
                friction_loss,
                rolling_loss,
                damping_loss,
            ) = pair_force(
                constants,
                radius_eff,
                mass_eff,
                inertia_eff,
                overlap,
                normal,
                normal_half,
                velocity_tangential,
                overlap_rate_half,
                rate,
                arm,
                arm_partner,
                angular_velocity_of(i),
                angular_velocity_of_partner(i, j, pose),
                normal_history,
                tangential_displacement,
                rolling_displacement,
                dt,
            )
            write_history(list_index, normal_history, tangential_displacement, rolling_displacement)
            add_to_accounting(chunk, i, j, pose, normal, force, torque, friction_loss, rolling_loss, damping_loss, dt)
        else:
            energy_lost, released = 0.0 * dt, 0
            if ti.static(transfers):
                released = release_history(i, list_index, j, pose)
            if released == 0:
                energy_lost = end_contact(list_index, constants, radius_eff, mass_eff, dt)
            if ti.static(features.energy_budget):
                control.losses[chunk][PLASTIC] = control.losses[chunk][PLASTIC] + weight(i, j) * energy_lost
        return force, torque

    return contact


def build_forces(state: State) -> Any:
    """Device function (worker, chunk, count, pose, time_step): force and torque on the particles of one chunk.

    Forces are at the time of the positions and include the weight. A pair across two chunks is evaluated in both, so
    that no two workers write to the same particle.

    Reads:   position, velocity, velocity_synchronized, angular_velocity, radius, mass, neighbor lists, walls
    Writes:  force, torque, history, losses, impulses, wall forces, abort
    """
    plan, particles, neighbors = state.plan, state.particles, state.neighbors
    features, real, chunk_size = plan.features, state.backend.real, plan.chunk_size
    gravity, batched = [float(g) for g in plan.gravity], state.batch is not None
    batched_forces = build_batched_forces(state) if batched else None
    particle_contact = None if batched else build_contact(state, False)
    wall_contact = build_contact(state, True) if plan.has_walls else None
    pass_count = len(CONTACT_ORDER) if transfers_history(state) else 1

    @ti.func
    def in_this_pass(list_index, pass_index):
        """1 if the entry is evaluated in this pass; see CONTACT_ORDER."""
        chosen = 1
        if ti.static(pass_count > 1):
            chosen = ti.cast(neighbors.in_contact[list_index] == ti.Vector(CONTACT_ORDER)[pass_index], ti.i32)
        return chosen

    force_controlled = features.force_controlled_walls
    clear_wall_forces, _add = build_add_wall_force(state) if force_controlled else (None, None)

    @ti.func
    def particle_forces(chunk, i, pose, dt):
        """Weight, wall forces and, without batches, particle contact forces."""
        force = particles.mass[i] * ti.Vector(gravity, dt=real)
        torque = 0.0 * force
        if ti.static(plan.has_walls):
            for pass_index in range(pass_count):
                for list_index in range(neighbors.list_begin[i], neighbors.list_walls_end[i]):
                    if in_this_pass(list_index, pass_index) == 1:
                        force_added, torque_added = wall_contact(
                            chunk, i, list_index, neighbors.partner[list_index], pose, dt
                        )
                        force, torque = force + force_added, torque + torque_added
        if ti.static(not batched):
            for list_index in range(neighbors.list_walls_end[i], neighbors.list_end[i]):
                force_added, torque_added = particle_contact(
                    chunk, i, list_index, neighbors.partner[list_index], pose, dt
                )
                force, torque = force + force_added, torque + torque_added
        particles.force[i] = force
        if ti.static(features.rotation):
            particles.torque[i] = torque

    @ti.func
    def forces(worker, chunk, count, pose, dt):
        first, last = chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)
        if ti.static(force_controlled):
            clear_wall_forces(chunk)
        for i in range(first, last):
            particle_forces(chunk, i, pose, dt)
        if ti.static(batched):
            batched_forces(worker, chunk, first, last, pose, dt)

    return forces
