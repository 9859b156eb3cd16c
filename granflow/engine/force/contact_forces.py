"""Contact forces on one chunk of particles: wall contacts one at a time, particle contacts in batches on a CPU.

Forces and torques are summed exactly, see `exact_sums`. Sums are written `a[i] = a[i] + b`: Taichi compiles
`a[i] += b` on a field to an atomic operation, which costs more than the whole contact model and is not needed within a
chunk.
"""

from typing import Any

from granflow.engine.exact_sums import (
    build_to_grid,
    holds_sums,
)
from granflow.engine.force.contact import build_contact
from granflow.engine.force.contact_accounting import build_carry_sums, build_clear_wall_work_ahead
from granflow.engine.force.set_forces import build_set_forces
from granflow.engine.force.simd_pair_force import build_batched_forces
from granflow.engine.neighbor.wall_contact_history import (
    CONTACT_ORDER,
    transfers_history,
)
from granflow.engine.state import State
from granflow.engine.wall_dynamics import build_add_wall_force
from granflow.kernel_language import ti
from granflow.plan.sum_units import FORCE, TORQUE


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


def _build_particle_forces(state: State) -> Any:
    """Device function (chunk, i, acceleration, pose, time_step): sums of the forces and torques on one particle.

    Those of walls and, without batches, of particles; in f64 with the rounded weight. Integration adds the rest of the
    weight. A further loop over the particles, which adds the weight to the sums, takes an eighth of the time of the
    forces.

    Reads:   mass, neighbor lists, and as `build_contact`
    Writes:  as `build_contact`
    """
    plan, neighbors, particles = state.plan, state.neighbors, state.particles
    exact, batched = holds_sums(state), state.batch is not None
    shift, shift_torque = state.parameter("shift", FORCE), state.parameter("shift", TORQUE)
    to_grid = build_to_grid(state.backend.real)
    particle_contact = None if batched else build_contact(state, False)
    wall_contact = build_contact(state, True) if plan.has_walls else None
    pass_count, in_this_pass = _build_passes(state)

    @ti.func
    def add_contact(force, torque, force_sum, torque_sum):
        force_added, torque_added = to_grid(force, shift()), to_grid(torque, shift_torque())
        return force_sum + ti.cast(force_added, ti.f64), torque_sum + ti.cast(torque_added, ti.f64)

    @ti.func
    def particle_forces(chunk, i, acceleration, pose, dt):
        force_sum, torque_sum = ti.Vector.zero(ti.f64, 3), ti.Vector.zero(ti.f64, 3)
        if ti.static(exact):
            force_sum = to_grid(particles.mass[i] * acceleration, shift())
            if ti.static(plan.features.clumps):  # the weight of a clump acts at its center of mass
                force_sum *= ti.cast(particles.clump[i] < 0, ti.f64)
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

    return particle_forces


def _build_sums_of(state: State) -> Any:
    """Device function (worker, i, place in the chunk): sums of the forces and torques on a particle after the batches.

    Reads:  force, torque; or the sums of the batch, see `holds_sums`
    """
    particles, batch, exact, rotation = state.particles, state.batch, holds_sums(state), state.plan.features.rotation

    @ti.func
    def sums_of(worker, i, local):
        force_sum, torque_sum = ti.Vector.zero(ti.f64, 3), ti.Vector.zero(ti.f64, 3)
        if ti.static(exact):
            force_sum = particles.force[i]
            if ti.static(rotation):
                torque_sum = particles.torque[i]
        else:
            sums = batch.sums[worker, local]
            force_sum = ti.Vector([sums[0], sums[1], sums[2]])
            if ti.static(rotation):
                torque_sum = ti.Vector([sums[3], sums[4], sums[5]])
        return force_sum, torque_sum

    return sums_of


def build_forces(state: State) -> Any:
    """Device function (worker, chunk, count, pose, time_step): force and torque on the particles of one chunk.

    Forces are at the time of the positions and include the weight. A pair across two chunks is evaluated in both, so
    that no two workers write to the same particle.

    Reads:   position, velocity, velocity_synchronized, angular_velocity, radius, mass, neighbor lists, walls
    Writes:  force, torque, history, losses, impulses, wall forces, abort
    """
    features, particles, batch = state.plan.features, state.particles, state.batch
    exact, adds_others = holds_sums(state), features.external_forces or features.damping != "none"
    chunk_size, gravity, real = state.parameter("chunk_size"), state.parameter("gravity"), state.backend.real
    batched, set_forces, carry_sums = batch is not None, build_set_forces(state), build_carry_sums(state)
    batched_forces = build_batched_forces(state) if batched else None
    particle_forces, sums_of = _build_particle_forces(state), _build_sums_of(state)
    force_controlled, clear_wall_work_ahead = features.force_controlled_walls, build_clear_wall_work_ahead(state)
    clear_wall_forces, _add = build_add_wall_force(state) if force_controlled else (None, None)

    @ti.func
    def forces(worker, chunk, count, pose, dt):
        size, acceleration = chunk_size(), ti.cast(gravity(), real)
        first, last = chunk * size, ti.min((chunk + 1) * size, count)
        clear_wall_work_ahead(chunk)
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
