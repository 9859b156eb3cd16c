"""Second part of a batch of contacts: gather velocities, masses, constants and histories of its pairs into columns."""

from typing import Any

from granflow.engine.force.batch_columns import store_vector
from granflow.engine.force.liquid_transfer import build_form_bridge, transfers_liquid
from granflow.engine.force.pair_force import (
    effective_value,
    normal_time_step,
)
from granflow.engine.force.pair_kinematics import (
    build_effective,
    build_pair_constants,
    build_pair_number,
)
from granflow.engine.force.structs import (
    build_slot_history,
    build_slot_vector,
)
from granflow.engine.frozen_masks import build_contact_mass
from granflow.engine.periodic_box import build_image_velocity
from granflow.engine.state import State
from granflow.kernel_language import ti


def build_gather(state: State) -> Any:
    """Device function (worker, chunk, end, pose, time_step): gather velocities, masses and histories into columns.

    Evaluates `NormalLaw.prepare` and forms bridges, which have branches, so that `evaluate` has none.

    Reads:   velocity, velocity_synchronized, angular_velocity, radius, mass, history
    Writes:  columns of the batch, liquid_film
    """
    plan, particles, control, batch = state.plan, state.particles, state.control, state.batch
    features, stored, pair_number = plan.features, state.neighbors.history, build_pair_number(state)
    slots, law_prepares = list(stored), plan.laws.normal.prepares
    image_velocity, contact_mass, prepare = (
        build_image_velocity(state),
        build_contact_mass(state),
        _build_prepare(state),
    )
    liquid = transfers_liquid(state)
    with_bridge = _build_with_bridge(state) if liquid else None

    @ti.func
    def gather_history(worker, chunk, entry, i, j, list_index, velocity_rel, dt):
        for slot in ti.static(slots):
            vector = stored[slot][list_index]
            if ti.static(slot == "normal" and law_prepares):
                vector = prepare(worker, entry, i, j, velocity_rel, vector, dt)
            elif ti.static(slot == "cohesion" and liquid):
                vector = with_bridge(worker, chunk, entry, i, j, vector)
            store_vector(batch.history[slot], worker, entry, vector)

    @ti.func
    def gather(worker, chunk, end, pose, dt):
        for entry in range(end):
            i, j, list_index = batch.owner[worker, entry], batch.partner[worker, entry], batch.list_index[worker, entry]
            batch.radius[worker, entry] = particles.radius[i]
            velocity_rel_half = particles.velocity[i] - particles.velocity[j] - image_velocity(i, j, pose)
            velocity_rel = velocity_rel_half
            store_vector(batch.velocity_rel_half, worker, entry, velocity_rel_half)
            if ti.static(features.rate_dependent):
                velocity_rel = (
                    particles.velocity_synchronized[i] - particles.velocity_synchronized[j] - image_velocity(i, j, pose)
                )
                store_vector(batch.velocity_rel, worker, entry, velocity_rel)
            batch.mass[worker, entry] = contact_mass(i)
            batch.mass_partner[worker, entry] = contact_mass(j)
            if ti.static(features.rotation):
                store_vector(batch.angular_velocity, worker, entry, particles.angular_velocity[i])
                store_vector(batch.angular_velocity_partner, worker, entry, particles.angular_velocity[j])
            gather_history(worker, chunk, entry, i, j, list_index, velocity_rel, dt)
            if ti.static(not features.one_material):
                store_vector(batch.constants, worker, entry, control.pair_constants[pair_number(i, j)])

    return gather


@ti.func
def branch_of(batch: ti.template(), worker, entry):
    """Branch vector [m] of an entry of the batch."""
    return ti.Vector([batch.branch[0][worker, entry], batch.branch[1][worker, entry], batch.branch[2][worker, entry]])


def _build_with_bridge(state: State) -> Any:
    """Device function (worker, chunk, entry, i, j, components) -> components of the cohesion history, with a bridge.

    Reads:   branch vector of the batch, radius, mass, liquid_film_before, pair_constants, law_parameters
    Writes:  liquid_film
    """
    laws, particles, batch, effective = state.plan.laws, state.particles, state.batch, build_effective(state, False)
    form_bridge, pair_constants = build_form_bridge(state), build_pair_constants(state)
    history_of, vector_of = build_slot_history(laws, "cohesion"), build_slot_vector(laws, "cohesion")

    @ti.func
    def with_bridge(worker, chunk, entry, i, j, components):
        branch = branch_of(batch, worker, entry)
        overlap = particles.radius[i] + particles.radius[j] - ti.sqrt(branch.dot(branch))
        history = history_of(components)
        return vector_of(form_bridge(chunk, i, j, pair_constants(i, j), effective(i, j), overlap, history))

    return with_bridge


def _build_prepare(state: State) -> Any:
    """Device function (worker, entry, i, j, relative velocity [m/s], normal history, time_step) -> normal history.

    Evaluates the branches of the normal model.

    Reads:  branch vector of the batch, radius, mass, pair_constants, law_parameters
    """
    plan, particles, batch, law = state.plan, state.particles, state.batch, state.plan.laws.normal
    pair_constants = build_pair_constants(state)
    history_of, vector_of = build_slot_history(plan.laws, "normal"), build_slot_vector(plan.laws, "normal")
    contact_mass, longest_time_step = build_contact_mass(state), state.parameter("longest_time_step")

    @ti.func
    def prepare(worker, entry, i, j, velocity_rel, vector, dt):
        branch = branch_of(batch, worker, entry)
        distance = ti.sqrt(branch.dot(branch))
        radius, radius_partner = particles.radius[i], particles.radius[j]
        contact = ti.Struct(
            radius_eff=effective_value(radius, radius_partner),
            mass_eff=effective_value(contact_mass(i), contact_mass(j)),
            time_step=normal_time_step(dt, longest_time_step()),
            overlap=radius + radius_partner - distance,
            overlap_rate=-velocity_rel.dot(1.0 / distance * branch),
        )
        return vector_of(law.prepare(pair_constants(i, j).normal, contact, history_of(vector)))

    return prepare
