"""`granflow plot`: chosen columns, expressions, several runs, files, and refused input."""

import json
import re
import shutil

import numpy as np
import pytest

from granflow.cli.main import main
from granflow.errors import GranflowError
from granflow.io.tables import COLLISION_COLUMNS, read_series
from granflow.studies.plot import panels_of, quantity_of, series_of

HEAD = "time [s],stage,wall_pressure.lid [Pa],wall_displacement.lid [m],wall_force_x.lid [N],wall_force_z.lid [N],slope [rad]"
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
    lines = [HEAD, *(",".join(map(str, row)) for row in ROWS)]
    (directory / "timeseries.csv").write_text("\n".join(lines) + "\n")
    return directory


def value(run, text):
    return quantity_of(read_series(run / "timeseries.csv"), text, "timeseries.csv")


@pytest.mark.parametrize(("text", "unit", "expected"), [
    ("-(wall_displacement.lid - 1e-3)*2", "", [0.002, 0.0, -0.006]),
    ("wall_force_x.lid / wall_force_z.lid", "", [0.1, 0.1, 0.1]),
    ("sqrt(time**2 + 0 * wall_pressure.lid)", "", [0.0, 1.0, 2.0]), ("abs(1 - time)", "", [1.0, 0.0, 1.0]),
    ("wall_pressure.lid", "Pa", [0.0, 2e3, 4e3]), ("slope", "deg", np.degrees([0.5, 0.25, 0.0]))
])  # fmt: skip
def test_expressions_of_columns(run, text, unit, expected):
    found = value(run, text)
    assert found.values == pytest.approx(expected) and found.unit == unit


def test_foreign_columns_are_in_si_by_their_units(tmp_path):
    """Stage times are converted as well; a unit of two dimensions remains."""
    path = tmp_path / "scope.csv"
    path.write_text(
        "time [ms],stage,energy (mJ),share [%],speed [rpm],mass [g]\n0,a,1,50,60,2\n20,b,2,100,30,4\n"
    )
    (panel,) = panels_of([path], "time", ["energy"])
    assert (panel.x_title, panel.y_title) == ("time (s)", "energy (J)")
    _, series = series_of(path, "time")
    assert series.stages == ((0.0, "a"), (0.02, "b"))
    columns = {each.name: (each.unit, each.values.tolist()) for each in series.columns}
    assert columns == {
        "energy": ("J", pytest.approx([1e-3, 2e-3])), "share": ("", [0.5, 1.0]), "mass": ("g", [2.0, 4.0]),
        "speed": ("rad/s", pytest.approx([2 * np.pi, np.pi])),
    }  # fmt: skip


@pytest.mark.parametrize(("text", "line", "part"), [
    ("time [ms,a [kPa]\n0,1\n", 1, "only one of the brackets []"),
    ("time [s];a [mm]\n0;1\n", 1, "separated by semicolons"),
    ("time [s],a [m]\n1,2\n2,3\n3,5\n4\n5,x\n", 5, "the row '4' has 1 value, but the header has 2."),
    ("time [s],a [m]\n1,2\n2,x\n3,5\n4\n5,6\n", 3, "a [m] is x, but a number is expected")
])  # fmt: skip
def test_damaged_headers_and_rows_are_refused_with_their_line(tmp_path, text, line, part):
    path = tmp_path / "scope.csv"
    path.write_text(text)
    with pytest.raises(GranflowError, match=re.escape(f"{path}:{line}: ") + ".*" + re.escape(part)):
        panels_of([path], "time", ["a"])


@pytest.mark.parametrize("last", ["", "2", "2.5,hold,1.5e-", "2.5,hold,-", "2.5,hold,na"])
def test_empty_cells_and_a_last_line_that_is_being_written_are_accepted(tmp_path, last):
    path = tmp_path / "timeseries.csv"
    path.write_text(f"time [s],stage,mass [kg],remark\n0,load,1,a\n1,load,,\n2,hold,nan,b\n{last}")
    (panel,) = panels_of([path], "time", ["mass"])
    assert panel.curves[0].y == pytest.approx([1.0, np.nan, np.nan], nan_ok=True)


@pytest.mark.parametrize(("text", "sentence"), [
    ("time / wall_presure.lid", "has no column wall_presure.lid. Did you mean wall_pressure.lid?"),
    ("__import__('os')", "has no column __import__"), ("time +", "is neither a column of"),
    ("-" * 100_000 + "1", "neither a column"), ("8e307 * time", "at most 1e+250 can be drawn"),
    ("wall_pressure.lid / 0", "has no finite value")
])  # fmt: skip
def test_a_quantity_that_cannot_be_drawn_is_refused_with_one_sentence(run, capsys, text, sentence):
    assert main(["plot", str(run), "--y=wall_pressure.lid", f"--y={text}"]) == 2
    assert sentence in capsys.readouterr().err
    assert not list(run.glob("*.png"))


def test_quantities_of_one_unit_share_a_panel_and_a_stage_selects_rows(run):
    names = ["wall_force_x.lid", "wall_pressure.lid", "wall_force_z.lid"]
    panels = panels_of([run, run / "timeseries.csv"], "time", names)
    assert [panel.y_title for panel in panels] == ["wall force (N)", "wall pressure, lid (Pa)"]
    assert [len(panel.curves) for panel in panels] == [4, 2]
    runs = run.parent / "sweep" / "runs"
    shutil.copytree(run, runs / "0a1b")
    shutil.copytree(run, runs / "c2d3")
    head = "pairs.a-a.friction,particles.a.count,seed,status,run"
    (runs.parent / "runs.csv").write_text(f"{head}\n0.30000000000000004,5,1,done,0a1b\n0.4,5,2,done,c2d3\n")
    (panel,) = panels_of([runs / "0a1b", runs / "c2d3" / "timeseries.csv"], "time", ["slope"])
    assert [curve.name for curve in panel.curves] == ["a-a.friction 0.3, seed 1", "a-a.friction 0.4, seed 2"]
    (panel,) = panels_of([run], "wall_displacement.lid", ["wall_pressure.lid"], ["load"])
    assert panel.curves[0].x.tolist() == [0.0, 1e-3] and panel.curves[0].y.tolist() == [0.0, 2e3]
    with pytest.raises(GranflowError, match=r"no rows of the stage press; its stages are: load, hold\."):
        panels_of([run], "time", ["wall_pressure.lid"], ["press"])


def test_page_and_image_of_a_quantity(run, tmp_path):
    pytest.importorskip("plotly")
    pytest.importorskip("matplotlib")
    command = ["plot", str(run), "--x", "wall_displacement.lid / 0.05", "--y", "wall_pressure.lid"]
    page = tmp_path / "new" / "curve.html"
    assert main([*command, "--log", "y", "--out", str(page), "--y-label", "stress (Pa)"]) == 0
    found = re.search(r'<script type="application/json">(.*?)</script>', page.read_text(), re.DOTALL)
    figure = json.loads(found[1])
    assert figure["data"][0]["x"] == [0.0, 0.02, 0.08] and figure["data"][0]["y"] == [0.0, 2e3, 4e3]
    assert figure["layout"]["xaxis"]["range"] == [0.0, 0.08]
    assert figure["layout"]["yaxis"]["type"] == "log"
    assert figure["layout"]["yaxis"]["title"]["text"] == "stress (Pa)"
    assert main(command) == 0
    path = run / "plot_wall_pressure.lid_over_wall_displacement.lid_0.05.png"
    assert path.read_bytes().startswith(b"\x89PNG")


def test_numbers_of_collisions_over_time_and_over_energy_at_the_end(tmp_path):
    """Two intervals with three classes, and an incomplete third interval."""
    path = tmp_path / "collision_energies.csv"
    head = ",".join(COLLISION_COLUMNS)
    path.write_text(f"""{head}
0,1,particle,0,1e-6,0,0
0,1,particle,1e-6,1e-4,2,2
0,1,particle,1e-4,inf,3,3
1,2,particle,0,1e-6,0,0
1,2,particle,1e-6,1e-4,1,3
1,2,particle,1e-4,inf,5,8
2,3,particle,0,1e-6,9,9
""")
    (panel,) = panels_of([path], "time", ["count.particle", "count_total.particle"])
    assert [curve.x.tolist() for curve in panel.curves] == [[1.0, 2.0]] * 2
    assert [curve.y.tolist() for curve in panel.curves] == [[5, 6], [5, 11]]
    (panel,) = panels_of([path], "energy", ["count_total.particle"])
    assert panel.x_title == "energy (J)" and panel.curves[0].y.tolist() == [0, 3, 8]
    assert panel.curves[0].x == pytest.approx([np.nan, 1e-5, np.nan], nan_ok=True)
    path.write_text(f"{head}\n0,1,particle,0,1e-6,2,2\n")
    with pytest.raises(GranflowError, match="has no complete rows yet"):
        panels_of([path], "time", ["count.particle"])
