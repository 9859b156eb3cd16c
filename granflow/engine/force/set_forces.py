"""Total force and torque on a particle: sums over contacts, weight and external forces."""

from typing import Any

from granflow.engine.force.damping import build_damped
from granflow.engine.force.external_forces import build_external_force
from granflow.engine.limits import ABORT_FORCE
from granflow.engine.state import State
from granflow.kernel_language import ti
from granflow.plan.sum_units import FORCE, SUM_BITS, TORQUE

LIMIT_SQUARED = 2.0 ** (2 * SUM_BITS)
"""Largest squared sum of forces or torques in units: below it, all sums are exact."""


def build_set_forces(state: State) -> Any:
    """Device function (chunk, i, sums of contact forces and torques, gravity [m/s2], time_step): set total forces.

    Weight, external forces and damping are added to the sums. Aborts if the sums are above the range in which they are
    exact.

    Reads:   mass, id; as `build_external_force` and `build_damped`
    Writes:  force, torque, abort, abort_particle; as `build_external_force` and `build_damped`
    """
    particles, control, features, real = state.particles, state.control, state.plan.features, state.backend.real
    per_unit = state.parameter("per_unit")
    external_force = build_external_force(state) if features.external_forces else None
    damped = build_damped(state) if features.damping != "none" else None

    @ti.func
    def set_forces(chunk, i, force_sum, torque_sum, acceleration, dt):
        particles.force[i] = ti.cast(force_sum, real) + particles.mass[i] * acceleration
        if ti.static(features.external_forces):
            particles.force[i] = particles.force[i] + external_force(chunk, i, particles.force[i], dt)
        if ti.static(features.rotation):
            particles.torque[i] = ti.cast(torque_sum, real)
        if ti.static(features.damping != "none"):
            damping_force, damping_torque = damped(chunk, i, particles.force[i], ti.cast(torque_sum, real), dt)
            particles.force[i] = particles.force[i] + damping_force
            if ti.static(features.rotation):
                particles.torque[i] = particles.torque[i] + damping_torque
        units = ti.cast(per_unit(), ti.f64)
        force, torque = units[FORCE] * force_sum, units[TORQUE] * torque_sum
        if ti.max(force.norm_sqr(), torque.norm_sqr()) > LIMIT_SQUARED:
            ti.atomic_max(control.abort[0], ABORT_FORCE)
            ti.atomic_min(control.abort_particle[0], particles.id[i])

    return set_forces
