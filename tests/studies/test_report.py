"""Report of one run: complete, interrupted and resumed runs, numbers in tables and plots, and the 3D view."""

import json
import re
from base64 import b64decode
from dataclasses import asdict
from types import SimpleNamespace
from zlib import decompress

import numpy as np
import pytest
from observers.snapshots import particles_of, snapshot_of

import granflow as gf
from granflow import read_run
from granflow.cli.main import main
from granflow.io.log import RecordEntry, SessionFacts
from granflow.io.vtu import VtuMesh, write_vtu
from granflow.observers.frames import ParticleFrames
from granflow.observers.timeseries import CollisionEnergies
from granflow.runs.read_run import Frames
from granflow.snapshot import Snapshot
from granflow.studies import report as report_module
from granflow.studies.frames import frames_of, read_particles
from granflow.studies.report import (
    collision_topics,
    field_content,
    report_text,
    residence_topics,
    size_topics,
)
from granflow.studies.report_view import interactive_view

HEAD = (
    "time [s],stage,particle_count,kinetic_energy [J],elastic_energy [J],idle [N],"
    "mass_flow.a [kg/s],force_z.floor [N],force_z.lid [N]\n"
)
ROWS = [
    "0.0,fill,1,2e-6,0,0,0,1,2\n",
    "0.1,fill,2,,1e-6,0,0,1,3\n",
    "0.2,pour,2,1e-6,0,0,4,1,2\n",
]
PLAN = "Two <beads> (two.yaml)\n  friction  off  every pair has friction 0"
VERSIONS = "granflow 0.1.0, taichi 1.7.4, Python 3.11"
FIRST, SECOND = (
    SessionFacts(VERSIONS, "cpu", "f64", 2, 1.5, "", 0.0, PLAN),
    SessionFacts("granflow 0.2.0", "cuda", "f32", None, 2.5, "checkpoint_1.npz", 0.1, ""),
)
RECORD = [
    RecordEntry("2026-01-02 03:04:05", "INFO", VERSIONS, FIRST),
    RecordEntry("2026-01-02 03:04:06", "WARNING", "too fast"),
    RecordEntry("2026-01-02 03:04:07", "WARNING", "too fast"),
    RecordEntry("2026-01-02 03:04:08", "ERROR", "ended by RunError: it burst", ended_by="RunError"),
]
RESULT = {
    "run": {"simulated_time": 0.2, "step_count": 12345, "wall_clock": 10.0},
    "timings": {"forces": 6.0, "compile": 3.0},
    "totals": {"particle_count": 2, "energy_error": 1e-4, "angle_of_repose.left": 0.4},
    "metrics": {"left": {"angle_of_repose": 0.4, "angle_of_repose_error": 0.01}},
    "expect": [{"sentence": "it is 1, as expected.", "met": True}, {"sentence": "it is <2>.", "met": False}],
    "wall_forces": {"lid": {"wall_force": 7.5}},
    "insertion": {"beads": {"inserted_count": 40321, "not_inserted_count": 0}},
}


def lines_of(entries):
    """Lines of a record with entries."""
    contents = [{name: value for name, value in asdict(each).items() if value} for each in entries]
    return "".join(json.dumps(each) + "\n" for each in contents)


@pytest.fixture
def run(tmp_path):
    (tmp_path / "timeseries.csv").write_text(HEAD + "".join(ROWS))
    (tmp_path / "run.log").write_text("")
    (tmp_path / "run.jsonl").write_text(lines_of(RECORD))
    (tmp_path / "result.json").write_text(json.dumps(RESULT))
    (tmp_path / "scene_as_run.yaml").write_text("title: A & B\nnot a scene: at all\n")
    return tmp_path


def text_of(directory):
    """Text of the page."""
    html = report_text(read_run(directory), "/* plotly */", None)
    return re.sub(r"<script>.*?</script>|<[^>]*>", "", html, flags=re.DOTALL)


def test_page_of_a_complete_run_contains_all_results(run):
    """The page loads no external content."""
    assert main(["report", str(run)]) == 0
    assert not re.findall(r'(?:src|href)="(?!data:|#)', (run / "report.html").read_text(encoding="utf-8"))
    text = text_of(run)
    for fragment in (
        *("The run is complete.", "1 of 2 expectations", "it is &lt;2&gt;.", "too fast (2 times)", "12 345"),
        *("every pair has friction 0", VERSIONS, "40 321", "wall force (N)", "7.5", "not a scene: at all"),
        *("This version cannot read the scene", "Always zero: idle", "it burst"),
    ):
        assert fragment in text, fragment
    record = read_run(run)
    assert [row[:3] for row in report_module.timings(record).rows] == [
        ("forces", "6.00", "60%"), ("compile", "3.00", "30%"), ("other", "1.00", "10%")
    ]  # fmt: skip
    (metrics,) = next(each for each in report_module.topics(record, True) if each.title == "Metrics").tables
    assert metrics.rows == [["left", "0.4 (22.92 deg)", "0.01 (0.573 deg)"]]


def test_page_of_an_interrupted_and_resumed_run_states_reason_and_time(run):
    """A line that a killed session has cut off is skipped; the last row replaces the result."""
    (run / "result.json").unlink()
    with (run / "timeseries.csv").open("a") as file:
        file.write("0.3,pour,2,1e-")
    resumed = [RecordEntry("2026-01-02 04:00:00", "INFO", "granflow 0.2.0", SECOND)]
    lines = lines_of(RECORD[:3]) + '{"time": "2026-\n' + lines_of(resumed) + lines_of(RECORD[3:])
    (run / "run.jsonl").write_text(lines)
    text = text_of(run)
    assert "The run did not finish (ended by RunError: see the warnings). granflow resume" in text
    assert "cuda" in text and "resumed from checkpoint_1.npz" in text
    assert re.search(r"simulated time\s*0.2\s*s", text)
    assert re.search(r"last row.*mass flow \(kg/s\)\s*a\s*4", text, re.DOTALL)


def test_fields_of_a_row_of_cells_are_profiles(tmp_path):
    """Three unit cells along z at 0.5 s: the number of the cell as the solid fraction, a velocity of 2 m/s."""
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    layers = [np.column_stack([square, np.full(4, float(z))]) for z in (0, 1, 1, 2, 2, 3)]
    values = {"solid_fraction": np.arange(3.0), "velocity": np.full((3, 3), [2.0, 0.0, 0.0])}
    mesh = VtuMesh.of_cells("hexahedron", np.concatenate(layers), np.arange(24).reshape(-1, 8), values)
    write_vtu(tmp_path / "fields_bed_0000.vtu", mesh)
    (tmp_path / "fields_bed.pvd").write_text(
        '<VTKFile><Collection><DataSet timestep="0.5" file="fields_bed_0000.vtu"/></Collection></VTKFile>'
    )
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
    passing = {1e-3: 0, 2e-3: 0.4, 4e-3: 1}
    sizes = gf.SieveSizes(sieves=[{"opening": d, "passing": share} for d, share in passing.items()])
    particles = {"diameter": np.array([1e-3] * 8 + [2e-3, 3e-3, 3e-3]), "group": np.array([0] * 9 + [1, 1])}
    files = [(0.5, tmp_path / "first"), (1.5, tmp_path / "second"), (2.5, tmp_path / "first")]
    record = SimpleNamespace(
        frames=Frames(files, lambda time, _: SimpleNamespace(time=time, particles=particles)),
        scene_problem="",
        scene=SimpleNamespace(particles={"a": SimpleNamespace(diameter=sizes), "b": None}),
    )
    (topic,) = size_topics(record, True)
    assert topic.tables[0].rows == [("a", "9", "1", "1", "2")] and "1.5 s" in topic.tables[0].caption
    curve, given = topic.plots[0].figure["data"]
    assert np.interp(2.0, given["x"], given["y"]) == pytest.approx(0.4, abs=0.01)
    assert curve["y"] == pytest.approx([k / 16 for k in range(1, 9)] + [1.0]) and curve["x"][-1] == 2.0


def test_residence_times_have_their_distributions_by_mass(run):
    """Times of 1, 2 and 4 s of 3, 1 and 1 kg: 60 % of the mass within 1 s, 80 % within 2 s."""
    rows = [(9.0, 1.0, 4), (5.0, 3.0, 1), (6.0, 1.0, 2)]
    lines = [f"{end},0,{time},{k},feed,glass,0.1,{mass}" for k, (end, mass, time) in enumerate(rows)]
    header = "time [s],time_entered [s],residence_time [s],id,group,material,diameter [m],mass [kg]"
    (run / "residence_time.csv").write_text("\n".join([header, *lines]) + "\n")
    (topic,) = residence_topics(read_run(run), True)
    assert [row[1] for row in topic.tables[0].rows][-3:] == ["1", "1", "4"]
    density, share = (plot.figure["data"][0] for plot in topic.plots)
    assert share["x"] == [1.0, 2.0, 4.0] and share["y"] == pytest.approx([0.6, 0.8, 1.0])
    assert sum(density["y"]) * 3.0 / len(density["y"]) == pytest.approx(1.0), "the classes from 1 to 4 s"
    assert topic.title in text_of(run)


def test_collisions_by_impact_energy_since_the_start(run):
    observer = CollisionEnergies(run, 1.0, np.array([1e-6, 1e-4, 1e-2]))
    counts = ([0] * 4, [0] * 4), ([0, 1, 2, 0], [0] * 4), ([0, 5, 7, 1], [3, 0, 0, 0])
    for time, (particle, wall) in enumerate(counts):
        collisions = {"particle": np.array(particle), "wall": np.array(wall)}
        observer.observe(Snapshot(float(time), 0, "run", {}, None, {}, {}, {}, collisions))
    observer.finish()
    (topic,) = collision_topics(run, True)
    assert [row[1:] for row in topic.folded[0].rows] == [("0", "3"), ("5", "0"), ("7", "0"), ("1", "0")]
    particle, wall = topic.plots[0].figure["data"]
    assert particle["x"] == pytest.approx([1e-5, 1e-3], rel=1e-5) and particle["y"] == [5, 7]
    assert wall["y"] == [None, None], "a logarithmic axis has no 0"
    assert topic.title in text_of(run)


CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
FACES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])


def write_run(directory, frame_count=3):
    """A run of which only the particle frames and an unreadable scene exist."""
    writer = ParticleFrames(directory, 0.1)
    for k in range(frame_count):
        writer.observe(snapshot_of(time=0.1 * k, particles=particles_of(50, seed=k)))
    (directory / "scene_as_run.yaml").write_text("title: spheres\n")
    return read_run(directory)


def array(data, reference, width=1):
    """An array of the view, as the script of the page reads it."""
    dtype = np.dtype(reference["type"].removesuffix("Array").lower())
    found = np.frombuffer(decompress(b64decode(data)), dtype, reference["length"], reference["offset"])
    return found.reshape(-1, width) if width > 1 else found


def test_positions_radii_and_colors_are_within_the_resolution(tmp_path):
    view = interactive_view(write_run(tmp_path))
    grid = view.header["grid"]
    step = view.header["radiusStep"]
    titles = [each["title"] for each in view.header["quantities"]]
    index = next(k for k, title in enumerate(titles) if title.startswith("velocity"))
    low, high = (float(each) for each in view.header["quantities"][index]["labels"][:2])
    for frame, entry in zip(frames_of(tmp_path), view.header["frames"], strict=True):
        particles = read_particles(frame)
        position = grid["low"] + grid["step"] * array(view.data, entry["position"], 3)
        np.testing.assert_allclose(position, particles.position, atol=0.51 * grid["step"], rtol=0)
        radius = step * array(view.data, entry["radius"])
        np.testing.assert_allclose(radius, particles.radius, atol=0.51 * step)
        speed = np.linalg.norm(particles.arrays["velocity"], axis=1)
        expected = np.clip((speed - low) / (high - low), 0, 1) * 255
        np.testing.assert_allclose(array(view.data, entry["colors"][index]), expected, atol=2)
    assert grid["step"] <= particles.radius.min() / 60


def test_walls_are_in_the_view_and_colored_by_their_wear(tmp_path):
    """Levels from 0 to the largest value of all frames; walls without a value have no colors."""
    record = write_run(tmp_path, frame_count=1)
    low, high = np.array(interactive_view(record).header["extent"])
    triangles = FACES[:2, :3]
    wear = {"wear_depth": np.array([2e-6, np.nan]), "wear_normal_work": np.zeros(2)}
    cells = {"wall": np.arange(2, dtype=np.int32)} | wear
    write_vtu(tmp_path / "walls_0000.vtu", VtuMesh.of_cells("triangle", 3.0 * CUBE, triangles, cells))
    collection = (tmp_path / "particles.pvd").read_text().replace("particles_", "walls_")
    (tmp_path / "walls.pvd").write_text(collection)
    view = interactive_view(record)
    np.testing.assert_allclose(view.header["extent"], [np.minimum(low, 0.0), np.maximum(high, 3.0)])
    (quantity,) = view.header["wallQuantities"]
    assert quantity["title"] == "wear depth (µm)" and quantity["labels"] == ["0", "2"]
    (wall,) = view.header["frames"][0]["walls"]
    points = wall["grid"]["low"] + wall["grid"]["step"] * array(view.data, wall["worn"]["points"], 3)
    np.testing.assert_allclose(points, 3.0 * CUBE[triangles[0]], atol=3e-4)
    assert array(view.data, wall["worn"]["levels"][0]).tolist() == [255] * 3
