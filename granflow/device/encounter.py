"""Geometry and kinematics of one near pair: what every law needs, for a partner grain or a wall alike."""

from typing import Any

import taichi as ti

from granflow.device.state import State
from granflow.device.walls import build_wall_geometry


def build_encounter(state: State, with_wall: bool) -> Any:
    """Device function (i, j, pose, time_step) -> what there is to know of a near pair; a wall's j is -1 - its index.

    Returns overlap [m] (0 or less: apart), normal from j to i, mean of this normal and that of a step earlier, part of
    the velocity of i relative to j across the normal half a step earlier, rate of overlap then and at the time of
    the positions [m/s] (> 0 approaching), lever arms of both [m], effective radius [m] and mass [kg]. Grains and
    walls have functions of their own, without a branch between them in the loops.

    Every operation gives exactly the opposite or the same number when i and j change places.
    """
    return _build_wall_encounter(state) if with_wall else _build_grain_encounter(state)


def _build_grain_encounter(state: State) -> Any:
    particles, features, real = state.particles, state.plan.features, state.backend.real

    @ti.func
    def grain_encounter(i, j, pose, time_step):
        radius, radius_partner = particles.radius[i], particles.radius[j]
        zero = 0.0 * particles.velocity[i]
        overlap, rate, arm, arm_partner = -radius, 0.0 * radius, radius, radius_partner
        normal, middle, across, radius_eff, mass_eff, late_rate = zero, zero, zero, radius, radius, 0.0 * radius
        apart = ti.cast(particles.position[i] - particles.position[j], real)
        reach = radius + radius_partner
        square = apart.dot(apart)
        if square < reach * reach:
            distance = ti.sqrt(square)
            inverse = 1.0 / distance
            overlap = reach - distance
            normal = inverse * apart
            late = particles.velocity[i] - particles.velocity[j]
            late_rate = -late.dot(normal)
            rate = late_rate
            if ti.static(features.rate_dependent):
                rate = -(particles.velocity_now[i] - particles.velocity_now[j]).dot(normal)
            across = late + late_rate * normal
            middle = normal - (0.5 * time_step * inverse) * across
            share = 1.0 / reach
            radius_eff = radius * radius_partner * share
            mass, mass_partner = particles.mass[i], particles.mass[j]
            mass_eff = mass * mass_partner / (mass + mass_partner)
            arm = radius - overlap * (share * radius_partner)
            arm_partner = radius_partner - overlap * (share * radius)
        return overlap, normal, middle, across, late_rate, rate, arm, arm_partner, radius_eff, mass_eff

    return grain_encounter


def _build_wall_encounter(state: State) -> Any:
    particles, features, real = state.particles, state.plan.features, state.backend.real
    geometry = build_wall_geometry(state)

    @ti.func
    def wall_encounter(i, j, pose, time_step):
        radius = particles.radius[i]
        zero = 0.0 * particles.velocity[i]
        normal, middle, across, late_rate, rate = zero, zero, zero, 0.0 * radius, 0.0 * radius
        gap, direction = geometry.closest(-1 - j, pose, particles.position[i])
        overlap = ti.cast(radius - gap, real)
        if overlap > 0.0:
            normal = ti.cast(direction, real)
            foot = particles.position[i] - gap * direction
            surface = ti.cast(geometry.surface_velocity(-1 - j, pose, foot), real)
            late = particles.velocity[i] - surface
            late_rate = -late.dot(normal)
            rate = late_rate
            if ti.static(features.rate_dependent):
                rate = -(particles.velocity_now[i] - surface).dot(normal)
            across = late + late_rate * normal
            middle = normal - (0.5 * time_step / ti.max(ti.cast(gap, real), 0.5 * radius)) * across
        arm = radius - overlap
        return overlap, normal, middle, across, late_rate, rate, arm, 0.0 * radius, radius, particles.mass[i]

    return wall_encounter


def build_either_encounter(state: State) -> Any:
    """Device function as those of `build_encounter`, for grains and walls alike: for surveys, where speed is no matter.

    Returns (overlap, rate, effective radius, effective mass).
    """
    grain = build_encounter(state, False)
    wall = build_encounter(state, True) if state.plan.has_walls else grain

    @ti.func
    def either(i, j, pose, time_step):
        overlap, rate = 0.0 * particles.radius[i], 0.0 * particles.radius[i]
        radius_eff, mass_eff = overlap, overlap
        if j < 0:
            overlap, _n, _m, _c, _l, rate, _a, _p, radius_eff, mass_eff = wall(i, j, pose, time_step)
        else:
            overlap, _n2, _m2, _c2, _l2, rate, _a2, _p2, radius_eff, mass_eff = grain(i, j, pose, time_step)
        return overlap, rate, radius_eff, mass_eff

    particles = state.particles
    return either


def build_weight(state: State) -> Any:
    """Device function: 1 for a pair that stands in one row, 1/2 for one that stands in two."""
    chunk_size = state.plan.chunk_size

    @ti.func
    def weight(i, j):
        share = 1.0
        if j >= 0 and i // chunk_size != j // chunk_size:
            share = 0.5
        return share

    return weight


def build_pair_number(state: State) -> Any:
    """Device function: row of the pair constants for particle i and partner j."""
    plan, particles, walls = state.plan, state.particles, state.walls
    features = plan.features

    @ti.func
    def pair_number(i, j):
        number = 0
        if ti.static(not features.one_material):
            number = particles.material[i] * plan.material_count
            if j >= 0:
                number += particles.material[j]
        if ti.static(plan.has_walls):
            if j < 0:
                number += walls.material[-1 - j]
        return number

    return pair_number
