"""Forces on a particle alone: external forces, and damping of all motion; fixed particles.

External forces are device functions of a program; with damping, a scene settles. Both are evaluated with the
contact forces, at the time of the positions, and are part of `force`: integration, synchronized velocities
and snapshots need no other term. `build_set_forces` adds them to the sums over the contacts, and below f64
the weight; in f64 the sums contain the weight from the start (`step.TimeStep.forces`).

Velocities are half a step behind the positions; where a force depends on the velocity, it is extrapolated
by `lag`, half a step. The host writes it with the time of the forces (`write_force_inputs`).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from granflow.device_functions import at_compile_time
from granflow.engine.backend import Backend
from granflow.engine.contact_structs import number_at, vector_at
from granflow.engine.fields import FieldBlock
from granflow.engine.state import State
from granflow.engine.sums import add_energy, holds_sums
from granflow.geometry.sphere import sphere_inertia
from granflow.kernel_language import ti
from granflow.plan.plan import ExternalForce
from granflow.plan.sum_units import LOSS_DAMPING, LOSSES, UNIT_ENERGY


def build_set_forces(state: State) -> Any:
    """Device function (chunk, i, sums of contact forces and torques, gravity [m/s2], dt): set total
    forces.

    External forces and damping are added to the sums; also the weight, unless the sums contain it.

    Reads:   mass; as `build_external_force` and `build_damped`
    Writes:  force, torque; as `build_external_force` and `build_damped`
    """
    particles = state.particles
    features = state.plan.features
    real = state.backend.real
    exact = holds_sums(state)
    external_force = build_external_force(state) if features.external_forces else None
    damped = build_damped(state) if features.damping != "none" else None

    @ti.func
    def set_forces(chunk, i, force_sum, torque_sum, gravity, dt):
        particles.force[i] = ti.cast(force_sum, real)
        if ti.static(features.clumps and not exact):
            if particles.clump[i] < 0:  # the weight of a clump acts at its center of mass
                particles.force[i] = particles.force[i] + particles.mass[i] * gravity
        elif ti.static(not exact):
            particles.force[i] = particles.force[i] + particles.mass[i] * gravity
        if ti.static(features.external_forces):
            particles.force[i] = particles.force[i] + external_force(chunk, i, particles.force[i], dt)
        if ti.static(features.rotation):
            particles.torque[i] = ti.cast(torque_sum, real)
        if ti.static(features.damping != "none"):
            damping_force, damping_torque = damped(
                chunk, i, particles.force[i], ti.cast(torque_sum, real), dt
            )
            particles.force[i] = particles.force[i] + damping_force
            if ti.static(features.rotation):
                particles.torque[i] = particles.torque[i] + damping_torque

    return set_forces


def write_force_inputs(state: State, step: int, velocities_lag: bool = True) -> None:
    """Write clock and parameters of external forces and damping, for forces after step number `step`, if any.

    `velocities_lag`: velocities are half a step behind the positions.
    """
    if state.control.force_clock is None:
        return
    control = state.control
    clock = state.clock.state_dict()
    lag = 0.5 * clock["time_step"] if velocities_lag else 0.0
    for k, value in enumerate((clock["since_time"], clock["time_step"], step - clock["since_step"], lag)):
        control.force_clock[k] = float(value)
    numbers = [number for force in state.plan.external_forces for number in force.numbers]
    for k, number in enumerate(numbers):
        control.force_parameters[k] = number


# Fixed particles


def build_mobility(state: State) -> Any:
    """Device function (i): 1, or 0 for a fixed particle, whose velocity no force changes.

    Reads:  fixed
    """
    particles = state.particles
    real = state.backend.real

    @ti.func
    def mobility(i):
        share = ti.cast(1.0, real)
        if ti.static(state.plan.features.fixed_particles):
            share = ti.cast(1 - particles.fixed[i], real)
        return share

    return mobility


def mobility_mask(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """1.0 for mobile and 0.0 for fixed particles, float64 (n,).

    arrays:  particle fields: mass (n,), and `fixed` (n,) only if some are fixed
    """
    fixed = arrays.get("fixed", np.zeros(len(arrays["mass"]), np.int32))
    return 1.0 - np.asarray(fixed, float)


# External forces and their work
#
# The velocity is extrapolated with the total force, first without and then with the external forces; D(F)
# is the damping force:
#
#     v'  = v(t - dt/2) + dt/2 (F + D(F)) / m
#     v'' = v(t - dt/2) + dt/2 (F + f(v') + D(F + f(v'))) / m,      f = f(x(t), v'', t)
#
# which is of second order in dt for velocity-dependent forces. The work of a step is the mean of the forces
# at its ends times the displacement:
#
#     W = dt v(t + dt/2) . [f(t) + f(t + dt)] / 2


def build_external_force(state: State) -> Any:
    """Device function (chunk, i, force [N], dt): external force [N] on particle i.

    `force`: without external forces and damping

    Reads:   position, velocity, radius, mass, fixed, force_clock, force_parameters, damping
    Writes:  external_force, external_work
    """
    particles = state.particles
    control = state.control
    real = state.backend.real
    total_force = _build_total_force(state)
    mobility = build_mobility(state)
    add_work = build_add_external_work(state)
    damping_of = build_damping_of(state)

    @ti.func
    def present_velocity(i, force):
        total = force
        if ti.static(state.plan.features.damping != "none"):
            total = force + damping_of(force, particles.velocity[i], particles.mass[i])
        lag = mobility(i) * ti.cast(control.force_clock[3], real) / particles.mass[i]
        return particles.velocity[i] + lag * total

    @ti.func
    def external_force(chunk, i, force, dt):
        first = total_force(i, present_velocity(i, force))
        found = total_force(i, present_velocity(i, force + first))
        particles.external_force[i] = found
        if ti.static(state.plan.features.energy_budget):
            add_work(chunk, i, found, particles.velocity[i], dt)
        return found

    return external_force


def _build_total_force(state: State) -> Any:
    """Device function (i, velocity [m/s]): sum of all external forces [N]."""
    particles = state.particles
    control = state.control
    real = state.backend.real
    forces = []
    first = 0
    for force in state.plan.external_forces:
        forces.append(_build_call(force, first, control.force_parameters))
        first += sum(width for _, width in force.layout)

    @ti.func
    def total_force(i, velocity):
        since = control.force_clock[0]
        time_step = control.force_clock[1]
        count = control.force_clock[2]
        time = since + (count + ti.cast(control.steps_done[0], ti.f64)) * time_step
        total = ti.Vector.zero(real, 3)
        for call in ti.static(forces):
            found = call(particles.position[i], velocity, particles.radius[i], particles.mass[i], time)
            total += ti.cast(found, real)
        return total

    return total_force


def _build_call(force: ExternalForce, first: int, values: Any) -> Any:
    """Device function (position, velocity, radius, mass, time): one force, with its parameters from `first`
    on."""
    function = _device_function(force)
    parts = []
    k = first
    for name, width in force.layout:
        parts.append((name, number_at if width == 1 else vector_at, k))
        k += width

    @ti.func
    def call(position, velocity, radius, mass, time):
        parameters = ti.Struct({name: part(values, k) for name, part, k in ti.static(parts)})
        found = function(position, velocity, radius, mass, time, parameters)
        check_vector(found)
        return found

    return call


def _device_function(force: ExternalForce) -> Any:
    """The function of a force as a device function, also if it is a Python function without decorator."""
    is_compiled = any(hasattr(force.function, f"_is_{name}_function") for name in ("taichi", "quadrants"))
    return force.function if is_compiled else ti.func(force.function)


@at_compile_time
def check_vector(found: Any) -> None:
    """Raise TypeError unless the result of a force function is a vector of three components."""
    if not (hasattr(found, "is_tensor") and found.is_tensor() and tuple(found.get_shape()) == (3,)):
        raise TypeError("the function must return a vector of three components [N]")


def build_add_external_work(state: State) -> Any:
    """Device function (chunk, i, force [N], velocity [m/s] at the half step, dt): add the work of half
    a step.

    Fixed particles do not move.

    Reads:   fixed
    Writes:  external_work
    """
    control = state.control
    high_words_per_joule = state.parameter("per_unit", UNIT_ENERGY)
    mobility = build_mobility(state)

    @ti.func
    def add_work(chunk, i, force, velocity, dt):
        power = ti.cast(mobility(i), ti.f64) * ti.cast(force, ti.f64).dot(ti.cast(velocity, ti.f64))
        # Added once, this counts as half of the work of a step (`sums.SHARES` is 2): the other half is added
        # with the force at the other end of the step.
        value = ti.cast(high_words_per_joule(), ti.f64) * ti.cast(dt, ti.f64) * power
        add_energy(control.external_work, chunk, 0, 1, 1, value)

    return add_work


def compile_alone(backend: Backend, force: ExternalForce) -> None:
    """Compile one force by itself, on a particle at the origin, so that an error refers to it.

    Raises the exceptions of the kernel language.
    """
    block = FieldBlock(backend)
    real = backend.real
    values = block.scalar(ti.f64, max(len(force.numbers), 1))
    result = block.vector(ti.f64, 1)
    block.finish()
    call = _build_call(force, 0, values)
    position_real = backend.position_real

    @ti.kernel
    def evaluate():
        origin = ti.Vector.zero(position_real, 3)
        rest = ti.Vector.zero(real, 3)
        one = ti.cast(1.0, real)
        result[0] = ti.cast(call(origin, rest, one, one, ti.cast(0.0, ti.f64)), ti.f64)

    try:
        evaluate()
    finally:
        block.free()


# Damping of all motion for settling: Cundall's non-viscous damping and a viscous drag, for forces and torques
#
# For a force F without damping, a velocity v(t - dt/2) and a mass m:
#
#     Fc = -a |F_k| sign(v_k)                                 with v = v(t - dt/2) + (dt/2) F / m
#     Fd = -g m v,  v = (v(t - dt/2) + (dt/2) (F + Fc) / m) / (1 + g dt/2)
#
# The drag is thereby the mean over the step: a free velocity changes by the factor (1 - g dt/2) / (1 + g
# dt/2) in a step, and the terminal velocity is exact. The same with torque, angular velocity and moment of
# inertia. Sources: Cundall 1987; Šmilauer et al., Yade documentation (numerical damping).


def write_damping(state: State, stage: str) -> None:
    """Write the damping of a stage; nothing without damping in the plan."""
    if state.plan.scene.damping is not None:
        for k, value in enumerate(state.plan.scene.damping.values(stage)):
            state.control.damping[k] = value


def build_damped(state: State) -> Any:
    """Device function (chunk, i, force [N], torque [N m], dt): damping force and torque on a particle.

    Arguments are without damping. Adds the loss of half a step.

    Reads:   velocity, angular_velocity, radius, mass, fixed, damping, force_clock
    Writes:  damping_force, damping_torque, losses
    """
    particles = state.particles
    features = state.plan.features
    mobility = build_mobility(state)
    damping_of = build_damping_of(state)
    add_loss = build_add_damping_loss(state)

    @ti.func
    def damped(chunk, i, force, torque, dt):
        mass = particles.mass[i]
        found = mobility(i) * damping_of(force, particles.velocity[i], mass)
        found_torque = 0.0 * torque
        if ti.static(features.rotation):
            inertia = sphere_inertia(mass, particles.radius[i])
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
    control = state.control
    real = state.backend.real

    @ti.func
    def damping_of(force, velocity, mass):
        ratio = ti.cast(control.damping[0], real)
        rate = ti.cast(control.damping[1], real)
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
    """Device function (chunk, i, dt): add the loss of half a step with the present velocities.

    Reads:   velocity, angular_velocity, damping_force, damping_torque
    Writes:  losses
    """
    particles = state.particles
    control = state.control
    features = state.plan.features
    high_words_per_joule = state.parameter("per_unit", UNIT_ENERGY)
    loss_count = len(LOSSES)

    @ti.func
    def add_loss(chunk, i, dt):
        power = ti.cast(particles.damping_force[i], ti.f64).dot(ti.cast(particles.velocity[i], ti.f64))
        if ti.static(features.rotation):
            angular_velocity = ti.cast(particles.angular_velocity[i], ti.f64)
            power += ti.cast(particles.damping_torque[i], ti.f64).dot(angular_velocity)
        # Added once, this counts as half of the loss of a step (`sums.SHARES` is 2): the other half is added
        # with the force at the other end of the step.
        value = -ti.cast(high_words_per_joule(), ti.f64) * ti.cast(dt, ti.f64) * power
        add_energy(control.losses, chunk, LOSS_DAMPING, loss_count, 1, value)

    return add_loss
