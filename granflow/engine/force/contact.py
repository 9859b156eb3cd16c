"""One contact of a particle with a partner or a wall: its force, its history and its end."""

from typing import Any

from granflow.engine.force.collision_counts import build_count_collision
from granflow.engine.force.contact_accounting import build_add_to_accounting
from granflow.engine.force.distant_force import build_distant_force, build_in_range
from granflow.engine.force.liquid_transfer import build_form_bridge, build_return_liquid, transfers_liquid
from granflow.engine.force.pair_force import build_pair_force
from granflow.engine.force.pair_kinematics import (
    build_effective,
    build_pair_constants,
    build_pair_kinematics,
)
from granflow.engine.limits import ABORT_OVERLAP
from granflow.engine.neighbor.contact_history_entry import (
    build_add_plastic_loss,
    build_end_contact,
    build_read_history,
    build_write_history,
)
from granflow.engine.neighbor.wall_contact_history import (
    build_acquire_history,
    build_release_history,
    transfers_history,
)
from granflow.engine.state import State
from granflow.engine.walls import build_wall_of
from granflow.kernel_language import ti


def build_contact(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, list index, j, pose, time_step) -> (force [N], torque [N m]) on i of one contact.

    with_wall:  True for walls (j < 0), False for particles

    Without overlap, or beyond the range of a model that acts at a distance, it ends the contact and clears its history;
    its plastic work is added to the losses.

    Reads:   position, velocity, velocity_synchronized, angular_velocity, radius, mass, history, walls
    Writes:  history, in_contact, losses, boundary_work, impulses, collisions, wall_force, liquid_film, abort,
             abort_particle
    """
    transfers = with_wall and transfers_history(state)
    pair_kinematics, effective = build_pair_kinematics(state, with_wall), build_effective(state, with_wall)
    angular_velocities_of = _build_angular_velocities(state, with_wall)
    check_overlap = _build_check_overlap(state, with_wall)
    pair_constants, in_range = build_pair_constants(state), build_in_range(state)
    acts_at_distance = state.plan.laws.acts_at_distance
    distant_contact = _build_distant_contact(state, with_wall) if acts_at_distance else None
    release_history, acquire_history = (
        (build_release_history(state), build_acquire_history(state)) if transfers else (None, None)
    )
    read_history, write_history = build_read_history(state), build_write_history(state)
    pair_force, add_to_accounting = build_pair_force(state.plan, False), build_add_to_accounting(state, with_wall)
    end_contact, add_plastic_loss = build_end_contact(state), build_add_plastic_loss(state)
    longest_time_step, count_collision = state.parameter("longest_time_step"), build_count_collision(state, with_wall)
    liquid, return_liquid = transfers_liquid(state), build_return_liquid(state)
    form_bridge = build_form_bridge(state) if liquid else None

    @ti.func
    def contact(chunk, i, list_index, j, pose, dt):
        force, torque = 0.0 * state.particles.velocity[i], 0.0 * state.particles.velocity[i]
        kinematics, bodies = pair_kinematics(i, j, pose, dt), effective(i, j)
        constants = pair_constants(i, j)
        if kinematics.overlap > 0.0:
            check_overlap(i, j, kinematics.overlap)
            if ti.static(transfers):
                acquire_history(i, list_index, j, pose)
            angular_velocities, history = angular_velocities_of(i, j, pose), read_history(list_index)
            if ti.static(liquid):
                history.cohesion = form_bridge(chunk, i, j, constants, bodies, kinematics.overlap, history.cohesion)
            found = pair_force(constants, bodies, kinematics, angular_velocities, history, dt, longest_time_step())
            force, torque = found.force, found.torque
            count_collision(chunk, list_index, j, bodies, kinematics.overlap_rate_half)
            write_history(list_index, found.history)
            add_to_accounting(chunk, i, j, pose, kinematics.normal, found, dt)
        elif in_range(i, j, kinematics.overlap):
            if ti.static(acts_at_distance):
                force = distant_contact(chunk, i, list_index, j, pose, kinematics, dt)
        else:
            energy_lost, released = 0.0 * dt, 0
            if ti.static(transfers):
                released = release_history(i, list_index, j, pose)
            if released == 0:
                return_liquid(chunk, i, j, list_index)
                energy_lost = end_contact(list_index, constants, bodies, dt)
            add_plastic_loss(chunk, j, energy_lost)
        return force, torque

    return contact


def _build_distant_contact(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, list index, j, pose, kinematics, time_step): force [N] on i of a separated pair.

    Reads:   as `build_contact`
    Writes:  as `build_contact`
    """
    distant_force, transfers = build_distant_force(state, with_wall), with_wall and transfers_history(state)
    acquire_history = build_acquire_history(state) if transfers else None
    add_to_accounting = build_add_to_accounting(state, with_wall)

    @ti.func
    def distant_contact(chunk, i, list_index, j, pose, kinematics, dt):
        if ti.static(transfers):
            acquire_history(i, list_index, j, pose)
        attraction = distant_force(chunk, i, list_index, j, kinematics.overlap, dt)
        nothing, force = 0.0 * attraction, -attraction * kinematics.normal
        found = ti.Struct(force=force, torque=0.0 * force, losses=ti.Vector([nothing, nothing, nothing]))
        add_to_accounting(chunk, i, j, pose, kinematics.normal, found, dt)
        return force

    return distant_contact


def _build_angular_velocities(state: State, with_wall: bool) -> Any:
    """Device function (i, j, pose) -> struct of the angular velocities [rad/s] of i and of its partner.

    Reads:  angular_velocity of particles and walls
    """
    particles, features, real = state.particles, state.plan.features, state.backend.real
    wall_of = build_wall_of(state)

    @ti.func
    def angular_velocities_of(i, j, pose):
        first, partner = 0.0 * particles.velocity[i], 0.0 * particles.velocity[i]
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
    particles, control, max_overlap = state.particles, state.control, state.parameter("max_overlap")

    @ti.func
    def check_overlap(i, j, overlap):
        radius_min = particles.radius[i]
        if ti.static(not with_wall):
            radius_min = ti.min(radius_min, particles.radius[j])
        if overlap > max_overlap() * radius_min:
            ti.atomic_max(control.abort[0], ABORT_OVERLAP)
            ti.atomic_min(control.abort_particle[0], particles.id[i])

    return check_overlap
