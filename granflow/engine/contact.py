"""One contact of a particle with another particle or a wall, evaluated on its own.

`Contact.evaluate` gathers what `pair.py` needs, evaluates the force, writes the contact history and adds the
losses of the contact to the accounting. All wall contacts take this path, and all particle contacts if each
particle is a chunk: on a GPU, and on a CPU with up to 64 particles or a normal model that is not branch-free
(`chunk_size` of the plan). Otherwise `batch.py` evaluates the particle contacts, many at a time, and shares
the parts of this file.
"""

from typing import Any

import numpy as np

from granflow.engine.box import DeviceBox
from granflow.engine.codes import ABORT_OVERLAP
from granflow.engine.deformation import DeformingBox
from granflow.engine.fields import build_tasks_of_thread, thread_count
from granflow.engine.flows import Flows
from granflow.engine.history import (
    IN_CONTACT,
    NO_CONTACT,
    ContactHistory,
    HistoryTransfer,
    transfers_history,
)
from granflow.engine.liquid import LiquidFilms
from granflow.engine.pair import PAIR_LOSSES, Pair, PairForce, no_losses, normal_contact, normal_time_step
from granflow.engine.state import State
from granflow.engine.sums import SHARES, add_energy, build_list_shares, build_to_grid, carried, exact_totals
from granflow.engine.wall_dynamics import ForceControlledWalls, WallImpulses
from granflow.engine.walls import Faces, WallGeometry
from granflow.engine.wear import FaceWear
from granflow.kernel_language import ti
from granflow.plan.sum_units import (
    LOSS_VISCOUS,
    LOSS_WALL_WORK,
    LOSSES,
    UNIT_ENERGY,
    UNIT_FORCE,
    terms_ahead,
)


class Contact:
    """One contact in a step.

    with_wall:  True for walls (j < 0), False for particles

    Reads:   position, velocity, velocity_synchronized, angular_velocity, angular_velocity_synchronized,
             radius, mass, fixed, material, history, in_contact, neighbor lists, walls, mesh, pair_constants,
             law_parameters, liquid_film_before, collision_edges, and the properties that flows read
    Writes:  history, in_contact, losses, losses_ahead, boundary_work, impulses, collisions, wall_force,
             wear, liquid_film, sums of flows, abort, abort_particle
    """

    def __init__(self, state: State, with_wall: bool) -> None:
        plan = state.plan
        self.particles = state.particles
        self.neighbors = state.neighbors
        self.control = state.control
        self.laws = plan.laws
        self.with_wall = with_wall
        self.pair = state.built(Pair, with_wall)
        self.pair_force = PairForce(plan.laws, plan.features.rotation, False)
        self.histories = state.built(ContactHistory)
        self.transfers = with_wall and transfers_history(state)
        self.transfer = state.built(HistoryTransfer)
        self.accounting = state.built(Accounting)
        self.liquid = plan.features.liquid_transfer
        self.films = state.built(LiquidFilms) if self.liquid else None
        self.has_flows = len(plan.laws.flows) > 0
        self.flows = state.built(Flows) if self.has_flows else None
        self.flows_at_distance = plan.laws.flows_at_distance
        self.wears = with_wall and plan.features.wear
        self.wear = state.built(FaceWear) if self.wears else None
        self.longest_time_step = state.parameter("longest_time_step")
        self.keeps_bond = "cohesion" in state.neighbors.history
        self.slots_of_surface = [slot for slot in state.neighbors.history if slot != "cohesion"]

    @ti.func
    def evaluate(self, chunk, i, list_index, j, pose, dt):
        """Force [N] and torque [N m] on i.

        Three cases: the pair overlaps; a cohesion model acts between the separated surfaces; or there is no
        contact, and a contact that has existed so far ends. Its history is then cleared, unless another face
        of the walls has the contact now, and its plastic work is added to the losses. Flows between separated
        surfaces do not depend on these cases.
        """
        force = 0.0 * self.particles.velocity[i]
        torque = 0.0 * self.particles.velocity[i]
        kinematics = self.pair.kinematics(i, j, pose, dt)
        bodies = self.pair.bodies(i, j)
        constants = self.pair.constants(i, j)
        if kinematics.overlap > 0.0:
            self._check_overlap(i, j, kinematics.overlap)
            if ti.static(self.transfers):
                self.transfer.acquire(i, list_index, j, pose)
            angular_velocities = self.pair.angular_velocities(i, j, pose)
            history = self.histories.read(list_index)
            if ti.static(self.liquid):
                history.cohesion = self.films.form_bridge(
                    chunk, i, j, constants, bodies, kinematics.overlap, history.cohesion
                )
            longest = self.longest_time_step()
            found = self.pair_force.evaluate(
                constants, bodies, kinematics, angular_velocities, history, dt, longest
            )
            force = found.force
            torque = found.torque
            self.accounting.count_collision(
                chunk, list_index, j, bodies, kinematics.overlap_rate_half, self.with_wall
            )
            self.histories.write(list_index, found.history)
            self._account(chunk, i, j, pose, kinematics.normal, found, dt)
            if ti.static(self.wears):
                self.wear.add(i, j, kinematics, angular_velocities, force, found.slides, dt)
            if ti.static(self.has_flows):
                if ti.static(not self.flows_at_distance):
                    touching = normal_contact(bodies, kinematics, normal_time_step(dt, longest))
                    self.flows.add(chunk, i, j, constants, touching, self.with_wall)
                self._add_loss_heat(chunk, i, j, found, dt)
        elif self.pair.in_range(i, j, kinematics.overlap):
            if ti.static(self.laws.cohesion_at_distance):
                if ti.static(self.transfers):
                    self.transfer.acquire(i, list_index, j, pose)
                found = self.distant_force(chunk, i, list_index, j, kinematics, pose, dt)
                force = found.force
                torque = found.torque
                self._account(chunk, i, j, pose, kinematics.normal, found, dt)
        else:
            energy_lost = 0.0 * dt
            released = 0
            if ti.static(self.transfers):
                released = self.transfer.release(i, list_index, j, pose)
            if released == 0:
                if ti.static(self.liquid):
                    self.films.return_liquid(chunk, i, j, list_index)
                energy_lost = self.histories.end(list_index, constants, bodies, dt)
            self._add_plastic_loss(chunk, i, j, energy_lost)
        if ti.static(self.flows_at_distance):
            near = normal_contact(bodies, kinematics, normal_time_step(dt, self.longest_time_step()))
            self.flows.add(chunk, i, j, constants, near, self.with_wall)
        return force, torque

    @ti.func
    def _check_overlap(self, i, j, overlap):
        """Request an abort if the overlap exceeds the limit."""
        radius_min = self.pair.radius(i)
        if ti.static(not self.with_wall):
            radius_min = ti.min(radius_min, self.pair.radius(j))
        if overlap > self.control.overlap_limit[0] * radius_min:
            ti.atomic_max(self.control.abort[0], ABORT_OVERLAP)
            ti.atomic_min(self.control.abort_particle[0], self.particles.id[i])

    @ti.func
    def _account(self, chunk, i, j, pose, normal, found, dt):
        if ti.static(self.with_wall):
            self.accounting.add_wall_contact(chunk, i, j, pose, normal, found, dt)
        else:
            self.accounting.add_particle_contact(chunk, i, j, pose, found, dt)

    @ti.func
    def distant_force(self, chunk, i, list_index, j, kinematics, pose, dt):
        """Force of a pair without overlap, for cohesion models that act at a distance.

        kinematics:  without overlap, see `Pair.separated`, at a distance within the range
        Returns:     struct of force, torques and losses, as of `PairForce.evaluate`

        Such a pair has no force of other models. The contact history of the cohesion model is kept until the
        model ends it or the distance exceeds its range; the histories of the other models end with the
        overlap.
        """
        constants = self.pair.constants(i, j)
        bodies = self.pair.bodies(i, j)
        history = self.histories.read(list_index)
        contact = normal_contact(bodies, kinematics, normal_time_step(dt, self.longest_time_step()))
        attraction, history_new = self.laws.cohesion.force(constants.cohesion, contact, history.cohesion)
        force = -attraction * kinematics.normal
        found = ti.Struct(
            force=force,
            torque=0.0 * force,
            torque_partner=0.0 * force,
            losses=no_losses(0.0 * attraction),
            viscous_power=0.0 * attraction,
        )
        if ti.static(self.laws.has_viscous_cohesion):
            history.cohesion = history_new
            viscous = self.pair_force.viscous_force(
                constants, contact, history, kinematics, self.pair.angular_velocities(i, j, pose)
            )
            found.force += viscous.force
            found.torque = viscous.torque
            found.torque_partner = viscous.torque_partner
            found.viscous_power = viscous.power
            if ti.static(self.has_flows):
                self._add_loss_heat(chunk, i, j, found, dt)
        energy_lost = 0.0 * dt
        is_kept = False
        if ti.static(self.keeps_bond):
            components = self.pair.structs.vector("cohesion", history_new)
            is_kept = components[0] > 0.0
            if ti.static(self.liquid):
                if not is_kept:
                    self.films.return_liquid(chunk, i, j, list_index)
            self.neighbors.history["cohesion"][list_index] = components
            if is_kept:
                self.neighbors.in_contact[list_index] = IN_CONTACT
                energy_lost = self._end_surface_contact(list_index, constants, bodies, dt)
        if not is_kept:
            energy_lost = self.histories.end(list_index, constants, bodies, dt)
        self._add_plastic_loss(chunk, i, j, energy_lost)
        return found

    @ti.func
    def _add_loss_heat(self, chunk, i, j, found, dt):
        """Add the losses [J] of a contact in this step to the heat of its partners."""
        lost = ti.cast(0.0, ti.f64)
        for k in ti.static(range(len(PAIR_LOSSES))):
            lost += ti.cast(found.losses[k], ti.f64)
        self.flows.add_loss(chunk, i, j, lost, self.with_wall)
        if ti.static(self.laws.has_viscous_cohesion):
            self.flows.add_viscous_loss(chunk, i, j, found.viscous_power, dt, self.with_wall)

    @ti.func
    def _add_plastic_loss(self, chunk, i, j, energy_lost):
        """Add the plastic work [J] of a contact that has ended to the losses, and to the heat of its
        partners."""
        self.histories.add_plastic_loss(chunk, j, energy_lost)
        if ti.static(self.has_flows):
            self.flows.add_loss(chunk, i, j, energy_lost, self.with_wall)

    @ti.func
    def _end_surface_contact(self, list_index, constants, bodies, dt):
        """End the contact of all models but cohesion.

        Returns the plastic work [J] of a contact whose overlap has ended in this step; 0 without the energy
        budget.
        """
        energy_lost = 0.0 * dt
        if ti.static(self.histories.energy_budget):
            energy_lost = self.histories.normal_loss(list_index, constants, bodies, dt)
        for slot in ti.static(self.slots_of_surface):
            self.neighbors.history[slot][list_index] = 0.0 * self.neighbors.history[slot][list_index]
        return energy_lost


class Accounting:
    """Losses, work, wall forces and number of contacts, added to the sums of a chunk.

    The work of a moving wall in a step has the mean of the forces at both ends of the step, with the velocity
    V of the wall at its middle:

        W = sum of dt/2 [F(t) . V(t - dt/2) + F(t) . V(t + dt/2)]

    The second term belongs to the next step: `losses_ahead` holds it, and the total without it is the work
    until t. The work of each measured wall keeps it, as the impulse of a wall has F(t) dt. The loss of a
    viscous force of the cohesion model is summed in the same way, with the present power in both terms: it
    does not begin with a small force, as contacts do.

    Reads:   position, walls, image_speed, in_contact, collision_edges
    Writes:  losses, losses_ahead, boundary_work, external_work, gravity_work, impulses, wall_force,
             collisions, virial, face_force
    """

    def __init__(self, state: State) -> None:
        self.features = state.plan.features
        self.particles = state.particles
        self.neighbors = state.neighbors
        self.walls = state.walls
        self.control = state.control
        self.real = state.backend.real
        self.geometry = state.built(WallGeometry)
        self.wall_of = state.built(Faces).wall_of
        self.box = state.built(DeviceBox)
        self.impulses = state.built(WallImpulses)
        self.controlled_walls = state.built(ForceControlledWalls)
        self.deformation = state.built(DeformingBox) if self.features.deforming_box else None
        self.list_shares = build_list_shares(state)
        self.to_grid = build_to_grid(state.backend.real)
        self.shift = state.parameter("shift", UNIT_FORCE)
        self.high_words_per_joule = state.parameter("per_unit", UNIT_ENERGY)
        self.longest_time_step = state.parameter("longest_time_step")
        self.loss_count = len(LOSSES)
        self.wall_work = LOSS_WALL_WORK
        summed = state.plan.features.energy_budget or state.plan.features.wall_forces
        self.has_power = summed and state.plan.features.moving_walls
        self.viscous_loss = LOSS_VISCOUS
        self.terms_ahead = terms_ahead(state.plan.features)
        self.ahead_count = len(self.terms_ahead)
        self.has_ahead = state.control.losses_ahead is not None
        self.collision_rows = state.capacities.wall_rows
        self.energy_classes = state.capacities.energy_classes

    @ti.func
    def add_particle_contact(self, chunk, i, j, pose, found, dt):
        """Add the losses of a contact; `found`: result of the pair force."""
        if ti.static(self.features.energy_budget):
            self._add_losses(chunk, j, found)
            self.add_viscous_loss(chunk, j, found.viscous_power, dt)
        self.add_moving_image(chunk, i, j, found.force, pose, dt)

    @ti.func
    def add_wall_contact(self, chunk, i, j, pose, normal, found, dt):
        """As `add_particle_contact`, with the work of the wall and the force on it."""
        if ti.static(self.features.energy_budget):
            self._add_losses(chunk, j, found)
            self.add_viscous_loss(chunk, j, found.viscous_power, dt)
        self.add_wall_force(chunk, i, j, pose, normal, found, dt)

    @ti.func
    def add_wall_force(self, chunk, i, j, pose, normal, found, dt):
        """Add the force [N] and torque [N m] of a wall on particle i to those of the wall, and their work."""
        power = 0.0 * dt
        power_ahead = 0.0 * dt
        if ti.static(self.has_power):
            power_ahead = self._wall_power(i, j, pose, pose + 1, normal, found)
            power = self._wall_power(i, j, pose, pose, normal, found)
        if ti.static(self.features.energy_budget and self.features.moving_walls):
            self._add_halves(chunk, j, self.wall_work, power, power_ahead, dt)
        if ti.static(self.features.force_controlled_walls):
            self.controlled_walls.add(chunk, self.wall_of(j), found.force)
        if ti.static(self.features.wall_forces):
            mean_power = 0.5 * (power + power_ahead)
            self.impulses.add(
                chunk, self.wall_of(j), i, pose, normal, found.force, found.torque, mean_power, dt
            )

    @ti.func
    def _add_losses(self, chunk, j, found):
        shares = self.list_shares(chunk, j)
        scale = self.high_words_per_joule()
        for k, loss in ti.static(enumerate(PAIR_LOSSES)):
            add_energy(self.control.losses, chunk, loss, self.loss_count, shares, scale * found.losses[k])

    @ti.func
    def add_viscous_loss(self, chunk, j, power, dt):
        """Add the loss of the viscous force of the cohesion model, of which `power` [W] is dissipated now."""
        if ti.static(self.features.viscous_cohesion):
            self._add_halves(chunk, j, self.viscous_loss, power, power, dt)

    @ti.func
    def _add_halves(self, chunk, j, term: ti.template(), power, power_ahead, dt):
        """Add half a step of a power [W], and half of the next step with the power then."""
        half = 0.5 * self.high_words_per_joule() * dt
        half_ahead = 0.5 * self.high_words_per_joule() * normal_time_step(dt, self.longest_time_step())
        shares = self.list_shares(chunk, j)
        work_ahead = half_ahead * power_ahead
        add_energy(self.control.losses, chunk, term, self.loss_count, shares, half * power)
        add_energy(self.control.losses, chunk, term, self.loss_count, shares, work_ahead)
        place = ti.static(self.terms_ahead.index(term))
        add_energy(self.control.losses_ahead, chunk, place, self.ahead_count, shares, work_ahead)

    @ti.func
    def _wall_power(self, i, j, pose, step, normal, found):
        """Power [W] of prescribed wall motion and surface velocity on particle i.

        step:  index of the step at whose middle the velocity is
        """
        velocity = self.geometry.prescribed_velocity(-1 - j, pose, step, self.particles.position[i])
        angular_velocity = self.walls.angular_velocity[step, self.wall_of(j)]
        power = found.force.dot(ti.cast(velocity, self.real))
        power += found.torque.dot(ti.cast(angular_velocity, self.real))
        if ti.static(self.features.surface_velocity):
            power += found.force.dot(self.geometry.surface_velocity(-1 - j, step, normal))
        return power

    @ti.func
    def add_moving_image(self, chunk, i, j, force, pose, dt):
        """Add the work of the image of j in a sheared box, or the force [N] on i to the sums of a deforming
        one."""
        if ti.static(self.features.energy_budget and self.features.lees_edwards):
            self.add_boundary_work(chunk, i, j, force, pose, dt)
        if ti.static(self.features.deforming_box):
            self.deformation.add(chunk, i, j, force, pose)

    @ti.func
    def add_boundary_work(self, chunk, i, j, force, pose, dt):
        """Add the work of the moving image of j on a pair [J].

            W = F_ij . (velocity of the image relative to its original) dt, once per pair

        with the force on i rounded as in the sum of forces: its last bits depend on the instructions that
        computed it.
        """
        rounded = self.to_grid(force, self.shift())
        work = self.high_words_per_joule() * dt * rounded.dot(self.box.image_velocity(i, j, pose))
        add_energy(self.control.boundary_work, chunk, 0, 1, self.list_shares(chunk, j), work)

    @ti.func
    def clear_ahead(self, chunk):
        """Clear the parts of the next step, before the forces at its end are added."""
        if ti.static(self.has_ahead):
            self.control.losses_ahead[chunk] = ti.Vector.zero(ti.i64, ti.static(2 * self.ahead_count))

    @ti.func
    def carry(self, chunk):
        """Move the carries of the energies, once per step and chunk."""
        if ti.static(self.features.energy_budget):
            self.control.losses[chunk] = carried(self.control.losses[chunk], self.loss_count)
            if ti.static(self.features.periodic != "none"):
                self.control.boundary_work[chunk] = carried(self.control.boundary_work[chunk], 1)
            if ti.static(self.features.external_forces):
                self.control.external_work[chunk] = carried(self.control.external_work[chunk], 1)
            if ti.static(self.features.changing_gravity):
                self.control.gravity_work[chunk] = carried(self.control.gravity_work[chunk], 1)

    @ti.func
    def count_collision(self, chunk, list_index, j, bodies, overlap_rate, with_wall: ti.template()):
        """Count a contact that begins, by its impact energy; without collision energies nothing.

            E = m_eff v_n^2 / 2,     v_n: approach velocity half a step before the first force

        It precedes `ContactHistory.write`, which marks the contact. The counts are integers, so that they do
        not depend on threads and ranks.
        """
        if ti.static(self.features.collision_energies):
            if self.neighbors.in_contact[list_index] == NO_CONTACT:
                velocity = ti.cast(ti.max(overlap_rate, 0.0), ti.f64)
                number = 0
                if ti.static(with_wall):
                    number = self.energy_classes
                energy = 0.5 * ti.cast(bodies.mass_eff, ti.f64) * (velocity * velocity)
                for edge in range(self.energy_classes - 1):
                    number += ti.cast(energy >= self.control.collision_edges[edge], ti.i32)
                shares = ti.cast(self.list_shares(chunk, j), ti.i64)
                ti.atomic_add(self.control.collisions[chunk % self.collision_rows, number][0], shares)


def build_end_ahead(state: State) -> Any:
    """Kernel (withdraws): clear the parts of the next step in all chunks, whose number may change.

    withdraws:  1 if there will be another force evaluation before the next step, which counts them again

    Writes:  losses_ahead, losses
    """
    control = state.control
    chunks = state.capacities.chunks
    terms = terms_ahead(state.plan.features)
    ahead_count = len(terms)
    # the low words of all terms precede the high words
    words = [(term, place) for place, term in enumerate(terms)]
    words += [(len(LOSSES) + term, ahead_count + place) for term, place in words]

    @ti.func
    def end(chunk, withdraws):
        if withdraws == 1:
            for word, ahead in ti.static(words):
                control.losses[chunk][word] = control.losses[chunk][word] - control.losses_ahead[chunk][ahead]
        control.losses_ahead[chunk] = ti.Vector.zero(ti.i64, 2 * ahead_count)

    threads = thread_count(chunks)
    end_each = build_tasks_of_thread(end, chunks)

    @ti.kernel
    def end_ahead(withdraws: ti.i32):
        for thread in range(threads):
            end_each(thread, chunks, withdraws)

    return end_ahead


def collision_counts(state: State) -> dict[str, np.ndarray]:
    """Numbers of collisions since the start by kind of the partner, "particle" or "wall": arrays (classes,)
    int64.

    The first class is below the smallest edge, the last one above the largest. Empty without collision
    energies.
    """
    if state.control.collisions is None:
        return {}
    words = state.ranks.total(state.control.collisions.to_numpy())
    counts = [exact_totals(words[:, column], np.array([1.0 / SHARES]))[0] for column in range(words.shape[1])]
    by_kind = np.rint(counts).astype(np.int64).reshape(2, -1)
    kinds = ("particle", "wall") if state.plan.features.walls else ("particle",)
    return dict(zip(kinds, by_kind, strict=False))
