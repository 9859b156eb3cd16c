"""`granflow plot`: chosen columns, expressions, several runs, files, and refused input."""

import json
import re

import numpy as np
import pytest

from granflow.cli.main import main
from granflow.errors import GranflowError
from granflow.io.tables import COLLISION_COLUMNS, read_series
from granflow.studies.plot import panels_of, quantity_of, series_of

HEAD = (
    "time [s],stage,wall_pressure.lid [Pa],wall_displacement.lid [m],wall_force_x.lid [N],wall_force_z.lid "
    "[N],slope [rad]"
)
ROWS = (
    (0.0, "load", 0.0, 0.0, 1.0, 10.0, 0.5),
    (1.0, "load", 2e3, 1e-3, 2.0, 20.0, 0.25),
    (2.0, "hold", 4e3, 4e-3, 3.0, 30.0, 0.0),
)


@pytest.fixture
def run(tmp_path):
    """Directory with a time series of three rows in two stages."""
    directory = tmp_path / "dense"
    directory.mkdir()
    (directory / "timeseries.csv").write_text(
        "\n".join([HEAD, *(",".join(map(str, row)) for row in ROWS)]) + "\n"
    )
    return directory


def value(run, text):
    return quantity_of(read_series(run / "timeseries.csv"), text, "timeseries.csv")


@pytest.mark.parametrize(("text", "expected"), [
    ("wall_displacement.lid / 0.05", [0.0, 0.02, 0.08]),
    ("-(wall_displacement.lid - 1e-3)*2", [0.002, 0.0, -0.006]),
    ("wall_force_x.lid / wall_force_z.lid", [0.1, 0.1, 0.1]),
    ("sqrt(time**2 + 0 * wall_pressure.lid)", [0.0, 1.0, 2.0]),
    ("abs(1 - time)", [1.0, 0.0, 1.0]), ("3", [3.0, 3.0, 3.0])
])  # fmt: skip
def test_expressions_of_columns(run, text, expected):
    found = value(run, text)
    assert found.values == pytest.approx(expected) and found.unit == ""
    assert value(run, "wall_pressure.lid").unit == "Pa"
    slope = value(run, "slope")
    assert slope.unit == "deg" and slope.values == pytest.approx(np.degrees([0.5, 0.25, 0.0]))


def test_foreign_columns_are_in_si_by_their_units(tmp_path):
    """Stage times are converted as well; a unit that granflow does not know, or of two dimensions,
    remains."""
    path = tmp_path / "scope.csv"
    path.write_text(
        "time [ms],stage,energy (mJ),share [%],angle [deg],speed [rpm],mass [g],torque [Nmm]\n"
        "0,a,1,50,90,60,2,3\n20,b,2,100,180,30,4,6\n"
    )
    (panel,) = panels_of([path], "time", ["energy"])
    assert panel.x_title == "time (s)" and panel.y_title == "energy (J)"
    assert panel.curves[0].x == pytest.approx([0.0, 0.02]) and panel.curves[0].y == pytest.approx(
        [1e-3, 2e-3]
    )
    _, series = series_of(path, "time")
    assert series.stages == ((0.0, "a"), (0.02, "b"))
    columns = {each.name: (each.unit, each.values.tolist()) for each in series.columns}
    assert columns["share"] == ("", [0.5, 1.0]) and columns["speed"] == (
        "rad/s",
        pytest.approx([2 * np.pi, np.pi]),
    )
    assert columns["angle"] == ("rad", pytest.approx([np.pi / 2, np.pi]))
    assert columns["mass"] == ("g", [2.0, 4.0]) and columns["torque"] == ("Nmm", [3.0, 6.0])


@pytest.mark.parametrize(("text", "line", "parts"), [
    ("time [ms,a [kPa]\n0,1\n", 1, ["'time [ms,a [kPa]'", "only one of the brackets []"]),
    ("time [s];a [mm]\n0;1\n", 1, ["'time [s];a [mm]'", "separated by semicolons"]),
    ("time [s] a [mm]\n0 1\n", 1, ["'time [s] a [mm]' does not end with its unit"]),
    ("time [s],a [m]\n1,2\n2,3\n3,5\n4\n5,x\n", 5, ["the row '4' has 1 value, but the header has 2."]),
    ("time [s],a [m]\n1,2\n2,x\n3,5\n4\n5,6\n", 3, ["a [m] is x, but a number is expected"])
])  # fmt: skip
def test_damaged_headers_and_rows_are_refused_with_their_line(tmp_path, capsys, text, line, parts):
    path = tmp_path / "scope.csv"
    path.write_text(text)
    assert main(["plot", str(path), "--y", "a", "--out", str(tmp_path / "a.png")]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and f"{path}:{line}: " in message
    assert all(part in message for part in parts), message


@pytest.mark.parametrize(
    "last", ["", "2", "2.5,ho", "2.5,hold,", "2.5,hold,1.5e-", "2.5,hold,-", "2.5,hold,na"]
)
def test_empty_cells_and_a_last_line_that_is_being_written_are_accepted(tmp_path, last):
    path = tmp_path / "timeseries.csv"
    path.write_text(f"time [s],stage,mass [kg],remark\n0,load,1,a\n1,load,,\n2,hold,nan,b\n{last}")
    (panel,) = panels_of([path], "time", ["mass"])
    assert panel.curves[0].y == pytest.approx([1.0, np.nan, np.nan], nan_ok=True)


@pytest.mark.parametrize(("text", "sentence"), [
    ("wall_presure.lid", "has no column wall_presure.lid. Did you mean wall_pressure.lid?"),
    ("time / wall_presure.lid", "has no column wall_presure.lid. Did you mean wall_pressure.lid?"),
    ("__import__('os')", "has no column __import__"),
    ("nonsense", "has no column nonsense. The columns are time, "),
    ("time +", "neither a column of timeseries.csv nor an arithmetic expression"),
    ("-" * 100_000 + "1", "neither a column"),
    ("(" * 500 + "time" + ")" * 500, "neither a column")
])  # fmt: skip
def test_text_that_is_no_quantity_is_refused_with_one_sentence(run, text, sentence):
    with pytest.raises(GranflowError, match=re.escape(sentence)):
        value(run, text)


@pytest.mark.parametrize(("y", "sentence"), [
    ("(-8)**0.5", "'(-8)**0.5' over 'time' has no finite value"),
    ("wall_pressure.lid / 0", "has no finite value"),
    ("8e307 * time", "reach 1.6e+308, but at most 1e+250 can be drawn: divide them")
])  # fmt: skip
def test_a_quantity_that_cannot_be_drawn_is_refused_with_one_sentence(run, capsys, y, sentence):
    assert main(["plot", str(run), "--y", "wall_pressure.lid", y]) == 2
    assert sentence in capsys.readouterr().err
    assert not list(run.glob("*.png"))


def test_quantities_of_one_unit_share_a_panel_and_runs_are_named_by_their_directories(run):
    panels = panels_of([run, run.parent / "dense" / "timeseries.csv"], "time", [
        "wall_force_x.lid", "wall_pressure.lid", "wall_force_z.lid"
    ])  # fmt: skip
    assert [panel.y_title for panel in panels] == ["wall force (N)", "wall pressure, lid (Pa)"]
    assert [curve.name for curve in panels[1].curves] == [
        "dense, wall pressure, lid",
        "timeseries.csv, wall pressure, lid",
    ]
    assert len(panels[0].curves) == 4


def test_rows_of_one_stage(run):
    (panel,) = panels_of([run], "wall_displacement.lid", ["wall_pressure.lid"], ["load"])
    assert panel.curves[0].x.tolist() == [0.0, 1e-3] and panel.curves[0].y.tolist() == [0.0, 2e3]
    with pytest.raises(GranflowError, match=r"no rows of the stage press; its stages are: load, hold\."):
        panels_of([run], "time", ["wall_pressure.lid"], ["press"])


def test_the_page_contains_the_points_and_titles(run, tmp_path):
    pytest.importorskip("plotly")
    page = tmp_path / "new" / "curve.html"
    arguments = [
        "--x", "wall_displacement.lid / 0.05", "--y", "wall_pressure.lid", "--log", "y", "--out", str(page),
        "--y-label", "stress (Pa)"
    ]  # fmt: skip
    assert main(["plot", str(run), *arguments]) == 0
    figure = json.loads(
        re.search(r'<script type="application/json">(.*?)</script>', page.read_text(), re.DOTALL)[1]
    )
    assert figure["data"][0]["x"] == [0.0, 0.02, 0.08] and figure["data"][0]["y"] == [0.0, 2e3, 4e3]
    assert figure["layout"]["xaxis"]["title"]["text"] == "wall_displacement.lid / 0.05"
    assert figure["layout"]["xaxis"]["range"] == [0.0, 0.08]
    assert figure["layout"]["yaxis"]["type"] == "log"
    assert figure["layout"]["yaxis"]["title"]["text"] == "stress (Pa)"


def test_the_image_is_named_after_its_quantities(run, capsys):
    pytest.importorskip("matplotlib")
    assert main(["plot", str(run), "--x", "wall_displacement.lid / 0.05", "--y", "wall_pressure.lid"]) == 0
    path = run / "plot_wall_pressure.lid_over_wall_displacement.lid_0.05.png"
    assert path.read_bytes().startswith(b"\x89PNG") and str(path) in capsys.readouterr().out


COLLISION_ROWS = {  # end of the interval: count and count_total of the classes of particle, then of wall
    1.0: ([0, 2, 3, 0], [0, 2, 3, 0], [1, 0, 0, 0], [1, 0, 0, 0]),
    2.0: ([0, 1, 1, 4], [0, 3, 4, 4], [0, 5, 0, 0], [1, 5, 0, 0]),
}


@pytest.fixture
def collisions(tmp_path):
    """collision_energies.csv of two intervals with four classes, and an incomplete third interval."""
    edges = [0.0, 1e-6, 1e-4, 1e-2, np.inf]
    rows = []
    for end, numbers in COLLISION_ROWS.items():
        for kind, counts, totals in (("particle", *numbers[:2]), ("wall", *numbers[2:])):
            classes = zip(edges[:-1], edges[1:], counts, totals, strict=True)
            rows += [(end - 1.0, end, kind, *values) for values in classes]
    rows.append((2.0, 3.0, "particle", 0.0, 1e-6, 9, 9))
    path = tmp_path / "collision_energies.csv"
    path.write_text(
        "\n".join([",".join(COLLISION_COLUMNS), *(",".join(map(str, row)) for row in rows)]) + "\n"
    )
    return path


def test_numbers_of_collisions_over_time_and_over_energy_at_the_end(collisions):
    names = ["count.particle", "count_total.particle", "count.wall", "count.particle_0.0001_to_0.01_J"]
    (panel,) = panels_of([collisions], "time", names)
    assert [curve.x.tolist() for curve in panel.curves] == [[1.0, 2.0]] * 4
    assert [curve.y.tolist() for curve in panel.curves] == [[5, 6], [5, 11], [1, 5], [3, 1]]
    (panel,) = panels_of([collisions], "energy", ["count_total.particle", "count.wall"])
    assert panel.x_title == "energy (J)"
    assert [curve.y.tolist() for curve in panel.curves] == [[0, 3, 4, 4], [0, 5, 0, 0]]
    assert panel.curves[0].x == pytest.approx([np.nan, 1e-5, 1e-3, np.nan], nan_ok=True)


@pytest.mark.parametrize(("text", "sentence"), [
    (",".join(COLLISION_COLUMNS) + "\n", "has no complete rows yet."),
    (",".join(COLLISION_COLUMNS) + "\n0,1,particle,0,1e-6,2,2\n", "has no complete rows yet."),
    ("time [s],speed [m/s]\n", "has no complete rows yet."),
    ("energy [J],number\n1,2\n",
     "has neither a column time nor the columns of collision_energies.csv; its columns are: energy, "
     "number."),
    ("", "its columns are: none.")
])  # fmt: skip
def test_file_without_known_columns_or_rows(tmp_path, text, sentence):
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(GranflowError, match=re.escape(sentence)):
        panels_of([tmp_path / "table.csv"], "time", ["count.wall"])
