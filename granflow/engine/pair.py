"""One pair of partners in contact: its kinematics, its constants and its force.

A pair is a particle i and a partner j, which is another particle, or a wall or triangle if j < 0 (see
`walls.Faces.wall_of`). The state gives

    kinematics   overlap, normal, relative velocity and lever arms (`build_pair_kinematics`)
    bodies       effective radius, mass and inertia (`build_effective`)
    constants    numbers of the contact models for the two materials (`build_pair_constants`)

and `build_pair_force` turns these and the history of the contact into forces, torques, the new history and
the losses: it calls the normal and the cohesion model of the scene, then those that act on the surfaces in
the order of `contact.law.SLOTS`.

`build_sphere_kinematics` and `build_pair_force` are functions of values, which read and write no field, so
that the scalar contact loop (`contact.py`) and the batched one (`batch.py`) share them. If the partners are
exchanged, each of their results is bit-identical or has exactly the opposite sign.
"""

from typing import Any

from granflow.contact.law import SLOTS, in_contact_plane
from granflow.contact.registry import ContactLaws
from granflow.engine.box import DeviceBox
from granflow.engine.contact_structs import build_constants, member, set_member
from granflow.engine.state import State
from granflow.engine.walls import Faces, JoinedWalls, WallGeometry
from granflow.geometry.sphere import sphere_inertia
from granflow.kernel_language import ti
from granflow.plan.plan import Plan
from granflow.plan.sum_units import LOSS_DAMPING, LOSSES

# Kinematics


def build_pair_kinematics(state: State, with_wall: bool) -> Any:
    """Device function (i, j, pose, dt) -> kinematics of a candidate pair, read from the state.

    with_wall:  True for walls; separate functions, so that the loops contain no branch between the two kinds
                of partner

    Returns the struct of `build_sphere_kinematics`; without contact, the overlap is not above 0, and only
    models that act at a distance get its value and the normal.

    Reads:  position, velocity, velocity_synchronized, radius, walls, image_offset, image_speed
    """
    return _build_wall_kinematics(state) if with_wall else _build_particle_kinematics(state)


def _build_particle_kinematics(state: State) -> Any:
    """`build_pair_kinematics` for two particles."""
    particles = state.particles
    features = state.plan.features
    real = state.backend.real
    sphere_kinematics = build_sphere_kinematics(state.plan)
    overlaps = build_overlaps(real)
    box = state.built(DeviceBox)
    acts_at_distance = state.plan.laws.acts_at_distance

    @ti.func
    def particle_kinematics(i, j, pose, dt):
        radius = particles.radius[i]
        radius_partner = particles.radius[j]
        found = no_contact(-radius, particles.velocity[i])
        branch = ti.cast(box.minimum_image(particles.position[i], particles.position[j], pose), real)
        if overlaps(branch.dot(branch), radius + radius_partner):
            velocity_rel_half = particles.velocity[i] - particles.velocity[j] - box.image_velocity(i, j, pose)
            velocity_rel = velocity_rel_half
            if ti.static(features.rate_dependent):
                velocity_rel = (
                    particles.velocity_synchronized[i]
                    - particles.velocity_synchronized[j]
                    - box.image_velocity(i, j, pose)
                )
            found = sphere_kinematics(radius, radius_partner, branch, velocity_rel_half, velocity_rel, dt)
        elif ti.static(acts_at_distance):
            distance = ti.sqrt(branch.dot(branch))
            found.overlap = ti.min(radius + radius_partner - distance, 0.0)
            found.normal = 1.0 / distance * branch
        return found

    return particle_kinematics


def _build_wall_kinematics(state: State) -> Any:
    """`build_pair_kinematics` for a particle and a wall: the contact point halves the overlap; no lever arm
    of j.

    Velocities are those of the half step; normal_half and the velocity of the wall at the contact point are
    as well.
    """
    particles = state.particles
    features = state.plan.features
    real = state.backend.real
    geometry = state.built(WallGeometry)
    acts_at_distance = state.plan.laws.acts_at_distance
    joined_walls = state.built(JoinedWalls)

    @ti.func
    def wall_kinematics(i, j, pose, dt):
        radius = particles.radius[i]
        face = -1 - j
        gap, direction = joined_walls.contact(i, j, pose)
        found = no_contact(ti.cast(radius - gap, real), particles.velocity[i])
        found.arm = radius - 0.5 * found.overlap
        if ti.static(acts_at_distance):
            found.normal = ti.cast(direction, real)
        if found.overlap > 0.0:
            position = particles.position[i]
            velocity = particles.velocity[i]
            normal_half = geometry.normal_half(face, pose, position, velocity, direction, dt)
            found.normal = ti.cast(direction, real)
            found.normal_half = ti.cast(normal_half, real)
            wall_velocity = geometry.velocity_half(
                face, pose, position - found.arm * normal_half, velocity, dt
            )
            found.velocity_rel_half = velocity - ti.cast(wall_velocity, real)
            found.overlap_rate_half = -found.velocity_rel_half.dot(found.normal_half)
            found.overlap_rate = -found.velocity_rel_half.dot(found.normal)
            if ti.static(features.rate_dependent):
                wall_velocity_now = ti.cast(
                    geometry.velocity(face, pose, position - found.arm * direction), real
                )
                found.overlap_rate = -(particles.velocity_synchronized[i] - wall_velocity_now).dot(
                    found.normal
                )
            found.arm_half = found.arm + 0.25 * dt * found.overlap_rate_half
            if ti.static(features.surface_velocity):  # it does not turn the normal
                found.velocity_rel_half -= geometry.surface_velocity(face, pose, found.normal_half)
        return found

    return wall_kinematics


@ti.func
def no_contact(overlap, vector):
    """Kinematics of a pair without contact; `vector` has the type of the 3-vectors."""
    zero = 0.0 * vector
    nothing = 0.0 * overlap
    return ti.Struct(
        overlap=overlap,
        normal=zero,
        normal_half=zero,
        velocity_rel_half=zero,
        overlap_rate_half=nothing,
        overlap_rate=nothing,
        arm=nothing,
        arm_partner=nothing,
        arm_half=nothing,
        arm_partner_half=nothing,
    )


ROUNDING = {ti.f64: 2.0**-50, ti.f32: 2.0**-21}
"""Eight units in the last place of 1: pairs with a relative overlap below this are not in contact; no overlap
is 0."""


def build_overlaps(real: Any) -> Any:
    """Device function (squared distance [m2], sum of radii [m]): true if the overlap is above rounding.

    The field `in_contact` is another thing: the state of a neighbor-list entry, see `history.py`.

    real:  Taichi type of the arguments
    """
    ratio = 1.0 - ROUNDING[real]

    @ti.func
    def overlaps(distance_squared, contact_distance):
        return distance_squared < ratio * (contact_distance * contact_distance)

    return overlaps


def build_sphere_kinematics(plan: Plan) -> Any:
    """Device function: kinematics of two spheres in contact, relative to the first.

    Arguments: radii [m], `branch` vector b from the second to the first [m], relative velocity v at the half
    step and now [m/s], dt [s]. Returns a struct of overlap [m]; normal n; normal_half p, see
    `contact/law.py`; relative velocity at the half step [m/s]; overlap rate at the half step and now
    [m/s] (positive if approaching); and the lever arms of both, now and at the half step [m]: the contact
    point halves the overlap.

        b(t - dt/2) = b - v dt/2    =>    p = n - dt/(2 |b|) (v - (v . n) n),    overlap rate  -v . p

    Without a dashpot the overlap rate of the normal models is -v . n, of which no model accumulates an error.
    """
    rate_dependent = plan.features.rate_dependent

    @ti.func
    def sphere_kinematics(radius, radius_partner, branch, velocity_rel_half, velocity_rel, dt):
        distance = ti.sqrt(branch.dot(branch))
        inverse = 1.0 / distance
        contact_distance = radius + radius_partner
        overlap = contact_distance - distance
        normal = inverse * branch
        approach = -velocity_rel_half.dot(normal)
        rate = approach
        if ti.static(rate_dependent):
            rate = -velocity_rel.dot(normal)
        normal_half = normal - (0.5 * dt * inverse) * (velocity_rel_half + approach * normal)
        arm = radius - 0.5 * overlap
        arm_partner = radius_partner - 0.5 * overlap
        growth = 0.25 * dt * approach  # half of the overlap grew by this in half a step
        return ti.Struct(
            overlap=overlap,
            normal=normal,
            normal_half=normal_half,
            velocity_rel_half=velocity_rel_half,
            overlap_rate_half=-velocity_rel_half.dot(normal_half),
            overlap_rate=rate,
            arm=arm,
            arm_partner=arm_partner,
            arm_half=arm + growth,
            arm_partner_half=arm_partner + growth,
        )

    return sphere_kinematics


# Bodies and constants


def build_effective(state: State, with_wall: bool) -> Any:
    """Device function (i, j) -> struct `bodies`: effective radius [m], mass [kg] and inertia [kg m2] of a
    pair.

    a b / (a + b) for two particles, the value of the particle for a wall; a fixed particle has a very large
    mass.

    Reads:  radius, mass, fixed
    """
    particles = state.particles
    contact_mass = build_contact_mass(state)

    @ti.func
    def effective(i, j):
        radius = particles.radius[i]
        mass = contact_mass(i)
        bodies = ti.Struct(radius_eff=radius, mass_eff=mass, inertia_eff=sphere_inertia(mass, radius))
        if ti.static(not with_wall):
            bodies = sphere_bodies(radius, mass, particles.radius[j], contact_mass(j))
        return bodies

    return effective


@ti.func
def sphere_bodies(radius, mass, radius_partner, mass_partner):
    """Struct `bodies` of two spheres."""
    inertia = sphere_inertia(mass, radius)
    inertia_partner = sphere_inertia(mass_partner, radius_partner)
    return ti.Struct(
        radius_eff=effective_value(radius, radius_partner),
        mass_eff=effective_value(mass, mass_partner),
        inertia_eff=effective_value(inertia, inertia_partner),
    )


@ti.func
def effective_value(one, other):
    """Effective radius, mass or inertia of a pair: a b / (a + b)."""
    return one * other / (one + other)


FIXED_MASS_FACTOR = 2.0**60
"""Mass factor of a fixed particle in contacts, as of an infinite mass: the term of its partner's mass is
below rounding, also in f64."""


def build_contact_mass(state: State) -> Any:
    """Device function (i): mass [kg] of a particle in its contacts, FIXED_MASS_FACTOR times as large if it
    is fixed.

    A sphere of a clump has the mass of the clump, as in LIGGGHTS and MercuryDPM.

    Reads:  mass, fixed, clump_mass
    """
    particles = state.particles
    real = state.backend.real
    mass_field = particles.clump_mass if state.plan.features.clumps else particles.mass

    @ti.func
    def contact_mass(i):
        mass = mass_field[i]
        if ti.static(state.plan.features.fixed_particles):
            mass *= ti.select(particles.fixed[i] == 1, ti.cast(FIXED_MASS_FACTOR, real), ti.cast(1.0, real))
        return mass

    return contact_mass


def build_pair_constants(state: State) -> Any:
    """Device function (i, j) -> struct of the constants of the contact laws for particle i and partner j.

    Reads:  pair_constants, law_parameters, material of particles and walls
    """
    control = state.control
    constants_of = build_constants(state.plan.laws)
    pair_number = build_pair_number(state)

    @ti.func
    def pair_constants(i, j):
        return constants_of(control.pair_constants[pair_number(i, j)], control.law_parameters[0])

    return pair_constants


def build_pair_number(state: State) -> Any:
    """Device function (i, j): row of the pair constants for particle i and partner j.

        material of i * material count + material of j

    Reads:  material of particles and walls
    """
    plan = state.plan
    particles = state.particles
    walls = state.walls
    features = plan.features
    wall_of = state.built(Faces).wall_of
    material_count = state.parameter("material_count")

    @ti.func
    def pair_number(i, j):
        number = 0
        if ti.static(not features.one_material):
            number = particles.material[i] * material_count()
            if j >= 0:
                number += particles.material[j]
        if ti.static(plan.features.walls):
            if j < 0:
                number += walls.material[wall_of(j)]
        return number

    return pair_number


def build_in_range(state: State) -> Any:
    """Device function (i, j, overlap): true if the cohesion model acts at this overlap, which may be
    negative.

    Reads:  law_parameters
    """
    acts_at_distance = state.plan.laws.acts_at_distance
    pair_constants = build_pair_constants(state)

    @ti.func
    def in_range(i, j, overlap):
        found = overlap > 0.0
        if ti.static(acts_at_distance):
            found = overlap > -pair_constants(i, j).cohesion.range
        return found

    return in_range


# Force

PAIR_LOSSES = (
    *dict.fromkeys(LOSSES.index(slot.loss) for slot in SLOTS.values() if slot.on_surface),
    LOSS_DAMPING,
)
"""Terms of the energy budget that a pair force adds to, in the order of its vector `losses`."""


def build_pair_force(plan: Plan, is_prepared: bool) -> Any:
    """Device function: force and torques of one contact in a step.

    is_prepared:  True if `NormalLaw.prepare` has been evaluated before

    Arguments: pair constants; bodies, a struct of the effective radius [m], mass [kg] and inertia [kg m2];
    kinematics of `build_sphere_kinematics`; angular_velocities, a struct of those of the first and the
    partner [rad/s]; history; dt, and the longest time step of the run [s].

    Returns a struct of the force on the first [N], the torques on both [N m], the history, and the losses: a
    vector of the energies [J] dissipated in this step, in the order of PAIR_LOSSES.
    """
    rotation = plan.features.rotation
    normal_force_of = build_normal_force(plan.laws, is_prepared)
    surface_contact = build_surface_contact(plan)
    damping = PAIR_LOSSES.index(LOSS_DAMPING)
    surface_laws = [
        (slot, law, PAIR_LOSSES.index(LOSSES.index(SLOTS[slot].loss))) for slot, law in plan.laws.on_surface
    ]

    @ti.func
    def pair_force(constants, bodies, kinematics, angular_velocities, history, dt, longest_time_step):
        contact = normal_contact(bodies, kinematics, normal_time_step(dt, longest_time_step))
        normal_force, load, viscous, history_new = normal_force_of(constants, contact, history)
        force = normal_force * kinematics.normal
        torque = 0.0 * force
        torque_partner = 0.0 * force
        losses = no_losses(0.0 * load)
        losses[damping] = viscous * kinematics.overlap_rate * dt
        if ti.static(rotation):
            surface = surface_contact(
                constants,
                contact,
                load,
                history_new,
                bodies,
                kinematics,
                angular_velocities,
                dt,
                longest_time_step,
            )
            for slot, law, loss in ti.static(surface_laws):
                found = law.act(member(constants, slot), surface, kinematics, member(history, slot))
                if ti.static("force" in found.keys):
                    force += found.force
                torque += found.torque
                torque_partner += found.torque_partner
                losses[loss] += found.loss
                set_member(history_new, slot, found.history)
        return ti.Struct(
            force=force,
            torque=torque,
            torque_partner=torque_partner,
            history=history_new,
            losses=losses,
        )

    return pair_force


@ti.func
def no_losses(nothing):
    """Vector `losses` of a contact without losses; `nothing`: 0 of the type of forces."""
    return ti.Vector([nothing for _ in ti.static(range(len(PAIR_LOSSES)))])


@ti.func
def normal_contact(bodies, kinematics, time_step):
    """Argument `contact` of the normal and cohesion models."""
    return ti.Struct(
        radius_eff=bodies.radius_eff,
        mass_eff=bodies.mass_eff,
        time_step=time_step,
        overlap=kinematics.overlap,
        overlap_rate=kinematics.overlap_rate,
    )


@ti.func
def normal_time_step(dt, longest_time_step):
    """Time step [s] of normal models: the longest of the run if that of this force evaluation is 0, without
    motion."""
    return ti.select(dt > 0.0, dt, longest_time_step)


def build_normal_force(laws: ContactLaws, is_prepared: bool) -> Any:
    """Device function (constants, contact, history): normal force of one contact, cohesion included.

    is_prepared:  True if `NormalLaw.prepare` has been evaluated before
    Returns:      normal force [N], load [N] that presses the surfaces together, viscous force [N], history
    """
    normal = laws.normal
    cohesion = laws.cohesion

    @ti.func
    def normal_force_of(constants, contact, history):
        history_new = history
        if ti.static(normal.prepares and not is_prepared):
            history_new.normal = normal.prepare(constants.normal, contact, history.normal)
        force, viscous, normal_history = normal.force(constants.normal, contact, history_new.normal)
        history_new.normal = normal_history
        attraction = 0.0 * force
        if ti.static(laws.has_cohesion):
            attraction, cohesion_history = cohesion.force(constants.cohesion, contact, history.cohesion)
            history_new.cohesion = cohesion_history
            force -= attraction
        if ti.static(normal.attracts):
            attraction += normal.attraction(constants.normal, contact, normal_history)
        load = force
        if ti.static(laws.attracts):
            load += attraction
        return force, load, viscous, history_new

    return normal_force_of


def build_surface_contact(plan: Plan) -> Any:
    """Device function: struct `contact` of the surface models, see `contact/law.py`.

    Arguments: pair constants, struct `contact`, load [N], history, structs and times as for
    `build_pair_force`. The time step is 0 in a force evaluation without motion, so that displacements do not
    change.
    """
    laws = plan.laws
    law = laws.normal

    @ti.func
    def surface_contact(
        constants, contact, load, history, bodies, kinematics, angular_velocities, dt, longest_time_step
    ):
        ratio = 0.0 * contact.overlap + 1.0  # of the previous to the present stiffness
        if ti.static(law.tangential_stiffness_grows):
            overlap_before = contact.overlap - dt * kinematics.overlap_rate_half
            ratio = ti.sqrt(ti.max(overlap_before, 0.0) / contact.overlap)
        normal_damping = 0.0 * contact.overlap
        if ti.static(len(laws.damped_slots) > 0):
            normal_damping = law.damping(constants.normal, contact, history.normal)
        rotation = (
            kinematics.arm_half * angular_velocities.first
            + kinematics.arm_partner_half * angular_velocities.partner
        )
        surface_velocity = kinematics.velocity_rel_half - rotation.cross(kinematics.normal_half)
        slip_rate = in_contact_plane(surface_velocity, kinematics.normal, kinematics.normal_half)
        return ti.Struct(
            radius_eff=contact.radius_eff,
            mass_eff=contact.mass_eff,
            inertia_eff=bodies.inertia_eff,
            time_step=dt,
            longest_time_step=longest_time_step,
            overlap=contact.overlap,
            overlap_rate=contact.overlap_rate,
            normal=kinematics.normal,
            normal_half=kinematics.normal_half,
            normal_load=load,
            stiffness=law.tangential_stiffness(constants.normal, contact, history.normal),
            stiffness_ratio=ratio,
            normal_damping=normal_damping,
            slip=dt * slip_rate,
            slip_rate=slip_rate,
            rolling_rate=angular_velocities.first - angular_velocities.partner,
        )

    return surface_contact
