"""Losses, work and wall forces of one contact.

The work of a moving wall in a step has the mean of the forces at both ends of the step, with the velocity V of the wall
at its middle:

    W = sum of dt/2 [F(t) . V(t - dt/2) + F(t) . V(t + dt/2)]

The second term belongs to the next step: `wall_work_ahead` holds it, and the total without it is the work until t.
"""

from typing import Any

from granflow.engine.dispatch import build_tasks_of_thread, thread_count
from granflow.engine.exact_sums import (
    add_energy,
    build_list_shares,
    carried,
)
from granflow.engine.force.pair_force import normal_time_step
from granflow.engine.force.pair_kinematics import (
    build_boundary_work,
)
from granflow.engine.force.wall_forces import build_add_impulse
from granflow.engine.state import State
from granflow.engine.wall_dynamics import build_add_wall_force
from granflow.engine.walls import WallGeometry, build_wall_of
from granflow.kernel_language import ti
from granflow.plan.chunk_sums import DAMPING, FRICTION, LOSSES, ROLLING, WALL_WORK
from granflow.plan.sum_units import ENERGY


def build_add_to_accounting(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, j, pose, normal, result of the pair force, time_step): losses, work and wall forces.

    Writes:  losses, wall_work_ahead, boundary_work, impulses, wall_force
    """
    features, wall_of, wall_power = state.plan.features, build_wall_of(state), _build_wall_power(state)
    control, list_shares, add_boundary_work = state.control, build_list_shares(state), build_boundary_work(state)
    per_unit, longest_time_step = state.parameter("per_unit", ENERGY), state.parameter("longest_time_step")
    moving = with_wall and features.moving_walls
    measured, loss_count = with_wall and features.wall_forces, len(LOSSES)
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
        half, half_ahead = 0.5 * per_unit() * dt, 0.5 * per_unit() * normal_time_step(dt, longest_time_step())
        shares, work_ahead = list_shares(chunk, j), half_ahead * wall_power(i, j, pose, pose + 1, normal, found)
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

    Arguments: i, j, pose, index of the step at whose middle the velocity is, normal, result of the pair force.

    Reads:  position, velocities of walls
    """
    geometry, wall_of, real = WallGeometry(state), build_wall_of(state), state.backend.real

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
    ahead, exists = state.control.wall_work_ahead, state.control.wall_work_ahead is not None

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
    control, chunks, high = state.control, state.capacities.chunks, len(LOSSES) + WALL_WORK

    @ti.func
    def end(chunk, withdraws):
        if withdraws == 1:
            control.losses[chunk][WALL_WORK] = control.losses[chunk][WALL_WORK] - control.wall_work_ahead[chunk][0]
            control.losses[chunk][high] = control.losses[chunk][high] - control.wall_work_ahead[chunk][1]
        control.wall_work_ahead[chunk] = ti.Vector.zero(ti.i64, 2)

    threads, end_each = thread_count(chunks), build_tasks_of_thread(end, chunks)

    @ti.kernel
    def end_wall_work(withdraws: ti.i32):
        for thread in range(threads):
            end_each(thread, chunks, withdraws)

    return end_wall_work


def build_carry_sums(state: State) -> Any:
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
