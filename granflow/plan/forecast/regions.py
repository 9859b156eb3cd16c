"""Forecasts of insertion regions that walls cut, and of initial particles inside walls."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from granflow.geometry.catalog import distance_from
from granflow.geometry.motion import pose
from granflow.load import Scene
from granflow.particles.insertion import insertion_region
from granflow.particles.particle_data import ParticleData
from granflow.particles.regions import RegionSampler, sampler_of
from granflow.plan.forecast.spheres import spheres_by_particle
from granflow.plan.forecast.times import is_present, nominal_times
from granflow.plan.plan import Plan
from granflow.plan.size_classes import outer_diameter_range
from granflow.plan.walls import PlannedWall, StageTimes
from granflow.scene.schema.insertion import InletInsertion, LatticeInsertion, PackInsertion, RainInsertion
from granflow.scene.schema.particles import Group

SAMPLES = 2000
"""Number of random positions at which a region is compared with the walls."""


def region_warnings(scene: Scene, plan: Plan, times: StageTimes) -> Iterator[str]:
    """A sentence for each region and wall where particles would be inserted with overlaps above the limit."""
    for name, group in scene.particles.items():
        region = region_of(group)
        if region is None or group.fixed:
            continue
        radius = 0.5 * outer_diameter_range(group)[0]
        if radius > region.radius_max:
            continue  # the particles do not fit: reported when they are generated
        points = region.sample(np.full(SAMPLES, radius), np.random.default_rng(0))
        bodies = spheres_by_particle(group, points, np.full(SAMPLES, radius), None)
        start = getattr(group.insert, "start", 0.0)
        for wall, overlap in _overlaps(plan.walls, bodies, start, times):
            share = float(np.mean(overlap > plan.max_overlap))
            if share > 0.0:
                yield (
                    f"particles.{name}.insert ({scene.where('particles', name, 'insert')}): {100 * share:.3g} % of the "
                    f"positions in the region are inside or behind walls.{wall.name}, and particles there stop the "
                    "run. Choose a region that does not intersect the wall."
                )


def particle_warnings(scene: Scene, plan: Plan, particles: ParticleData) -> Iterator[str]:
    """A sentence for each group and wall whose initial particles overlap the wall by more than the limit.

    Groups in regions are compared with walls by `region_warnings`.
    """
    times = nominal_times(plan.stages)
    for number, (name, group) in enumerate(scene.particles.items()):
        own = np.flatnonzero(particles.group == number)
        if group.fixed or not len(own) or region_of(group) is not None:
            continue
        points, turns = particles.position[own], particles.orientation
        bodies = spheres_by_particle(group, points, particles.radius[own], None if turns is None else turns[own])
        for wall, overlap in _overlaps(plan.walls, bodies, 0.0, times):
            count = int((overlap > plan.max_overlap).sum())
            if count:
                worst = int(overlap.argmax())
                x, y, z = points[worst]
                yield (
                    f"particles.{name} ({scene.where('particles', name)}): {count} of {len(own)} particles are inside "
                    f"walls.{wall.name} at the start, by up to {overlap[worst]:.3g} of the radius, at "
                    f"[{x:.4g}, {y:.4g}, {z:.4g}] m. Move them out, or move the wall."
                )


def region_of(group: Group) -> RegionSampler | None:
    """The region in which particles of a group are inserted at random or on a lattice; None for given positions."""
    insertion = group.insert
    if isinstance(insertion, LatticeInsertion | PackInsertion | RainInsertion):
        return sampler_of(insertion.region)
    if isinstance(insertion, InletInsertion):
        return insertion_region(insertion, 0.5 * outer_diameter_range(group)[1], np.array(group.velocity, float), 0.0)
    return None


def _overlaps(
    walls: Sequence[PlannedWall], bodies: tuple[np.ndarray, np.ndarray], time: float, times: StageTimes
) -> Iterator[tuple[PlannedWall, np.ndarray]]:
    """For each wall that is present at `time` [s]: largest overlap over the radius (n,) of the spheres of a particle.

    `bodies`: centers (n, k, 3) [m] and radii (n, k) [m] of spheres.
    """
    points, radius = bodies[0].reshape(-1, 3), bodies[1].reshape(-1)
    for wall in walls:
        if not is_present(wall, time, times):
            continue
        at = pose([each.at(_started(times, time)) for each in wall.motions], np.array([time]))
        local = (points - at.pivot - at.offset[0]) @ at.rotation[0] + at.pivot
        overlap = 1.0 - distance_from(wall.shape, local, float(radius.max())) / radius
        yield wall, overlap.reshape(bodies[1].shape).max(axis=1)


def _started(times: StageTimes, time: float) -> Mapping[str, tuple[float, float]]:
    """The stages that have begun at `time` [s]."""
    return {name: span for name, span in times.items() if span[0] <= time}
