"""Forces on a particle alone, which few scenes have: external forces, and damping of all motion.

External forces are device functions of a program; with damping, a scene settles. Both are evaluated with the
contact forces, at the time of the positions, and are part of `force`: integration, synchronized velocities
and snapshots need no other term. `step.TimeStep` adds them to the sums over the contacts.

Velocities are half a step behind the positions; where a force depends on the velocity, it is extrapolated
by `lag`, half a step. The host writes it with the time of the forces (`write_force_inputs`).
"""

from typing import Any

from granflow.device_functions import at_compile_time
from granflow.engine.backend import Backend
from granflow.engine.fields import FieldBlock
from granflow.engine.pair import number_at, vector_at
from granflow.engine.state import State
from granflow.engine.sums import add_energy
from granflow.geometry.sphere import sphere_inertia
from granflow.kernel_language import ti
from granflow.plan.plan import ExternalForce
from granflow.plan.sum_units import LOSS_DAMPING, LOSSES, UNIT_ENERGY

# External forces and their work
#
# The velocity is extrapolated with the total force, first without and then with the external forces; D(F)
# is the damping force:
#
#     v'  = v(t - dt/2) + dt/2 (F + D(F)) / m
#     v'' = v(t - dt/2) + dt/2 (F + f(v') + D(F + f(v'))) / m,      f = f(x(t), v'', t)
#
# which is of second order in dt for velocity-dependent forces. The motion of a sphere of a clump depends on
# the forces on the other spheres: v'' is then the velocity half a step before, and the force is of first
# order. The work of a step is the mean of the forces at its ends times the displacement:
#
#     W = dt v(t + dt/2) . [f(t) + f(t + dt)] / 2


class ExternalForces:
    """Sum of the external forces on a particle, and its work.

    Reads:   position, velocity, radius, mass, fixed, force_clock, force_parameters, steps_done; as `Damping`
    Writes:  external_force, external_work
    """

    def __init__(self, state: State) -> None:
        self.particles = state.particles
        self.control = state.control
        self.features = state.plan.features
        self.real = state.backend.real
        self.damping = state.built(Damping)
        self.high_words_per_joule = state.parameter("per_unit", UNIT_ENERGY)
        self.calls = []
        first = 0
        for force in state.plan.external_forces:
            self.calls.append(_build_call(force, first, state.control.force_parameters))
            first += sum(width for _, width in force.layout)

    @ti.func
    def force(self, chunk, i, others, dt):
        """External force [N] on particle i; `others` [N]: its other forces, without damping."""
        first = self._total(i, self._present_velocity(i, others))
        found = self._total(i, self._present_velocity(i, others + first))
        self.particles.external_force[i] = found
        if ti.static(self.features.energy_budget):
            self.add_work(chunk, i, found, self.particles.velocity[i], dt)
        return found

    @ti.func
    def _present_velocity(self, i, force):
        """Velocity [m/s] at the time of the positions, with a force [N] without damping."""
        total = force
        if ti.static(self.features.damping != "none"):
            total = force + self.damping.of(force, self.particles.velocity[i], self.particles.mass[i])
        share = self.particles.mobility(i)
        if ti.static(self.features.clumps):
            share *= ti.cast(self.particles.clump[i] < 0, self.real)
        lag = share * ti.cast(self.control.force_clock[3], self.real) / self.particles.mass[i]
        return self.particles.velocity[i] + lag * total

    @ti.func
    def _total(self, i, velocity):
        """Sum of all external forces [N] at a velocity [m/s]."""
        since = self.control.force_clock[0]
        time_step = self.control.force_clock[1]
        count = self.control.force_clock[2]
        time = since + (count + ti.cast(self.control.steps_done[0], ti.f64)) * time_step
        total = ti.Vector.zero(self.real, 3)
        for call in ti.static(self.calls):
            found = call(
                self.particles.position[i], velocity, self.particles.radius[i], self.particles.mass[i], time
            )
            total += ti.cast(found, self.real)
        return total

    @ti.func
    def add_work(self, chunk, i, force, velocity, dt):
        """Add the work of half a step; `velocity` [m/s]: at the half step. Fixed particles do not move."""
        share = ti.cast(self.particles.mobility(i), ti.f64)
        power = share * ti.cast(force, ti.f64).dot(ti.cast(velocity, ti.f64))
        # Added once, this counts as half of the work of a step (`sums.SHARES` is 2): the other half is added
        # with the force at the other end of the step.
        value = ti.cast(self.high_words_per_joule(), ti.f64) * ti.cast(dt, ti.f64) * power
        add_energy(self.control.external_work, chunk, 0, 1, 1, value)


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


def write_force_inputs(state: State, step: int, velocities_lag: bool) -> None:
    """Write clock and parameters of external forces and damping, for forces after step number `step`.

    `velocities_lag`: velocities are half a step behind the positions.
    """
    control = state.control
    clock = state.clock.state_dict()
    lag = 0.5 * clock["time_step"] if velocities_lag else 0.0
    for k, value in enumerate((clock["since_time"], clock["time_step"], step - clock["since_step"], lag)):
        control.force_clock[k] = float(value)
    numbers = [number for force in state.plan.external_forces for number in force.numbers]
    for k, number in enumerate(numbers):
        control.force_parameters[k] = number


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


class Damping:
    """Damping force and torque on a particle, and their loss.

    Reads:   velocity, angular_velocity, radius, mass, fixed, damping, force_clock, damping_force,
             damping_torque
    Writes:  damping_force, damping_torque, losses
    """

    def __init__(self, state: State) -> None:
        self.particles = state.particles
        self.control = state.control
        self.features = state.plan.features
        self.real = state.backend.real
        self.loss_count = len(LOSSES)
        self.high_words_per_joule = state.parameter("per_unit", UNIT_ENERGY)

    @ti.func
    def forces(self, chunk, i, force, torque, dt):
        """Damping force [N] and torque [N m]; arguments are without damping. Adds the loss of half a step."""
        mass = self.particles.mass[i]
        share = self.particles.mobility(i)
        found = share * self.of(force, self.particles.velocity[i], mass)
        found_torque = 0.0 * torque
        if ti.static(self.features.rotation):
            inertia = sphere_inertia(mass, self.particles.radius[i])
            found_torque = share * self.of(torque, self.particles.angular_velocity[i], inertia)
        if ti.static(self.features.energy_budget):
            self.particles.damping_force[i] = found
            if ti.static(self.features.rotation):
                self.particles.damping_torque[i] = found_torque
            self.add_loss(chunk, i, dt)
        return found, found_torque

    @ti.func
    def of(self, force, velocity, mass):
        """Damping of a force at a velocity of the half step; the same for torque, rotation and inertia."""
        ratio = ti.cast(self.control.damping[0], self.real)
        rate = ti.cast(self.control.damping[1], self.real)
        lag = ti.cast(self.control.force_clock[3], self.real)
        present = velocity + (lag / mass) * force
        found = 0.0 * force
        for k in ti.static(range(3)):
            sign = ti.select(present[k] > 0.0, 1.0, ti.select(present[k] < 0.0, -1.0, 0.0))
            found[k] = -ratio * ti.abs(force[k]) * ti.cast(sign, self.real)
        drag = -(rate * mass / (1.0 + rate * lag)) * (present + (lag / mass) * found)
        return found + drag

    @ti.func
    def add_loss(self, chunk, i, dt):
        """Add the loss of half a step with the present velocities."""
        velocity = ti.cast(self.particles.velocity[i], ti.f64)
        power = ti.cast(self.particles.damping_force[i], ti.f64).dot(velocity)
        if ti.static(self.features.rotation):
            angular_velocity = ti.cast(self.particles.angular_velocity[i], ti.f64)
            power += ti.cast(self.particles.damping_torque[i], ti.f64).dot(angular_velocity)
        self.add_power(chunk, power, dt)

    @ti.func
    def add_power(self, chunk, power, dt):
        """Add the loss of half a step with this power [W] of the damping forces, which is negative."""
        # Added once, this counts as half of the loss of a step (`sums.SHARES` is 2): the other half is added
        # with the force at the other end of the step.
        value = -ti.cast(self.high_words_per_joule(), ti.f64) * ti.cast(dt, ti.f64) * power
        add_energy(self.control.losses, chunk, LOSS_DAMPING, self.loss_count, 1, value)
