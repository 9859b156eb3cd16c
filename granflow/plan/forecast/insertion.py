"""Forecasts of insertions that the run is too short for, and of inlets that are too small for their rate."""

from collections.abc import Iterator
from math import ceil, pi, sqrt

import numpy as np

from granflow.load import Scene
from granflow.particles.insertion import MAX_BATCHES, insertion_region
from granflow.particles.regions import CylinderSampler, SlabSampler
from granflow.plan.forecast.pressures import mean_volume
from granflow.plan.plan import Plan
from granflow.plan.size_classes import outer_diameter_range
from granflow.plan.walls import StageTimes
from granflow.scene.schema.insertion import InletInsertion, RainInsertion
from granflow.scene.schema.particles import Group

DENSEST_FLOW = 0.45
"""Solid fraction that the flow out of an inlet does not exceed.

Random sequential packings reach 0.38. Free fall from a disc of 10 diameters has 0.40, from one of 1.5 diameters 0.25.
"""

TOLERANCE = 0.01
"""Fraction of the count that may be missing without a warning: the mean mass of particles is a sample."""


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


def inlet_warnings(scene: Scene, plan: Plan) -> Iterator[str]:
    """A sentence for each inlet through which fewer particles than required can flow."""
    for name, group in scene.particles.items():
        insertion = group.insert
        if not isinstance(insertion, InletInsertion):
            continue
        required = 1.0 / _interval(plan, group, insertion)
        largest = _largest_rate(scene, group, insertion, 1.0 / required)
        if required > largest > 0.0:
            key = f"particles.{name}.insert ({scene.where('particles', name, 'insert')})"
            yield (
                f"{key}: {required:.3g} particles per second are required, but at most about {largest:.2g} leave the "
                "face in a second; the others are queued. Enlarge the face, raise particles."
                f"{name}.velocity, or lower the {'rate' if insertion.rate else 'mass_flow'}."
            )


def _largest_rate(scene: Scene, group: Group, insertion: InletInsertion, interval: float) -> float:
    """Upper bound of the number of particles per second that leave the region behind the face of an inlet.

        rate = phi (A v_n + W h v_t) / V,     v_n^2 = v0_n^2 + 2 g_n h,     v_t^2 = v0_t^2 + 2 g_t W

    A, W: area and width of the face; h: depth of the region; n, t: along the normal of the face and across it; phi:
    DENSEST_FLOW; V: mean volume of a particle, of a clump that of the sphere around it. 0 if particles neither start
    with a velocity nor fall: walls can carry them away. `interval` [s]: mean time between particles.
    """
    velocity, gravity = np.array(group.velocity, float), np.array(scene.gravity, float)
    gathered = ceil(group.count / MAX_BATCHES) * interval
    region = insertion_region(insertion, 0.5 * outer_diameter_range(group)[1], velocity, gathered)
    if isinstance(region, CylinderSampler):
        normal, depth, area, width = region.frame[2], region.length, pi * region.radius**2, 2.0 * region.radius
    else:
        assert isinstance(region, SlabSampler)
        first, second, depth = region.box.high
        normal, area, width = region.frame[2], first * second, float(np.hypot(first, second))
    along = sqrt(max(velocity @ normal, 0.0) ** 2 + 2.0 * max(gravity @ normal, 0.0) * depth)
    slide = float(np.linalg.norm(gravity - (gravity @ normal) * normal))
    across = sqrt(float(np.sum((velocity - (velocity @ normal) * normal) ** 2)) + 2.0 * slide * width)
    volume = mean_volume(group) if group.clump is None else pi / 6.0 * outer_diameter_range(group)[1] ** 3
    return DENSEST_FLOW * float(area * along + width * depth * across) / volume


def _interval(plan: Plan, group: Group, insertion: RainInsertion | InletInsertion) -> float:
    """Mean time [s] between two particles."""
    if insertion.rate:
        return 1.0 / insertion.rate
    assert insertion.mass_flow is not None
    return mean_volume(group) * plan.solids[group.material].density / insertion.mass_flow
