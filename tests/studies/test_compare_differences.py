"""Differences between contact models: conclusions, and Welch's interval of a comparison against scipy."""

import csv
import sys

import numpy as np
import pytest
from scene_builders import build_scene, plane
from scipy import stats

from granflow.studies.compare import report as reporting
from granflow.studies.compare.differences import Estimate, difference_of
from granflow.studies.compare.report import compare


@pytest.mark.parametrize(("first", "other", "conclusion"), [
    ([1.0, 1.01, 0.99], [2.0, 2.02, 1.98], "larger"), ([2.0, 2.02, 1.98], [1.0, 1.01, 0.99], "smaller"),
    ([1.0, 1.2, 0.8], [1.02, 1.2, 0.85], "not distinguishable"), ([1.0, 1.0], [1.0, 1.0], "equal"),
    ([1.0, 1.0], [1.1, 1.1], "larger"), ([-2.0, -2.1], [-1.0, -1.1], "larger"),
])  # fmt: skip
def test_conclusions(first, other, conclusion):
    found = difference_of("x", "", ("a", "b"), Estimate.of(first), Estimate.of(other))
    assert found.conclusion == conclusion
    assert difference_of("x", "", ("a", "b"), Estimate.of(first[:1]), Estimate.of(other[:1])) is None


def falling():
    """Twelve particles at random places fall onto a plate, through a flow meter."""
    region = {"box": {"min": [-0.05, -0.05, 0.02], "max": [0.05, 0.05, 0.06]}}
    group = {"material": "glass", "count": 12, "diameter": 0.01, "insert": {"kind": "pack", "region": region}}
    return build_scene(
        {"beads": group}, walls={"floor": plane([0, 0, 0], [0, 0, 1])}, gravity=[0, 0, -9.81],
        pair={"restitution": 0.5}, run={"duration": 0.12},
        output={"timeseries_interval": 0.002, "interval": 0.02,
                "flow_meters": {"below": {"point": [0, 0, 0.03], "normal": [0, 0, -1]}}},
    )  # fmt: skip


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_comparison_with_seeds_has_intervals_of_its_runs(taichi_f64, monkeypatch, tmp_path):
    """Each interval is Welch's of the values in seeds.csv; the values of the summary are their means."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr(reporting, "sweeps_of", lambda *_: [])
    compare(falling(), ["hertz", "zhou"], tmp_path, seeds=2)
    seeds = rows(tmp_path / "seeds.csv")
    summary = {(row["quantity"], row["law"]): float(row["value"]) for row in rows(tmp_path / "compare.csv")}
    differences = rows(tmp_path / "differences.csv")
    assert {"center of mass", "surface"} <= {row["quantity"] for row in differences}
    samples = {}
    for each in seeds:
        if each["value"] != "nan":
            samples.setdefault((each["quantity"], each["law"]), []).append(float(each["value"]))
    for row in differences:
        hertz, zhou = (samples[row["quantity"], law] for law in ("hertz", "zhou"))
        assert summary[row["quantity"], "zhou"] == pytest.approx(np.mean(zhou), rel=1e-12)
        if np.ptp(hertz) > 0.0 or np.ptp(zhou) > 0.0:
            interval = stats.ttest_ind(zhou, hertz, equal_var=False).confidence_interval()
            assert (float(row["low"]), float(row["high"])) == pytest.approx(tuple(interval), rel=1e-9)
    heights = samples["center of mass", "hertz"] + samples["center of mass", "zhou"]
    assert len(set(heights)) == 4, "each seed is another packing"
