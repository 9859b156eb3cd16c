"""Force and torque of one contact as a function of values: positions and velocities in, forces and history out.

No function reads or writes a field, so that the scalar and the batched contact loops share them. If the partners are
exchanged, each result is bit-identical or has exactly the opposite sign.
"""

from typing import Any

from granflow.contact.laws import ContactLaws
from granflow.contact.surface_law import in_contact_plane
from granflow.kernel_language import ti
from granflow.plan.plan import Plan

ROUNDING = {ti.f64: 2.0**-50, ti.f32: 2.0**-21}
"""Eight units in the last place of 1: pairs with a relative overlap below this are not in contact; no overlap is 0."""


def build_in_contact(real: Any) -> Any:
    """Device function (squared distance [m2], sum of radii [m]): true if the overlap is above rounding.

    real:  Taichi type of the arguments
    """
    ratio = 1.0 - ROUNDING[real]

    @ti.func
    def in_contact(square, contact_distance):
        return square < ratio * (contact_distance * contact_distance)

    return in_contact


def build_sphere_kinematics(plan: Plan) -> Any:
    """Device function: kinematics of two spheres in contact, relative to the first.

    Arguments: radii [m], `branch` vector b from the second to the first [m], relative velocity v at the half step and
    now [m/s], time step [s]. Returns a struct of overlap [m]; normal n; normal_half p, see `contact.surface_law`;
    relative velocity at the half step [m/s]; overlap rate at the half step and now [m/s] (positive if approaching); and
    the lever arms of both, now and at the half step [m]: the contact point halves the overlap.

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
        arm, arm_partner = radius - 0.5 * overlap, radius_partner - 0.5 * overlap
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


@ti.func
def effective_value(one, other):
    """Effective radius, mass or inertia of a pair: a b / (a + b)."""
    return one * other / (one + other)


@ti.func
def normal_time_step(dt, longest_time_step):
    """Time step [s] of normal models: that of the run if the one of this force evaluation is 0, without motion."""
    return ti.select(dt > 0.0, dt, longest_time_step)


def build_normal_force(laws: ContactLaws, is_prepared: bool) -> Any:
    """Device function (constants, contact, history): normal force of one contact, cohesion included.

    is_prepared:  True if `NormalLaw.prepare` has been evaluated before
    Returns:      normal force [N], load [N] that presses the surfaces together, viscous force [N], history
    """
    normal, cohesion = laws.normal, laws.cohesion

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
    """Device function: struct `contact` of the surface models, see `granflow.contact.surface_law`.

    Arguments: pair constants, struct `contact`, load [N], history, structs and times as for `build_pair_force`.
    The time step is 0 in a force evaluation without motion, so that displacements do not change.
    """
    law, laws = plan.laws.normal, plan.laws

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
            kinematics.arm_half * angular_velocities.first + kinematics.arm_partner_half * angular_velocities.partner
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


def build_pair_force(plan: Plan, is_prepared: bool) -> Any:
    """Device function: force and torques of one contact in a step.

    is_prepared:  True if `NormalLaw.prepare` has been evaluated before

    Arguments: pair constants; bodies, a struct of the effective radius [m], mass [kg] and inertia [kg m2]; kinematics
    of `build_sphere_kinematics`; angular_velocities, a struct of those of the first and the partner [rad/s]; history;
    time step, and longest time step of the run [s].

    Returns a struct of the force on the first [N], the torques on both [N m], the history, and the losses (friction,
    rolling and twisting, damping): energy [J] dissipated in this step.
    """
    features, laws, tangential, rolling = plan.features, plan.laws, plan.laws.tangential, plan.laws.rolling
    twisting = plan.laws.twisting
    normal_force_of, surface_contact = build_normal_force(plan.laws, is_prepared), build_surface_contact(plan)

    @ti.func
    def pair_force(constants, bodies, kinematics, angular_velocities, history, dt, longest_time_step):
        contact = normal_contact(bodies, kinematics, normal_time_step(dt, longest_time_step))
        normal_force, load, viscous, history_new = normal_force_of(constants, contact, history)
        force = normal_force * kinematics.normal
        torque, torque_partner = 0.0 * force, 0.0 * force
        friction_loss, rolling_loss = 0.0 * load, 0.0 * load
        if ti.static(features.rotation):
            surface = surface_contact(
                constants, contact, load, history_new, bodies, kinematics, angular_velocities, dt, longest_time_step
            )
            if ti.static(laws.has_tangential):
                tangential_force, tangential_history, friction_loss = tangential.force(
                    constants.tangential, surface, history.tangential
                )
                force += tangential_force
                moment = kinematics.normal.cross(tangential_force)
                torque, torque_partner = -kinematics.arm * moment, -kinematics.arm_partner * moment
                history_new.tangential = tangential_history
            if ti.static(laws.has_rolling):
                rolling_torque, rolling_history, rolling_loss = rolling.torque(
                    constants.rolling, surface, history.rolling
                )
                torque, torque_partner = torque + rolling_torque, torque_partner - rolling_torque
                history_new.rolling = rolling_history
            if ti.static(laws.has_twisting):
                twisting_torque, twisting_history, twisting_loss = twisting.torque(
                    constants.twisting, surface, history.twisting
                )
                torque, torque_partner = torque + twisting_torque, torque_partner - twisting_torque
                rolling_loss += twisting_loss
                history_new.twisting = twisting_history
        return ti.Struct(
            force=force,
            torque=torque,
            torque_partner=torque_partner,
            history=history_new,
            losses=ti.Vector([friction_loss, rolling_loss, viscous * kinematics.overlap_rate * dt]),
        )

    return pair_force
