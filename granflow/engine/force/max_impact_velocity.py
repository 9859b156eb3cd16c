"""Maximum impact velocity of the present state, from which an adaptive time step is computed."""

from typing import Any

import numpy as np

from granflow.engine.field_block import FieldBlock
from granflow.engine.force.pair_force import build_sphere_kinematics
from granflow.engine.force.pair_kinematics import build_effective, build_pair_constants
from granflow.engine.periodic_box import build_image_velocity, build_minimum_image
from granflow.engine.state import State
from granflow.engine.walls import WallGeometry
from granflow.kernel_language import ti


class MaxImpactVelocity:
    """Evaluates all candidate pairs and walls. The result is a maximum, independent of threads and order."""

    def __init__(self, state: State) -> None:
        self.state = state
        self.block = FieldBlock(state.backend)
        self._squares = self.block.scalar(state.backend.real, state.plan.capacities.chunks)
        self.block.finish()
        self._scan = _build_scan(state, self._squares)

    def measure(self) -> float:
        """Largest impact velocity [m/s] of all candidate pairs, including the elastic energy of present overlaps.

        On MPI ranks, of those of all ranks.
        """
        state, largest = self.state, 0.0
        if state.count:
            self._scan(state.chunk_count, state.count, state.clock.time_step)
            largest = float(np.sqrt(self._squares.to_numpy()[: state.chunk_count].max()))
        return state.ranks.largest(largest)


def _build_scan(state: State, squares: Any) -> Any:
    """Kernel (chunks, count, time_step): largest squared impact velocity [m2/s2] of each chunk.

    Reads:   position, velocity, radius, mass, neighbor lists, walls
    Writes:  squares
    """
    neighbors, stride, real = state.neighbors, state.stride, state.backend.real
    chunk_size, energy_velocity_squared = state.parameter("chunk_size"), _build_square(state)

    @ti.kernel
    def scan(chunks: ti.i32, count: ti.i32, dt: real):
        for task in range(chunks * stride):
            if task % stride == 0:
                chunk = task // stride
                largest = ti.cast(0.0, real)
                for i in range(chunk * chunk_size(), ti.min((chunk + 1) * chunk_size(), count)):
                    for list_index in range(neighbors.list_begin[i], neighbors.list_end[i]):
                        largest = ti.max(largest, energy_velocity_squared(i, neighbors.partner[list_index], dt))
                squares[chunk] = largest

    return scan


def _build_square(state: State) -> Any:
    """Device function (i, j, time_step): squared impact velocity with the kinetic and elastic energy of a pair.

        v^2 = d'^2 + 4 k d^2.5 / (5 M)        (Zhou 2011, Eq. 5)

    For a pair without overlap v is the approach velocity, 0 if the pair separates.
    """
    overlap_and_rate, pair_constants = _build_overlap_and_rate(state), build_pair_constants(state)
    effective, wall_effective = build_effective(state, False), build_effective(state, True)

    @ti.func
    def energy_velocity_squared(i, j, dt):
        overlap, rate = overlap_and_rate(i, j, dt)
        found = ti.max(rate, 0.0) ** 2
        if overlap > 0.0:
            bodies = wall_effective(i, j)
            if j >= 0:
                bodies = effective(i, j)
            constants = pair_constants(i, j)
            k = 4.0 / 3.0 * constants.normal.modulus_eff * ti.sqrt(bodies.radius_eff)
            found = rate * rate + 0.8 * k * overlap * overlap * ti.sqrt(overlap) / bodies.mass_eff
        return found

    return energy_velocity_squared


def _build_overlap_and_rate(state: State) -> Any:
    """Device function (i, j, time_step): overlap [m], negative for a gap, and overlap rate [m/s] of a pair.

    Walls are at pose 0. Velocities are half a step behind the positions.
    """
    particles, real, has_walls = state.particles, state.backend.real, state.plan.has_walls
    sphere_kinematics, geometry = build_sphere_kinematics(state.plan), WallGeometry(state)
    minimum_image, image_velocity = build_minimum_image(state), build_image_velocity(state)

    @ti.func
    def overlap_and_rate(i, j, dt):
        overlap, rate = 0.0 * particles.radius[i], 0.0 * particles.radius[i]
        if j >= 0:
            branch = ti.cast(minimum_image(particles.position[i], particles.position[j], 0), real)
            velocity_rel_half = particles.velocity[i] - particles.velocity[j] - image_velocity(i, j, 0)
            kinematics = sphere_kinematics(
                particles.radius[i], particles.radius[j], branch, velocity_rel_half, velocity_rel_half, dt
            )
            overlap, rate = kinematics.overlap, kinematics.overlap_rate_half
        elif ti.static(has_walls):
            gap, normal = geometry.closest(-1 - j, 0, particles.position[i])
            wall_velocity = geometry.velocity(-1 - j, 0, particles.position[i])
            overlap = ti.cast(particles.radius[i] - gap, real)
            rate = -(particles.velocity[i] - ti.cast(wall_velocity, real)).dot(ti.cast(normal, real))
        return overlap, rate

    return overlap_and_rate
