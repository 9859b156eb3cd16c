"""Forecasts of insertions that the run is too short for."""

from collections.abc import Iterator

from granflow.load import Scene
from granflow.plan.forecast.pressures import mean_volume
from granflow.plan.plan import Plan
from granflow.plan.walls import StageTimes
from granflow.scene.schema.insertion import InletInsertion, RainInsertion
from granflow.scene.schema.particles import Group

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


def _interval(plan: Plan, group: Group, insertion: RainInsertion | InletInsertion) -> float:
    """Mean time [s] between two particles."""
    if insertion.rate:
        return 1.0 / insertion.rate
    assert insertion.mass_flow is not None
    return mean_volume(group) * plan.solids[group.material].density / insertion.mass_flow
