"""Total force and torque on a particle: sums over contacts, external forces, damping and, below f64, the weight."""

from typing import Any

from granflow.engine.exact_sums import holds_sums
from granflow.engine.force.damping import build_damped
from granflow.engine.force.external_forces import build_external_force
from granflow.engine.state import State
from granflow.kernel_language import ti


def build_set_forces(state: State) -> Any:
    """Device function (chunk, i, sums of contact forces and torques, gravity [m/s2], time_step): set total forces.

    External forces and damping are added to the sums; also the weight, unless the sums contain it.

    Reads:   mass; as `build_external_force` and `build_damped`
    Writes:  force, torque; as `build_external_force` and `build_damped`
    """
    particles, features, real, exact = state.particles, state.plan.features, state.backend.real, holds_sums(state)
    external_force = build_external_force(state) if features.external_forces else None
    damped = build_damped(state) if features.damping != "none" else None

    @ti.func
    def set_forces(chunk, i, force_sum, torque_sum, acceleration, dt):
        particles.force[i] = ti.cast(force_sum, real)
        if ti.static(features.clumps and not exact):
            if particles.clump[i] < 0:  # the weight of a clump acts at its center of mass
                particles.force[i] = particles.force[i] + particles.mass[i] * acceleration
        elif ti.static(not exact):
            particles.force[i] = particles.force[i] + particles.mass[i] * acceleration
        if ti.static(features.external_forces):
            particles.force[i] = particles.force[i] + external_force(chunk, i, particles.force[i], dt)
        if ti.static(features.rotation):
            particles.torque[i] = ti.cast(torque_sum, real)
        if ti.static(features.damping != "none"):
            damping_force, damping_torque = damped(chunk, i, particles.force[i], ti.cast(torque_sum, real), dt)
            particles.force[i] = particles.force[i] + damping_force
            if ti.static(features.rotation):
                particles.torque[i] = particles.torque[i] + damping_torque

    return set_forces
