"""One contact of a particle with a partner or a wall: its force, its history and its end."""

from typing import Any

import numpy as np

from granflow.engine.codes import ABORT_OVERLAP
from granflow.engine.fields import build_tasks_of_thread, thread_count
from granflow.engine.history import (
    NO_CONTACT,
    build_acquire_history,
    build_add_plastic_loss,
    build_end_contact,
    build_read_history,
    build_release_history,
    build_write_history,
    transfers_history,
)
from granflow.engine.liquid import (
    build_distant_force,
    build_form_bridge,
    build_in_range,
    build_return_liquid,
    transfers_liquid,
)
from granflow.engine.pair import (
    build_boundary_work,
    build_effective,
    build_pair_constants,
    build_pair_force,
    build_pair_kinematics,
    normal_time_step,
)
from granflow.engine.state import State
from granflow.engine.sums import SHARES, add_energy, build_list_shares, carried, exact_totals
from granflow.engine.wall_dynamics import build_add_impulse, build_add_wall_force
from granflow.engine.walls import WallGeometry, build_wall_of
from granflow.kernel_language import ti
from granflow.plan.capacities import DAMPING, ENERGY, FRICTION, LOSSES, ROLLING, WALL_WORK

# Numbers of collisions by impact energy: each contact counts once, in the step in which it begins.
#
#     E = m_eff v_n^2 / 2,     v_n: approach velocity half a step before the first force
#
# The counts are integers, so that they do not depend on threads and ranks.


def build_count_collision(state: State, with_wall: bool) -> Any:
    """Device function (chunk, list index, j, bodies, overlap rate at the half step): count a contact that
    begins.

    Without collision energies it does nothing. It precedes `write_history`, which marks the contact.

    Reads:   in_contact, collision_edges
    Writes:  collisions
    """
    control = state.control
    neighbors = state.neighbors
    list_shares = build_list_shares(state)
    wanted = state.plan.features.collision_energies
    rows = state.capacities.wall_rows
    classes = state.capacities.energy_classes
    first = classes if with_wall else 0

    @ti.func
    def count_collision(chunk, list_index, j, bodies, overlap_rate):
        if ti.static(wanted):
            if neighbors.in_contact[list_index] == NO_CONTACT:
                velocity = ti.cast(ti.max(overlap_rate, 0.0), ti.f64)
                number = first
                energy = 0.5 * ti.cast(bodies.mass_eff, ti.f64) * (velocity * velocity)
                for edge in range(classes - 1):
                    number += ti.cast(energy >= control.collision_edges[edge], ti.i32)
                ti.atomic_add(
                    control.collisions[chunk % rows, number][0], ti.cast(list_shares(chunk, j), ti.i64)
                )

    return count_collision


def collision_counts(state: State) -> dict[str, np.ndarray]:
    """Numbers of collisions since the start by kind of the partner, "particle" or "wall": arrays (classes,)
    int64.

    The first class is below the smallest edge, the last one above the largest. Empty without collision
    energies.
    """
    if state.control.collisions is None:
        return {}
    words = state.ranks.total(state.control.collisions.to_numpy())
    counts = [exact_totals(words[:, column], np.array([1.0 / SHARES]))[0] for column in range(words.shape[1])]
    by_kind = np.rint(counts).astype(np.int64).reshape(2, -1)
    kinds = ("particle", "wall") if state.plan.has_walls else ("particle",)
    return dict(zip(kinds, by_kind, strict=False))


# Losses, work and wall forces of one contact.
#
# The work of a moving wall in a step has the mean of the forces at both ends of the step, with the velocity
# V of the wall at its middle:
#
#     W = sum of dt/2 [F(t) . V(t - dt/2) + F(t) . V(t + dt/2)]
#
# The second term belongs to the next step: `wall_work_ahead` holds it, and the total without it is the work
# until t.


def build_add_to_accounting(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, j, pose, normal, result of the pair force, time_step): losses, work and wall
    forces.

    Writes:  losses, wall_work_ahead, boundary_work, impulses, wall_force
    """
    features = state.plan.features
    wall_of = build_wall_of(state)
    wall_power = _build_wall_power(state)
    control = state.control
    list_shares = build_list_shares(state)
    add_boundary_work = build_boundary_work(state)
    per_unit = state.parameter("per_unit", ENERGY)
    longest_time_step = state.parameter("longest_time_step")
    moving = with_wall and features.moving_walls
    measured = with_wall and features.wall_forces
    loss_count = len(LOSSES)
    force_controlled = with_wall and features.force_controlled_walls
    add_impulse = build_add_impulse(state) if measured else None
    _clear, add_wall_force = build_add_wall_force(state) if force_controlled else (None, None)

    @ti.func
    def add_losses(chunk, shares, found):
        per_joule = per_unit()
        for k, loss in ti.static(enumerate((FRICTION, ROLLING, DAMPING))):
            add_energy(control.losses, chunk, loss, loss_count, shares, per_joule * found.losses[k])

    @ti.func
    def add_wall_work(chunk, i, j, pose, normal, found, dt):
        half = 0.5 * per_unit() * dt
        half_ahead = 0.5 * per_unit() * normal_time_step(dt, longest_time_step())
        shares = list_shares(chunk, j)
        work_ahead = half_ahead * wall_power(i, j, pose, pose + 1, normal, found)
        work = half * wall_power(i, j, pose, pose, normal, found)
        add_energy(control.losses, chunk, WALL_WORK, loss_count, shares, work)
        add_energy(control.losses, chunk, WALL_WORK, loss_count, shares, work_ahead)
        add_energy(control.wall_work_ahead, chunk, 0, 1, shares, work_ahead)

    @ti.func
    def add_to_accounting(chunk, i, j, pose, normal, found, dt):
        if ti.static(features.energy_budget):
            add_losses(chunk, list_shares(chunk, j), found)
            if ti.static(moving):
                add_wall_work(chunk, i, j, pose, normal, found, dt)
            if ti.static(features.lees_edwards and not with_wall):
                add_boundary_work(chunk, i, j, found.force, pose, dt)
        if ti.static(force_controlled):
            add_wall_force(chunk, wall_of(j), found.force)
        if ti.static(measured):
            add_impulse(chunk, wall_of(j), i, normal, found.force, found.torque, dt)

    return add_to_accounting


def _build_wall_power(state: State) -> Any:
    """Device function: power of prescribed wall motion and surface velocity on particle i [W].

    Arguments: i, j, pose, index of the step at whose middle the velocity is, normal, result of the pair
    force.

    Reads:  position, velocities of walls
    """
    geometry = WallGeometry(state)
    wall_of = build_wall_of(state)
    real = state.backend.real

    @ti.func
    def wall_power(i, j, pose, step, normal, found):
        velocity = geometry.prescribed_velocity(-1 - j, pose, step, state.particles.position[i])
        angular_velocity = state.walls.angular_velocity[step, wall_of(j)]
        power = found.force.dot(ti.cast(velocity, real)) + found.torque.dot(ti.cast(angular_velocity, real))
        if ti.static(state.plan.features.surface_velocity):
            power += found.force.dot(geometry.surface_velocity(-1 - j, step, normal))
        return power

    return wall_power


def build_clear_wall_work_ahead(state: State) -> Any:
    """Device function (chunk): the work of the next step, before the forces at its end are added.

    Writes:  wall_work_ahead
    """
    ahead = state.control.wall_work_ahead
    exists = state.control.wall_work_ahead is not None

    @ti.func
    def clear_wall_work_ahead(chunk):
        if ti.static(exists):
            ahead[chunk] = ti.Vector.zero(ti.i64, 2)

    return clear_wall_work_ahead


def build_end_wall_work(state: State) -> Any:
    """Kernel (withdraws): clear the work of the next step in all chunks, whose number may change.

    withdraws:  1 if there will be another force evaluation before the next step, which counts it again

    Writes:  wall_work_ahead, losses
    """
    control = state.control
    chunks = state.capacities.chunks
    high = len(LOSSES) + WALL_WORK

    @ti.func
    def end(chunk, withdraws):
        if withdraws == 1:
            control.losses[chunk][WALL_WORK] = (
                control.losses[chunk][WALL_WORK] - control.wall_work_ahead[chunk][0]
            )
            control.losses[chunk][high] = control.losses[chunk][high] - control.wall_work_ahead[chunk][1]
        control.wall_work_ahead[chunk] = ti.Vector.zero(ti.i64, 2)

    threads = thread_count(chunks)
    end_each = build_tasks_of_thread(end, chunks)

    @ti.kernel
    def end_wall_work(withdraws: ti.i32):
        for thread in range(threads):
            end_each(thread, chunks, withdraws)

    return end_wall_work


def build_carry_sums(state: State) -> Any:
    """Device function (chunk): move the carries of the energies, once per step and chunk.

    Writes:  losses, boundary_work, external_work
    """
    control = state.control
    features = state.plan.features
    loss_count = len(LOSSES)

    @ti.func
    def carry_sums(chunk):
        if ti.static(features.energy_budget):
            control.losses[chunk] = carried(control.losses[chunk], loss_count)
            if ti.static(features.periodic != "none"):
                control.boundary_work[chunk] = carried(control.boundary_work[chunk], 1)
            if ti.static(features.external_forces):
                control.external_work[chunk] = carried(control.external_work[chunk], 1)

    return carry_sums


def build_contact(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, list index, j, pose, time_step) -> (force [N], torque [N m]) on i of one
    contact.

    with_wall:  True for walls (j < 0), False for particles

    Without overlap, or beyond the range of a model that acts at a distance, it ends the contact and clears
    its history; its plastic work is added to the losses.

    Reads:   position, velocity, velocity_synchronized, angular_velocity, radius, mass, history, walls
    Writes:  history, in_contact, losses, boundary_work, impulses, collisions, wall_force, liquid_film, abort,
             abort_particle
    """
    transfers = with_wall and transfers_history(state)
    pair_kinematics = build_pair_kinematics(state, with_wall)
    effective = build_effective(state, with_wall)
    angular_velocities_of = _build_angular_velocities(state, with_wall)
    check_overlap = _build_check_overlap(state, with_wall)
    pair_constants = build_pair_constants(state)
    in_range = build_in_range(state)
    acts_at_distance = state.plan.laws.acts_at_distance
    distant_contact = _build_distant_contact(state, with_wall) if acts_at_distance else None
    release_history, acquire_history = (
        (build_release_history(state), build_acquire_history(state)) if transfers else (None, None)
    )
    read_history = build_read_history(state)
    write_history = build_write_history(state)
    pair_force = build_pair_force(state.plan, False)
    add_to_accounting = build_add_to_accounting(state, with_wall)
    end_contact = build_end_contact(state)
    add_plastic_loss = build_add_plastic_loss(state)
    longest_time_step = state.parameter("longest_time_step")
    count_collision = build_count_collision(state, with_wall)
    liquid = transfers_liquid(state)
    return_liquid = build_return_liquid(state)
    form_bridge = build_form_bridge(state) if liquid else None

    @ti.func
    def contact(chunk, i, list_index, j, pose, dt):
        force, torque = 0.0 * state.particles.velocity[i], 0.0 * state.particles.velocity[i]
        kinematics = pair_kinematics(i, j, pose, dt)
        bodies = effective(i, j)
        constants = pair_constants(i, j)
        if kinematics.overlap > 0.0:
            check_overlap(i, j, kinematics.overlap)
            if ti.static(transfers):
                acquire_history(i, list_index, j, pose)
            angular_velocities = angular_velocities_of(i, j, pose)
            history = read_history(list_index)
            if ti.static(liquid):
                history.cohesion = form_bridge(
                    chunk, i, j, constants, bodies, kinematics.overlap, history.cohesion
                )
            found = pair_force(
                constants, bodies, kinematics, angular_velocities, history, dt, longest_time_step()
            )
            force, torque = found.force, found.torque
            count_collision(chunk, list_index, j, bodies, kinematics.overlap_rate_half)
            write_history(list_index, found.history)
            add_to_accounting(chunk, i, j, pose, kinematics.normal, found, dt)
        elif in_range(i, j, kinematics.overlap):
            if ti.static(acts_at_distance):
                force = distant_contact(chunk, i, list_index, j, pose, kinematics, dt)
        else:
            energy_lost = 0.0 * dt
            released = 0
            if ti.static(transfers):
                released = release_history(i, list_index, j, pose)
            if released == 0:
                return_liquid(chunk, i, j, list_index)
                energy_lost = end_contact(list_index, constants, bodies, dt)
            add_plastic_loss(chunk, j, energy_lost)
        return force, torque

    return contact


def _build_distant_contact(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, list index, j, pose, kinematics, time_step): force [N] on i of a separated
    pair.

    Reads:   as `build_contact`
    Writes:  as `build_contact`
    """
    distant_force = build_distant_force(state, with_wall)
    transfers = with_wall and transfers_history(state)
    acquire_history = build_acquire_history(state) if transfers else None
    add_to_accounting = build_add_to_accounting(state, with_wall)

    @ti.func
    def distant_contact(chunk, i, list_index, j, pose, kinematics, dt):
        if ti.static(transfers):
            acquire_history(i, list_index, j, pose)
        attraction = distant_force(chunk, i, list_index, j, kinematics.overlap, dt)
        nothing = 0.0 * attraction
        force = -attraction * kinematics.normal
        found = ti.Struct(force=force, torque=0.0 * force, losses=ti.Vector([nothing, nothing, nothing]))
        add_to_accounting(chunk, i, j, pose, kinematics.normal, found, dt)
        return force

    return distant_contact


def _build_angular_velocities(state: State, with_wall: bool) -> Any:
    """Device function (i, j, pose) -> struct of the angular velocities [rad/s] of i and of its partner.

    Reads:  angular_velocity of particles and walls
    """
    particles = state.particles
    features = state.plan.features
    real = state.backend.real
    wall_of = build_wall_of(state)

    @ti.func
    def angular_velocities_of(i, j, pose):
        first = 0.0 * particles.velocity[i]
        partner = 0.0 * particles.velocity[i]
        if ti.static(features.rotation):
            first = particles.angular_velocity[i]
        if ti.static(features.rotation and not with_wall):
            partner = particles.angular_velocity[j]
        elif ti.static(features.rotation and features.moving_walls):
            partner = ti.cast(state.walls.angular_velocity[pose, wall_of(j)], real)
        return ti.Struct(first=first, partner=partner)

    return angular_velocities_of


def _build_check_overlap(state: State, with_wall: bool) -> Any:
    """Device function (i, j, overlap): request an abort if the overlap exceeds the limit.

    Reads:   radius
    Writes:  abort, abort_particle
    """
    particles = state.particles
    control = state.control
    max_overlap = state.parameter("max_overlap")

    @ti.func
    def check_overlap(i, j, overlap):
        radius_min = particles.radius[i]
        if ti.static(not with_wall):
            radius_min = ti.min(radius_min, particles.radius[j])
        if overlap > max_overlap() * radius_min:
            ti.atomic_max(control.abort[0], ABORT_OVERLAP)
            ti.atomic_min(control.abort_particle[0], particles.id[i])

    return check_overlap
