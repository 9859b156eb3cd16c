"""Wall forces: time integrals of the forces of the particles, summed exactly per chunk."""

from typing import Any

import numpy as np

from granflow.engine.exact_sums import carried, exact_totals, shares_rows, to_units
from granflow.engine.state import State
from granflow.kernel_language import ti
from granflow.plan.chunk_sums import IMPULSE_SIZE
from granflow.plan.sum_units import ANGULAR_IMPULSE, CARRY_BITS, IMPULSE


def build_add_impulse(state: State) -> Any:
    """Device function (chunk, wall, i, normal, force on i, torque on i, time_step): add one contact in one step.

        J += -F dt        L += -[(x - p) x F + M] dt        N += F . n dt

    with p the point of the wall's rotation in the scene, or the origin without rotation. Sums are exact, because a wall
    force is the difference of two sums. Chunks of one particle share rows by atomic additions.

    Reads:   position, impulse_row, pivot
    Writes:  impulses
    """
    particles, walls, impulses = state.particles, state.walls, state.control.impulses
    per_unit, shared, rows = state.parameter("per_unit"), shares_rows(state), state.capacities.wall_rows

    @ti.func
    def add_to_shared(chunk, row, terms):
        for k in ti.static(range(IMPULSE_SIZE)):
            high = terms[k] >> CARRY_BITS
            ti.atomic_add(impulses[chunk % rows, row][k], terms[k] - (high << CARRY_BITS))
            ti.atomic_add(impulses[chunk % rows, row][IMPULSE_SIZE + k], high)

    @ti.func
    def add_impulse(chunk, w, i, normal, force, torque, dt):
        row = walls.impulse_row[w]
        if row >= 0:
            time = ti.cast(dt, ti.f64)
            impulse, angular_impulse = -time * ti.cast(force, ti.f64), -time * ti.cast(torque, ti.f64)
            arm = ti.cast(particles.position[i], ti.f64) - ti.cast(walls.pivot[w], ti.f64)
            angular_impulse += arm.cross(impulse)
            units = ti.cast(per_unit(), ti.f64)
            terms = ti.Vector.zero(ti.i64, 2 * IMPULSE_SIZE)
            for axis in ti.static(range(3)):
                terms[axis] = to_units(units[IMPULSE] * impulse[axis])
                terms[3 + axis] = to_units(units[ANGULAR_IMPULSE] * angular_impulse[axis])
            terms[6] = -to_units(units[IMPULSE] * impulse.dot(ti.cast(normal, ti.f64)))
            if ti.static(shared):
                add_to_shared(chunk, row, terms)
            else:
                impulses[chunk, row] = carried(impulses[chunk, row] + terms, IMPULSE_SIZE)

    return add_impulse


def build_carry_impulses(state: State) -> Any:
    """Device function (chunk): move the carries of a row that chunks share, once per step and not beside additions.

    Writes:  impulses
    """
    impulses, rows = state.control.impulses, state.capacities.wall_rows
    shared, measured = impulses is not None and shares_rows(state), state.capacities.measured_walls

    @ti.func
    def carry_impulses(chunk):
        if ti.static(shared):
            if chunk < rows:
                for row in range(measured):
                    impulses[chunk, row] = carried(impulses[chunk, row], IMPULSE_SIZE)

    return carry_impulses


def wall_impulses(state: State) -> dict[str, np.ndarray]:
    """Time integrals since the start of each measured wall by name.

    Returns:  arrays (7,) float64: impulse (3) [N s], angular impulse (3) [N m s] and normal impulse [N s] of the
              particles on the wall; empty without measured walls
    """
    if state.control.impulses is None:
        return {}
    sums, units = state.ranks.total(state.control.impulses.to_numpy()), state.plan.sum_units
    unit = np.array([units.impulse] * 3 + [units.angular_impulse] * 3 + [units.impulse])
    return {name: exact_totals(sums[:, row], unit) for row, name in enumerate(state.plan.measured_walls)}
