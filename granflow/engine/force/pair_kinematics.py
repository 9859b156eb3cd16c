"""Geometry and kinematics of one candidate pair, read from the state, with a particle or a wall as the partner."""

from typing import Any

from granflow.engine.exact_sums import add_energy, build_list_shares, build_to_grid
from granflow.engine.force.pair_force import build_in_contact, build_sphere_kinematics, effective_value
from granflow.engine.force.structs import build_constants
from granflow.engine.frozen_masks import build_contact_mass
from granflow.engine.periodic_box import build_image_velocity, build_minimum_image
from granflow.engine.state import State
from granflow.engine.wall_contact import build_wall_contact
from granflow.engine.walls import WallGeometry, build_wall_of
from granflow.kernel_language import ti
from granflow.plan.sum_units import ENERGY, FORCE


def build_pair_kinematics(state: State, with_wall: bool) -> Any:
    """Device function (i, j, pose, time_step) -> kinematics of a candidate pair; for a wall, j is -1 - index.

    with_wall:  True for walls; separate functions, so that the loops contain no branch between the two kinds of partner

    Returns the struct of `build_sphere_kinematics`; without contact, the overlap is not above 0, and only models that
    act at a distance get its value and the normal.

    Reads:  position, velocity, velocity_synchronized, radius, walls, image_offset, image_speed
    """
    return _build_wall_kinematics(state) if with_wall else _build_particle_kinematics(state)


@ti.func
def no_contact(overlap, vector):
    """Kinematics of a pair without contact; `vector` has the type of the 3-vectors."""
    zero, nothing = 0.0 * vector, 0.0 * overlap
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


def _build_particle_kinematics(state: State) -> Any:
    """`build_pair_kinematics` for two particles."""
    particles, features, real = state.particles, state.plan.features, state.backend.real
    sphere_kinematics, in_contact = build_sphere_kinematics(state.plan), build_in_contact(real)
    minimum_image, image_velocity = build_minimum_image(state), build_image_velocity(state)
    acts_at_distance = state.plan.laws.acts_at_distance

    @ti.func
    def particle_kinematics(i, j, pose, time_step):
        radius, radius_partner = particles.radius[i], particles.radius[j]
        found = no_contact(-radius, particles.velocity[i])
        branch = ti.cast(minimum_image(particles.position[i], particles.position[j], pose), real)
        if in_contact(branch.dot(branch), radius + radius_partner):
            velocity_rel_half = particles.velocity[i] - particles.velocity[j] - image_velocity(i, j, pose)
            velocity_rel = velocity_rel_half
            if ti.static(features.rate_dependent):
                velocity_rel = (
                    particles.velocity_synchronized[i] - particles.velocity_synchronized[j] - image_velocity(i, j, pose)
                )
            found = sphere_kinematics(radius, radius_partner, branch, velocity_rel_half, velocity_rel, time_step)
        elif ti.static(acts_at_distance):
            distance = ti.sqrt(branch.dot(branch))
            found.overlap = ti.min(radius + radius_partner - distance, 0.0)
            found.normal = 1.0 / distance * branch
        return found

    return particle_kinematics


def _build_wall_kinematics(state: State) -> Any:
    """`build_pair_kinematics` for a particle and a wall: the contact point halves the overlap; no lever arm of j.

    Velocities are those of the half step; normal_half and the velocity of the wall at the contact point are as well.
    """
    particles, features, real = state.particles, state.plan.features, state.backend.real
    geometry, acts_at_distance = WallGeometry(state), state.plan.laws.acts_at_distance
    wall_contact = build_wall_contact(state, geometry)

    @ti.func
    def wall_kinematics(i, j, pose, time_step):
        radius, face = particles.radius[i], -1 - j
        gap, direction = wall_contact(i, j, pose)
        found = no_contact(ti.cast(radius - gap, real), particles.velocity[i])
        found.arm = radius - 0.5 * found.overlap
        if ti.static(acts_at_distance):
            found.normal = ti.cast(direction, real)
        if found.overlap > 0.0:
            position, velocity = particles.position[i], particles.velocity[i]
            normal_half = geometry.normal_half(face, pose, position, velocity, direction, time_step)
            found.normal, found.normal_half = ti.cast(direction, real), ti.cast(normal_half, real)
            wall_velocity = geometry.velocity_half(face, pose, position - found.arm * normal_half, velocity, time_step)
            found.velocity_rel_half = velocity - ti.cast(wall_velocity, real)
            found.overlap_rate_half = -found.velocity_rel_half.dot(found.normal_half)
            found.overlap_rate = -found.velocity_rel_half.dot(found.normal)
            if ti.static(features.rate_dependent):
                wall_velocity_now = ti.cast(geometry.velocity(face, pose, position - found.arm * direction), real)
                found.overlap_rate = -(particles.velocity_synchronized[i] - wall_velocity_now).dot(found.normal)
            found.arm_half = found.arm + 0.25 * time_step * found.overlap_rate_half
            if ti.static(features.surface_velocity):  # it does not turn the normal
                found.velocity_rel_half -= geometry.surface_velocity(face, pose, found.normal_half)
        return found

    return wall_kinematics


def build_effective(state: State, with_wall: bool) -> Any:
    """Device function (i, j) -> struct `bodies`: effective radius [m], mass [kg] and inertia [kg m2] of a pair.

    a b / (a + b) for two particles, the value of the particle for a wall; a fixed particle has a very large mass.

    Reads:  radius, mass, fixed
    """
    particles, contact_mass = state.particles, build_contact_mass(state)

    @ti.func
    def effective(i, j):
        radius_eff, mass_eff = particles.radius[i], contact_mass(i)
        inertia_eff = 0.4 * mass_eff * radius_eff * radius_eff
        if ti.static(not with_wall):
            radius, mass = particles.radius[j], contact_mass(j)
            radius_eff, mass_eff = effective_value(radius_eff, radius), effective_value(mass_eff, mass)
            inertia_eff = effective_value(inertia_eff, 0.4 * mass * radius * radius)
        return ti.Struct(radius_eff=radius_eff, mass_eff=mass_eff, inertia_eff=inertia_eff)

    return effective


def build_any_kinematics(state: State) -> Any:
    """Device function (i, j, pose, time_step): kinematics for particles and walls alike, where speed does not matter.

    Returns the normal, and the struct `contact` of the contact models.

    Reads:  as `build_pair_kinematics`
    """
    has_walls = state.plan.has_walls
    particle_kinematics, particle_effective = build_pair_kinematics(state, False), build_effective(state, False)
    wall_kinematics = build_pair_kinematics(state, True) if has_walls else particle_kinematics
    wall_effective = build_effective(state, True)

    @ti.func
    def any_kinematics(i, j, pose, time_step):
        bodies = wall_effective(i, j)
        found = no_contact(0.0 * bodies.radius_eff, state.particles.velocity[i])
        if j < 0:
            found = wall_kinematics(i, j, pose, time_step)
        else:
            bodies = particle_effective(i, j)
            found = particle_kinematics(i, j, pose, time_step)
        contact = ti.Struct(
            radius_eff=bodies.radius_eff,
            mass_eff=bodies.mass_eff,
            time_step=time_step,
            overlap=found.overlap,
            overlap_rate=found.overlap_rate,
        )
        return found.normal, contact

    return any_kinematics


def build_boundary_work(state: State) -> Any:
    """Device function (chunk, i, j, force on i, pose, time_step): add the work of the moving image of j on a pair [J].

        W = F_ij . (velocity of the image relative to its original) dt, once per pair

    with the force rounded as in the sum of forces: its last bits depend on the instructions that computed it.

    Writes:  boundary_work
    """
    list_shares, image_velocity, control = build_list_shares(state), build_image_velocity(state), state.control
    per_unit, shift = state.parameter("per_unit", ENERGY), state.parameter("shift", FORCE)
    to_grid = build_to_grid(state.backend.real)

    @ti.func
    def add_boundary_work(chunk, i, j, force, pose, dt):
        rounded = to_grid(force, shift())
        work = per_unit() * dt * rounded.dot(image_velocity(i, j, pose))
        add_energy(control.boundary_work, chunk, 0, 1, list_shares(chunk, j), work)

    return add_boundary_work


def build_pair_number(state: State) -> Any:
    """Device function (i, j): row of the pair constants for particle i and partner j.

        material of i * material count + material of j

    Reads:  material of particles and walls
    """
    plan, particles, walls = state.plan, state.particles, state.walls
    features, wall_of, material_count = plan.features, build_wall_of(state), state.parameter("material_count")

    @ti.func
    def pair_number(i, j):
        number = 0
        if ti.static(not features.one_material):
            number = particles.material[i] * material_count()
            if j >= 0:
                number += particles.material[j]
        if ti.static(plan.has_walls):
            if j < 0:
                number += walls.material[wall_of(j)]
        return number

    return pair_number


def build_pair_constants(state: State) -> Any:
    """Device function (i, j) -> struct of the constants of the contact laws for particle i and partner j.

    Reads:  pair_constants, law_parameters, material of particles and walls
    """
    control, constants_of = state.control, build_constants(state.plan.laws)
    pair_number = build_pair_number(state)

    @ti.func
    def pair_constants(i, j):
        return constants_of(control.pair_constants[pair_number(i, j)], control.law_parameters[0])

    return pair_constants
