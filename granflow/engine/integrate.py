"""Time integration of one chunk of particles: the leapfrog form of velocity Verlet.

Before a step, positions and forces are at t, velocities and angular velocities half a step earlier:

    v(t + dt/2) = v(t - dt/2) + dt F(t) / m          x(t + dt) = x(t) + dt v(t + dt/2)

Dashpots need the velocity at the time of the positions; it is extrapolated with the force at t:

    velocity_synchronized = v(t + dt/2) + dt F(t) / (2 m)
"""

from typing import Any

from granflow.engine.clumps import build_integrate_clumps, build_kick_clump
from granflow.engine.exact_sums import build_weight_rest
from granflow.engine.force.damping import build_add_damping_loss
from granflow.engine.force.external_forces import build_add_external_work
from granflow.engine.force.liquid_transfer import build_begin_step
from granflow.engine.force.wall_forces import build_carry_impulses
from granflow.engine.frozen_masks import build_mobility
from granflow.engine.limits import ABORT_DISPLACEMENT, ABORT_FORCE, ABORT_NOT_FINITE
from granflow.engine.periodic_box import build_wrap
from granflow.engine.state import State
from granflow.engine.velocity_sums import build_changed
from granflow.kernel_language import ti
from granflow.plan.sum_units import FORCE, SUM_BITS, TORQUE

LIMIT_SQUARED = 2.0 ** (2 * SUM_BITS)
"""Largest squared sum of forces or torques in units: below it, all sums are exact."""


def build_integrate(state: State) -> Any:
    """Device function (chunk, count, pose, time_step): kick and drift the particles of one chunk.

    Requests a rebuild if a particle has moved by more than its reach since the last one; aborts if a position is
    not finite, a displacement in one step exceeds `plan.travel_limit`, or a force the range of exact sums.

    Reads:   parameters, force, torque, mass, radius, fixed, position_at_rebuild, reach
    Writes:  velocity, velocity_synchronized, angular_velocity, position, rebuild_requested, abort, abort_particle,
             external_work, losses, impulses; as `build_changed`, `build_wrap`, `build_begin_step`, `build_move_clump`
    """
    particles, features = state.particles, state.plan.features
    periodic, counts_damping = features.periodic != "none", features.damping != "none" and features.energy_budget
    step_limit, wrap = state.parameter("travel_limit_squared"), build_wrap(state) if periodic else None
    add_work, carry_impulses = build_add_external_work(state), build_carry_impulses(state)
    add_damping_loss = build_add_damping_loss(state) if counts_damping else None
    weight_rest, begin_step, mobility = build_weight_rest(state), build_begin_step(state), build_mobility(state)
    square_of_sums, request, real = _build_square_of_sums(state), _build_request(state), state.backend.real
    changed_velocity, changed_rotation = (build_changed(state, name) for name in ("velocity", "angular_velocity"))
    integrate_clumps = build_integrate_clumps(state, request, square_of_sums) if features.clumps else None
    gravity, shift, per_unit, chunk_size = map(state.parameter, ("gravity", "shift", "per_unit", "chunk_size"))

    @ti.func
    def integrate(chunk, count, pose, dt):
        carry_impulses(chunk)
        size, step_squared_limit = chunk_size(), step_limit()
        acceleration, shift_of_force, units = ti.cast(gravity(), real), shift()[FORCE], per_unit()
        for i in range(chunk * size, ti.min((chunk + 1) * size, count)):
            if ti.static(features.clumps):
                if particles.clump[i] >= 0:
                    continue
            begin_step(i)
            mass, force, torque = particles.mass[i], particles.force[i], 0.0 * particles.force[i]
            kick = mobility(i) * dt / mass * (force + weight_rest(mass * acceleration, shift_of_force))
            velocity = changed_velocity(i, kick)
            if ti.static(features.rate_dependent):
                particles.velocity_synchronized[i] = velocity + 0.5 * kick
            particles.velocity[i] = velocity  # an assignment: Taichi compiles `+=` on a field to an atomic operation
            if ti.static(features.external_forces and features.energy_budget):
                add_work(chunk, i, particles.external_force[i], velocity, dt)
            step_displacement = dt * velocity
            position = particles.position[i] + step_displacement
            particles.position[i] = position
            if ti.static(features.rotation):
                torque = particles.torque[i]  # a sphere needs no orientation and no gyroscopic term
                inertia = 0.4 * mass * particles.radius[i] * particles.radius[i]
                particles.angular_velocity[i] = changed_rotation(i, mobility(i) * dt / inertia * torque)
            if ti.static(counts_damping):
                add_damping_loss(chunk, i, dt)
            displacement, reach = (position - particles.position_at_rebuild[i]).norm_sqr(), particles.reach[i]
            step, sums = step_displacement.norm_sqr(), square_of_sums(force, torque, units)
            # One branch per particle: with one for each limit, the whole step takes 8 % longer.
            is_usual = (displacement <= reach * reach) & (step <= step_squared_limit) & (sums <= LIMIT_SQUARED)
            if not is_usual:
                request(i, displacement, reach * reach, step, step_squared_limit, sums)
            if ti.static(periodic):
                wrap(chunk, i, pose, dt)
        if ti.static(features.clumps):
            integrate_clumps(chunk, count, pose, dt)

    return integrate


def _build_request(state: State) -> Any:
    """Device function: request a rebuild or an abort because of particle i.

    Arguments: i, squares of the displacement since the last rebuild and of the reach [m^2], squares of the displacement
    in this step and of its limit [m^2], `square_of_sums`.

    Writes:  rebuild_requested, abort, abort_particle
    """
    particles, control = state.particles, state.control

    @ti.func
    def request(i, displacement, reach, step, step_squared_limit, sums):
        abort = 0
        if displacement > reach:
            control.rebuild_requested[0] = 1
        elif not displacement <= reach:  # NaN fails both comparisons
            abort = ti.max(abort, ABORT_NOT_FINITE)
        if sums > LIMIT_SQUARED:
            abort = ti.max(abort, ABORT_FORCE)
        # Above this limit a particle could pass another one, or a wall, between two force evaluations.
        if step > step_squared_limit:
            abort = ti.max(abort, ABORT_DISPLACEMENT)
        if abort > 0:
            ti.atomic_max(control.abort[0], abort)
            ti.atomic_min(control.abort_particle[0], particles.id[i])

    return request


def _build_square_of_sums(state: State) -> Any:
    """Device function (force, torque, per_unit): the larger of their squares in units; sums are exact below a limit."""
    rotation = state.plan.features.rotation

    @ti.func
    def square_of_sums(force, torque, units):
        square = (ti.cast(units[FORCE], ti.f64) * ti.cast(force, ti.f64)).norm_sqr()
        if ti.static(rotation):
            square = ti.max(square, (ti.cast(units[TORQUE], ti.f64) * ti.cast(torque, ti.f64)).norm_sqr())
        return square

    return square_of_sums


def build_kick(state: State) -> Any:
    """Kernel (count, time [s]): change velocities by the present forces; backwards if the time is negative.

        v += time F / m,   w += time M / I,   I = (2/5) m R^2

    Fixed particles keep their velocity; of clumps the state changes, not yet the velocities of the spheres.

    Reads:   force, torque, mass, radius, fixed, clump
    Writes:  velocity, angular_velocity; clumps as `build_kick_clump`
    """
    particles, rotation, real = state.particles, state.plan.features.rotation, state.backend.real
    mobility, clumps = build_mobility(state), state.plan.features.clumps
    kick_clump = build_kick_clump(state) if clumps else None

    @ti.kernel
    def kick(count: ti.i32, time: real):
        for i in range(count):
            if ti.static(clumps):
                if particles.clump[i] >= 0:
                    kick_clump(i, time)
                    continue
            particles.velocity[i] = particles.velocity[i] + mobility(i) * time / particles.mass[i] * particles.force[i]
            if ti.static(rotation):
                inertia = 0.4 * particles.mass[i] * particles.radius[i] * particles.radius[i]
                particles.angular_velocity[i] = (
                    particles.angular_velocity[i] + mobility(i) * time / inertia * particles.torque[i]
                )

    return kick
