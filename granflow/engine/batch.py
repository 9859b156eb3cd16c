"""Particle contacts on a CPU, in batches: collect the contacts of a few neighbor lists, then evaluate them
together.

A batch has a column per number of a contact, such as a component of the branch vector. Its loops are

    collect    the pairs of a list that overlap; pairs apart are handled one at a time
    gather     velocities, masses, constants and histories of the pairs into the columns
    evaluate   forces, torques and new histories, column by column
    scatter    results to the sums of the particles and to the contact histories

`evaluate` has no branch and no indirect address, so that the compiler vectorizes it: four (float64) or eight
(float32) contacts per instruction. The other loops have the indirect addresses and the branches. A batch
holds only a few neighbor lists, so that its columns remain in the cache.
"""

from typing import Any

from granflow.engine.box import DeviceBox
from granflow.engine.codes import ABORT_OVERLAP
from granflow.engine.contact import build_boundary_work, build_count_collision, build_distant_force
from granflow.engine.contact_structs import (
    build_constants,
    build_read_slots,
    build_slot_history,
    build_slot_vector,
    member,
)
from granflow.engine.flows import Flows
from granflow.engine.history import IN_CONTACT, ContactHistory
from granflow.engine.liquid import build_form_bridge, build_return_liquid
from granflow.engine.pair import (
    PAIR_LOSSES,
    build_contact_mass,
    build_effective,
    build_overlaps,
    build_pair_constants,
    build_pair_force,
    build_pair_kinematics,
    build_pair_number,
    build_sphere_kinematics,
    normal_time_step,
    sphere_bodies,
)
from granflow.engine.state import BATCH, LANES, State
from granflow.engine.sums import add_energy, build_list_shares, build_to_grid, holds_sums
from granflow.kernel_language import ti
from granflow.plan.sum_units import (
    LOSSES,
    UNIT_ENERGY,
    UNIT_FORCE,
    UNIT_TORQUE,
)


def build_batched_forces(state: State) -> Any:
    """Device function (worker, chunk, first, end, pose, dt): add the contacts between particles.

    first, end:  particles of the chunk, `end` exclusive

    Reads:   position, velocity, velocity_synchronized, angular_velocity, radius, mass, neighbor lists
    Writes:  force, torque, history, losses, liquid_film, abort, batch of the worker
    """
    collect = _build_collect(state)
    gather = _build_gather(state)
    evaluate = _build_evaluate(state)
    scatter = _build_scatter(state)

    @ti.func
    def batched_forces(worker, chunk, first, end, pose, dt):
        i = first
        while i < end:
            entry_count = 0
            while i < end and entry_count < BATCH:
                entry_count = collect(worker, chunk, i, entry_count, first, end, pose, dt)
                i += 1
            gather(worker, chunk, entry_count, pose, dt)
            evaluate(worker, (entry_count + LANES - 1) // LANES * LANES, dt)
            scatter(worker, chunk, entry_count, first, end, pose, dt)

    return batched_forces


# Collect


def _build_collect(state: State) -> Any:
    """Device function that adds the contacts of one neighbor list to the batch.

    Arguments: worker, chunk, i, next entry of the batch, first and end of the particles of the chunk, pose,
    dt. Returns the next entry after those of the list. Candidate pairs without contact are overwritten by the
    next one; open contacts end.

    Reads:   position, radius, neighbor lists, in_contact
    Writes:  list_index, owner, partner, branch of the batch; history, in_contact, losses, abort; with a model
             that acts at a distance, sums
    """
    particles = state.particles
    neighbors = state.neighbors
    control = state.control
    batch = state.batch
    real = state.backend.real
    has_history = bool(neighbors.history)
    overlaps = build_overlaps(real)
    histories = state.built(ContactHistory)
    effective = build_effective(state, False)
    box = state.built(DeviceBox)
    pair_constants = build_pair_constants(state)
    max_overlap = state.parameter("max_overlap")
    acts_at_distance = state.plan.laws.acts_at_distance
    attract = _build_attract(state) if acts_at_distance else None

    @ti.func
    def end_lost_contact(chunk, list_index, i, j, dt):
        energy_lost = histories.end(list_index, pair_constants(i, j), effective(i, j), dt)
        histories.add_plastic_loss(chunk, j, energy_lost)

    @ti.func
    def check_overlap(i, distance_squared, contact_distance, overlap_limit):
        distance_limit = contact_distance - overlap_limit
        if distance_squared < distance_limit * distance_limit:
            ti.atomic_max(control.abort[0], ABORT_OVERLAP)
            ti.atomic_min(control.abort_particle[0], particles.id[i])

    @ti.func
    def collect(worker, chunk, i, entry_begin, first, end, pose, dt):
        position = particles.position[i]
        radius = particles.radius[i]
        overlap_ratio = max_overlap()
        entry = entry_begin
        for list_index in range(neighbors.list_walls_end[i], neighbors.list_end[i]):
            j = neighbors.partner[list_index]
            branch = ti.cast(box.minimum_image(position, particles.position[j], pose), real)
            radius_partner = particles.radius[j]
            batch.list_index[worker, entry] = list_index
            batch.owner[worker, entry] = i
            batch.partner[worker, entry] = j
            batch.radius_partner[worker, entry] = radius_partner
            for axis in ti.static(range(3)):
                batch.branch[axis][worker, entry] = branch[axis]
            distance_squared = branch.dot(branch)
            contact_distance = radius + radius_partner
            is_contact = overlaps(distance_squared, contact_distance)
            entry += ti.cast(is_contact, ti.i32)
            radius_min = ti.select(radius < radius_partner, radius, radius_partner)
            check_overlap(i, distance_squared, contact_distance, overlap_ratio * radius_min)
            if ti.static(acts_at_distance):
                if not is_contact:
                    attract(worker, chunk, i, j, list_index, branch, contact_distance, first, end, pose, dt)
            elif ti.static(has_history):
                if neighbors.in_contact[list_index] == IN_CONTACT and not is_contact:
                    end_lost_contact(chunk, list_index, i, j, dt)
        return entry

    return collect


def _build_attract(state: State) -> Any:
    """Device function: attraction of a pair without overlap, one at a time; ends the contact beyond the
    range.

    Arguments: worker, chunk, i, j, list index, branch vector and sum of the radii [m], first and end of the
    particles of the chunk, pose, dt. The force is rounded for the exact sums.

    Reads:   radius, mass, history, pair_constants, law_parameters
    Writes:  sums of the batch, history, in_contact, losses, boundary_work, liquid_film
    """
    features = state.plan.features
    to_grid = build_to_grid(state.backend.real)
    shift = state.parameter("shift", UNIT_FORCE)
    add_to_sums = build_add_to_sums(state)
    liquid = features.liquid_transfer
    return_liquid = build_return_liquid(state) if liquid else None
    distant_force = build_distant_force(state, False)
    add_boundary_work = build_boundary_work(state)
    histories = state.built(ContactHistory)
    pair_constants = build_pair_constants(state)
    effective = build_effective(state, False)
    has_history = bool(state.neighbors.history)

    @ti.func
    def attract(worker, chunk, i, j, list_index, branch, contact_distance, first, end, pose, dt):
        distance = ti.sqrt(branch.dot(branch))
        constants = pair_constants(i, j)
        if distance < contact_distance + constants.cohesion.range:
            overlap = ti.min(contact_distance - distance, 0.0)
            attraction = distant_force(chunk, i, list_index, j, overlap, dt)
            force = to_grid(-attraction / distance * branch, shift())
            added = ti.cast(force, ti.f64)
            add_to_sums(worker, i, first, 0, added)
            if j >= first and j < end:
                add_to_sums(worker, j, first, 0, -added)
            if ti.static(features.energy_budget and features.lees_edwards):
                add_boundary_work(chunk, i, j, force, pose, dt)
        elif ti.static(has_history):
            if ti.static(liquid):
                return_liquid(chunk, i, j, list_index)
            histories.add_plastic_loss(chunk, j, histories.end(list_index, constants, effective(i, j), dt))

    return attract


# Gather


def _build_gather(state: State) -> Any:
    """Device function (worker, chunk, entry_count, pose, dt): gather velocities, masses and histories into
    columns.

    Evaluates `NormalLaw.prepare` and forms bridges, which have branches, so that `evaluate` has none.

    Reads:   velocity, velocity_synchronized, angular_velocity, radius, mass, history
    Writes:  columns of the batch, liquid_film
    """
    plan = state.plan
    particles = state.particles
    control = state.control
    batch = state.batch
    features = plan.features
    stored = state.neighbors.history
    pair_number = build_pair_number(state)
    slots = list(stored)
    law_prepares = plan.laws.normal.prepares
    box = state.built(DeviceBox)
    contact_mass = build_contact_mass(state)
    prepare = _build_prepare(state)
    liquid = features.liquid_transfer
    with_bridge = _build_with_bridge(state) if liquid else None
    has_flows = len(plan.laws.flows) > 0
    pair_constants = build_pair_constants(state)
    contact_of = _build_contact_of(state)
    flows = state.built(Flows) if has_flows else None
    longest_time_step = state.parameter("longest_time_step")

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
    def gather(worker, chunk, entry_count, pose, dt):
        for entry in range(entry_count):
            i = batch.owner[worker, entry]
            j = batch.partner[worker, entry]
            list_index = batch.list_index[worker, entry]
            batch.radius[worker, entry] = particles.radius[i]
            velocity_rel_half = particles.velocity[i] - particles.velocity[j] - box.image_velocity(i, j, pose)
            velocity_rel = velocity_rel_half
            store_vector(batch.velocity_rel_half, worker, entry, velocity_rel_half)
            if ti.static(features.rate_dependent):
                velocity_rel = (
                    particles.velocity_synchronized[i]
                    - particles.velocity_synchronized[j]
                    - box.image_velocity(i, j, pose)
                )
                store_vector(batch.velocity_rel, worker, entry, velocity_rel)
            batch.mass[worker, entry] = contact_mass(i)
            batch.mass_partner[worker, entry] = contact_mass(j)
            if ti.static(features.rotation):
                store_vector(batch.angular_velocity, worker, entry, particles.angular_velocity[i])
                store_vector(batch.angular_velocity_partner, worker, entry, particles.angular_velocity[j])
            gather_history(worker, chunk, entry, i, j, list_index, velocity_rel, dt)
            if ti.static(has_flows):
                time_step = normal_time_step(dt, longest_time_step())
                contact = contact_of(worker, entry, i, j, velocity_rel, time_step)
                flows.add(chunk, i, j, pair_constants(i, j), contact, False)
            if ti.static(not features.one_material):
                store_vector(batch.constants, worker, entry, control.pair_constants[pair_number(i, j)])

    return gather


@ti.func
def branch_of(batch: ti.template(), worker, entry):
    """Branch vector [m] of an entry of the batch."""
    return ti.Vector(
        [batch.branch[0][worker, entry], batch.branch[1][worker, entry], batch.branch[2][worker, entry]]
    )


def _build_prepare(state: State) -> Any:
    """Device function (worker, entry, i, j, relative velocity [m/s], normal history, dt) -> normal
    history.

    Evaluates the branches of the normal model.

    Reads:  branch vector of the batch, radius, mass, pair_constants, law_parameters
    """
    plan = state.plan
    law = state.plan.laws.normal
    pair_constants = build_pair_constants(state)
    history_of = build_slot_history(plan.laws, "normal")
    vector_of = build_slot_vector(plan.laws, "normal")
    contact_of = _build_contact_of(state)
    longest_time_step = state.parameter("longest_time_step")

    @ti.func
    def prepare(worker, entry, i, j, velocity_rel, vector, dt):
        contact = contact_of(worker, entry, i, j, velocity_rel, normal_time_step(dt, longest_time_step()))
        return vector_of(law.prepare(pair_constants(i, j).normal, contact, history_of(vector)))

    return prepare


def _build_contact_of(state: State) -> Any:
    """Device function (worker, entry, i, j, relative velocity [m/s], time step [s]) -> struct `contact` of
    the normal model.

    Reads:  branch vector of the batch, radius, mass
    """
    particles = state.particles
    batch = state.batch
    effective = build_effective(state, False)

    @ti.func
    def contact_of(worker, entry, i, j, velocity_rel, time_step):
        branch = branch_of(batch, worker, entry)
        distance = ti.sqrt(branch.dot(branch))
        bodies = effective(i, j)
        return ti.Struct(
            radius_eff=bodies.radius_eff,
            mass_eff=bodies.mass_eff,
            time_step=time_step,
            overlap=particles.radius[i] + particles.radius[j] - distance,
            overlap_rate=-velocity_rel.dot(1.0 / distance * branch),
        )

    return contact_of


def _build_with_bridge(state: State) -> Any:
    """Device function (worker, chunk, entry, i, j, components) -> components of the cohesion history, with a
    bridge.

    Reads:   branch vector of the batch, radius, mass, liquid_film_before, pair_constants, law_parameters
    Writes:  liquid_film
    """
    laws = state.plan.laws
    particles = state.particles
    batch = state.batch
    effective = build_effective(state, False)
    form_bridge = build_form_bridge(state)
    pair_constants = build_pair_constants(state)
    history_of = build_slot_history(laws, "cohesion")
    vector_of = build_slot_vector(laws, "cohesion")

    @ti.func
    def with_bridge(worker, chunk, entry, i, j, components):
        branch = branch_of(batch, worker, entry)
        overlap = particles.radius[i] + particles.radius[j] - ti.sqrt(branch.dot(branch))
        history = history_of(components)
        return vector_of(form_bridge(chunk, i, j, pair_constants(i, j), effective(i, j), overlap, history))

    return with_bridge


# Evaluate


def _build_evaluate(state: State) -> Any:
    """Function (worker, entry_count, dt): force and torque of all entries, column by column.

    Results replace the inputs: the new histories replace the old ones, forces and torques the columns that
    `_result_columns` names. Forces and torques are rounded for the exact sums, losses are in their units. It
    is a separate function (`ti.real_func`), because the compiler does not vectorize the loop inside a large
    kernel.

    Reads:   columns of the batch, pair_constants, law_parameters
    Writes:  columns of the batch
    """
    plan = state.plan
    control = state.control
    batch = state.batch
    real = state.backend.real
    features = plan.features
    constant_count = plan.pair_constants.shape[1]
    sphere_kinematics = build_sphere_kinematics(plan)
    pair_force = build_pair_force(plan, True)
    load_vector, load_bodies, load_angular_velocities, load_history = _build_load(state)
    constants_of = build_constants(plan.laws)
    store_results = _build_store_results(state)
    longest_time_step = state.parameter("longest_time_step")
    shift_parameter = state.parameter("shift")
    per_unit_parameter = state.parameter("per_unit")

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
    def evaluate(worker: ti.i32, entry_count: ti.i32, dt: real):
        row_of_only_pair = control.pair_constants[0]  # with one material, all contacts have these constants
        parameters = control.law_parameters[0]
        longest = longest_time_step()
        shift = shift_parameter()
        per_unit = per_unit_parameter()
        for entry in range(entry_count):
            row = row_of_only_pair
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
            store_results(worker, entry, found, shift, per_unit)

    return evaluate


def _result_columns(batch: Any) -> tuple[Any, Any, Any]:
    """Columns of the force on the owner and of the torques on owner and partner, after `evaluate`.

    They are those of the branch vector and of the angular velocities, which nothing reads after it.
    """
    return batch.branch, batch.angular_velocity, batch.angular_velocity_partner


def _build_load(state: State) -> Any:
    """Device functions (worker, entry) that load vectors, bodies, angular velocities and history from the
    columns.

    Reads:  columns of the batch
    """
    batch = state.batch
    real = state.backend.real
    sizes = state.plan.history

    @ti.func
    def load_vector(columns: ti.template(), worker, entry, count: ti.template()):
        """Vector of `count` components from columns; zeros without columns."""
        vector = ti.Vector.zero(real, count)
        for k in ti.static(range(len(columns))):
            vector[k] = columns[k][worker, entry]
        return vector

    @ti.func
    def load_bodies(worker, entry):
        return sphere_bodies(
            batch.radius[worker, entry],
            batch.mass[worker, entry],
            batch.radius_partner[worker, entry],
            batch.mass_partner[worker, entry],
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


def _build_store_results(state: State) -> Any:
    """Device function (worker, entry, result of the pair force, shift, per_unit): write it to the columns.

    Writes:  columns of the batch
    """
    plan = state.plan
    batch = state.batch
    forces, torques, torques_partner = _result_columns(batch)
    to_grid = build_to_grid(state.backend.real)
    slots = [(slot, build_slot_vector(plan.laws, slot)) for slot in plan.history]

    @ti.func
    def store_results(worker, entry, found, shift, per_unit):
        store_vector(forces, worker, entry, to_grid(found.force, shift[UNIT_FORCE]))
        store_vector(torques, worker, entry, to_grid(found.torque, shift[UNIT_TORQUE]))
        store_vector(torques_partner, worker, entry, to_grid(found.torque_partner, shift[UNIT_TORQUE]))
        for slot, vector_of in ti.static(slots):
            store_vector(batch.history[slot], worker, entry, vector_of(member(found.history, slot)))
        if ti.static(plan.features.energy_budget):
            store_vector(batch.losses, worker, entry, per_unit[UNIT_ENERGY] * found.losses)

    return store_results


# Scatter


def _build_scatter(state: State) -> Any:
    """Device function (worker, chunk, entry_count, first, end, pose, dt): add forces, write histories back.

    Forces are added to both partners, if the second is in this chunk.

    Reads:   columns of the batch
    Writes:  force, torque or sums of the batch; history, in_contact, losses, boundary_work, collisions
    """
    plan = state.plan
    neighbors = state.neighbors
    control = state.control
    batch = state.batch
    forces, torques, torques_partner = _result_columns(batch)
    features = plan.features
    history = neighbors.history
    slots = list(neighbors.history)
    list_shares = build_list_shares(state)
    add_boundary_work = build_boundary_work(state)
    add_to_sums = build_add_to_sums(state)
    loss_count = len(LOSSES)
    pair_kinematics = build_pair_kinematics(state, False)
    effective = build_effective(state, False)
    count_collision = build_count_collision(state, False)

    @ti.func
    def vector_of(columns: ti.template(), worker, entry):
        return ti.Vector([columns[0][worker, entry], columns[1][worker, entry], columns[2][worker, entry]])

    @ti.func
    def store_history(worker, entry, list_index):
        if ti.static(len(history) > 0):
            neighbors.in_contact[list_index] = IN_CONTACT
        for slot in ti.static(slots):
            for k in ti.static(range(len(batch.history[slot]))):
                history[slot][list_index][k] = batch.history[slot][k][worker, entry]

    @ti.func
    def add_losses(worker, chunk, j, entry):
        shares = list_shares(chunk, j)
        for k, loss in ti.static(enumerate(PAIR_LOSSES)):
            add_energy(control.losses, chunk, loss, loss_count, shares, batch.losses[k][worker, entry])

    @ti.func
    def scatter(worker, chunk, entry_count, first, end, pose, dt):
        for entry in range(entry_count):
            i = batch.owner[worker, entry]
            j = batch.partner[worker, entry]
            force = ti.cast(vector_of(forces, worker, entry), ti.f64)
            add_to_sums(worker, i, first, 0, force)
            if ti.static(features.rotation):
                torque = vector_of(torques, worker, entry)
                add_to_sums(worker, i, first, 3, ti.cast(torque, ti.f64))
            if j >= first and j < end:
                add_to_sums(worker, j, first, 0, -force)
                if ti.static(features.rotation):
                    torque_partner = vector_of(torques_partner, worker, entry)
                    add_to_sums(worker, j, first, 3, ti.cast(torque_partner, ti.f64))
            if ti.static(features.collision_energies):
                rate = pair_kinematics(i, j, pose, dt).overlap_rate_half
                count_collision(chunk, batch.list_index[worker, entry], j, effective(i, j), rate)
            store_history(worker, entry, batch.list_index[worker, entry])
            if ti.static(features.energy_budget):
                add_losses(worker, chunk, j, entry)
                if ti.static(features.lees_edwards):
                    add_boundary_work(chunk, i, j, vector_of(forces, worker, entry), pose, dt)

    return scatter


# Columns of the batch, and sums over the contacts of a particle


@ti.func
def store_vector(columns: ti.template(), worker, entry, vector):
    """Write the components of a vector into columns, one column [worker, entry] per component."""
    for k in ti.static(range(len(columns))):
        columns[k][worker, entry] = vector[k]


def build_store_sums(state: State) -> Any:
    """Device function (worker, i, first, force_sum, torque_sum): set the sums of particle i.

    first:  first particle of the chunk

    In f64, the fields of forces and torques hold the exact sums, see `holds_sums`; in other precisions an
    array of the worker does.

    Writes:  force, torque; or the sums of the batch
    """
    batch = state.batch
    particles = state.particles
    exact = holds_sums(state)
    rotation = state.plan.features.rotation

    @ti.func
    def store_sums(worker, i, first, force_sum, torque_sum):
        if ti.static(exact):
            particles.force[i] = force_sum
            if ti.static(rotation):
                particles.torque[i] = torque_sum
        else:
            for axis in ti.static(range(3)):
                batch.sums[worker, i - first][axis] = force_sum[axis]
                if ti.static(rotation):
                    batch.sums[worker, i - first][3 + axis] = torque_sum[axis]

    return store_sums


def build_load_sums(state: State) -> Any:
    """Device function (worker, i, first) -> (force, torque): the sums of particle i.

    Reads:  as `build_store_sums` writes
    """
    batch = state.batch
    particles = state.particles
    exact = holds_sums(state)
    rotation = state.plan.features.rotation

    @ti.func
    def load_sums(worker, i, first):
        force_sum = ti.Vector.zero(ti.f64, 3)
        torque_sum = ti.Vector.zero(ti.f64, 3)
        if ti.static(exact):
            force_sum = particles.force[i]
            if ti.static(rotation):
                torque_sum = particles.torque[i]
        else:
            sums = batch.sums[worker, i - first]
            force_sum = ti.Vector([sums[0], sums[1], sums[2]])
            if ti.static(rotation):
                torque_sum = ti.Vector([sums[3], sums[4], sums[5]])
        return force_sum, torque_sum

    return load_sums


def build_add_to_sums(state: State) -> Any:
    """Device function (worker, i, first, component, terms): add three terms to the sums of particle i.

    `first`: first particle of the chunk; `component`: of the first term, 0 for a force and 3 for a torque.

    Writes:  as `build_store_sums`
    """
    batch = state.batch
    particles = state.particles
    exact = holds_sums(state)

    @ti.func
    def add_to_sums(worker, i, first, component: ti.template(), terms):
        if ti.static(not exact):
            for k in ti.static(range(3)):
                number = ti.static(component + k)
                batch.sums[worker, i - first][number] = batch.sums[worker, i - first][number] + terms[k]
        elif ti.static(component == 0):
            particles.force[i] = particles.force[i] + terms
        else:
            particles.torque[i] = particles.torque[i] + terms

    return add_to_sums
