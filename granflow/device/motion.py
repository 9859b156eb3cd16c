"""Motion of one chunk of particles: the leapfrog form of velocity Verlet.

Before a step, positions and forces stand at t, velocities and spins half a step earlier:

    v(t + dt/2) = v(t - dt/2) + dt F(t) / m          x(t + dt) = x(t) + dt v(t + dt/2)
"""

from typing import Any

import taichi as ti

from granflow.device.fixed import build_freedom
from granflow.device.guards import GUARD_LOST, GUARD_TRAVEL
from granflow.device.state import State


def build_move(state: State) -> Any:
    """Device function (chunk, count, time_step): kick and drift the particles of one chunk.

    Reads:   force, torque, mass, radius, fixed, position_at_search
    Writes:  velocity, velocity_now, spin, position, search_wanted, guard
    """
    plan, particles, control = state.plan, state.particles, state.control
    features, chunk_size = plan.features, plan.chunk_size
    free = build_freedom(state)
    near, farthest = (0.5 * plan.skin) ** 2, plan.travel_limit**2

    @ti.func
    def warn(code, i):
        ti.atomic_max(control.guard[0], code)
        ti.atomic_min(control.guard_particle[0], particles.id[i])

    @ti.func
    def move(chunk, count, dt):
        wanted = 0
        for i in range(chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)):
            kick = free(i) * dt / particles.mass[i] * particles.force[i]
            velocity = particles.velocity[i] + kick
            if ti.static(features.rate_dependent):
                particles.velocity_now[i] = velocity + 0.5 * kick
            particles.velocity[i] = velocity
            way = dt * velocity
            position = particles.position[i] + way
            particles.position[i] = position
            if ti.static(features.rotation):
                inertia = 0.4 * particles.mass[i] * particles.radius[i] * particles.radius[i]
                particles.spin[i] = particles.spin[i] + free(i) * dt / inertia * particles.torque[i]
            travel = position - particles.position_at_search[i]
            square = travel.dot(travel)
            if square > near:
                wanted = 1
            elif not square <= near:
                warn(GUARD_LOST, i)
            if way.dot(way) > farthest:
                warn(GUARD_TRAVEL, i)
        if wanted == 1:
            control.search_wanted[0] = 1

    return move
