"""Force and torque of one contact as a function of values: positions and velocities in, forces and history out.

No function reads or writes a field, so that the scalar and the batched contact loops share them. If the partners are
exchanged, each result is bit-identical or has exactly the opposite sign.
"""

from typing import Any

import taichi as ti

from granflow.contact.complete_force import complete_force
from granflow.contact.rolling.rolling import directional_torque, torque_loss
from granflow.contact.tangential.mindlin import elastic_plastic_spring, rotated_displacement, spring_loss
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

    Arguments: radii [m], `branch` vector from the second to the first [m], relative velocity at the half step and now
    [m/s], time step [s]. Returns overlap [m], normal, mean of the present and the previous normal, tangential relative
    velocity at the half step [m/s], overlap rate at the half step and now [m/s] (positive if approaching), and the
    lever arms of both [m].
    """
    rate_dependent = plan.features.rate_dependent

    @ti.func
    def sphere_kinematics(radius, radius_partner, branch, velocity_rel_half, velocity_rel, dt):
        distance = ti.sqrt(branch.dot(branch))
        inverse = 1.0 / distance
        contact_distance = radius + radius_partner
        overlap = contact_distance - distance
        normal = inverse * branch
        overlap_rate_half = -velocity_rel_half.dot(normal)
        rate = overlap_rate_half
        if ti.static(rate_dependent):
            rate = -velocity_rel.dot(normal)
        velocity_tangential = velocity_rel_half + overlap_rate_half * normal
        normal_half = normal - (0.5 * dt * inverse) * velocity_tangential
        ratio = overlap / contact_distance
        arm = radius - ratio * radius_partner
        arm_partner = radius_partner - ratio * radius
        return overlap, normal, normal_half, velocity_tangential, overlap_rate_half, rate, arm, arm_partner

    return sphere_kinematics


@ti.func
def effective_value(one, other):
    """Effective radius, mass or inertia of a pair: a b / (a + b)."""
    return one * other / (one + other)


def build_pair_force(plan: Plan, is_prepared: bool) -> Any:
    """Device function: force and torques of one contact in a step.

    is_prepared:  True if `NormalLaw.prepare` has been evaluated before

    Arguments: pair constants; effective radius [m], mass [kg] and inertia [kg m2]; kinematics of
    `build_sphere_kinematics`; angular velocities of both [rad/s]; normal history, tangential displacement [m], rolling
    displacement; time step [s].

    Returns the force on the first [N], the torques on both [N m], the three histories, and the energy [J] dissipated in
    this step by friction, rolling and damping.
    """
    law, features = plan.law, plan.features
    normal_force_of = law.force if is_prepared else complete_force(law)
    friction_index, rolling_index = plan.friction_index, plan.rolling_index
    rolling_torque = _build_rolling_torque(plan)

    @ti.func
    def stiffness_ratio(overlap, overlap_rate_half, dt):
        """Ratio of the previous to the present tangential stiffness, sqrt(d(t - dt) / d(t)) for Hertz contacts."""
        ratio = 0.0 * overlap + 1.0
        if ti.static(law.tangential_stiffness_grows):
            ratio = ti.sqrt(ti.max(overlap - dt * overlap_rate_half, 0.0) / overlap)
        return ratio

    @ti.func
    def pair_force(
        constants, radius_eff, mass_eff, inertia_eff, overlap, normal, normal_half, velocity_tangential,
        overlap_rate_half, rate, arm, arm_partner, angular_velocity, angular_velocity_partner, normal_history,
        tangential_displacement, rolling_displacement, dt,
    ):  # fmt: skip
        normal_force, viscous, normal_history_new = normal_force_of(
            constants, radius_eff, mass_eff, dt, overlap, rate, normal_history
        )
        force = normal_force * normal
        torque, torque_partner = 0.0 * normal, 0.0 * normal
        tangential_displacement_new, rolling_displacement_new = tangential_displacement, rolling_displacement
        friction_loss, rolling_loss = 0.0 * overlap, 0.0 * overlap
        if ti.static(features.rotation):
            normal_load = normal_force
            if ti.static(law.attracts):
                normal_load += law.attraction(constants, radius_eff, overlap, normal_history_new)
            stiffness = law.tangential_stiffness(constants, radius_eff, overlap, normal_history_new)
            ratio = stiffness_ratio(overlap, overlap_rate_half, dt)
            if ti.static(features.friction):
                slip = dt * (
                    velocity_tangential
                    - (arm * angular_velocity + arm_partner * angular_velocity_partner).cross(normal)
                )
                rotated = rotated_displacement(tangential_displacement, normal, normal_half)
                friction_limit = constants[friction_index] * normal_load
                tangential, tangential_displacement_new = elastic_plastic_spring(
                    stiffness, ratio, friction_limit, rotated, slip
                )
                force += tangential
                moment = normal.cross(tangential)
                torque, torque_partner = -arm * moment, -arm_partner * moment
                if ti.static(features.energy_budget):
                    friction_loss = spring_loss(
                        stiffness, ratio, rotated, slip, tangential, tangential_displacement_new
                    )
            if ti.static(features.rolling != "none"):
                torque_rolling, rolling_displacement_new, rolling_loss = rolling_torque(
                    stiffness,
                    ratio,
                    constants[rolling_index],
                    normal_load,
                    radius_eff,
                    inertia_eff,
                    normal,
                    normal_half,
                    angular_velocity - angular_velocity_partner,
                    rolling_displacement,
                    dt,
                )
                torque, torque_partner = torque + torque_rolling, torque_partner - torque_rolling
        return (
            force, torque, torque_partner, normal_history_new, tangential_displacement_new, rolling_displacement_new,
            friction_loss, rolling_loss, viscous * rate * dt,
        )  # fmt: skip

    return pair_force


def _build_rolling_torque(plan: Plan) -> Any:
    """Device function: rolling torque on the first [N m], rolling history, dissipated energy [J].

    The history (`rolling_displacement`) is the rolling displacement of EPSD [rad]; with CDT and the energy budget it is
    the torque of the previous step [N m]. See `laws/rolling.py`.
    """
    epsd, energy_budget, longest_step = (
        plan.features.rolling == "epsd",
        plan.features.energy_budget,
        plan.longest_time_step,
    )

    @ti.func
    def rolling_torque(
        stiffness, ratio, mu, normal_force, radius_eff, inertia_eff, normal, normal_half, rate, rolling_displacement, dt
    ):
        rate_tangential = rate - rate.dot(normal) * normal
        torque, rolling_displacement_new, energy_lost = 0.0 * rate_tangential, rolling_displacement, 0.0 * stiffness
        if ti.static(epsd):
            rotated = rotated_displacement(rolling_displacement, normal, normal_half)
            spring = stiffness * radius_eff * radius_eff
            torque, rolling_displacement_new = elastic_plastic_spring(
                spring, ratio, mu * radius_eff * normal_force, rotated, dt * rate_tangential
            )
            if ti.static(energy_budget):
                energy_lost = spring_loss(
                    spring, ratio, rotated, dt * rate_tangential, torque, rolling_displacement_new
                )
        else:
            torque = directional_torque(radius_eff, mu, normal_force, rate_tangential, inertia_eff, longest_step)
            if ti.static(energy_budget):
                energy_lost = torque_loss(rolling_displacement, torque, rate, dt)
                rolling_displacement_new = torque
        return torque, rolling_displacement_new, energy_lost

    return rolling_torque
