"""Metrics of the time series: evaluated at each row, with a mean over the last stage."""

from collections.abc import Callable, Mapping
from typing import Any

from granflow.snapshot import Snapshot


class MetricMeter:
    """Evaluates `measure` for snapshots with the parts `wants`; values by name in METRIC_QUANTITIES.

    The mean restarts with each stage. Values that are NaN (not defined for the present state) do not enter the mean.
    `remark`: of the last evaluation, a sentence for a warning at the end of the run, or an empty text.

    get_remark:  function that returns the remark after an evaluation
    """

    def __init__(
        self,
        measure: Callable[[Snapshot], Mapping[str, float]],
        wants: frozenset[str],
        get_remark: Callable[[], str] = lambda: "",
    ) -> None:
        self.wants = wants
        self._measure, self._get_remark = measure, get_remark
        self.remark = ""
        self._stage = ""
        self._last: dict[str, float] = {}
        self._sums: dict[str, float] = {}
        self._counts: dict[str, int] = {}
        self._sums_before: dict[str, float] = {}
        self._counts_before: dict[str, int] = {}

    def update(self, snapshot: Snapshot, replaces_last: bool = False) -> None:
        """Evaluate the metric with a snapshot, which must have the parts `wants`.

        `replaces_last`: the last values, of the same stage, do not enter the mean any more.
        """
        if replaces_last:
            self._sums, self._counts = self._sums_before, self._counts_before
        if snapshot.stage != self._stage:
            self._stage, self._sums, self._counts = snapshot.stage, {}, {}
        self._sums_before, self._counts_before = dict(self._sums), dict(self._counts)
        self._last = {name: float(value) for name, value in self._measure(snapshot).items()}
        self.remark = self._get_remark()
        for name, number in self._last.items():
            known = number == number
            self._sums[name] = self._sums.get(name, 0.0) + (number if known else 0.0)
            self._counts[name] = self._counts.get(name, 0) + known

    def readings(self) -> dict[str, float]:
        """Return the values of the last snapshot, in the units of METRIC_QUANTITIES; empty before the first."""
        return self._last

    def result(self) -> dict[str, float]:
        """Return the last values, and as `NAME_mean` the means over the values of the last stage that are not NaN."""
        means = {
            f"{name}_mean": self._sums[name] / count if count else float("nan") for name, count in self._counts.items()
        }
        return self._last | means

    def state_dict(self) -> dict[str, Any]:
        """Return the stage, the last values and their remark, and sums and counts of the stage, also without these."""
        sums = {"sums": self._sums, "counts": self._counts}
        sums |= {"sums_before": self._sums_before, "counts_before": self._counts_before}
        return {"stage": self._stage, "last": self._last, "remark": self.remark, **sums}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`."""
        self._stage, self._last, self.remark = saved["stage"], saved["last"], saved["remark"]
        self._sums, self._counts = saved["sums"], saved["counts"]
        self._sums_before, self._counts_before = saved["sums_before"], saved["counts_before"]
