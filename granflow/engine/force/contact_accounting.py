"""Losses, work and wall forces of one contact."""

from typing import Any

from granflow.engine.exact_sums import (
    add_energy,
    build_list_shares,
    carried,
)
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

    Writes:  losses, boundary_work, impulses, wall_force
    """
    features, wall_of, wall_work = state.plan.features, build_wall_of(state), _build_wall_work(state, with_wall)
    control, list_shares, add_boundary_work = state.control, build_list_shares(state), build_boundary_work(state)
    per_unit = state.parameter("per_unit", ENERGY)
    measured, loss_count = with_wall and features.wall_forces, len(LOSSES)
    force_controlled = with_wall and features.force_controlled_walls
    add_impulse = build_add_impulse(state) if measured else None
    _clear, add_wall_force = build_add_wall_force(state) if force_controlled else (None, None)

    @ti.func
    def add_losses(chunk, shares, found, work):
        per_joule = per_unit()
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
