"""Damping of all motion for settling: Cundall's non-viscous damping and a viscous drag, for forces and torques.

For a force F without damping, a velocity v(t - dt/2) and a mass m:

    Fc = -a |F_k| sign(v_k)                                 with v = v(t - dt/2) + (dt/2) F / m
    Fd = -g m v,  v = (v(t - dt/2) + (dt/2) (F + Fc) / m) / (1 + g dt/2)

The drag is thereby the mean over the step: a free velocity changes by the factor (1 - g dt/2) / (1 + g dt/2) in a step,
and the terminal velocity is exact. The same with torque, angular velocity and moment of inertia. Sources: Cundall 1987;
Šmilauer et al., Yade documentation (numerical damping).
"""

from typing import Any

from granflow.engine.exact_sums import add_energy
from granflow.engine.frozen_masks import build_mobility
from granflow.engine.state import State
from granflow.kernel_language import ti
from granflow.plan.chunk_sums import DAMPING, LOSSES
from granflow.plan.sum_units import ENERGY


def write_damping(state: State, stage: str) -> None:
    """Write the damping of a stage; nothing without damping in the plan."""
    if state.plan.damping is not None:
        for k, value in enumerate(state.plan.damping.values(stage)):
            state.control.damping[k] = value


def build_damped(state: State) -> Any:
    """Device function (chunk, i, force [N], torque [N m], time_step): damping force and torque on a particle.

    Arguments are without damping. Adds the loss of half a step.

    Reads:   velocity, angular_velocity, radius, mass, fixed, damping, force_clock
    Writes:  damping_force, damping_torque, losses
    """
    particles, features, mobility = state.particles, state.plan.features, build_mobility(state)
    damping_of, add_loss = build_damping_of(state), build_add_damping_loss(state)

    @ti.func
    def damped(chunk, i, force, torque, dt):
        mass = particles.mass[i]
        found, found_torque = mobility(i) * damping_of(force, particles.velocity[i], mass), 0.0 * torque
        if ti.static(features.rotation):
            inertia = 0.4 * mass * particles.radius[i] * particles.radius[i]
            found_torque = mobility(i) * damping_of(torque, particles.angular_velocity[i], inertia)
        if ti.static(features.energy_budget):
            particles.damping_force[i] = found
            if ti.static(features.rotation):
                particles.damping_torque[i] = found_torque
            add_loss(chunk, i, dt)
        return found, found_torque

    return damped


def build_damping_of(state: State) -> Any:
    """Device function (force, velocity at the half step, mass): damping force; the same for rotation.

    Reads:  damping, force_clock
    """
    control, real = state.control, state.backend.real

    @ti.func
    def damping_of(force, velocity, mass):
        ratio, rate = ti.cast(control.damping[0], real), ti.cast(control.damping[1], real)
        lag = ti.cast(control.force_clock[3], real)
        present = velocity + (lag / mass) * force
        found = 0.0 * force
        for k in ti.static(range(3)):
            sign = ti.select(present[k] > 0.0, 1.0, ti.select(present[k] < 0.0, -1.0, 0.0))
            found[k] = -ratio * ti.abs(force[k]) * ti.cast(sign, real)
        drag = -(rate * mass / (1.0 + rate * lag)) * (present + (lag / mass) * found)
        return found + drag

    return damping_of


def build_add_damping_loss(state: State) -> Any:
    """Device function (chunk, i, time_step): add the loss of half a step with the present velocities.

    Reads:   velocity, angular_velocity, damping_force, damping_torque
    Writes:  losses
    """
    particles, control, features = state.particles, state.control, state.plan.features
    per_unit, loss_count = state.parameter("per_unit", ENERGY), len(LOSSES)

    @ti.func
    def add_loss(chunk, i, dt):
        power = ti.cast(particles.damping_force[i], ti.f64).dot(ti.cast(particles.velocity[i], ti.f64))
        if ti.static(features.rotation):
            angular_velocity = ti.cast(particles.angular_velocity[i], ti.f64)
            power += ti.cast(particles.damping_torque[i], ti.f64).dot(angular_velocity)
        # half of the loss in a step, as energies are in units / SHARES
        value = -ti.cast(per_unit(), ti.f64) * ti.cast(dt, ti.f64) * power
        add_energy(control.losses, chunk, DAMPING, loss_count, 1, value)

    return add_loss
