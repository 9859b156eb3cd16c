"""One contact of a particle with another particle or a wall, evaluated on its own.

`build_contact` gathers what `pair.py` needs, evaluates the force, writes the contact history and adds the
losses of the contact to the accounting. All wall contacts take this path, and all particle contacts if each
particle is a chunk: on a GPU, and on a CPU with up to 64 particles or a normal model that is not branch-free
(`chunk_size` of the plan). Otherwise `batch.py` evaluates the particle contacts, many at a time, and shares
the parts of this file.
"""

from typing import Any

import numpy as np

from granflow.engine.box import DeviceBox
from granflow.engine.codes import ABORT_OVERLAP
from granflow.engine.contact_structs import build_slot_vector
from granflow.engine.fields import build_tasks_of_thread, thread_count
from granflow.engine.flows import Flows
from granflow.engine.history import (
    IN_CONTACT,
    NO_CONTACT,
    ContactHistory,
    HistoryTransfer,
    cohesive_contact,
    transfers_history,
)
from granflow.engine.liquid import build_form_bridge, build_return_liquid
from granflow.engine.pair import (
    PAIR_LOSSES,
    build_effective,
    build_in_range,
    build_pair_constants,
    build_pair_force,
    build_pair_kinematics,
    no_losses,
    normal_contact,
    normal_time_step,
)
from granflow.engine.state import State
from granflow.engine.sums import SHARES, add_energy, build_list_shares, build_to_grid, carried, exact_totals
from granflow.engine.wall_dynamics import ForceControlledWalls, WallImpulses
from granflow.engine.walls import Faces, WallGeometry
from granflow.kernel_language import ti
from granflow.plan.sum_units import (
    LOSS_WALL_WORK,
    LOSSES,
    UNIT_ENERGY,
    UNIT_FORCE,
)


def build_contact(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, list index, j, pose, dt) -> (force [N], torque [N m]) on i of one
    contact.

    with_wall:  True for walls (j < 0), False for particles

    Three cases: the pair overlaps; a cohesion model acts between the separated surfaces; or there is no
    contact, and a contact that has existed so far ends. Its history is then cleared, unless another face of
    the walls has the contact now, and its plastic work is added to the losses.

    Reads:   position, velocity, velocity_synchronized, angular_velocity, radius, mass, history, walls
    Writes:  history, in_contact, losses, boundary_work, impulses, collisions, wall_force, liquid_film, abort,
             abort_particle
    """
    transfers = with_wall and transfers_history(state)
    pair_kinematics = build_pair_kinematics(state, with_wall)
    effective = build_effective(state, with_wall)
    angular_velocities_of = _build_angular_velocities(state, with_wall)
    check_overlap = _build_check_overlap(state, with_wall)
    pair_constants = build_pair_constants(state)
    in_range = build_in_range(state)
    acts_at_distance = state.plan.laws.acts_at_distance
    distant_contact = _build_distant_contact(state, with_wall) if acts_at_distance else None
    transfer = state.built(HistoryTransfer)
    histories = state.built(ContactHistory)
    pair_force = build_pair_force(state.plan, False)
    add_to_accounting = build_add_to_accounting(state, with_wall)
    longest_time_step = state.parameter("longest_time_step")
    count_collision = build_count_collision(state, with_wall)
    liquid = state.plan.features.liquid_transfer
    form_bridge = build_form_bridge(state) if liquid else None
    return_liquid = build_return_liquid(state) if liquid else None
    has_flows = len(state.plan.laws.flows) > 0
    flows = state.built(Flows) if has_flows else None

    @ti.func
    def contact(chunk, i, list_index, j, pose, dt):
        force = 0.0 * state.particles.velocity[i]
        torque = 0.0 * state.particles.velocity[i]
        kinematics = pair_kinematics(i, j, pose, dt)
        bodies = effective(i, j)
        constants = pair_constants(i, j)
        if kinematics.overlap > 0.0:
            check_overlap(i, j, kinematics.overlap)
            if ti.static(transfers):
                transfer.acquire(i, list_index, j, pose)
            angular_velocities = angular_velocities_of(i, j, pose)
            history = histories.read(list_index)
            if ti.static(liquid):
                history.cohesion = form_bridge(
                    chunk, i, j, constants, bodies, kinematics.overlap, history.cohesion
                )
            found = pair_force(
                constants, bodies, kinematics, angular_velocities, history, dt, longest_time_step()
            )
            force = found.force
            torque = found.torque
            count_collision(chunk, list_index, j, bodies, kinematics.overlap_rate_half)
            histories.write(list_index, found.history)
            add_to_accounting(chunk, i, j, pose, kinematics.normal, found, dt)
            if ti.static(has_flows):
                touching = normal_contact(bodies, kinematics, normal_time_step(dt, longest_time_step()))
                flows.add(chunk, i, j, constants, touching, with_wall)
        elif in_range(i, j, kinematics.overlap):
            if ti.static(acts_at_distance):
                force = distant_contact(chunk, i, list_index, j, pose, kinematics, dt)
        else:
            energy_lost = 0.0 * dt
            released = 0
            if ti.static(transfers):
                released = transfer.release(i, list_index, j, pose)
            if released == 0:
                if ti.static(liquid):
                    return_liquid(chunk, i, j, list_index)
                energy_lost = histories.end(list_index, constants, bodies, dt)
            histories.add_plastic_loss(chunk, j, energy_lost)
        return force, torque

    return contact


def _build_angular_velocities(state: State, with_wall: bool) -> Any:
    """Device function (i, j, pose) -> struct of the angular velocities [rad/s] of i and of its partner.

    Reads:  angular_velocity of particles and walls
    """
    particles = state.particles
    features = state.plan.features
    real = state.backend.real
    wall_of = state.built(Faces).wall_of

    @ti.func
    def angular_velocities_of(i, j, pose):
        first = 0.0 * particles.velocity[i]
        partner = 0.0 * particles.velocity[i]
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
    particles = state.particles
    control = state.control
    max_overlap = state.parameter("max_overlap")

    @ti.func
    def check_overlap(i, j, overlap):
        radius_min = particles.radius[i]
        if ti.static(not with_wall):
            radius_min = ti.min(radius_min, particles.radius[j])
        if overlap > max_overlap() * radius_min:
            ti.atomic_max(control.abort[0], ABORT_OVERLAP)
            ti.atomic_min(control.abort_particle[0], particles.id[i])

    return check_overlap


# Attraction of pairs without overlap, for cohesion models that act at a distance
#
# Such a pair has no normal, tangential or rolling force. The contact history of the cohesion model is kept
# until the model ends it or the distance exceeds its range; the histories of the other models end with the
# overlap.


def _build_distant_contact(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, list index, j, pose, kinematics, dt): force [N] on i of a separated
    pair.

    Reads:   as `build_contact`
    Writes:  as `build_contact`
    """
    distant_force = build_distant_force(state, with_wall)
    transfers = with_wall and transfers_history(state)
    transfer = state.built(HistoryTransfer)
    add_to_accounting = build_add_to_accounting(state, with_wall)

    @ti.func
    def distant_contact(chunk, i, list_index, j, pose, kinematics, dt):
        if ti.static(transfers):
            transfer.acquire(i, list_index, j, pose)
        attraction = distant_force(chunk, i, list_index, j, kinematics.overlap, dt)
        force = -attraction * kinematics.normal
        found = ti.Struct(force=force, torque=0.0 * force, losses=no_losses(0.0 * attraction))
        add_to_accounting(chunk, i, j, pose, kinematics.normal, found, dt)
        return force

    return distant_contact


def build_distant_force(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, list index, j, overlap, dt) -> attraction [N] of a pair without
    overlap.

    with_wall:  True for walls (j < 0), False for particles
    overlap:    minus the distance of the surfaces [m], above minus the range

    Reads:   radius, mass, history, pair_constants, law_parameters
    Writes:  history, in_contact, losses, liquid_film
    """
    laws = state.plan.laws
    neighbors = state.neighbors
    keeps_history = "cohesion" in neighbors.history
    vector_of = build_slot_vector(laws, "cohesion") if keeps_history else None
    histories = state.built(ContactHistory)
    effective = build_effective(state, with_wall)
    pair_constants = build_pair_constants(state)
    end_surface_contact = _build_end_surface_contact(state)
    liquid = state.plan.features.liquid_transfer
    return_liquid = build_return_liquid(state) if liquid else None

    @ti.func
    def distant_force(chunk, i, list_index, j, overlap, dt):
        constants = pair_constants(i, j)
        bodies = effective(i, j)
        history = histories.read(list_index)
        contact = cohesive_contact(bodies, overlap, dt)
        attraction, history_new = laws.cohesion.force(constants.cohesion, contact, history.cohesion)
        energy_lost = 0.0 * dt
        is_kept = False
        if ti.static(keeps_history):
            components = vector_of(history_new)
            is_kept = components[0] > 0.0
            if ti.static(liquid):
                if not is_kept:
                    return_liquid(chunk, i, j, list_index)
            neighbors.history["cohesion"][list_index] = components
            if is_kept:
                neighbors.in_contact[list_index] = IN_CONTACT
                energy_lost = end_surface_contact(list_index, constants, bodies, dt)
        if not is_kept:
            energy_lost = histories.end(list_index, constants, bodies, dt)
        histories.add_plastic_loss(chunk, j, energy_lost)
        return attraction

    return distant_force


def _build_end_surface_contact(state: State) -> Any:
    """Device function (list index, constants, bodies, dt): end the contact of all models but cohesion.

    Returns the plastic work [J] of a contact whose overlap has ended in this step; 0 without the energy
    budget.

    Writes:  history
    """
    neighbors = state.neighbors
    energy_budget = state.plan.features.energy_budget
    histories = state.built(ContactHistory)
    names = [name for name in neighbors.history if name != "cohesion"]

    @ti.func
    def end_surface_contact(list_index, constants, bodies, dt):
        energy_lost = 0.0 * dt
        if ti.static(energy_budget):
            energy_lost = histories.normal_loss(list_index, constants, bodies, dt)
        for name in ti.static(names):
            neighbors.history[name][list_index] = 0.0 * neighbors.history[name][list_index]
        return energy_lost

    return end_surface_contact


# Losses, work and wall forces of one contact
#
# The work of a moving wall in a step has the mean of the forces at both ends of the step, with the velocity
# V of the wall at its middle:
#
#     W = sum of dt/2 [F(t) . V(t - dt/2) + F(t) . V(t + dt/2)]
#
# The second term belongs to the next step: `wall_work_ahead` holds it, and the total without it is the work
# until t.


def build_add_to_accounting(state: State, with_wall: bool) -> Any:
    """Device function (chunk, i, j, pose, normal, result of the pair force, dt): losses, work and wall
    forces.

    Writes:  losses, wall_work_ahead, boundary_work, impulses, wall_force
    """
    features = state.plan.features
    wall_of = state.built(Faces).wall_of
    wall_power = _build_wall_power(state)
    control = state.control
    list_shares = build_list_shares(state)
    add_boundary_work = build_boundary_work(state)
    high_words_per_joule = state.parameter("per_unit", UNIT_ENERGY)
    longest_time_step = state.parameter("longest_time_step")
    moving = with_wall and features.moving_walls
    measured = with_wall and features.wall_forces
    loss_count = len(LOSSES)
    force_controlled = with_wall and features.force_controlled_walls
    impulses = state.built(WallImpulses)
    controlled_walls = state.built(ForceControlledWalls)

    @ti.func
    def add_losses(chunk, shares, found):
        scale = high_words_per_joule()
        for k, loss in ti.static(enumerate(PAIR_LOSSES)):
            add_energy(control.losses, chunk, loss, loss_count, shares, scale * found.losses[k])

    @ti.func
    def add_wall_work(chunk, i, j, pose, normal, found, dt):
        half = 0.5 * high_words_per_joule() * dt
        half_ahead = 0.5 * high_words_per_joule() * normal_time_step(dt, longest_time_step())
        shares = list_shares(chunk, j)
        work_ahead = half_ahead * wall_power(i, j, pose, pose + 1, normal, found)
        work = half * wall_power(i, j, pose, pose, normal, found)
        add_energy(control.losses, chunk, LOSS_WALL_WORK, loss_count, shares, work)
        add_energy(control.losses, chunk, LOSS_WALL_WORK, loss_count, shares, work_ahead)
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
            controlled_walls.add(chunk, wall_of(j), found.force)
        if ti.static(measured):
            impulses.add(chunk, wall_of(j), i, normal, found.force, found.torque, dt)

    return add_to_accounting


def _build_wall_power(state: State) -> Any:
    """Device function: power of prescribed wall motion and surface velocity on particle i [W].

    Arguments: i, j, pose, index of the step at whose middle the velocity is, normal, result of the pair
    force.

    Reads:  position, velocities of walls
    """
    geometry = state.built(WallGeometry)
    wall_of = state.built(Faces).wall_of
    real = state.backend.real

    @ti.func
    def wall_power(i, j, pose, step, normal, found):
        velocity = geometry.prescribed_velocity(-1 - j, pose, step, state.particles.position[i])
        angular_velocity = state.walls.angular_velocity[step, wall_of(j)]
        power = found.force.dot(ti.cast(velocity, real)) + found.torque.dot(ti.cast(angular_velocity, real))
        if ti.static(state.plan.features.surface_velocity):
            power += found.force.dot(geometry.surface_velocity(-1 - j, step, normal))
        return power

    return wall_power


def build_boundary_work(state: State) -> Any:
    """Device function (chunk, i, j, force on i, pose, dt): add the work of the moving image of j on a
    pair [J].

        W = F_ij . (velocity of the image relative to its original) dt, once per pair

    with the force rounded as in the sum of forces: its last bits depend on the instructions that computed it.

    Writes:  boundary_work
    """
    list_shares = build_list_shares(state)
    box = state.built(DeviceBox)
    control = state.control
    high_words_per_joule = state.parameter("per_unit", UNIT_ENERGY)
    shift = state.parameter("shift", UNIT_FORCE)
    to_grid = build_to_grid(state.backend.real)

    @ti.func
    def add_boundary_work(chunk, i, j, force, pose, dt):
        rounded = to_grid(force, shift())
        work = high_words_per_joule() * dt * rounded.dot(box.image_velocity(i, j, pose))
        add_energy(control.boundary_work, chunk, 0, 1, list_shares(chunk, j), work)

    return add_boundary_work


def build_clear_wall_work_ahead(state: State) -> Any:
    """Device function (chunk): the work of the next step, before the forces at its end are added.

    Writes:  wall_work_ahead
    """
    ahead = state.control.wall_work_ahead
    exists = state.control.wall_work_ahead is not None

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
    control = state.control
    chunks = state.capacities.chunks
    high = len(LOSSES) + LOSS_WALL_WORK

    @ti.func
    def end(chunk, withdraws):
        if withdraws == 1:
            control.losses[chunk][LOSS_WALL_WORK] = (
                control.losses[chunk][LOSS_WALL_WORK] - control.wall_work_ahead[chunk][0]
            )
            control.losses[chunk][high] = control.losses[chunk][high] - control.wall_work_ahead[chunk][1]
        control.wall_work_ahead[chunk] = ti.Vector.zero(ti.i64, 2)

    threads = thread_count(chunks)
    end_each = build_tasks_of_thread(end, chunks)

    @ti.kernel
    def end_wall_work(withdraws: ti.i32):
        for thread in range(threads):
            end_each(thread, chunks, withdraws)

    return end_wall_work


def build_carry_sums(state: State) -> Any:
    """Device function (chunk): move the carries of the energies, once per step and chunk.

    Writes:  losses, boundary_work, external_work
    """
    control = state.control
    features = state.plan.features
    loss_count = len(LOSSES)

    @ti.func
    def carry_sums(chunk):
        if ti.static(features.energy_budget):
            control.losses[chunk] = carried(control.losses[chunk], loss_count)
            if ti.static(features.periodic != "none"):
                control.boundary_work[chunk] = carried(control.boundary_work[chunk], 1)
            if ti.static(features.external_forces):
                control.external_work[chunk] = carried(control.external_work[chunk], 1)

    return carry_sums


# Numbers of collisions by impact energy: each contact counts once, in the step in which it begins
#
#     E = m_eff v_n^2 / 2,     v_n: approach velocity half a step before the first force
#
# The counts are integers, so that they do not depend on threads and ranks.


def build_count_collision(state: State, with_wall: bool) -> Any:
    """Device function (chunk, list index, j, bodies, overlap rate at the half step): count a contact that
    begins.

    Without collision energies it does nothing. It precedes `ContactHistory.write`, which marks the contact.

    Reads:   in_contact, collision_edges
    Writes:  collisions
    """
    control = state.control
    neighbors = state.neighbors
    list_shares = build_list_shares(state)
    wanted = state.plan.features.collision_energies
    rows = state.capacities.wall_rows
    classes = state.capacities.energy_classes
    first = classes if with_wall else 0

    @ti.func
    def count_collision(chunk, list_index, j, bodies, overlap_rate):
        if ti.static(wanted):
            if neighbors.in_contact[list_index] == NO_CONTACT:
                velocity = ti.cast(ti.max(overlap_rate, 0.0), ti.f64)
                number = first
                energy = 0.5 * ti.cast(bodies.mass_eff, ti.f64) * (velocity * velocity)
                for edge in range(classes - 1):
                    number += ti.cast(energy >= control.collision_edges[edge], ti.i32)
                ti.atomic_add(
                    control.collisions[chunk % rows, number][0], ti.cast(list_shares(chunk, j), ti.i64)
                )

    return count_collision


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
