"""The time series contains the numbers of the snapshots."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from observers.snapshots import particles_of, snapshot_of

from granflow.io.tables import read_table, table_in, write_table
from granflow.observers.meters import FlowCounter, WallForceMeter
from granflow.observers.metrics import MetricMeter
from granflow.observers.timeseries import TimeSeries
from granflow.runs.result import Result
from granflow.scene.blocks.metrics import Reading
from granflow.scene.blocks.output import FlowMeter


def rows_of(path):
    with open(path, newline="") as file:
        return list(csv.reader(file))


def test_rows_are_exact_and_written_once(tmp_path):
    series = TimeSeries(tmp_path, 0.1)
    assert series.wants == {"totals"}
    energies = np.random.default_rng(3).uniform(size=20)
    for step, energy in enumerate(energies):
        totals = {"kinetic_energy": energy, "particle_count": 3, "own_number": 1.5}
        for _ in range(2):
            series.observe(snapshot_of(time=step / 7, stage="a, b", totals=totals))
        assert len(rows_of(series.path)) == step + 2, "each row is flushed"
    series.finish()
    header, *rows = rows_of(series.path)
    assert header == ["time [s]", "stage", "particle_count", "kinetic_energy [J]", "own_number"]
    expected = [
        [repr(step / 7), "a, b", "3", repr(float(energy)), "1.5"] for step, energy in enumerate(energies)
    ]
    assert rows == expected


def test_totals_have_means_and_largest_values_of_each_stage(tmp_path):
    """Energies of 1, 5 J in one stage and 2, 4 J in another; the last row, of 8 J, replaces that of 4 J."""
    series = TimeSeries(tmp_path, 0.1)
    rows = [
        (0.0, "fill", 1.0),
        (0.1, "fill", 5.0),
        (0.2, "shake", 2.0),
        (0.3, "shake", 4.0),
        (0.31, "shake", 8.0),
    ]
    for time, stage, energy in rows:
        if time == 0.31:
            saved = series.state_dict()
            series = TimeSeries(None, 0.1)
            series.load_state_dict(saved)
        series.observe(snapshot_of(time, stage=stage, totals={"kinetic_energy": energy, "own_number": 1.0}))
    stages = series.results_by_kind()["stages"]
    assert stages == {
        "fill": {"kinetic_energy_mean": 3.0, "kinetic_energy_largest": 5.0},
        "shake": {"kinetic_energy_mean": 5.0, "kinetic_energy_largest": 8.0},
    }
    numbers = Result({}, {}, {"kinetic_energy": 8.0}, stages=stages).numbers
    assert numbers["kinetic_energy_mean"] == numbers["kinetic_energy_mean.shake"] == 5.0
    assert (numbers["kinetic_energy"], numbers["kinetic_energy_largest.fill"]) == (8.0, 5.0)


def test_tables_are_read_back_exactly_and_without_an_incomplete_row(tmp_path):
    path = tmp_path / "new" / "a.csv"
    numbers = np.random.default_rng(1).normal(size=7)
    write_table(path, ["time [s]", "stage"], ([number, 'fill, "slow"'] for number in numbers.tolist()))
    path.write_text(path.read_text() + "\n# note\n1.5\n")
    table = read_table(path)
    assert table.names == ("time [s]", "stage") and [line for line, _ in table.rows][-1] == 11
    assert table.complete().numbers(0).tolist() == numbers.tolist()
    assert set(table.complete().texts(1)) == {'fill, "slow"'}
    table = table_in("# made by hand\n\na;b [mm];\n1,5;x;\n", tmp_path, (";", ","))
    assert (table.names, table.separator, table.heading_line) == (("a", "b [mm]"), ";", 3)
    assert table.numbers(0).tolist() == [1.5] and np.isnan(table.numbers(1)).all()
    assert table_in("# only\n# comments\n", tmp_path) is None


def measured_series(folder):
    """A series with a flow meter, a wall of 2 m2 in the stage `run`, and a metric whose value is the time."""
    metric = MetricMeter(
        lambda snapshot: Reading({"coordination_number": snapshot.time}), frozenset({"totals"})
    )
    meters = {"out": FlowCounter(FlowMeter(point=(0, 0, 0), normal=(0, 0, -1)))}
    forces = {"lid": WallForceMeter("lid", 2.0, ("run",))}
    return TimeSeries(folder, 0.1, meters, wall_forces=forces, metrics={"bed": metric})


def pushed(time, stage="run"):
    """One particle of 0.2 kg passes every 0.1 s, from 0.05 s; a force of 8 N, and an impact of 1 N s at
    0.3000001 s."""
    number = np.arange(30)
    position = np.stack([0 * number, 0 * number, 0.05 + 0.1 * number - time], axis=1)
    particles = particles_of(30, position=position, mass=np.full(30, 0.2), insertion_time=np.zeros(30))
    impulse = 8.0 * time + (time > 0.3)
    snapshot = snapshot_of(time=time, stage=stage, particles=particles, totals={})
    return replace(snapshot, impulses={"lid": np.array([0, 0, impulse, 0, 0, 0, impulse, 0])})


TIMES = [0.0, 0.1, 0.2, 0.3]


def test_a_short_last_row_replaces_the_row_before_it(tmp_path):
    """A row of one step had a mean force of (8 N dt + 1 N s) / dt; right is that since 0.2 s.

    The mean of the metric is that of the rows 0, 0.1, 0.2 and of the last one.
    """
    series = measured_series(tmp_path)
    end = 0.300001
    for time in (*TIMES, end):
        series.observe(pushed(time))
        lid = series.results_by_kind()["wall_forces"]["lid"]
        assert np.isnan(list(lid.values())).all() == (time == 0.0), "one row has no mean force"
    results = series.results_by_kind()
    window = end - 0.2
    force = (8.0 * window + 1.0) / window
    expected = {
        "wall_force_z_last": force, "wall_pressure_last": 0.5 * force, "wall_force_largest": force,
        "wall_force_z": (8.0 * end + 1.0) / end,
    }  # fmt: skip
    lid = results["wall_forces"]["lid"]
    assert {name: lid[name] for name in expected} == pytest.approx(expected, rel=1e-9)
    mean = results["metrics"]["bed"]["coordination_number_mean"]
    assert mean == pytest.approx((0.1 + 0.2 + end) / 4, rel=1e-12)
    assert results["flow_meters"]["out"]["flow_count"] == 3
    header, *rows = rows_of(series.path)
    assert [float(row[0]) for row in rows] == [0.0, 0.1, 0.2, end]
    last = dict(zip(header, rows[-1], strict=True))
    assert float(last["mass_flow.out [kg/s]"]) == pytest.approx(0.2 / window, rel=1e-9)
    assert float(last["wall_force_z.lid [N]"]) == pytest.approx(force, rel=1e-9)
    assert series.last_row.time_before == 0.2


@pytest.mark.parametrize(("last", "stage"), [(0.351, "run"), (0.300001, "next")])
def test_a_last_row_of_half_an_interval_or_of_another_stage_is_added(tmp_path, last, stage):
    series = measured_series(tmp_path)
    for time in TIMES:
        series.observe(pushed(time))
    series.observe(pushed(last, stage))
    assert [float(row[0]) for row in rows_of(series.path)[1:]] == [*TIMES, last]
    lid = series.results_by_kind()["wall_forces"]["lid"]
    mean = (8.0 * last + 1.0) / last if stage == "run" else 0.0
    assert lid["wall_force_z"] == pytest.approx(mean, rel=1e-9), "0 in a stage without the wall"
