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

from granflow.engine.codes import ABORT_OVERLAP
from granflow.engine.contact import Contact
from granflow.engine.flows import Flows
from granflow.engine.history import IN_CONTACT, ContactHistory
from granflow.engine.liquid import LiquidFilms
from granflow.engine.pair import (
    PAIR_LOSSES,
    ModelStructs,
    Pair,
    PairForce,
    member,
    normal_contact,
    normal_time_step,
    sphere_bodies,
    sphere_kinematics,
)
from granflow.engine.state import BATCH, LANES, State
from granflow.engine.sums import add_energy, build_list_shares, build_to_grid, holds_sums
from granflow.kernel_language import KERNELS, ti
from granflow.plan.sum_units import (
    LOSSES,
    UNIT_ENERGY,
    UNIT_FORCE,
    UNIT_TORQUE,
)


class BatchedContacts:
    """The contacts between the particles of a chunk.

    In methods, `entry` is the index of a contact in the columns of the batch of a worker; `first` and `end`
    are the particles of the chunk, `end` exclusive.

    Reads:   position, velocity, velocity_synchronized, angular_velocity, angular_velocity_synchronized,
             radius, mass, fixed, material, neighbor lists, history, in_contact, pair_constants,
             law_parameters, liquid_film_before, collision_edges, image_offset, image_speed, and the
             properties that flows read
    Writes:  force, torque, history, in_contact, losses, boundary_work, collisions, liquid_film, flows,
             abort, abort_particle, batch of the worker
    """

    def __init__(self, state: State) -> None:
        plan = state.plan
        self.particles = state.particles
        self.neighbors = state.neighbors
        self.control = state.control
        self.batch = state.batch
        self.features = plan.features
        self.laws = plan.laws
        self.has_history = bool(state.neighbors.history)
        self.slots = list(state.neighbors.history)
        self.pair = state.built(Pair, False)
        self.contact = state.built(Contact, False)
        self.accounting = self.contact.accounting
        self.histories = state.built(ContactHistory)
        self.structs = ModelStructs(plan.laws)
        self.sums = state.built(ContactSums)
        self.liquid = plan.features.liquid_transfer
        self.films = state.built(LiquidFilms) if self.liquid else None
        self.has_flows = len(plan.laws.flows) > 0
        self.flows = state.built(Flows) if self.has_flows else None
        self.flows_at_distance = plan.laws.flows_at_distance
        self.list_shares = build_list_shares(state)
        self.to_grid = build_to_grid(state.backend.real)
        self.loss_count = len(LOSSES)
        self.longest_time_step = state.parameter("longest_time_step")
        self.shifts = state.parameter("shift")
        self.high_words_per_joule = state.parameter("per_unit", UNIT_ENERGY)
        self.evaluate = _build_evaluate(state)
        self.forces, self.torques, self.torques_partner = _result_columns(state.batch)

    @ti.func
    def add(self, worker, chunk, first, end, pose, dt):
        """Add force and torque of all contacts to the sums of the particles."""
        i = first
        while i < end:
            entry_count = 0
            while i < end and entry_count < BATCH:
                entry_count = self._collect(worker, chunk, i, entry_count, first, end, pose, dt)
                i += 1
            self._gather(worker, chunk, entry_count, pose, dt)
            self.evaluate(worker, (entry_count + LANES - 1) // LANES * LANES, dt)
            self._scatter(worker, chunk, entry_count, first, end, pose, dt)

    # Collect

    @ti.func
    def _collect(self, worker, chunk, i, entry_begin, first, end, pose, dt):
        """Add the contacts of one neighbor list to the batch; returns the next entry after those of the list.

        Candidate pairs without contact are overwritten by the next one; open contacts end.
        """
        position = self.particles.position[i]
        radius = self.pair.radius(i)
        overlap_ratio = self.control.overlap_limit[0]
        entry = entry_begin
        for list_index in range(self.neighbors.list_walls_end[i], self.neighbors.list_end[i]):
            j = self.neighbors.partner[list_index]
            branch = self.pair.branch(position, j, pose)
            radius_partner = self.pair.radius(j)
            self.batch.list_index[worker, entry] = list_index
            self.batch.owner[worker, entry] = i
            self.batch.partner[worker, entry] = j
            if ti.static(not self.features.one_size):
                self.batch.radius_partner[worker, entry] = radius_partner
            store_vector(self.batch.branch, worker, entry, branch)
            distance_squared = branch.dot(branch)
            contact_distance = radius + radius_partner
            is_contact = self.pair.overlaps(distance_squared, contact_distance)
            entry += ti.cast(is_contact, ti.i32)
            radius_min = ti.select(radius < radius_partner, radius, radius_partner)
            self._check_overlap(i, distance_squared, contact_distance, overlap_ratio * radius_min)
            if ti.static(self.flows_at_distance):
                if not is_contact:
                    self._add_flows(chunk, i, j, branch, pose, dt)
            if ti.static(self.laws.cohesion_at_distance):
                if not is_contact:
                    self._add_separated(worker, chunk, i, j, list_index, branch, first, end, pose, dt)
            elif ti.static(self.has_history):
                if self.neighbors.in_contact[list_index] == IN_CONTACT and not is_contact:
                    self._end_contact(chunk, list_index, i, j, dt)
        return entry

    @ti.func
    def _check_overlap(self, i, distance_squared, contact_distance, overlap_limit):
        distance_limit = contact_distance - overlap_limit
        if distance_squared < distance_limit * distance_limit:
            ti.atomic_max(self.control.abort[0], ABORT_OVERLAP)
            ti.atomic_min(self.control.abort_particle[0], self.particles.id[i])

    @ti.func
    def _end_contact(self, chunk, list_index, i, j, dt):
        constants = self.pair.constants(i, j)
        energy_lost = self.histories.end(list_index, constants, self.pair.bodies(i, j), dt)
        self.histories.add_plastic_loss(chunk, j, energy_lost)
        if ti.static(self.has_flows):
            self.flows.add_loss(chunk, i, j, energy_lost, False)

    @ti.func
    def _add_flows(self, chunk, i, j, branch, pose, dt):
        """What flows between the surfaces of a pair without overlap."""
        time_step = normal_time_step(dt, self.longest_time_step())
        kinematics = self.pair.separated(i, j, branch, pose)
        contact = normal_contact(self.pair.bodies(i, j), kinematics, time_step)
        self.flows.add(chunk, i, j, self.pair.constants(i, j), contact, False)

    @ti.func
    def _add_separated(self, worker, chunk, i, j, list_index, branch, first, end, pose, dt):
        """Force of a pair without overlap, one at a time; ends the contact beyond the range.

        Force and torques are rounded for the exact sums.
        """
        kinematics = self.pair.separated(i, j, branch, pose)
        if self.pair.in_range(i, j, kinematics.overlap):
            found = self.contact.distant_force(chunk, i, list_index, j, kinematics, pose, dt)
            force = self.to_grid(found.force, self.shifts()[UNIT_FORCE])
            added = ti.cast(force, ti.f64)
            self.sums.add(worker, i, first, 0, added)
            if j >= first and j < end:
                self.sums.add(worker, j, first, 0, -added)
            if ti.static(self.laws.has_viscous_cohesion):
                self._add_torques(worker, i, j, first, end, found)
                if ti.static(self.features.energy_budget):
                    self.accounting.add_viscous_loss(chunk, j, found.viscous_power, dt)
            self.accounting.add_moving_image(chunk, i, j, force, pose, dt)
        elif ti.static(self.has_history):
            if ti.static(self.liquid):
                self.films.return_liquid(chunk, i, j, list_index)
            self._end_contact(chunk, list_index, i, j, dt)

    @ti.func
    def _add_torques(self, worker, i, j, first, end, found):
        shift = self.shifts()[UNIT_TORQUE]
        self.sums.add(worker, i, first, 3, ti.cast(self.to_grid(found.torque, shift), ti.f64))
        if j >= first and j < end:
            self.sums.add(worker, j, first, 3, ti.cast(self.to_grid(found.torque_partner, shift), ti.f64))

    # Gather

    @ti.func
    def _gather(self, worker, chunk, entry_count, pose, dt):
        """Gather velocities, masses, constants and histories into the columns.

        Evaluates `NormalLaw.prepare` and forms bridges, which have branches, so that `evaluate` has none.
        """
        for entry in range(entry_count):
            i = self.batch.owner[worker, entry]
            j = self.batch.partner[worker, entry]
            list_index = self.batch.list_index[worker, entry]
            velocity_rel_half, velocity_rel = self.pair.relative_velocities(i, j, pose)
            store_vector(self.batch.velocity_rel_half, worker, entry, velocity_rel_half)
            if ti.static(self.features.synchronized):
                store_vector(self.batch.velocity_rel, worker, entry, velocity_rel)
            if ti.static(not self.features.one_size):
                self.batch.radius[worker, entry] = self.particles.radius[i]
                self.batch.mass[worker, entry] = self.pair.contact_mass(i)
                self.batch.mass_partner[worker, entry] = self.pair.contact_mass(j)
            if ti.static(self.features.rotation):
                angular_velocities = self.pair.angular_velocities(i, j, pose)
                store_vector(self.batch.angular_velocity, worker, entry, angular_velocities.first)
                store_vector(self.batch.angular_velocity_partner, worker, entry, angular_velocities.partner)
                if ti.static(self.features.viscous_cohesion):
                    first_now, partner_now = angular_velocities.first_now, angular_velocities.partner_now
                    store_vector(self.batch.angular_velocity_now, worker, entry, first_now)
                    store_vector(self.batch.angular_velocity_partner_now, worker, entry, partner_now)
            self._gather_history(worker, chunk, entry, i, j, list_index, velocity_rel, dt)
            if ti.static(self.has_flows):
                contact = self._contact_of(worker, entry, i, j, velocity_rel, dt)
                self.flows.add(chunk, i, j, self.pair.constants(i, j), contact, False)
            if ti.static(not self.features.one_material):
                row = self.control.pair_constants[self.pair.row(i, j)]
                store_vector(self.batch.constants, worker, entry, row)

    @ti.func
    def _gather_history(self, worker, chunk, entry, i, j, list_index, velocity_rel, dt):
        for slot in ti.static(self.slots):
            vector = self.neighbors.history[slot][list_index]
            if ti.static(slot == "normal" and self.laws.normal.prepares):
                vector = self._prepared(worker, entry, i, j, velocity_rel, vector, dt)
            elif ti.static(slot == "cohesion" and self.liquid):
                vector = self._with_bridge(worker, chunk, entry, i, j, vector)
            store_vector(self.batch.history[slot], worker, entry, vector)

    @ti.func
    def _prepared(self, worker, entry, i, j, velocity_rel, vector, dt):
        """Components of the normal history after the branches of the normal model."""
        contact = self._contact_of(worker, entry, i, j, velocity_rel, dt)
        history = self.structs.history("normal", vector)
        constants = self.pair.constants(i, j)
        return self.structs.vector("normal", self.laws.normal.prepare(constants.normal, contact, history))

    @ti.func
    def _contact_of(self, worker, entry, i, j, velocity_rel, dt):
        """Struct `contact` of the normal model."""
        branch = self._branch(worker, entry)
        distance = ti.sqrt(branch.dot(branch))
        bodies = self.pair.bodies(i, j)
        return ti.Struct(
            radius_eff=bodies.radius_eff,
            mass_eff=bodies.mass_eff,
            time_step=normal_time_step(dt, self.longest_time_step()),
            overlap=self.pair.radius(i) + self.pair.radius(j) - distance,
            overlap_rate=-velocity_rel.dot(1.0 / distance * branch),
        )

    @ti.func
    def _with_bridge(self, worker, chunk, entry, i, j, components):
        """Components of the cohesion history, with a bridge."""
        branch = self._branch(worker, entry)
        overlap = self.pair.radius(i) + self.pair.radius(j) - ti.sqrt(branch.dot(branch))
        history = self.structs.history("cohesion", components)
        formed = self.films.form_bridge(
            chunk, i, j, self.pair.constants(i, j), self.pair.bodies(i, j), overlap, history
        )
        return self.structs.vector("cohesion", formed)

    @ti.func
    def _branch(self, worker, entry):
        return vector_of(self.batch.branch, worker, entry)

    # Scatter

    @ti.func
    def _scatter(self, worker, chunk, entry_count, first, end, pose, dt):
        """Add forces, write histories back.

        Forces are added to both partners, if the second is in this chunk.
        """
        for entry in range(entry_count):
            i = self.batch.owner[worker, entry]
            j = self.batch.partner[worker, entry]
            force = ti.cast(vector_of(self.forces, worker, entry), ti.f64)
            self.sums.add(worker, i, first, 0, force)
            if ti.static(self.features.rotation):
                torque = vector_of(self.torques, worker, entry)
                self.sums.add(worker, i, first, 3, ti.cast(torque, ti.f64))
            if j >= first and j < end:
                self.sums.add(worker, j, first, 0, -force)
                if ti.static(self.features.rotation):
                    torque_partner = vector_of(self.torques_partner, worker, entry)
                    self.sums.add(worker, j, first, 3, ti.cast(torque_partner, ti.f64))
            list_index = self.batch.list_index[worker, entry]
            if ti.static(self.features.collision_energies):
                rate = self.pair.kinematics(i, j, pose, dt).overlap_rate_half
                self.accounting.count_collision(chunk, list_index, j, self.pair.bodies(i, j), rate, False)
            self._store_history(worker, entry, list_index)
            if ti.static(self.features.energy_budget):
                self._add_losses(worker, chunk, i, j, entry, dt)
            if ti.static(self.features.moving_images):
                force_on_owner = vector_of(self.forces, worker, entry)
                self.accounting.add_moving_image(chunk, i, j, force_on_owner, pose, dt)

    @ti.func
    def _store_history(self, worker, entry, list_index):
        if ti.static(self.has_history):
            self.neighbors.in_contact[list_index] = IN_CONTACT
        for slot in ti.static(self.slots):
            for k in ti.static(range(len(self.batch.history[slot]))):
                self.neighbors.history[slot][list_index][k] = self.batch.history[slot][k][worker, entry]

    @ti.func
    def _add_losses(self, worker, chunk, i, j, entry, dt):
        shares = self.list_shares(chunk, j)
        lost = ti.cast(0.0, ti.f64)
        for k, loss in ti.static(enumerate(PAIR_LOSSES)):
            value = self.batch.losses[k][worker, entry]
            add_energy(self.control.losses, chunk, loss, self.loss_count, shares, value)
            lost += ti.cast(value, ti.f64)
        if ti.static(self.has_flows):
            per_joule = ti.cast(self.high_words_per_joule(), ti.f64)
            self.flows.add_loss(chunk, i, j, lost / per_joule, False)
        if ti.static(self.features.viscous_cohesion):
            power = self.batch.viscous_power[0][worker, entry]
            self.accounting.add_viscous_loss(chunk, j, power, dt)
            if ti.static(self.has_flows):
                self.flows.add_viscous_loss(chunk, i, j, power, dt, False)


# Evaluate


def _build_evaluate(state: State) -> Any:
    """Function (worker, entry_count, dt): force and torque of all entries, column by column.

    Results replace the inputs: the new histories replace the old ones, forces and torques the columns that
    `_result_columns` names. Forces and torques are rounded for the exact sums, losses are in their units.

    With Taichi it is a separate function: inlined, the steps take 2 to 5 % longer. Quadrants merges equal
    expressions within a task, not within separate functions: there, each access would read the address of the
    fields again, which LLVM cannot move out of a loop with stores, so that it would not vectorize the loop,
    and the forces would take twice as long.

    Reads:   columns of the batch, pair_constants, law_parameters
    Writes:  columns of the batch
    """
    control = state.control
    real = state.backend.real
    columns = Columns(state)
    longest_time_step = state.parameter("longest_time_step")
    shift_parameter = state.parameter("shift")
    per_unit_parameter = state.parameter("per_unit")
    one_size = state.plan.features.one_size
    equal_spheres = state.parameter("equal_spheres") if one_size else None

    func = ti.real_func if KERNELS == "taichi" else ti.func

    @func
    def evaluate(worker: ti.i32, entry_count: ti.i32, dt: real):
        row_of_only_pair = control.pair_constants[0]  # with one material, all contacts have these constants
        parameters = control.law_parameters[0]
        longest = longest_time_step()
        shift = shift_parameter()
        per_unit = per_unit_parameter()
        spheres = ti.Vector.zero(real, 2)
        if ti.static(one_size):
            spheres = equal_spheres()
        for entry in range(entry_count):
            columns.evaluate(
                worker, entry, row_of_only_pair, parameters, spheres, dt, longest, shift, per_unit
            )

    return evaluate


def _result_columns(batch: Any) -> tuple[Any, Any, Any]:
    """Columns of the force on the owner and of the torques on owner and partner, after `evaluate`.

    They are those of the branch vector and of the angular velocities, which nothing reads after it.
    """
    return batch.branch, batch.angular_velocity, batch.angular_velocity_partner


class Columns:
    """Evaluates one entry of the columns of the batch, without branches.

    Reads:   columns of the batch
    Writes:  columns of the batch
    """

    def __init__(self, state: State) -> None:
        plan = state.plan
        self.batch = state.batch
        self.features = plan.features
        self.real = state.backend.real
        self.sizes = plan.history
        self.slots = list(plan.history)
        self.constant_count = plan.pair_constants.shape[1]
        self.pair_force = PairForce(plan.laws, plan.features.rotation, True)
        self.structs = ModelStructs(plan.laws)
        self.to_grid = build_to_grid(state.backend.real)
        self.forces, self.torques, self.torques_partner = _result_columns(state.batch)

    @ti.func
    def evaluate(
        self, worker, entry, row_of_only_pair, parameters, spheres, dt, longest_time_step, shift, per_unit
    ):
        """Force, torques, history and losses of an entry.

        row_of_only_pair, spheres:  constants of one material, radius [m] and mass [kg] of equal spheres
        """
        row = row_of_only_pair
        if ti.static(not self.features.one_material):
            row = self._load(self.batch.constants, worker, entry, self.constant_count)
        found = self.pair_force.evaluate(
            self.structs.constants(row, parameters),
            self._bodies(worker, entry, spheres),
            self._kinematics(worker, entry, spheres, dt),
            self._angular_velocities(worker, entry),
            self.structs.histories(self._slot, worker, entry),
            dt,
            longest_time_step,
        )
        store_vector(self.forces, worker, entry, self.to_grid(found.force, shift[UNIT_FORCE]))
        store_vector(self.torques, worker, entry, self.to_grid(found.torque, shift[UNIT_TORQUE]))
        torque_partner = self.to_grid(found.torque_partner, shift[UNIT_TORQUE])
        store_vector(self.torques_partner, worker, entry, torque_partner)
        for slot in ti.static(self.slots):
            vector = self.structs.vector(slot, member(found.history, slot))
            store_vector(self.batch.history[slot], worker, entry, vector)
        if ti.static(self.features.energy_budget):
            store_vector(self.batch.losses, worker, entry, per_unit[UNIT_ENERGY] * found.losses)
            if ti.static(self.features.viscous_cohesion):
                self.batch.viscous_power[0][worker, entry] = found.viscous_power

    @ti.func
    def _bodies(self, worker, entry, spheres):
        if ti.static(self.features.one_size):
            return sphere_bodies(spheres[0], spheres[1], spheres[0], spheres[1])
        else:
            return sphere_bodies(
                self.batch.radius[worker, entry],
                self.batch.mass[worker, entry],
                self.batch.radius_partner[worker, entry],
                self.batch.mass_partner[worker, entry],
            )

    @ti.func
    def _kinematics(self, worker, entry, spheres, dt):
        radius, radius_partner = spheres[0], spheres[0]
        if ti.static(not self.features.one_size):
            radius = self.batch.radius[worker, entry]
            radius_partner = self.batch.radius_partner[worker, entry]
        return sphere_kinematics(
            radius,
            radius_partner,
            self._load(self.batch.branch, worker, entry, 3),
            self._load(self.batch.velocity_rel_half, worker, entry, 3),
            self._load(self.batch.velocity_rel, worker, entry, 3),
            dt,
            self.features.rate_dependent,
        )

    @ti.func
    def _angular_velocities(self, worker, entry):
        return ti.Struct(
            first=self._load(self.batch.angular_velocity, worker, entry, 3),
            partner=self._load(self.batch.angular_velocity_partner, worker, entry, 3),
            first_now=self._load(self.batch.angular_velocity_now, worker, entry, 3),
            partner_now=self._load(self.batch.angular_velocity_partner_now, worker, entry, 3),
        )

    @ti.func
    def _slot(self, slot: ti.template(), worker, entry):
        return self._load(self.batch.history[slot], worker, entry, self.sizes[slot])

    @ti.func
    def _load(self, columns: ti.template(), worker, entry, count: ti.template()):
        """Vector of `count` components from columns; zeros without columns."""
        vector = ti.Vector.zero(self.real, count)
        for k in ti.static(range(len(columns))):
            vector[k] = columns[k][worker, entry]
        return vector


@ti.func
def vector_of(columns: ti.template(), worker, entry):
    """Vector of three components from their columns [worker, entry]."""
    return ti.Vector([columns[0][worker, entry], columns[1][worker, entry], columns[2][worker, entry]])


@ti.func
def store_vector(columns: ti.template(), worker, entry, vector):
    """Write the components of a vector into columns, one column [worker, entry] per component."""
    for k in ti.static(range(len(columns))):
        columns[k][worker, entry] = vector[k]


class ContactSums:
    """Sums of force [N] and torque [N m] over the contacts of particle i of a chunk.

    In f64, the fields of forces and torques hold the exact sums, see `holds_sums`; in other precisions an
    array of the worker does. `first` is the first particle of the chunk.

    Reads:   force, torque; or the sums of the batch
    Writes:  as it reads
    """

    def __init__(self, state: State) -> None:
        self.batch = state.batch
        self.particles = state.particles
        self.exact = holds_sums(state)
        self.rotation = state.plan.features.rotation

    @ti.func
    def store(self, worker, i, first, force_sum, torque_sum):
        """Set the sums."""
        if ti.static(self.exact):
            self.particles.force[i] = force_sum
            if ti.static(self.rotation):
                self.particles.torque[i] = torque_sum
        else:
            for axis in ti.static(range(3)):
                self.batch.sums[worker, i - first][axis] = force_sum[axis]
                if ti.static(self.rotation):
                    self.batch.sums[worker, i - first][3 + axis] = torque_sum[axis]

    @ti.func
    def load(self, worker, i, first):
        """Both sums."""
        force_sum = ti.Vector.zero(ti.f64, 3)
        torque_sum = ti.Vector.zero(ti.f64, 3)
        if ti.static(self.exact):
            force_sum = self.particles.force[i]
            if ti.static(self.rotation):
                torque_sum = self.particles.torque[i]
        else:
            sums = self.batch.sums[worker, i - first]
            force_sum = ti.Vector([sums[0], sums[1], sums[2]])
            if ti.static(self.rotation):
                torque_sum = ti.Vector([sums[3], sums[4], sums[5]])
        return force_sum, torque_sum

    @ti.func
    def add(self, worker, i, first, component: ti.template(), terms):
        """Add three terms; `component`: of the first term, 0 for a force and 3 for a torque."""
        if ti.static(not self.exact):
            for k in ti.static(range(3)):
                number = ti.static(component + k)
                self.batch.sums[worker, i - first][number] = (
                    self.batch.sums[worker, i - first][number] + terms[k]
                )
        elif ti.static(component == 0):
            self.particles.force[i] = self.particles.force[i] + terms
        else:
            self.particles.torque[i] = self.particles.torque[i] + terms
