"""The time series contains the numbers of the snapshots."""

import csv

import numpy as np
from observers.snapshots import snapshot_of

from granflow.io.tables import read_table, table_in, write_table
from granflow.observers.flow_meters import FlowMeter
from granflow.observers.timeseries import TimeSeries


def rows_of(path):
    with open(path, newline="") as file:
        return list(csv.reader(file))


def test_header_has_units_and_only_the_given_quantities(tmp_path):
    series = TimeSeries(tmp_path, 0.1)
    assert series.wants == {"totals"}
    series.observe(snapshot_of(totals={"kinetic_energy": 0.1, "particle_count": 3, "own_number": 1.5}))
    header, row = rows_of(tmp_path / "timeseries.csv")
    assert header == ["time [s]", "stage", "particle_count", "kinetic_energy [J]", "own_number"]
    assert row == ["0.0", "run", "3", "0.1", "1.5"]


def test_rows_are_exact_and_written_once(tmp_path):
    series = TimeSeries(tmp_path, 0.1)
    energies = np.random.default_rng(3).uniform(size=20)
    for step, energy in enumerate(energies):
        for _ in range(2):
            series.observe(snapshot_of(time=step / 7, stage="a, b", totals={"kinetic_energy": energy}))
        assert len(rows_of(series.path)) == step + 2, "each row is flushed"
    series.finish()
    rows = rows_of(series.path)[1:]
    assert [float(row[0]) for row in rows] == [step / 7 for step in range(20)]
    assert [float(row[2]) for row in rows] == list(energies)
    assert {row[1] for row in rows} == {"a, b"}


def test_flow_meters_have_columns(tmp_path):
    series = TimeSeries(tmp_path, 0.1, {"outlet": FlowMeter((0, 0, 0), (0, 0, -1))})
    assert series.wants == {"totals", "particles"}
    for time, height in ((0.0, 1.0), (0.5, -1.0)):
        particles = {"id": np.array([4]), "position": np.array([[0, 0, height]]), "mass": np.array([3.0])}
        particles["insertion_time"] = np.array([0.125])
        series.observe(snapshot_of(time=time, particles=particles, totals={}))
    series.finish()
    header, first, last = rows_of(series.path)
    names = ["flow_mass.outlet [kg]", "flow_count.outlet", "mass_flow.outlet [kg/s]", "residence_time.outlet [s]"]
    assert header[2:] == names
    assert first[2:] == ["0.0", "0", "0.0", "nan"]
    assert last[2:] == ["3.0", "1", "6.0", "0.125"]
    assert series.results_by_kind()["flow_meters"]["outlet"]["flow_count"] == 1


def test_tables_are_read_back_exactly_and_without_an_incomplete_row(tmp_path):
    path, numbers = tmp_path / "new" / "a.csv", np.random.default_rng(1).normal(size=7)
    write_table(path, ["time [s]", "stage"], ([number, 'fill, "slow"'] for number in numbers.tolist()))
    path.write_text(path.read_text() + "\n# note\n1.5\n")
    table = read_table(path)
    assert table.names == ("time [s]", "stage") and [line for line, _ in table.rows][-1] == 11
    assert table.complete().numbers(0).tolist() == numbers.tolist()
    assert set(table.complete().texts(1)) == {'fill, "slow"'}


def test_header_and_separator_of_tables(tmp_path):
    table = table_in("# made by hand\n\na;b [mm];\n1,5;x;\n", tmp_path, (";", ","))
    assert (table.names, table.separator, table.heading_line) == (("a", "b [mm]"), ";", 3)
    assert table.numbers(0).tolist() == [1.5] and np.isnan(table.numbers(1)).all()
    assert table_in("# only\n# comments\n", tmp_path) is None
