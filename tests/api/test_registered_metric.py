"""A metric from outside the package: in the schema, the time series, result.json and expectations of a run."""

import csv
import json
from typing import Literal

import numpy as np
import pytest
from api.scenes import flying
from pydantic import Field

import granflow as gf
from granflow.fields import Quantity
from granflow.scene.blocks.metrics import METRICS, Metric, Reading
from granflow.scene.registration import unregister_metric
from granflow.schema.faults import Fault


class Height(Metric):
    """Heights of the particles above a level."""

    kind: Literal["elevation"] = Field("elevation", description="kind of metric")
    level: float = Field(0.0, description="level [m]", examples=[0.25])
    quantities = (
        Quantity("mean_height", "z", "m", "mean height of the particles above a level"),
        Quantity("share_above", "", "1", "share of the particles above a level"),
    )

    def faults_in(self, parts):
        if self.level < parts.scene.domain.min[2]:
            yield Fault(("level",), "it is below the domain")

    def measure(self, snapshot, scene):
        height = snapshot.particles["position"][:, 2] - self.level
        return Reading({"mean_height": float(height.mean()), "share_above": float((height > 0).mean())})


@pytest.fixture
def registered():
    """The metric is registered during a test."""
    gf.register_metric(Height)
    yield
    unregister_metric(Height)


def falling_beads(metrics, expect=()):
    """Two beads at rest at the heights 0.1 m and 0.2 m that fall freely for 10 ms."""
    output = {"interval": 0.005, "energy_budget": True, "metrics": metrics}
    positions = [[0.0, 0.0, 0.1], [0.05, 0.0, 0.2]]
    return flying(positions, [0.0] * 3, gravity=[0.0, 0.0, -10.0], output=output, expect=list(expect))


def test_a_registered_metric_is_written_and_evaluated(registered, tmp_path, taichi_f64):
    """Free fall from the mean height 0.15 m: z = 0.15 m - g t^2 / 2, which velocity Verlet integrates
    exactly."""
    scene = falling_beads(
        {"fall": {"kind": "elevation", "level": 0.15}, "heap": {"kind": "repose", "surface": "cone"}},
        [{"quantity": "mean_height.fall", "between": [-0.000501, -0.000499]}],
    )
    with gf.Simulation(scene, out=tmp_path / "out", threads=2) as simulation:
        simulation.run()
    with (tmp_path / "out/timeseries.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        time = float(row["time [s]"])
        assert float(row["mean_height.fall [m]"]) == pytest.approx(-5.0 * time**2, abs=1e-9)
        assert float(row["share_above.fall"]) == 0.5
    result = json.loads((tmp_path / "out/result.json").read_text())
    last = float(rows[-1]["time [s]"])
    assert result["metrics"]["fall"]["mean_height"] == pytest.approx(-5.0 * last**2, abs=1e-9)
    assert result["metrics"]["fall"]["mean_height_mean"] == pytest.approx(
        np.mean([float(row["mean_height.fall [m]"]) for row in rows]), abs=1e-9
    )
    assert [each["met"] for each in result["expect"]] == [True]
    assert result["metrics"]["heap"]["angle_of_repose"] is None, "beads without contacts are no heap"
    assert sum("output.metrics.heap: the angle of repose is NaN" in each for each in result["warnings"]) == 1


def changed(**values):
    """The class `Height` with other values of the class."""
    return type("Changed", (Height,), {"__module__": __name__, **values})


@pytest.mark.parametrize(("metric", "message"), [
    (gf.LaceyMetric, "a metric of the kind lacey exists"),
    (type("NoKind", (Metric,), {"__module__": __name__}), "it needs a field kind"),
    (changed(quantities=(Quantity("mean height", "", "m", "x"),)), "its quantity 'mean height' must have"),
    (changed(quantities=(Quantity("mass_flow", "", "kg/s", "x"),)), "mass_flow exists with another meaning"),
    (changed(measure=Metric.measure), r"it must define measure\(snapshot, scene\)")
])  # fmt: skip
def test_invalid_metrics_are_refused(metric, message):
    with pytest.raises(gf.GranflowError, match=message):
        gf.register_metric(metric)
    assert metric is gf.LaceyMetric or metric not in METRICS


def test_a_metric_that_fails_is_named_and_the_state_is_saved(registered, monkeypatch, tmp_path, taichi_f64):
    usual = Height.measure

    def measure(self, snapshot, scene):
        return Reading({"mean": 0.0}) if snapshot.time > 0.004 else usual(self, snapshot, scene)

    monkeypatch.setattr(Height, "measure", measure)
    simulation = gf.Simulation(
        falling_beads({"fall": {"kind": "elevation"}}), out=tmp_path / "out", threads=2
    )
    with pytest.raises(gf.FunctionError, match="a Reading with the numbers mean_height, share_above"):
        simulation.run()
    assert list((tmp_path / "out").glob("checkpoint_*.npz"))
