"""Batched particle contacts for CPUs: gather values into columns, evaluate the forces, scatter the results.

The loop over the columns has no branch and no indirect address, so that the compiler vectorizes it: four (float64) or
eight (float32) contacts per instruction. The loops before and after it contain the indirect addresses and the
branches. A batch holds a few neighbor lists, so that the columns remain in the cache.
"""

from typing import Any

from granflow.engine.exact_sums import add_energy, build_list_shares, build_to_grid
from granflow.engine.force.batch_collect import build_collect
from granflow.engine.force.batch_columns import build_add_to_sums, store_vector
from granflow.engine.force.batch_gather import build_gather
from granflow.engine.force.collision_counts import build_count_collision
from granflow.engine.force.pair_force import (
    build_pair_force,
    build_sphere_kinematics,
    effective_value,
)
from granflow.engine.force.pair_kinematics import build_boundary_work, build_effective, build_pair_kinematics
from granflow.engine.force.structs import (
    build_constants,
    build_read_slots,
    build_slot_vector,
    member,
)
from granflow.engine.pair_batch import BATCH, LANES
from granflow.engine.state import State
from granflow.kernel_language import ti
from granflow.plan.chunk_sums import DAMPING, FRICTION, LOSSES, ROLLING
from granflow.plan.sum_units import ENERGY, FORCE, TORQUE


def build_batched_forces(state: State) -> Any:
    """Device function (worker, chunk, first, last, pose, time_step): add the contacts between particles.

    Reads:   position, velocity, velocity_synchronized, angular_velocity, radius, mass, neighbor lists
    Writes:  force, torque, history, losses, liquid_film, abort, batch of the worker
    """
    collect, gather, evaluate, scatter = (
        build_collect(state),
        build_gather(state),
        _build_evaluate(state),
        _build_scatter(state),
    )

    @ti.func
    def batched_forces(worker, chunk, first, last, pose, dt):
        i = first
        while i < last:
            found = 0
            while i < last and found < BATCH:
                found = collect(worker, chunk, i, found, first, last, pose, dt)
                i += 1
            gather(worker, chunk, found, pose, dt)
            evaluate(worker, (found + LANES - 1) // LANES * LANES, dt)
            scatter(worker, chunk, found, first, last, pose, dt)

    return batched_forces


def _build_load(state: State) -> Any:
    """Device functions (worker, entry) that load vectors, bodies, angular velocities and history from the columns.

    Reads:  columns of the batch
    """
    batch, real, sizes = state.batch, state.backend.real, state.plan.history

    @ti.func
    def load_vector(columns: ti.template(), worker, entry, count: ti.template()):
        """Vector of `count` components from columns; zeros without columns."""
        vector = ti.Vector.zero(real, count)
        for k in ti.static(range(len(columns))):
            vector[k] = columns[k][worker, entry]
        return vector

    @ti.func
    def load_bodies(worker, entry):
        radius, radius_partner = batch.radius[worker, entry], batch.radius_partner[worker, entry]
        mass, mass_partner = batch.mass[worker, entry], batch.mass_partner[worker, entry]
        inertia, inertia_partner = 0.4 * mass * radius * radius, 0.4 * mass_partner * radius_partner * radius_partner
        return ti.Struct(
            radius_eff=effective_value(radius, radius_partner),
            mass_eff=effective_value(mass, mass_partner),
            inertia_eff=effective_value(inertia, inertia_partner),
        )

    @ti.func
    def load_angular_velocities(worker, entry):
        return ti.Struct(
            first=load_vector(batch.angular_velocity, worker, entry, 3),
            partner=load_vector(batch.angular_velocity_partner, worker, entry, 3),
        )

    @ti.func
    def load_slot(slot: ti.template(), worker, entry):
        return load_vector(batch.history[slot], worker, entry, sizes[slot])

    load_history = build_read_slots(state.plan.laws, load_slot, sizes)
    return load_vector, load_bodies, load_angular_velocities, load_history


def _build_evaluate(state: State) -> Any:
    """Function (worker, end, time_step): force and torque of all entries, column by column; results replace the inputs.

    The force replaces the branch vector, the torques replace the angular velocities, the new histories the old ones.
    Forces and torques are rounded for the exact sums, losses are in their units. It is a separate function
    (`ti.real_func`), because the compiler does not vectorize the loop inside a large kernel.

    Reads:   columns of the batch, pair_constants, law_parameters
    Writes:  columns of the batch
    """
    plan, control, batch, real = state.plan, state.control, state.batch, state.backend.real
    features, constant_count = plan.features, plan.pair_constants.shape[1]
    sphere_kinematics, pair_force = build_sphere_kinematics(plan), build_pair_force(plan, True)
    load_vector, load_bodies, load_angular_velocities, load_history = _build_load(state)
    constants_of, store_results = build_constants(plan.laws), _build_store_results(state)
    longest_time_step, shift_of, per_unit = (
        state.parameter(name) for name in ("longest_time_step", "shift", "per_unit")
    )

    @ti.func
    def kinematics_of(worker, entry, dt):
        return sphere_kinematics(
            batch.radius[worker, entry],
            batch.radius_partner[worker, entry],
            load_vector(batch.branch, worker, entry, 3),
            load_vector(batch.velocity_rel_half, worker, entry, 3),
            load_vector(batch.velocity_rel, worker, entry, 3),
            dt,
        )

    @ti.real_func
    def evaluate(worker: ti.i32, end: ti.i32, dt: real):
        shared, parameters = control.pair_constants[0], control.law_parameters[0]
        longest, shift, units = longest_time_step(), shift_of(), per_unit()
        for entry in range(end):
            row = shared
            if ti.static(not features.one_material):
                row = load_vector(batch.constants, worker, entry, constant_count)
            found = pair_force(
                constants_of(row, parameters),
                load_bodies(worker, entry),
                kinematics_of(worker, entry, dt),
                load_angular_velocities(worker, entry),
                load_history(worker, entry),
                dt,
                longest,
            )
            store_results(worker, entry, found, shift, units)

    return evaluate


def _build_store_results(state: State) -> Any:
    """Device function (worker, entry, result of the pair force, shift, per_unit): write it to the columns.

    Writes:  columns of the batch
    """
    plan, batch, to_grid = state.plan, state.batch, build_to_grid(state.backend.real)
    slots = [(slot, build_slot_vector(plan.laws, slot)) for slot in plan.history]

    @ti.func
    def store_results(worker, entry, found, shift, units):
        store_vector(batch.branch, worker, entry, to_grid(found.force, shift[FORCE]))
        store_vector(batch.angular_velocity, worker, entry, to_grid(found.torque, shift[TORQUE]))
        store_vector(batch.angular_velocity_partner, worker, entry, to_grid(found.torque_partner, shift[TORQUE]))
        for slot, vector_of in ti.static(slots):
            store_vector(batch.history[slot], worker, entry, vector_of(member(found.history, slot)))
        if ti.static(plan.features.energy_budget):
            store_vector(batch.losses, worker, entry, units[ENERGY] * found.losses)

    return store_results


def _build_scatter(state: State) -> Any:
    """Device function (worker, chunk, end, first, last, pose, time_step): add forces and write the histories back.

    Forces are added to both partners, if the second is in this chunk.

    Reads:   columns of the batch
    Writes:  force, torque or sums of the batch; history, in_contact, losses, boundary_work, collisions
    """
    plan, neighbors, control, batch = state.plan, state.neighbors, state.control, state.batch
    features, history, slots = plan.features, neighbors.history, list(neighbors.history)
    list_shares, add_boundary_work = build_list_shares(state), build_boundary_work(state)
    add_to_sums, loss_count = build_add_to_sums(state), len(LOSSES)
    pair_kinematics, effective = build_pair_kinematics(state, False), build_effective(state, False)
    count_collision = build_count_collision(state, False)

    @ti.func
    def vector_of(columns: ti.template(), worker, entry):
        return ti.Vector([columns[0][worker, entry], columns[1][worker, entry], columns[2][worker, entry]])

    @ti.func
    def store_history(worker, entry, list_index):
        if ti.static(len(history) > 0):
            neighbors.in_contact[list_index] = 1
        for slot in ti.static(slots):
            for k in ti.static(range(len(batch.history[slot]))):
                history[slot][list_index][k] = batch.history[slot][k][worker, entry]

    @ti.func
    def add_losses(worker, chunk, j, entry):
        shares = list_shares(chunk, j)
        for k, loss in ti.static(enumerate((FRICTION, ROLLING, DAMPING))):
            add_energy(control.losses, chunk, loss, loss_count, shares, batch.losses[k][worker, entry])

    @ti.func
    def scatter(worker, chunk, end, first, last, pose, dt):
        for entry in range(end):
            i, j = batch.owner[worker, entry], batch.partner[worker, entry]
            force = ti.cast(vector_of(batch.branch, worker, entry), ti.f64)
            add_to_sums(worker, i, first, 0, force)
            if ti.static(features.rotation):
                add_to_sums(worker, i, first, 3, ti.cast(vector_of(batch.angular_velocity, worker, entry), ti.f64))
            if j >= first and j < last:
                add_to_sums(worker, j, first, 0, -force)
                if ti.static(features.rotation):
                    torque_partner = vector_of(batch.angular_velocity_partner, worker, entry)
                    add_to_sums(worker, j, first, 3, ti.cast(torque_partner, ti.f64))
            if ti.static(features.collision_energies):
                rate = pair_kinematics(i, j, pose, dt).overlap_rate_half
                count_collision(chunk, batch.list_index[worker, entry], j, effective(i, j), rate)
            store_history(worker, entry, batch.list_index[worker, entry])
            if ti.static(features.energy_budget):
                add_losses(worker, chunk, j, entry)
                if ti.static(features.lees_edwards):
                    add_boundary_work(chunk, i, j, vector_of(batch.branch, worker, entry), pose, dt)

    return scatter
