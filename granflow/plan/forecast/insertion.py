"""Forecasts of insertions: runs that are too short, rates too high for a face or region, inlets turned backward."""

from collections.abc import Iterator
from math import ceil, pi, sqrt

import numpy as np

from granflow.geometry.sphere import sphere_volume
from granflow.load import Scene
from granflow.particles.insertion import MAX_BATCHES, insertion_region
from granflow.particles.regions import BoxSampler, CylinderSampler, RegionSampler, SlabSampler
from granflow.plan.forecast.pressures import mean_volume
from granflow.plan.plan import Plan
from granflow.plan.size_classes import outer_diameter_range
from granflow.plan.walls import StageTimes
from granflow.scene.schema.insertion import DiscFace, InletInsertion, RainInsertion
from granflow.scene.schema.particles import Group

DENSEST_FLOW = 0.45
"""Solid fraction that the flow out of an inlet does not exceed.

Random sequential packings reach 0.38. Free fall from a disc of 10 diameters has 0.40, from one of 1.5 diameters 0.25.
"""

TOLERANCE = 0.01
"""Fraction of the count that may be missing without a warning: the mean mass of particles is a sample."""

ALONG_FACE = 1e-3
"""Component along the normal over the magnitude below which a vector is parallel to a face: decimals are rounded."""


def insertion_warnings(scene: Scene, plan: Plan, times: StageTimes) -> Iterator[str]:
    """A sentence for each rain or inlet whose rate cannot insert all particles before the end of the run.

    The run takes its longest duration. Space is not considered: a full region delays particles further.
    """
    end = max(end for _, end in times.values())
    for name, group in scene.particles.items():
        insertion = group.insert
        if not isinstance(insertion, RainInsertion | InletInsertion):
            continue
        interval = _interval(plan, group, insertion)
        inserted = 0.0 if insertion.start > end else (end - insertion.start) / interval + 1.0
        if inserted < (1.0 - TOLERANCE) * group.count:
            key = f"particles.{name}.insert ({scene.where('particles', name, 'insert')})"
            flow = "rate" if insertion.rate else "mass_flow"
            yield (
                f"{key}: the insertion of {group.count} particles takes {(group.count - 1) * interval:.3g} s from "
                f"{insertion.start:.3g} s on, but the run ends at {end:.3g} s, after about {inserted:.3g} of them. "
                f"Raise {flow} or the duration."
            )


def flow_warnings(scene: Scene, plan: Plan) -> Iterator[str]:
    """A sentence for each inlet through which, or rain from whose region, fewer particles than required can flow."""
    for name, group in scene.particles.items():
        insertion = group.insert
        if not isinstance(insertion, RainInsertion | InletInsertion):
            continue
        interval = _interval(plan, group, insertion)
        if isinstance(insertion, InletInsertion) and (sentence := _direction(scene, plan, name, insertion)):
            yield sentence
            continue
        largest, held = _largest_flow(scene, group, insertion, interval)
        key = f"particles.{name}.insert ({scene.where('particles', name, 'insert')})"
        if isinstance(insertion, InletInsertion):
            is_small, place, also = True, "face", ""
        else:
            is_small, place = group.count * (1.0 - interval * largest) > held, "region"
            also = f", which holds {held:.2g}"
        if is_small and 1.0 / interval > largest > 0.0:
            yield (
                f"{key}: {1.0 / interval:.3g} particles per second are required, but at most about {largest:.2g} leave "
                f"the {place} in a second{also}; the others are queued. Enlarge the {place}, raise particles.{name}"
                f".velocity, or lower the {'rate' if insertion.rate else 'mass_flow'}."
            )
        elif is_small and not largest and place == "region" and _stays(plan, group):
            yield (
                f"{key}: {group.count} particles are required, but the region holds at most about {held:.2g}, and "
                f"neither gravity nor particles.{name}.velocity moves them out; the others are queued. Enlarge the "
                "region, or lower the count."
            )


def _direction(scene: Scene, plan: Plan, name: str, insertion: InletInsertion) -> str:
    """A sentence on an inlet that new particles leave backward or not at all; empty if they move into the scene.

    The velocity decides, and gravity if the velocity has no component along the normal. The proposed velocity is the
    given one with the opposite component, or with the smallest one that is sufficient for the rate.
    """
    group = scene.particles[name]
    velocity, gravity = np.array(group.velocity, float), np.array(scene.gravity, float)
    region = insertion_region(insertion, 0.5 * outer_diameter_range(group)[1], np.zeros(3), 0.0)
    normal, _, area, _ = _face(region, velocity)
    through, along = _through(velocity, normal), _through(gravity, normal)
    if through > 0.0 or (through == 0.0 and along > 0.0):
        return ""
    is_still = not velocity.any()
    if along == 0.0 and through == 0.0 and group.thermal is not None:
        return ""
    if is_still and along == 0.0 and (gravity.any() or not _stays(plan, group)):
        return ""
    needed = mean_volume(group) / (_interval(plan, group, insertion) * DENSEST_FLOW * area)
    speed = float(f"{1.5 * needed:.1g}") if through == 0.0 else -2.0 * float(velocity @ normal)
    if through < 0.0:
        fault = "points against it, so that they leave backward through the face"
    elif along < 0.0:
        fault = "has no component along it, so that gravity moves them backward through the face"
    else:
        fault = "has no component along it, so that they do not leave the face along its normal"
    given = f"particles.{name}.velocity ({scene.where('particles', name, 'velocity')}) is {_vector(velocity)} m/s"
    reverse = "reverse face.disc.normal"
    if not isinstance(insertion.face, DiscFace):
        reverse = "exchange the two sides of face.rectangle"
    return (
        f"{given}, but particles enter through the face of the inlet along {_vector(normal)}: the velocity {fault}. "
        f"Give a velocity such as {_vector(velocity + speed * normal)} m/s"
        f"{f', or {reverse}' if through < 0.0 or along < 0.0 else ''}."
    )


def _through(vector: np.ndarray, normal: np.ndarray) -> float:
    """Component of a vector along a normal; 0 for a vector that is parallel to the face within rounding."""
    component = float(vector @ normal)
    return 0.0 if abs(component) <= ALONG_FACE * float(np.linalg.norm(vector)) else component


def _vector(values: np.ndarray) -> str:
    """Three numbers in the form of the scene."""
    return "[" + ", ".join(f"{each + 0.0:.3g}" for each in np.round(values, 12)) + "]"


def _stays(plan: Plan, group: Group) -> bool:
    """Whether neither walls nor a granular temperature move new particles without gravity and velocity."""
    return group.thermal is None and not any(wall.motions for wall in plan.walls)


def _largest_flow(
    scene: Scene, group: Group, insertion: RainInsertion | InletInsertion, interval: float
) -> tuple[float, float]:
    """Upper bounds of the particles per second that leave the region of an insertion, and of those in the region.

        rate = phi (A v_n + W h v_t) / V,     v_n^2 = v0_n^2 + 2 g_n h,     v_t^2 = v0_t^2 + 2 g_t W

    A, W: area and width of a face; h: depth of the region; n, t: along the normal of the face and across it; phi:
    DENSEST_FLOW; V: mean volume of a particle, of a clump that of the sphere around it. Particles leave an inlet along
    the normal only, the region of rain at both ends. 0 if particles neither start with a velocity nor fall: walls can
    carry them away. `interval` [s]: mean time between particles.
    """
    velocity, gravity = np.array(group.velocity, float), np.array(scene.gravity, float)
    gathered = ceil(group.count / MAX_BATCHES) * interval
    region = insertion_region(insertion, 0.5 * outer_diameter_range(group)[1], velocity, gathered)
    normal, depth, area, width = _face(region, gravity if gravity.any() else velocity)
    ends = (velocity @ normal, gravity @ normal)
    initial, falling = map(abs, ends) if isinstance(insertion, RainInsertion) else (max(each, 0.0) for each in ends)
    along = sqrt(initial**2 + 2.0 * falling * depth)
    slide = float(np.linalg.norm(gravity - (gravity @ normal) * normal))
    across = sqrt(float(np.sum((velocity - (velocity @ normal) * normal) ** 2)) + 2.0 * slide * width)
    volume = mean_volume(group) if group.clump is None else sphere_volume(0.5 * outer_diameter_range(group)[1])
    flow, held = area * along + width * depth * across, region.volume
    return DENSEST_FLOW * float(flow) / volume, DENSEST_FLOW * held / volume


def _face(region: RegionSampler, direction: np.ndarray) -> tuple[np.ndarray, float, float, float]:
    """Normal (3,), depth [m] behind it, area [m2] and width [m] of a face of a region.

    Of a box with edges along the coordinate axes, the face that `direction` (3,) crosses most steeply.
    """
    if isinstance(region, CylinderSampler):
        return region.frame[2], region.length, pi * region.radius**2, 2.0 * region.radius
    if isinstance(region, SlabSampler):
        axis, normal, size = 2, region.frame[2], region.box.high
    else:
        assert isinstance(region, BoxSampler)
        axis, size = int(np.argmax(np.abs(direction))), region.high - region.low
        normal = np.eye(3)[axis]
    sides = np.delete(size, axis)
    return normal, float(size[axis]), float(np.prod(sides)), float(np.hypot(*sides))


def _interval(plan: Plan, group: Group, insertion: RainInsertion | InletInsertion) -> float:
    """Mean time [s] between two particles."""
    if insertion.rate:
        return 1.0 / insertion.rate
    assert insertion.mass_flow is not None
    return mean_volume(group) * plan.solids[group.material].density / insertion.mass_flow
