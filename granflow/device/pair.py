"""Arithmetic of one contact, on values alone: where the partners stand and how they move in, forces and history out.

Nothing here reads or writes a field, so that the same functions serve a contact at a time and a loop over many.
Every operation gives exactly the opposite or the same number when the partners change places.
"""

from typing import Any

import taichi as ti

from granflow.laws.mindlin import carried_displacement, elastic_plastic_spring, spring_loss
from granflow.laws.rolling import directional_torque, torque_loss
from granflow.laws.whole import whole_force
from granflow.plan import Plan

ROUNDING = {ti.f64: 2.0**-50, ti.f32: 2.0**-21}
"""Eight units in the last place of 1: spheres nearer than this to touching count as apart, so no overlap is 0."""


def build_touches(real: Any) -> Any:
    """Device function (square of the distance, sum of radii): whether the overlap is above rounding."""
    share = 1.0 - ROUNDING[real]

    @ti.func
    def touches(square, reach):
        return square < share * (reach * reach)

    return touches


def build_meet(plan: Plan) -> Any:
    """Device function: two touching spheres seen from the first.

    Takes radii, `apart` from the second to the first [m], relative velocities half a step ago and now [m/s], step [s].
    Returns overlap, normal, mean of it and that of a step earlier, part of the earlier velocity across the normal,
    rate of overlap then and now (> 0 approaching), and the lever arms of both.
    """
    rate_dependent = plan.features.rate_dependent

    @ti.func
    def meet(radius, radius_partner, apart, late, now, dt):
        distance = ti.sqrt(apart.dot(apart))
        inverse = 1.0 / distance
        reach = radius + radius_partner
        overlap = reach - distance
        normal = inverse * apart
        late_rate = -late.dot(normal)
        rate = late_rate
        if ti.static(rate_dependent):
            rate = -now.dot(normal)
        across = late + late_rate * normal
        middle = normal - (0.5 * dt * inverse) * across
        share = overlap / reach
        arm = radius - share * radius_partner
        arm_partner = radius_partner - share * radius
        return overlap, normal, middle, across, late_rate, rate, arm, arm_partner

    return meet


@ti.func
def half_of_both(one, other):
    """Effective radius, mass or inertia of a pair: a b / (a + b)."""
    return one * other / (one + other)


def build_respond(plan: Plan, prepared: bool) -> Any:
    """Device function: what one contact does in a step.

    With `prepared`, the law's branches have been taken already and only its arithmetic is left (see NormalLaw).
    Returns force on the first [N], torques on both [N m], the three histories, and the energy lost in this step to
    friction, rolling and damping [J].
    """
    law, features = plan.law, plan.features
    force_of = law.force if prepared else whole_force(law)
    friction_index, rolling_index = plan.friction_index, plan.rolling_index
    roll = _build_roll(plan)

    @ti.func
    def spring_share(overlap, late_rate, dt):
        share = 0.0 * overlap + 1.0
        if ti.static(law.lateral_grows):
            share = ti.sqrt(ti.max(overlap - dt * late_rate, 0.0) / overlap)
        return share

    @ti.func
    def respond(
        constants, radius_eff, mass_eff, inertia_eff, overlap, normal, middle, across, late_rate, rate, arm,
        arm_partner, spin, spin_partner, memory, slide, angle, dt
    ):  # fmt: skip
        normal_force, viscous, memory_now = force_of(constants, radius_eff, mass_eff, dt, overlap, rate, memory)
        force = normal_force * normal
        torque, torque_partner, slide_now, angle_now = 0.0 * normal, 0.0 * normal, slide, angle
        friction_loss, rolling_loss = 0.0 * overlap, 0.0 * overlap
        if ti.static(features.rotation):
            pressing = normal_force
            if ti.static(law.attracts):
                pressing += law.attraction(constants, radius_eff, overlap, memory_now)
            stiffness = law.lateral_stiffness(constants, radius_eff, overlap, memory_now)
            share = spring_share(overlap, late_rate, dt)
            if ti.static(features.friction):
                slip = dt * (across - (arm * spin + arm_partner * spin_partner).cross(normal))
                carried = carried_displacement(slide, normal, middle)
                cap = constants[friction_index] * pressing
                tangential, slide_now = elastic_plastic_spring(stiffness, share, cap, carried, slip)
                force += tangential
                moment = normal.cross(tangential)
                torque, torque_partner = -arm * moment, -arm_partner * moment
                if ti.static(features.ledger):
                    friction_loss = spring_loss(stiffness, share, carried, slip, tangential, slide_now)
            if ti.static(features.rolling != "none"):
                rolling, angle_now, rolling_loss = roll(
                    stiffness, share, constants[rolling_index], pressing, radius_eff, inertia_eff, normal, middle,
                    spin - spin_partner, angle, dt
                )  # fmt: skip
                torque, torque_partner = torque + rolling, torque_partner - rolling
        return (
            force, torque, torque_partner, memory_now, slide_now, angle_now, friction_loss, rolling_loss,
            viscous * rate * dt
        )  # fmt: skip

    return respond


def _build_roll(plan: Plan) -> Any:
    """Device function: rolling torque on the first [N m], rolling history, energy lost [J].

    The history (`angle`) is the rolling displacement of EPSD, or for the energy ledger of CDT the torque one step ago.
    """
    epsd, ledger, longest_step = plan.features.rolling == "epsd", plan.features.ledger, plan.longest_time_step

    @ti.func
    def roll(stiffness, share, mu, normal_force, radius_eff, inertia_eff, normal, middle, rate, angle, dt):
        across = rate - rate.dot(normal) * normal
        torque, angle_now, lost = 0.0 * across, angle, 0.0 * stiffness
        if ti.static(epsd):
            carried = carried_displacement(angle, normal, middle)
            spring = stiffness * radius_eff * radius_eff
            torque, angle_now = elastic_plastic_spring(
                spring, share, mu * radius_eff * normal_force, carried, dt * across
            )
            if ti.static(ledger):
                lost = spring_loss(spring, share, carried, dt * across, torque, angle_now)
        else:
            torque = directional_torque(radius_eff, mu, normal_force, across, inertia_eff, longest_step)
            if ti.static(ledger):
                lost = torque_loss(angle, torque, rate, dt)
                angle_now = torque
        return torque, angle_now, lost

    return roll
