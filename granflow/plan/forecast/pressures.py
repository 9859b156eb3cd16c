"""Static pressures of a scene, of the weight of the bed and of force-controlled walls, and their contact forces."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import log, pi
from typing import Literal

import numpy as np

from granflow.contact.material import Solid
from granflow.geometry.catalog import area_of
from granflow.geometry.sphere import sphere_volume
from granflow.load import Scene
from granflow.particles.regions import BoxSampler, CylinderSampler, sampler_of
from granflow.particles.sizes import draw_diameters
from granflow.plan.forecast.advice import pressure_words
from granflow.plan.plan import Plan
from granflow.plan.size_classes import diameter_range
from granflow.plan.wall_control import section
from granflow.scene.schema.domain import Domain
from granflow.scene.schema.insertion import FileInsertion, LatticeInsertion, PackInsertion, PositionsInsertion
from granflow.scene.schema.particles import Group

SOLID_FRACTION = 0.6
"""Solid fraction of a settled bed of spheres."""

COORDINATION = 6.0
"""Mean number of contacts of a sphere: 6 in an isostatic packing without friction, 4 to 6 with friction."""

FORCE_DECAY = 1.5
"""Decay beta of the distribution of contact forces over their mean, P(f) ~ exp(-beta f) for f > 1.

(D. M. Mueth, H. M. Jaeger & S. R. Nagel, Phys. Rev. E 57 (1998) 3164: beta = 1.5 +- 0.1.)
"""

SAMPLE = 1000
"""Number of diameters of which the mean mass of a group is computed; lists have one diameter per particle."""

PressureKind = Literal["weight", "wall"]


@dataclass(frozen=True)
class BedPressure:
    """A pressure [Pa] in the bed at rest, its cause in words, and the number of contacts that carry it."""

    kind: PressureKind
    cause: str
    pressure: float
    contact_count: float

    def largest_force(self, diameter: float) -> float:
        """Largest contact force [N] of spheres with a diameter [m].

            F = f pi d^2 p / (phi Z),      f = ln(2 N) / beta

        The mean normal force in a packing of equal spheres under a pressure p is pi d^2 p / (phi Z) (H. Rumpf, Chem.
        Ing. Tech. 42 (1970) 538). Of N forces with the tail exp(-beta f), the largest is about ln(2 N) / beta times the
        mean.
        """
        mean = pi * diameter**2 * self.pressure / (SOLID_FRACTION * COORDINATION)
        return max(log(2.0 * self.contact_count) / FORCE_DECAY, 1.0) * mean


def bed_pressures(scene: Scene, plan: Plan) -> Iterator[BedPressure]:
    """The pressures of a scene: the weight of its particles, and each wall that presses on them."""
    diameter = 2.0 * plan.radius_max
    count = sum(group.count for group in plan.groups if not group.fixed)
    weight, area = weight_pressure(scene, plan.solids)
    if weight > 0.0:
        contacts = min(3.0 * count, max(3.0 * area / diameter**2, 1.0))
        yield BedPressure("weight", f"the weight of the bed ({pressure_words(weight)} at its bottom)", weight, contacts)
    for motion in plan.controlled_motions:
        area = area_of(plan.walls[motion.wall].shape) or section(plan.domain, motion.direction)
        if motion.force > 0.0 and count > 1:
            pressure = motion.force / area
            cause = f"walls.{motion.name}, which presses with {motion.force:.3g} N ({pressure_words(pressure)})"
            yield BedPressure("wall", cause, pressure, 3.0 * count)


def weight_pressure(scene: Scene, solids: Mapping[str, Solid]) -> tuple[float, float]:
    """Pressure [Pa] of the weight of all mobile particles at the bottom of the bed, and the section of the bed [m2].

        p = |g| sum M_i / A_i,       at most 0.64 rho |g| H

    A lattice or a packing has the section A of its region, given positions that of their bounding box; other particles
    can fill the domain. With H, the height of
    the domain, and the density of the random close packing, the pressure is not above that of a full domain. The walls
    carry a part of the weight (Janssen 1895), which is not considered: the pressure is an upper bound for a bed that
    keeps its section.
    """
    gravity = np.array(scene.gravity)
    size = np.subtract(scene.domain.max, scene.domain.min)
    total, largest_section, densest = 0.0, 0.0, 0.0
    magnitude = float(np.linalg.norm(gravity))
    for group in scene.particles.values():
        if group.fixed or not magnitude:
            continue
        area, density = _section_of(scene.domain, group, gravity / magnitude), solids[group.material].density
        total += magnitude * group.count * mean_volume(group) * density / area
        largest_section, densest = max(largest_section, area), max(densest, density)
    return min(total, 0.64 * densest * float(np.abs(gravity) @ size)), largest_section


def mean_volume(group: Group) -> float:
    """Mean volume [m3] of the particles of a group, from a sample of at most SAMPLE diameters; that of a clump."""
    if group.clump is not None:
        return group.clump.shape.volume
    if isinstance(group.insert, FileInsertion):
        diameters = np.array(diameter_range(group))
    else:
        count = group.count if isinstance(group.sizes, tuple) else min(group.count, SAMPLE)
        diameters = draw_diameters(group.sizes, count, np.random.default_rng(0))
    return float(np.mean(sphere_volume(0.5 * diameters)))


def solid_volume(particles: Mapping[str, Group]) -> float:
    """Volume [m3] of all particles."""
    return sum(group.count * mean_volume(group) for group in particles.values())


def _section_of(domain: Domain, group: Group, down: np.ndarray) -> float:
    """Section [m2] of the region of a group across the unit vector `down`; that of the domain for other insertions."""
    if isinstance(group.insert, PositionsInsertion):
        x, y, z = np.ptp(np.array(group.insert.positions), axis=0) + diameter_range(group)[1]
        return float(np.abs(down) @ [y * z, z * x, x * y])
    if not isinstance(group.insert, LatticeInsertion | PackInsertion):
        return section(domain, down)
    region = sampler_of(group.insert.region)
    if isinstance(region, BoxSampler):
        x, y, z = region.high - region.low
        return float(np.abs(down) @ [y * z, z * x, x * y])
    assert isinstance(region, CylinderSampler)
    along = abs(float(region.frame[2] @ down))
    return (
        along * pi * region.radius**2 + float(np.sqrt(1.0 - min(along, 1.0) ** 2)) * 2.0 * region.radius * region.length
    )
