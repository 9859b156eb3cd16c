"""Geometry and kinematics of one near pair: what every law needs, for a partner grain or a wall alike."""

from typing import Any

import taichi as ti

from granflow.device.state import State
from granflow.device.walls import build_wall_geometry


def build_encounter(state: State) -> Any:
    """Device function (i, j, pose, time_step) -> what there is to know of the near pair; j < 0 is wall -1 - j.

    Returns overlap [m] (0 or less: apart), normal from j to i, the normal half a step earlier, relative velocity
    of the surfaces at the contact half a step earlier without spin, rate of overlap [m/s] (> 0 approaching),
    lever arms of both [m], effective radius [m] and mass [kg].

    Every operation gives exactly the opposite or the same number when i and j change places.
    """
    plan, particles = state.plan, state.particles
    features, real = plan.features, state.backend.real
    geometry = build_wall_geometry(state)

    @ti.func
    def velocities(i, j):
        """Relative velocity half a step back, and as of the positions where a law needs that."""
        late = particles.velocity[i] - particles.velocity[j]
        now = late
        if ti.static(features.rate_dependent):
            now = particles.velocity_now[i] - particles.velocity_now[j]
        return late, now

    @ti.func
    def wall_velocities(i, w, pose, foot):
        surface = ti.cast(geometry.surface_velocity(w, pose, foot), real)
        late = particles.velocity[i] - surface
        now = late
        if ti.static(features.rate_dependent):
            now = particles.velocity_now[i] - surface
        return late, now

    @ti.func
    def encounter(i, j, pose, time_step):
        radius, mass = particles.radius[i], particles.mass[i]
        overlap, distance = -radius, radius
        normal, late, now = 0.0 * particles.velocity[i], 0.0 * particles.velocity[i], 0.0 * particles.velocity[i]
        arm, arm_partner = 0.0 * radius, 0.0 * radius
        radius_eff, mass_eff = radius, mass
        if ti.static(plan.has_walls):
            if j < 0:
                gap, direction = geometry.closest(-1 - j, pose, particles.position[i])
                overlap = ti.cast(particles.radius[i] - gap, real)
                if overlap > 0.0:
                    normal, distance = ti.cast(direction, real), ti.cast(gap, real)
                    foot = particles.position[i] - gap * direction
                    late, now = wall_velocities(i, -1 - j, pose, foot)
                    arm = radius - overlap
        if j >= 0:
            apart = ti.cast(particles.position[i] - particles.position[j], real)
            reach = radius + particles.radius[j]
            square = apart.dot(apart)
            if square < reach * reach:
                distance = ti.sqrt(square)
                overlap = reach - distance
                normal = (1.0 / distance) * apart
                late, now = velocities(i, j)
                radius_eff = radius * particles.radius[j] / reach
                mass_eff = mass * particles.mass[j] / (mass + particles.mass[j])
                share = overlap / reach
                arm = radius - share * particles.radius[j]
                arm_partner = particles.radius[j] - share * radius
        middle, rate = normal, 0.0 * radius
        if overlap > 0.0:
            across = late - late.dot(normal) * normal
            middle -= (0.5 * time_step / ti.max(distance, 0.5 * radius)) * across
            rate = -now.dot(normal)
        return overlap, normal, middle, late, rate, arm, arm_partner, radius_eff, mass_eff

    return encounter


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
