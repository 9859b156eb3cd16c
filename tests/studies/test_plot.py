"""`granflow plot`: chosen columns, expressions, several runs, files, and refused input."""

import json
import re

import numpy as np
import pytest

from granflow.cli.main import main
from granflow.errors import GranflowError
from granflow.io.time_series import read_series
from granflow.studies.plot.curves import panels_of
from granflow.studies.plot.expression import quantity_of

HEAD = (
    "time [s],stage,wall_pressure.lid [Pa],wall_displacement.lid [m],wall_force_x.lid [N],wall_force_z.lid [N],"
    "slope [rad]"
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
    (directory / "timeseries.csv").write_text("\n".join([HEAD, *(",".join(map(str, row)) for row in ROWS)]) + "\n")
    return directory


def value(run, text):
    return quantity_of(read_series(run / "timeseries.csv"), text, "timeseries.csv")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("wall_displacement.lid / 0.05", [0.0, 0.02, 0.08]),
        ("-(wall_displacement.lid - 1e-3)*2", [0.002, 0.0, -0.006]),
        ("wall_force_x.lid / wall_force_z.lid", [0.1, 0.1, 0.1]),
        ("sqrt(time**2 + 0 * wall_pressure.lid)", [0.0, 1.0, 2.0]),
        ("abs(1 - time)", [1.0, 0.0, 1.0]),
        ("3", [3.0, 3.0, 3.0]),
    ],
)
def test_expressions_of_columns(run, text, expected):
    found = value(run, text)
    assert found.values == pytest.approx(expected) and found.unit == ""


def test_a_column_has_its_unit_and_an_angle_is_in_degrees(run):
    assert value(run, "wall_pressure.lid").unit == "Pa"
    slope = value(run, "slope")
    assert slope.unit == "deg" and slope.values == pytest.approx(np.degrees([0.5, 0.25, 0.0]))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("wall_presure.lid", "has no column wall_presure.lid. Did you mean wall_pressure.lid?"),
        ("time / wall_presure.lid", "has no column wall_presure.lid. Did you mean wall_pressure.lid?"),
        ("__import__('os')", "has no column __import__"),
        ("time if time else 1", "has no column if"),
        ("time +", "neither a column of timeseries.csv nor an arithmetic expression"),
        ("[time]", "neither a column"),
        ("time < 1", "neither a column"),
        ("abs", "neither a column"),
        ("9**9**9**9", "neither a column"),
        ("(" * 500 + "time" + ")" * 500, "neither a column"),
    ],
)
def test_text_that_is_no_quantity_is_refused_with_one_sentence(run, text, sentence):
    with pytest.raises(GranflowError, match=re.escape(sentence)):
        value(run, text)


def test_quantities_of_one_unit_share_a_panel_and_runs_are_named_by_their_directories(run):
    panels = panels_of(
        [run, run.parent / "dense" / "timeseries.csv"],
        "time",
        ["wall_force_x.lid", "wall_pressure.lid", "wall_force_z.lid"],
    )
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


def test_more_curves_than_colors_and_line_styles_are_refused(run):
    with pytest.raises(GranflowError, match=r"19 curves are too many for one plot; choose at most 18"):
        panels_of([run], "time", ["wall_pressure.lid"] * 19)


def test_without_y_the_columns_are_listed(run, capsys):
    assert main(["plot", str(run)]) == 0
    assert re.search(r"wall_displacement\.lid\W+m\b", capsys.readouterr().out)


def test_the_page_contains_the_points_and_titles(run, tmp_path):
    pytest.importorskip("plotly")
    page = tmp_path / "new" / "curve.html"
    arguments = [
        "--x",
        "wall_displacement.lid / 0.05",
        "--y",
        "wall_pressure.lid",
        "--log",
        "y",
        "--out",
        str(page),
        "--y-label",
        "stress (Pa)",
    ]
    assert main(["plot", str(run), *arguments]) == 0
    figure = json.loads(re.search(r'<script type="application/json">(.*?)</script>', page.read_text(), re.DOTALL)[1])
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


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["nowhere", "--y", "time"], "nowhere does not exist; give the directory of a run"),
        ([".", "--y", "time"], "contains no timeseries.csv; give the directory of a run"),
        (["RUN", "--y", "time", "--out", "curve.jpg"], "--out curve.jpg is not of a supported type"),
    ],
)
def test_invalid_arguments(run, tmp_path, monkeypatch, capsys, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    assert main(["plot", *(str(run) if each == "RUN" else each for each in arguments)]) == 2
    assert sentence in capsys.readouterr().err
