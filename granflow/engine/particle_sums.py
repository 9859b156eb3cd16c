"""Sums over the particles for the totals of a snapshot: on the host from its arrays, or on a GPU without copying them.

Both add the same terms, rounded to the same unit, so that the order of the particles does not matter, see `exact_sum`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow.engine.accounting import mechanical_energy
from granflow.engine.exact_sums import REDUCED_ROWS, build_to_nearest, exact_total, scale_exponent
from granflow.engine.frozen_masks import build_mobility, mobility_mask
from granflow.engine.ranks import ALONE, Gathering
from granflow.engine.state import State
from granflow.kernel_language import ti

ENERGY_COUNT = 3
"""Kinetic, rotational and gravitational energy."""

PARTICLE_CONTACTS, MOBILE, WALL_CONTACTS = range(ENERGY_COUNT, ENERGY_COUNT + 3)
"""Columns of further sums: contacts of mobile particles with particles, mobile particles, contacts with walls."""

LARGEST_SPEED_SQUARED = ENERGY_COUNT
"""Column of the largest values."""


@dataclass(frozen=True)
class ParticleSums:
    """Sums over all particles at the time of the positions.

    count:                number of particles
    energies:             kinetic, rotational and gravitational energy [J]
    speed:                largest speed [m/s]
    coordination_number:  mean number of contacts with particles, of mobile particles
    wall_contact_count:   number of contacts with walls
    """

    count: int
    energies: tuple[float, float, float]
    speed: float
    coordination_number: float
    wall_contact_count: float


def host_sums(arrays: Mapping[str, np.ndarray], gravity: np.ndarray, ranks: Gathering = ALONE) -> ParticleSums:
    """Sums of particles on the host.

    arrays:   as for `mechanical_energy`, and coordination_number (n,), wall_contact_count (n,) with walls, fixed (n,)
              with fixed particles
    gravity:  (3,) [m/s2]
    ranks:    adds up the sums of all ranks
    """
    mobile, walls = mobility_mask(arrays), arrays.get("wall_contact_count", np.zeros(0))
    sums = [len(arrays["mass"]), mobile @ arrays["coordination_number"], mobile.sum(), walls.sum()]
    count, contacts, mobile_count, wall_contacts = ranks.total(np.array([sums], float))[0].tolist()
    return ParticleSums(
        count=int(count),
        energies=mechanical_energy(arrays, gravity, ranks),
        speed=ranks.largest(largest_speed(arrays["velocity"])),
        coordination_number=contacts / max(mobile_count, 1.0),
        wall_contact_count=wall_contacts,
    )


def largest_speed(velocity: np.ndarray) -> float:
    """Largest speed [m/s] of velocities (n, 3)."""
    return float(np.sqrt(np.einsum("ij,ij->i", velocity, velocity).max(initial=0.0)))


def device_sums(state: State, half_step: float) -> ParticleSums:
    """Sums of the particles on a GPU: two kernels and two arrays of REDUCED_ROWS rows.

    half_step:  time [s] by which velocities are behind the positions; 0 before the first step
    """
    if not state.count:
        return ParticleSums(0, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0)
    find_largest, add_up = state.built(_build_particle_sums)
    largest = np.zeros((REDUCED_ROWS, ENERGY_COUNT + 1))
    find_largest(state.count, half_step, largest)
    largest = largest.max(axis=0)
    exponents = [scale_exponent(value, state.count) for value in largest[:ENERGY_COUNT].tolist()]
    units = np.zeros((REDUCED_ROWS, WALL_CONTACTS + 1), np.int64)
    add_up(state.count, half_step, *(2.0**exponent for exponent in exponents), units)
    kinetic, rotational, potential = (
        exact_total(units[:, k]) * 2.0**-exponent if np.isfinite(largest[k]) else float(largest[k])
        for k, exponent in enumerate(exponents)
    )
    contacts, mobile, walls = units[:, ENERGY_COUNT:].sum(axis=0).tolist()
    energies = (0.5 * kinetic, 0.5 * rotational, -potential)
    speed = float(np.sqrt(largest[LARGEST_SPEED_SQUARED]))
    return ParticleSums(state.count, energies, speed, contacts / max(mobile, 1.0), float(walls))


def _build_particle_sums(state: State) -> tuple[Callable[..., None], Callable[..., None]]:
    """Kernels (count, half step, rows) and (count, half step, three scales, rows).

    The first finds the largest magnitude of the energies and the largest squared speed of every REDUCED_ROWS-th
    particle, the second their sums in units of 1 / scale, and the further sums.

    Reads:  position, velocity, angular_velocity, force, torque, mass, radius, fixed, contact counts
    """
    particles, features = state.particles, state.plan.features
    terms_of, to_nearest, mobility = _build_energy_terms(state), build_to_nearest(), build_mobility(state)
    external: Any = ti.types.ndarray()

    @ti.kernel
    def find_largest(count: ti.i32, half_step: ti.f64, rows: external):
        for row in range(REDUCED_ROWS):
            largest, speed_squared = ti.Vector.zero(ti.f64, ENERGY_COUNT), ti.cast(0.0, ti.f64)
            for k in range((count - row + REDUCED_ROWS - 1) // REDUCED_ROWS):
                terms, squared = terms_of(row + k * REDUCED_ROWS, half_step)
                largest = ti.max(largest, ti.abs(terms))
                speed_squared = ti.max(speed_squared, squared)
            for energy in ti.static(range(ENERGY_COUNT)):
                rows[row, energy] = largest[energy]
            rows[row, LARGEST_SPEED_SQUARED] = speed_squared

    @ti.kernel
    def add_up(
        count: ti.i32, half_step: ti.f64, kinetic: ti.f64, rotational: ti.f64, potential: ti.f64, rows: external
    ):
        for row in range(REDUCED_ROWS):
            sums, scale = ti.Vector.zero(ti.i64, WALL_CONTACTS + 1), ti.Vector([kinetic, rotational, potential])
            for k in range((count - row + REDUCED_ROWS - 1) // REDUCED_ROWS):
                i = row + k * REDUCED_ROWS
                terms, _squared = terms_of(i, half_step)
                for energy in ti.static(range(ENERGY_COUNT)):
                    sums[energy] += to_nearest(terms[energy] * scale[energy])
                is_mobile = ti.cast(mobility(i), ti.i64)
                sums[PARTICLE_CONTACTS] += is_mobile * particles.coordination_number[i]
                sums[MOBILE] += is_mobile
                if ti.static(features.walls):
                    sums[WALL_CONTACTS] += particles.wall_contact_count[i]
            for column in ti.static(range(WALL_CONTACTS + 1)):
                rows[row, column] = sums[column]

    return find_largest, add_up


def _build_energy_terms(state: State) -> Any:
    """Device function (i, half step): twice the kinetic and rotational energy and -U [J], and the squared speed.

    Operations are in the order of `Engine.synchronized` and `mechanical_energy`.

    Reads:  position, velocity, angular_velocity, force, torque, mass, radius, fixed
    """
    particles, rotation, mobility = state.particles, state.plan.features.rotation, build_mobility(state)
    gravity = state.parameter("gravity")

    @ti.func
    def to_f64(vector):
        return ti.cast(vector, ti.f64)

    @ti.func
    def terms_of(i, half_step):
        mass, share = to_f64(particles.mass[i]), to_f64(mobility(i))
        velocity = to_f64(particles.velocity[i]) + half_step * share * to_f64(particles.force[i]) / mass
        squared = velocity[0] * velocity[0] + velocity[1] * velocity[1] + velocity[2] * velocity[2]
        turning = ti.cast(0.0, ti.f64)
        if ti.static(rotation):
            radius = to_f64(particles.radius[i])
            inertia = 0.4 * mass * (radius * radius)
            spin = to_f64(particles.angular_velocity[i]) + half_step * share * to_f64(particles.torque[i]) / inertia
            inertia_mobile = 0.4 * (mass * share) * (radius * radius)
            turning = inertia_mobile * (spin[0] * spin[0] + spin[1] * spin[1] + spin[2] * spin[2])
        x, g = to_f64(particles.position[i]), gravity()
        height = x[0] * g[0] + x[1] * g[1] + x[2] * g[2]
        return ti.Vector([mass * share * squared, turning, mass * share * height]), squared

    return terms_of
