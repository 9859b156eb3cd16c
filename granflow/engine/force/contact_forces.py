"""Contact forces on one chunk of particles: wall contacts one at a time, particle contacts in batches on a CPU.

Forces and torques are summed exactly, see `exact_sums`. Sums are written `a[i] = a[i] + b`: Taichi compiles
`a[i] += b` on a field to an atomic operation, which costs more than the whole contact model and is not needed within a
chunk.
"""

from typing import Any

from granflow.engine.exact_sums import (
    add_energy,
    build_list_shares,
    build_to_grid,
    carried,
    holds_sums,
)
from granflow.engine.force.distant_force import build_distant_force, build_in_range
from granflow.engine.force.pair_force import build_pair_force
from granflow.engine.force.pair_kinematics import (
    build_boundary_work,
    build_effective,
    build_pair_constants,
    build_pair_kinematics,
)
from granflow.engine.force.set_forces import build_set_forces
from granflow.engine.force.simd_pair_force import build_batched_forces
from granflow.engine.force.wall_forces import build_add_impulse
from granflow.engine.limits import ABORT_OVERLAP
from granflow.engine.neighbor.contact_history_entry import (
    build_add_plastic_loss,
    build_end_contact,
    build_read_history,
    build_write_history,
)
from granflow.engine.neighbor.mesh_contact_history import (
    CONTACT_ORDER,
    build_acquire_history,
    build_release_history,
    transfers_history,
)
from granflow.engine.state import State
from granflow.engine.wall_dynamics import build_add_wall_force
from granflow.engine.walls import WallGeometry, build_wall_of
from granflow.kernel_language import ti
from granflow.plan.chunk_sums import DAMPING, FRICTION, LOSSES, ROLLING, WALL_WORK
from granflow.plan.sum_units import ENERGY, FORCE, TORQUE


def build_contact(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, list index, j, pose, time_step) -> (force [N], torque [N m]) on i of one contact.

    with_wall:  True for walls (j < 0), False for particles

    Without overlap, or beyond the range of a model that acts at a distance, it ends the contact and clears its history;
    its plastic work is added to the losses.

    Reads:   position, velocity, velocity_synchronized, angular_velocity, radius, mass, history, walls
    Writes:  history, in_contact, losses, boundary_work, impulses, wall_force, abort, abort_particle
    """
    transfers = with_wall and transfers_history(state)
    pair_kinematics, effective = build_pair_kinematics(state, with_wall), build_effective(state, with_wall)
    angular_velocities_of, check_overlap = (
        _build_angular_velocities(state, with_wall),
        _build_check_overlap(state, with_wall),
    )
    pair_constants, in_range = build_pair_constants(state), build_in_range(state)
    acts_at_distance = state.plan.laws.acts_at_distance
    distant_contact = _build_distant_contact(state, with_wall) if acts_at_distance else None
    release_history, acquire_history = (
        (build_release_history(state), build_acquire_history(state)) if transfers else (None, None)
    )
    read_history, write_history = build_read_history(state), build_write_history(state)
    pair_force, add_to_accounting = build_pair_force(state.plan, False), _build_add_to_accounting(state, with_wall)
    end_contact, add_plastic_loss = build_end_contact(state), build_add_plastic_loss(state)
    longest_time_step = state.parameter("longest_time_step")

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
            found = pair_force(constants, bodies, kinematics, angular_velocities, history, dt, longest_time_step())
            force, torque = found.force, found.torque
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
    add_to_accounting = _build_add_to_accounting(state, with_wall)

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


def _build_add_to_accounting(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, j, pose, normal, result of the pair force, time_step): losses, work and wall forces.

    Writes:  losses, boundary_work, impulses, wall_force
    """
    features, wall_of, wall_work = state.plan.features, build_wall_of(state), _build_wall_work(state, with_wall)
    control, list_shares, add_boundary_work = state.control, build_list_shares(state), build_boundary_work(state)
    per_unit = state.parameter("per_unit")
    measured, loss_count = with_wall and features.wall_forces, len(LOSSES)
    force_controlled = with_wall and features.force_controlled_walls
    add_impulse = build_add_impulse(state) if measured else None
    _clear, add_wall_force = build_add_wall_force(state) if force_controlled else (None, None)

    @ti.func
    def add_losses(chunk, shares, found, work):
        per_joule = per_unit()[ENERGY]
        for k, loss in ti.static(enumerate((FRICTION, ROLLING, DAMPING))):
            add_energy(control.losses, chunk, loss, loss_count, shares, per_joule * found.losses[k])
        add_energy(control.losses, chunk, WALL_WORK, loss_count, shares, per_joule * work)

    @ti.func
    def add_to_accounting(chunk, i, j, pose, normal, found, dt):
        if ti.static(features.energy_budget):
            add_losses(chunk, list_shares(chunk, j), found, wall_work(i, j, pose, normal, found, dt))
            if ti.static(features.lees_edwards and not with_wall):
                add_boundary_work(chunk, i, j, found.force, pose, dt)
        if ti.static(force_controlled):
            add_wall_force(chunk, wall_of(j), found.force)
        if ti.static(measured):
            add_impulse(chunk, wall_of(j), i, normal, found.force, found.torque, dt)

    return add_to_accounting


def _build_wall_work(state: State, with_wall: bool) -> Any:
    """Device function: work of prescribed wall motion and surface velocity on particle i in this step [J].

    Arguments: i, j, pose, normal, result of the pair force, time step [s].

    Reads:  position, velocities of walls
    """
    geometry, wall_of, real = WallGeometry(state), build_wall_of(state), state.backend.real
    moving = with_wall and state.plan.features.moving_walls

    @ti.func
    def wall_work(i, j, pose, normal, found, dt):
        work = 0.0 * dt
        if ti.static(moving):
            velocity = geometry.prescribed_velocity(-1 - j, pose, state.particles.position[i])
            angular_velocity = state.walls.angular_velocity[pose, wall_of(j)]
            work = dt * (found.force.dot(ti.cast(velocity, real)) + found.torque.dot(ti.cast(angular_velocity, real)))
            if ti.static(state.plan.features.surface_velocity):
                work += dt * found.force.dot(geometry.surface_velocity(-1 - j, pose, normal))
        return work

    return wall_work


def _build_passes(state: State) -> tuple[int, Any]:
    """Number of passes over the walls of a particle, and device function (list index, pass number).

    The function returns 1 if the entry is evaluated in this pass; see CONTACT_ORDER.

    Reads:  in_contact
    """
    neighbors, pass_count = state.neighbors, len(CONTACT_ORDER) if transfers_history(state) else 1

    @ti.func
    def in_this_pass(list_index, pass_index):
        chosen = 1
        if ti.static(pass_count > 1):
            chosen = ti.cast(neighbors.in_contact[list_index] == ti.Vector(CONTACT_ORDER)[pass_index], ti.i32)
        return chosen

    return pass_count, in_this_pass


def build_forces(state: State) -> Any:
    """Device function (worker, chunk, count, pose, time_step): force and torque on the particles of one chunk.

    Forces are at the time of the positions and include the weight. A pair across two chunks is evaluated in both, so
    that no two workers write to the same particle.

    Reads:   position, velocity, velocity_synchronized, angular_velocity, radius, mass, neighbor lists, walls
    Writes:  force, torque, history, losses, impulses, wall forces, abort
    """
    plan, neighbors, particles = state.plan, state.neighbors, state.particles
    features, real, chunk_size = plan.features, state.backend.real, state.parameter("chunk_size")
    exact, adds_others = holds_sums(state), features.external_forces or features.damping != "none"
    gravity, shift = state.parameter("gravity"), state.parameter("shift")
    batch, to_grid = state.batch, build_to_grid(real)
    batched, set_forces, carry_sums = batch is not None, build_set_forces(state), _build_carry_sums(state)
    batched_forces = build_batched_forces(state) if batched else None
    particle_contact = None if batched else build_contact(state, False)
    wall_contact = build_contact(state, True) if plan.has_walls else None
    pass_count, in_this_pass = _build_passes(state)
    force_controlled = features.force_controlled_walls
    clear_wall_forces, _add = build_add_wall_force(state) if force_controlled else (None, None)

    @ti.func
    def add_contact(force, torque, force_sum, torque_sum):
        force_added, torque_added = to_grid(force, shift()[FORCE]), to_grid(torque, shift()[TORQUE])
        return force_sum + ti.cast(force_added, ti.f64), torque_sum + ti.cast(torque_added, ti.f64)

    @ti.func
    def particle_forces(chunk, i, acceleration, pose, dt):
        """Sums of the forces and torques of walls and, without batches, of particles; in f64 with the rounded weight.

        Integration adds the rest of the weight. A further loop over the particles, which adds the weight to the sums,
        takes an eighth of the time of the forces.
        """
        force_sum, torque_sum = ti.Vector.zero(ti.f64, 3), ti.Vector.zero(ti.f64, 3)
        if ti.static(exact):
            force_sum = to_grid(particles.mass[i] * acceleration, shift()[FORCE])
        if ti.static(plan.has_walls):
            for pass_index in range(pass_count):
                for list_index in range(neighbors.list_begin[i], neighbors.list_walls_end[i]):
                    if in_this_pass(list_index, pass_index) == 1:
                        force, torque = wall_contact(chunk, i, list_index, neighbors.partner[list_index], pose, dt)
                        force_sum, torque_sum = add_contact(force, torque, force_sum, torque_sum)
        if ti.static(not batched):
            for list_index in range(neighbors.list_walls_end[i], neighbors.list_end[i]):
                force, torque = particle_contact(chunk, i, list_index, neighbors.partner[list_index], pose, dt)
                force_sum, torque_sum = add_contact(force, torque, force_sum, torque_sum)
        return force_sum, torque_sum

    @ti.func
    def sums_of(worker, i, local):
        """Sums of the forces and torques on a particle after the batches."""
        force_sum, torque_sum = ti.Vector.zero(ti.f64, 3), ti.Vector.zero(ti.f64, 3)
        if ti.static(exact):
            force_sum = particles.force[i]
            if ti.static(features.rotation):
                torque_sum = particles.torque[i]
        else:
            sums = batch.sums[worker, local]
            force_sum = ti.Vector([sums[0], sums[1], sums[2]])
            if ti.static(features.rotation):
                torque_sum = ti.Vector([sums[3], sums[4], sums[5]])
        return force_sum, torque_sum

    @ti.func
    def forces(worker, chunk, count, pose, dt):
        size, acceleration = chunk_size(), ti.cast(gravity(), real)
        first, last = chunk * size, ti.min((chunk + 1) * size, count)
        if ti.static(force_controlled):
            clear_wall_forces(chunk)
        for i in range(first, last):
            force_sum, torque_sum = particle_forces(chunk, i, acceleration, pose, dt)
            if ti.static(batched and exact):
                particles.force[i] = force_sum
                if ti.static(features.rotation):
                    particles.torque[i] = torque_sum
            elif ti.static(batched):
                for axis in ti.static(range(3)):
                    batch.sums[worker, i - first][axis] = force_sum[axis]
                    if ti.static(features.rotation):
                        batch.sums[worker, i - first][3 + axis] = torque_sum[axis]
            else:
                set_forces(chunk, i, force_sum, torque_sum, acceleration, dt)
        if ti.static(batched):
            batched_forces(worker, chunk, first, last, pose, dt)
        if ti.static(batched and (adds_others or not exact)):
            for i in range(first, last):
                force_sum, torque_sum = sums_of(worker, i, i - first)
                set_forces(chunk, i, force_sum, torque_sum, acceleration, dt)
        carry_sums(chunk)

    return forces


def _build_carry_sums(state: State) -> Any:
    """Device function (chunk): move the carries of the energies, once per step and chunk.

    Writes:  losses, boundary_work, external_work
    """
    control, features, loss_count = state.control, state.plan.features, len(LOSSES)

    @ti.func
    def carry_sums(chunk):
        if ti.static(features.energy_budget):
            control.losses[chunk] = carried(control.losses[chunk], loss_count)
            if ti.static(features.periodic != "none"):
                control.boundary_work[chunk] = carried(control.boundary_work[chunk], 1)
            if ti.static(features.external_forces):
                control.external_work[chunk] = carried(control.external_work[chunk], 1)

    return carry_sums
