"""Geometry and kinematics of one near pair, read from the state, for a partner grain or a wall alike."""

from typing import Any

import taichi as ti

from granflow.device.apart import build_apart, build_drift
from granflow.device.fixed import build_felt_mass
from granflow.device.pair import build_meet, build_touches, half_of_both
from granflow.device.state import State
from granflow.device.walls import build_wall_geometry, build_wall_of


def build_encounter(state: State, with_wall: bool) -> Any:
    """Device function (i, j, pose, time_step) -> what there is to know of a near pair; a wall's j is -1 - its index.

    Returns overlap [m] (0 or less: apart), normal from j to i, mean of this normal and that of a step earlier, part of
    the velocity of i relative to j across the normal half a step earlier, rate of overlap then and at the time of
    the positions [m/s] (> 0 approaching), lever arms of both [m]. Grains and walls have functions of their own,
    without a branch between them in the loops.
    """
    return _build_wall_encounter(state) if with_wall else _build_grain_encounter(state)


def _build_grain_encounter(state: State) -> Any:
    particles, features, real = state.particles, state.plan.features, state.backend.real
    meet, touches = build_meet(state.plan), build_touches(real)
    apart, drift = build_apart(state), build_drift(state)

    @ti.func
    def grain_encounter(i, j, pose, time_step):
        radius, radius_partner = particles.radius[i], particles.radius[j]
        zero = 0.0 * particles.velocity[i]
        overlap, rate, arm, arm_partner = -radius, 0.0 * radius, radius, radius_partner
        normal, middle, across, late_rate = zero, zero, zero, 0.0 * radius
        between = ti.cast(apart(particles.position[i], particles.position[j], pose), real)
        if touches(between.dot(between), radius + radius_partner):
            late = particles.velocity[i] - particles.velocity[j] - drift(i, j, pose)
            now = late
            if ti.static(features.rate_dependent):
                now = particles.velocity_now[i] - particles.velocity_now[j] - drift(i, j, pose)
            overlap, normal, middle, across, late_rate, rate, arm, arm_partner = meet(
                radius, radius_partner, between, late, now, time_step
            )
        return overlap, normal, middle, across, late_rate, rate, arm, arm_partner

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
        return overlap, normal, middle, across, late_rate, rate, radius - overlap, 0.0 * radius

    return wall_encounter


def build_effective(state: State, with_wall: bool) -> Any:
    """Device function (i, j): effective radius [m], mass [kg] and moment of inertia [kg m2] of a pair."""
    particles, felt_mass = state.particles, build_felt_mass(state)

    @ti.func
    def inertia(i):
        return 0.4 * felt_mass(i) * particles.radius[i] * particles.radius[i]

    @ti.func
    def effective(i, j):
        radius_eff, mass_eff, inertia_eff = particles.radius[i], felt_mass(i), inertia(i)
        if ti.static(not with_wall):
            radius_eff = half_of_both(radius_eff, particles.radius[j])
            mass_eff = half_of_both(mass_eff, felt_mass(j))
            inertia_eff = half_of_both(inertia_eff, inertia(j))
        return radius_eff, mass_eff, inertia_eff

    return effective


def build_either_encounter(state: State) -> Any:
    """Device function as those of `build_encounter`, for grains and walls alike: for surveys, where speed is no matter.

    Returns (overlap, normal, rate, effective radius, effective mass).
    """
    has_walls = state.plan.has_walls
    grain, grain_effective = build_encounter(state, False), build_effective(state, False)
    wall = build_encounter(state, True) if has_walls else grain
    wall_effective = build_effective(state, True)
    particles = state.particles

    @ti.func
    def either(i, j, pose, time_step):
        overlap, rate, normal = 0.0 * particles.radius[i], 0.0 * particles.radius[i], 0.0 * particles.velocity[i]
        radius_eff, mass_eff, _inertia = wall_effective(i, j)
        if j < 0:
            overlap, normal, _m, _c, _l, rate, _a, _p = wall(i, j, pose, time_step)
        else:
            radius_eff, mass_eff, _inertia = grain_effective(i, j)
            overlap, normal, _m2, _c2, _l2, rate, _a2, _p2 = grain(i, j, pose, time_step)
        return overlap, normal, rate, radius_eff, mass_eff

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


def build_border_work(state: State) -> Any:
    """Device function (chunk, i, j, force on i, pose, time_step): enter the work of the moving image of j on a pair.

    W = F_ij . (velocity of the image over its original) dt, once for each pair.
    """
    weight, drift = build_weight(state), build_drift(state)
    border_work: Any = state.control.border_work

    @ti.func
    def enter_border_work(chunk, i, j, force, pose, dt):
        work = weight(i, j) * dt * force.dot(drift(i, j, pose))
        border_work[chunk] = border_work[chunk] + ti.cast(work, ti.f64)

    return enter_border_work


def build_pair_number(state: State) -> Any:
    """Device function: row of the pair constants for particle i and partner j."""
    plan, particles, walls = state.plan, state.particles, state.walls
    features, wall_of = plan.features, build_wall_of(state)

    @ti.func
    def pair_number(i, j):
        number = 0
        if ti.static(not features.one_material):
            number = particles.material[i] * plan.material_count
            if j >= 0:
                number += particles.material[j]
        if ti.static(plan.has_walls):
            if j < 0:
                number += walls.material[wall_of(j)]
        return number

    return pair_number
