"""Report of one run: complete, interrupted and resumed runs, and the grouping of columns into plots."""

import json
import re
import shutil
import sys
from dataclasses import asdict
from types import SimpleNamespace

import numpy as np
import pytest
from scene_runner import SCENES
from studies.test_page import BalanceParser

import granflow as gf
from granflow import read_run
from granflow.cli.main import main
from granflow.io.log import RecordEntry, SessionFacts, read_record, sessions, warnings_and_errors
from granflow.io.tables import SeriesColumn, TimeSeriesTable
from granflow.io.vtu import VtuMesh, write_vtu
from granflow.observers.timeseries import CollisionEnergies
from granflow.runs.read_run import Frames
from granflow.snapshot import Snapshot
from granflow.studies import report as report_module
from granflow.studies.interactive_plots import MOST_POINTS, groups_of, plot_of, thinned
from granflow.studies.report import (
    collision_topics,
    field_content,
    report_text,
    residence_topics,
    size_topics,
)

HEAD = (
    "time [s],stage,particle_count,kinetic_energy [J],elastic_energy [J],overlap_mean,overlap_largest,idle "
    "[N],"
)
HEAD += "flow_mass.a [kg],mass_flow.a [kg/s],force_z.floor [N],force_z.lid [N],temperature [K]\n"
ROWS = [
    "0.0,fill,1,2e-6,0,0,0,0,0,0,1,2,300\n",
    "0.1,fill,2,,1e-6,0.1,0.2,0,0,0,1,3,301\n",
    "0.2,pour,2,1e-6,0,0,0.5,0,3,4,1,2,302\n",
]
PLAN = "Two <beads> (two.yaml)\n  friction  off  every pair has friction 0"
VERSIONS = "granflow 0.1.0, taichi 1.7.4, Python 3.11"
RECORD = [
    RecordEntry(
        "2026-01-02 03:04:05", "INFO", VERSIONS, SessionFacts(VERSIONS, "cpu", "f64", 2, 1.5, "", 0.0, PLAN)
    ),
    RecordEntry("2026-01-02 03:04:06", "WARNING", "too fast"),
    RecordEntry("2026-01-02 03:04:07", "WARNING", "too fast"),
    RecordEntry(
        "2026-01-02 03:04:08", "ERROR", "ended by RunError: it burst\nat the seams", ended_by="RunError"
    )
]  # fmt: skip
RESUMED = [
    RecordEntry(
        "2026-01-02 04:00:00", "INFO", "granflow 0.2.0, taichi 1.7.4, Python 3.11",
        SessionFacts("granflow 0.2.0", "cuda", "f32", None, 2.5, "checkpoint_1.npz", 0.1, "")
    )
]  # fmt: skip


def lines_of(entries):
    """Lines of a record with entries."""
    return "".join(
        json.dumps({name: value for name, value in asdict(each).items() if value}) + "\n" for each in entries
    )


RESULT = {
    "run": {"simulated_time": 0.2, "step_count": 12345, "wall_clock": 10.0},
    "timings": {"forces": 6.0, "compile": 3.0},
    "totals": {"particle_count": 2, "energy_error": 1e-4},
    "flow_meters": {"a": {"flow_mass": 3.0, "mass_flow": 4.0}},
    "expect": [{"sentence": "it is 1, as expected.", "met": True}, {"sentence": "it is <2>.", "met": False}],
    "wall_forces": {"lid": {"wall_force": 7.5}},
    "packing": {"solid_fraction": 0.62, "not_known": None},
    "insertion": {"beads": {"inserted_count": 40321, "not_inserted_count": 0}},
}


@pytest.fixture
def run(tmp_path):
    (tmp_path / "timeseries.csv").write_text(HEAD + "".join(ROWS))
    (tmp_path / "run.log").write_text("")
    (tmp_path / "run.jsonl").write_text(lines_of(RECORD))
    (tmp_path / "result.json").write_text(json.dumps(RESULT))
    (tmp_path / "scene_as_run.yaml").write_text("title: A & B\nnot a scene: at all\n")
    return tmp_path


def text_of(directory, script="/* plotly */"):
    """Text of the page; asserts that its HTML is balanced."""
    html = report_text(read_run(directory), script, None)
    parser = BalanceParser()
    parser.feed(re.sub(r"<script>.*?</script>", "", html, flags=re.DOTALL))
    assert not parser.open
    return "".join(parser.text)


def columns(*names):
    return [SeriesColumn(name, unit, np.ones(1)) for name, _, unit in (each.partition(" ") for each in names)]


def test_page_of_a_complete_run_contains_all_results(run):
    text = text_of(run)
    for fragment in (
        *("The run is complete.", "1 of 2 expectations", "it is <2>.", "too fast (2 times)", "12 345"),
        *("Two <beads> (two.yaml)", "every pair has friction 0", "granflow 0.1.0, taichi 1.7.4"),
        *("solid fraction", "40 321", "wall force (N)", "7.5", "not a scene: at all"),
        *("This version cannot read the scene", "Always zero: idle", "it burst\nat the seams"),
    ):
        assert fragment in text, fragment
    assert [row[:3] for row in report_module.timings(read_run(run)).rows] == [
        ("forces", "6.00", "60%"), ("compile", "3.00", "30%"), ("other", "1.00", "10%")
    ]  # fmt: skip


def test_page_of_an_interrupted_run_states_reason_and_time(run):
    (run / "result.json").unlink()
    with (run / "timeseries.csv").open("a") as file:
        file.write("0.3,pour,2,1e-")
    text = text_of(run)
    assert "The run did not finish (ended by RunError: see the warnings). granflow resume" in text
    assert re.search(r"simulated time\s*0.2\s*s", text)
    assert re.search(r"last row.*mass flow \(kg/s\)\s*a\s*3\s*4", text, re.DOTALL), (
        "the last row replaces the result"
    )


def test_page_without_plotly_states_the_missing_package(run, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    assert main(["report", str(run)]) == 0
    assert "pip install plotly" in capsys.readouterr().out
    html = (run / "report.html").read_text(encoding="utf-8")
    assert "Plots require plotly" in html and "run has no frames" in html
    assert not re.findall(r'(?:src|href)="(?!data:|#)', html), "the page loads external content"


def test_columns_of_one_quantity_and_unit_share_a_plot():
    """Also for column names that the report does not list."""
    found = groups_of(
        columns(
            *(
                "kinetic_energy J", "elastic_energy J", "wall_work J", "overlap_mean", "overlap_largest",
                "count"
            ),
            *(
                "force_z.floor N", "force_z.lid N", "force_x.lid N", "pressure.lid Pa", "mean_count",
                "temperature K"
            )
        )
    )  # fmt: skip
    assert [(group.title, group.unit, [column.name for column in group.columns]) for group in found] == [
        ("energy", "J", ["kinetic_energy", "elastic_energy"]),
        ("wall work", "J", ["wall_work"]),
        ("overlap", "", ["overlap_mean", "overlap_largest"]),
        ("count", "", ["count", "mean_count"]),
        ("force", "N", ["force_z.floor", "force_z.lid", "force_x.lid"]),
        ("pressure, lid", "Pa", ["pressure.lid"]),
        ("temperature", "K", ["temperature"]),
    ]


def test_angles_are_in_rad_and_degrees(run):
    result = json.loads((run / "result.json").read_text())
    result["metrics"] = {"left": {"angle_of_repose": 0.4, "angle_of_repose_error": 0.01}}
    result["totals"]["angle_of_repose.left"] = 0.4
    (run / "result.json").write_text(json.dumps(result))
    record = read_run(run)
    tables = {table.caption: table for table in report_module.remaining_numbers(record)}
    (metrics,) = next(each for each in report_module.topics(record, True) if each.title == "Metrics").tables
    assert metrics.rows == [["left", "0.4 (22.92 deg)", "0.01 (0.573 deg)"]]
    assert ("angle of repose.left", "0.4", "rad (22.92 deg)") in tables["totals in result.json"].rows
    series = TimeSeriesTable(np.arange(2.0), np.array(["", ""]), (), ())
    (group,) = groups_of([SeriesColumn("angle_of_repose.left", "rad", np.array([0.0, np.pi / 4]))])
    figure = plot_of(group, series).figure
    assert figure["data"][0]["y"] == [0.0, 45.0] and figure["layout"]["yaxis"]["title"]["text"].endswith(
        "(deg)"
    )


def test_expected_quantities_are_first(run):
    """Quantities with a unit have a plot under their expectations; a plot of these alone is not repeated."""
    shutil.copy(SCENES / "two_spheres.yaml", run / "scene_as_run.yaml")
    record = read_run(run)
    assert not record.scene_problem
    topic = report_module.expected_topic(record, with_plots=True)
    names = [curve["name"] for plot in topic.plots for curve in plot.figure["data"]]
    assert names == ["kinetic energy"]
    text = text_of(run)
    assert text.index("it is <2>.") < text.index("Energies in J, without heat.")
    assert captions_of(record).count("Energy (J) over time") == 1, (
        "kinetic energy is also in the plot of energies"
    )
    (run / "timeseries.csv").write_text("time [s],stage,kinetic_energy [J]\n0,a,1\n1,a,2\n")
    assert captions_of(read_run(run)) == []


def captions_of(record):
    """Captions of the plots below those of the expectations."""
    return [plot.caption for topic in report_module.topics(record, with_plots=True) for plot in topic.plots]


def test_thinned_curve_keeps_peaks_and_ends():
    time = np.arange(1e5)
    values = np.zeros(100_000)
    values[[0, 777, 5_001, 99_999]] = 1.0, 9.0, -4.0, 2.0
    values[50_000] = np.nan
    x, y = thinned(time, values)
    assert len(x) <= MOST_POINTS and np.all(np.diff(x) > 0)
    assert {(0, 1.0), (777, 9.0), (5_001, -4.0), (99_999, 2.0)} <= set(zip(x, y, strict=True))
    np.testing.assert_array_equal(thinned(time[:9], values[:9])[1], values[:9])


def test_record_yields_sessions_warnings_and_explanations(run):
    """A line that a killed session has cut off is skipped."""
    (run / "run.jsonl").write_text(lines_of(RECORD) + '{"time": "2026-\n' + lines_of(RESUMED))
    entries = read_record(run / "run.jsonl")
    assert entries == RECORD + RESUMED
    first, second = (facts for _, facts in sessions(entries))
    assert sessions(entries)[0][0] == "2026-01-02 03:04:05"
    assert (first.arch, first.precision, first.compile_seconds) == ("cpu", "f64", 1.5)
    assert (second.arch, second.resumed_from, second.resumed_at) == ("cuda", "checkpoint_1.npz", 0.1)
    assert [(time[-2:], level) for time, level, _ in warnings_and_errors(entries)] == [
        ("06", "warning"),
        ("08", "error"),
    ]
    assert first.explanation.splitlines()[1].startswith("  friction") and not second.explanation
    text = text_of(run)
    assert "resumed (2 sessions)" in text and "cuda" in text and "resumed from checkpoint_1.npz" in text


def write_fields(directory, cells):
    """Fields of a grid of unit cells at 0.5 s: the number of the cell as the solid fraction, a velocity of 2
    m/s."""
    corners = np.array(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float
    )
    points = np.concatenate([corners + index for index in np.ndindex(*cells)])
    count = len(points) // 8
    values = {
        "solid_fraction": np.arange(count, dtype=float),
        "velocity": np.full((count, 3), [2.0, 0.0, 0.0]),
    }
    mesh = VtuMesh.of_cells("hexahedron", points, np.arange(8 * count).reshape(-1, 8), values)
    write_vtu(directory / "fields_bed_0000.vtu", mesh)
    (directory / "fields_bed.pvd").write_text(
        '<VTKFile><Collection><DataSet timestep="0.5" file="fields_bed_0000.vtu"/></Collection></VTKFile>'
    )


def test_fields_of_a_row_of_cells_are_profiles(tmp_path):
    write_fields(tmp_path, (1, 1, 3))
    tables, plots = field_content(tmp_path, with_plots=True)
    assert tables == [] and [plot.caption for plot in plots] == [
        "Field bed: solid fraction over z", "Field bed: velocity, magnitude (m/s) over z"
    ]  # fmt: skip
    (curve,) = plots[0].figure["data"]
    assert curve["x"] == [0.5, 1.5, 2.5] and curve["y"] == [0.0, 1.0, 2.0] and curve["name"] == "0.5 s"
    assert len(field_content(tmp_path, with_plots=False)[0]) == 1


def test_sizes_of_the_frame_with_most_particles_are_shares_of_the_mass(tmp_path):
    """Group a: 8 of 1 mm and 1 of 2 mm, half of the mass each; group b has one size."""
    for name, size in (("first", 9), ("second", 99)):
        (tmp_path / name).write_text(size * " ")
    sieves = [
        {"opening": 1e-3, "passing": 0},
        {"opening": 2e-3, "passing": 0.4},
        {"opening": 4e-3, "passing": 1},
    ]
    sizes = gf.SieveSizes(sieves=sieves)
    particles = {"diameter": np.array([1e-3] * 8 + [2e-3, 3e-3, 3e-3]), "group": np.array([0] * 9 + [1, 1])}
    record = SimpleNamespace(
        frames=Frames(
            [(0.5, tmp_path / "first"), (1.5, tmp_path / "second"), (2.5, tmp_path / "first")],
            lambda time, _: SimpleNamespace(time=time, particles=particles),
        ),
        scene_problem="",
        scene=SimpleNamespace(particles={"a": SimpleNamespace(diameter=sizes), "b": None}),
    )  # fmt: skip
    (topic,) = size_topics(record, True)
    assert topic.tables[0].rows == [("a", "9", "1", "1", "2")] and "1.5 s" in topic.tables[0].caption
    curve, given = topic.plots[0].figure["data"]
    assert np.interp(2.0, given["x"], given["y"]) == pytest.approx(0.4, abs=0.01)
    assert curve["y"] == pytest.approx([k / 16 for k in range(1, 9)] + [1.0]) and curve["x"][-1] == 2.0


def test_residence_times_have_their_distributions_by_mass(run):
    """Times of 1, 2 and 4 s of 3, 1 and 1 kg: 60 % of the mass within 1 s, 80 % within 2 s."""
    rows = [(9.0, 1.0, 4), (5.0, 3.0, 1), (6.0, 1.0, 2)]
    lines = [
        f"{exit_time},0,{time},{k},feed,glass,0.1,{mass}" for k, (exit_time, mass, time) in enumerate(rows)
    ]
    header = "time [s],time_entered [s],residence_time [s],id,group,material,diameter [m],mass [kg]"
    (run / "residence_time.csv").write_text("\n".join([header, *lines]) + "\n")
    (topic,) = residence_topics(read_run(run), True)
    (table,) = topic.tables
    assert [row[1] for row in table.rows][-3:] == ["1", "1", "4"]
    density, share = (plot.figure["data"][0] for plot in topic.plots)
    assert share["x"] == [1.0, 2.0, 4.0] and share["y"] == pytest.approx([0.6, 0.8, 1.0])
    assert sum(density["y"]) * 3.0 / len(density["y"]) == pytest.approx(1.0), "the classes from 1 to 4 s"
    assert topic.title in text_of(run)


def test_collisions_by_impact_energy_since_the_start(run):
    observer = CollisionEnergies(run, 1.0, np.array([1e-6, 1e-4, 1e-2]))
    for time, particle, wall in (
        (0.0, [0] * 4, [0] * 4),
        (1.0, [0, 1, 2, 0], [0] * 4),
        (2.0, [0, 5, 7, 1], [3, 0, 0, 0]),
    ):
        observer.observe(
            Snapshot(
                time, 0, "run", {}, None, {}, {}, {}, {"particle": np.array(particle), "wall": np.array(wall)}
            )
        )
    observer.finish()
    (topic,) = collision_topics(run, True)
    (table,) = topic.folded
    assert table.rows == [
        ("0 to 1e-06 J", "0", "3"), ("1e-06 to 0.0001 J", "5", "0"), ("0.0001 to 0.01 J", "7", "0"),
        ("0.01 to inf J", "1", "0")
    ]  # fmt: skip
    particle, wall = topic.plots[0].figure["data"]
    assert particle["x"] == pytest.approx([1e-5, 1e-3], rel=1e-5) and particle["y"] == [5, 7]
    assert wall["y"] == [None, None], "a logarithmic axis has no 0"
    assert topic.title in text_of(run)
