"""Metrics of a run: each entry of `output.metrics` becomes a `MetricMeter`.

It evaluates the metric for each row of the time series and computes its mean over the last stage. The kinds
of metrics and their formulas are in `scene.blocks.metrics`.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from granflow.arguments import shown
from granflow.errors import FunctionError
from granflow.observers.meters import StageRows
from granflow.plan.plan import Plan
from granflow.plan.wall_control import plane_of
from granflow.scene.blocks.metrics import MeasuredScene, Metric, Reading
from granflow.snapshot import Snapshot


class MetricMeter:
    """Evaluates `measure` for snapshots with the parts `wants`; values by name in METRIC_QUANTITIES.

    The mean restarts with each stage. Values that are NaN (not defined for the present state) do not enter
    the mean. `remark`: of the last evaluation, a sentence for a warning at the end of the run, or an empty
    text.
    """

    def __init__(self, measure: Callable[[Snapshot], Reading], wants: frozenset[str]) -> None:
        self.wants = wants
        self._measure = measure
        self.remark = ""
        self._stage = ""
        self._last: dict[str, float] = {}
        self._rows = StageRows()
        self._row_count = 0

    def update(self, snapshot: Snapshot, replaces_last: bool = False) -> None:
        """Evaluate the metric with a snapshot, which must have the parts `wants`.

        `replaces_last`: the last values, of the same stage, do not enter the mean any more.
        """
        if snapshot.stage != self._stage:
            self._stage = snapshot.stage
            self._row_count = 0
        self._row_count += not replaces_last
        reading = self._measure(snapshot)
        self._last = {name: float(value) for name, value in reading.numbers.items()}
        self.remark = reading.remark
        self._rows.update(snapshot.stage, self._last, replaces_last)

    def readings(self) -> dict[str, float]:
        """Return the values of the last snapshot, in the units of METRIC_QUANTITIES; empty before the
        first."""
        return self._last

    def result(self) -> dict[str, float]:
        """Return the last values, and as `NAME_mean` the means over the values of the last stage that are not
        NaN."""
        means = self._rows.means(self._stage)
        return self._last | {f"{name}_mean": means.get(name, float("nan")) for name in self._last}

    def remarks(self) -> Iterator[str]:
        """Yield the remark of the last evaluation, and one for each mean over less than half of the rows of
        the last stage."""
        if self.remark:
            yield self.remark
        counts = self._rows.counts(self._stage)
        for name in self._last:
            count = counts.get(name, 0)
            if 0 < count < 0.5 * self._row_count:
                yield (
                    f"{name}_mean is the mean of {count} of the {self._row_count} rows of the stage "
                    f"{self._stage}; {name} is NaN in the others"
                )

    def state_dict(self) -> dict[str, Any]:
        """Return the stage, the last values and their remark, the means over the rows and their number."""
        return {
            "stage": self._stage,
            "last": self._last,
            "remark": self.remark,
            "rows": self._rows.state_dict(),
            "row_count": self._row_count,
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`."""
        self._stage = saved["stage"]
        self._last = saved["last"]
        self.remark = saved["remark"]
        self._rows.load_state_dict(saved["rows"])
        self._row_count = saved["row_count"]


def metric_meters(plan: Plan) -> dict[str, MetricMeter]:
    """Return a meter for each metric of the plan, by its name in `output.metrics`."""
    scene = MeasuredScene(
        plan.scene.domain,
        plan.scene.usual_gravity,
        groups=tuple(group.name for group in plan.groups),
        materials=tuple(plan.scene.materials),
        densities=tuple(each.density for each in plan.scene.materials.values()),
        walls=tuple(wall.name for wall in plan.walls),
        planes={wall.name: plane for wall in plan.walls if (plane := plane_of(wall)) is not None},
    )
    return {
        name: MetricMeter(partial(_reading, name, metric, scene), metric.wants)
        for name, metric in plan.scene.output.metrics.items()
    }


def _reading(name: str, metric: Metric, scene: MeasuredScene, snapshot: Snapshot) -> Reading:
    """The reading of a metric. Raises FunctionError if one of a program fails or returns something else."""
    if type(metric).__module__.startswith("granflow."):
        return metric.measure(snapshot, scene)
    try:
        found = metric.measure(snapshot, scene)
    except Exception as error:
        raise FunctionError(
            f"The metric {name} failed at {snapshot.time:.6g} s: {type(error).__name__}: {error}"
        ) from error
    expected = [each.name for each in metric.quantities]
    if not isinstance(found, Reading) or sorted(found.numbers) != sorted(expected):
        raise FunctionError(
            f"The metric {name} returned {shown(found)}, but measure must return a Reading with the numbers "
            f"{', '.join(expected)}."
        )
    return found
