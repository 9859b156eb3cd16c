"""Differences between contact models: Welch's interval against scipy and its coverage, and conclusions of a
comparison with several seeds and with one."""

import csv
import sys

import numpy as np
import pytest
from scene_builders import build_scene, plane
from scipy import stats

from granflow.studies.compare import report as reporting
from granflow.studies.compare.differences import Estimate, difference_of, welch_interval
from granflow.studies.compare.report import compare, scatter_note


def test_interval_is_that_of_welch():
    rng = np.random.default_rng(1)
    first, other = rng.normal(5.0, 1.0, 4), rng.normal(6.0, 3.0, 7)
    expected = stats.ttest_ind(other, first, equal_var=False).confidence_interval(0.95)
    assert welch_interval(Estimate.of(first), Estimate.of(other)) == pytest.approx(tuple(expected), rel=1e-12)


def test_interval_contains_the_true_difference_in_95_percent_of_studies():
    """1000 studies with four and six runs of different scatter: the standard deviation of the share is 0.7 %."""
    rng = np.random.default_rng(2)
    inside = 0
    for _ in range(1000):
        low, high = welch_interval(
            Estimate.of(rng.normal(10.0, 0.3, 4)), Estimate.of(rng.normal(10.5, 0.6, 6))
        )
        inside += low <= 0.5 <= high
    assert inside / 1000 == pytest.approx(0.95, abs=0.03)


@pytest.mark.parametrize(("first", "other", "conclusion"), [
    ([1.0, 1.01, 0.99], [2.0, 2.02, 1.98], "larger"), ([2.0, 2.02, 1.98], [1.0, 1.01, 0.99], "smaller"),
    ([1.0, 1.2, 0.8], [1.02, 1.2, 0.85], "not distinguishable"), ([1.0, 1.0], [1.0, 1.0], "equal"),
    ([1.0, 1.0], [1.1, 1.1], "larger"), ([-2.0, -2.1], [-1.0, -1.1], "larger"),
])  # fmt: skip
def test_conclusions(first, other, conclusion):
    found = difference_of("x", "", ("a", "b"), Estimate.of(first), Estimate.of(other))
    assert found.conclusion == conclusion


def test_single_values_have_no_difference():
    assert difference_of("x", "", ("a", "b"), Estimate.of([1.0]), Estimate.of([2.0])) is None


def falling(restitution_seed=1):
    """Twelve particles at random places fall onto a plate, through a flow meter."""
    region = {"box": {"min": [-0.05, -0.05, 0.02], "max": [0.05, 0.05, 0.06]}}
    group = {"material": "glass", "count": 12, "diameter": 0.01, "insert": {"kind": "pack", "region": region}}
    return build_scene(
        {"beads": group}, walls={"floor": plane([0, 0, 0], [0, 0, 1])}, gravity=[0, 0, -9.81],
        pair={"restitution": 0.5}, run={"duration": 0.12}, seed=restitution_seed,
        output={"timeseries_interval": 0.002, "interval": 0.02,
                "flow_meters": {"below": {"point": [0, 0, 0.03], "normal": [0, 0, -1]}}},
    )  # fmt: skip


@pytest.fixture
def without_collisions(taichi_f64, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr(reporting, "sweeps_of", lambda *_: [])


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_comparison_with_seeds_has_intervals_of_its_runs(without_collisions, tmp_path):
    """Each interval is Welch's of the values in seeds.csv; the values of the summary are their means."""
    found = compare(falling(), ["hertz", "zhou"], tmp_path, seeds=3)
    assert {path.name for path in tmp_path.iterdir() if path.is_dir()} == {
        "hertz", "hertz_seed_2", "hertz_seed_3", "zhou", "zhou_seed_2", "zhou_seed_3"
    }  # fmt: skip
    seeds = rows(tmp_path / "seeds.csv")
    summary = {(row["quantity"], row["law"]): float(row["value"]) for row in rows(tmp_path / "compare.csv")}
    differences = rows(tmp_path / "differences.csv")
    assert {"center of mass", "surface"} <= {row["quantity"] for row in differences}
    for row in differences:
        samples = {
            law: [
                float(each["value"])
                for each in seeds
                if (each["quantity"], each["law"]) == (row["quantity"], law) and each["value"] != "nan"
            ]
            for law in ("hertz", "zhou")
        }
        assert summary[row["quantity"], "zhou"] == pytest.approx(np.mean(samples["zhou"]), rel=1e-12)
        if np.ptp(samples["hertz"]) == 0.0 and np.ptp(samples["zhou"]) == 0.0:
            continue
        interval = stats.ttest_ind(samples["zhou"], samples["hertz"], equal_var=False).confidence_interval()
        assert (float(row["low"]), float(row["high"])) == pytest.approx(tuple(interval), rel=1e-9)
    heights = [float(each["value"]) for each in seeds if each["quantity"] == "center of mass"]
    assert len(set(heights)) == len(heights), "each seed is another packing"
    assert "3 seeds" in scatter_note(found)


def test_comparison_with_one_seed_says_that_the_scatter_is_unknown(without_collisions, tmp_path):
    found = compare(falling(), ["hertz", "zhou"], tmp_path)
    note = scatter_note(found)
    assert "the scatter between random packings is unknown" in note and "--seeds 5" in note
    assert note in (tmp_path / "compare.html").read_text(encoding="utf-8")
    assert not (tmp_path / "seeds.csv").exists()
    compared = {each.quantity for each in found.differences}
    assert compared <= {"mass flow rate, below"}, "only flows have a scatter in time"
