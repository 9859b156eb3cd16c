"""The 3D view of the report: its arrays, chosen frames and particles, walls, and the picture in a browser."""

import shutil
import subprocess
from base64 import b64decode
from types import SimpleNamespace
from zlib import decompress

import numpy as np
import pytest
from observers.snapshots import particles_of, snapshot_of

from granflow import read_run
from granflow.io.vtu import VtuMesh, write_vtu
from granflow.observers.frames import ParticleFrames
from granflow.studies import report_view
from granflow.studies.frames import FrameWalls, frames_of, read_particles
from granflow.studies.report import report_text
from granflow.studies.report_view import PackedArrays, _wall_headers, geometry_of, interactive_view

CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
FACES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def write_run(directory, frame_count=3, particle_count=50):
    """A run of which only the particle frames and an unreadable scene exist."""
    writer = ParticleFrames(directory, 0.1)
    for k in range(frame_count):
        writer.observe(snapshot_of(time=0.1 * k, particles=particles_of(particle_count, seed=k)))
    (directory / "scene_as_run.yaml").write_text("title: spheres\n")
    return read_run(directory)


def write_walls(directory, points):
    """Walls of the first frame: the faces of a cube with these corners."""
    write_vtu(
        directory / "walls_0000.vtu", VtuMesh.of_cells("quad", points, FACES, {"wall": np.zeros(6, np.int32)})
    )
    (directory / "walls.pvd").write_text(
        (directory / "particles.pvd").read_text().replace("particles_", "walls_")
    )


def array(data, reference, width=1):
    """An array of the view, as the script of the page reads it."""
    dtype = np.dtype(reference["type"].removesuffix("Array").lower())
    found = np.frombuffer(decompress(b64decode(data)), dtype, reference["length"], reference["offset"])
    return found.reshape(-1, width) if width > 1 else found


def test_positions_and_radii_are_within_the_resolution(tmp_path):
    view = interactive_view(write_run(tmp_path))
    grid = view.header["grid"]
    step = view.header["radiusStep"]
    for frame, entry in zip(frames_of(tmp_path), view.header["frames"], strict=True):
        particles = read_particles(frame)
        position = grid["low"] + grid["step"] * array(view.data, entry["position"], 3)
        np.testing.assert_allclose(position, particles.position, atol=0.51 * grid["step"], rtol=0)
        np.testing.assert_allclose(
            step * array(view.data, entry["radius"]), particles.radius, atol=0.51 * step
        )
    assert grid["step"] <= particles.radius.min() / 60 or grid["step"] * 65535 <= 1.01 * np.ptp(
        particles.position
    )
    assert view.statement == "All 3 frames."


def test_colors_follow_from_the_labels(tmp_path):
    view = interactive_view(write_run(tmp_path))
    index = next(
        k for k, each in enumerate(view.header["quantities"]) if each["title"].startswith("velocity")
    )
    labels = [float(each) for each in view.header["quantities"][index]["labels"]]
    speed = np.linalg.norm(read_particles(frames_of(tmp_path)[0]).arrays["velocity"], axis=1)
    levels = array(view.data, view.header["frames"][0]["colors"][index])
    expected = np.clip((speed - labels[0]) / (labels[1] - labels[0]), 0, 1) * 255
    np.testing.assert_allclose(levels, expected, atol=2)


def test_many_particles_are_thinned_by_id(tmp_path, monkeypatch):
    monkeypatch.setattr(report_view, "MOST_PARTICLES", 20)
    view = interactive_view(write_run(tmp_path))
    ids = read_particles(frames_of(tmp_path)[0]).arrays["id"]
    assert view.header["frames"][0]["count"] == np.sum(ids % 3 == 0) <= 20
    assert "those whose id is a multiple of 3" in view.statement


def test_many_frames_are_reduced_to_the_budget_with_both_ends(tmp_path, monkeypatch):
    monkeypatch.setattr(report_view, "PARTICLE_FRAMES", 250)
    view = interactive_view(write_run(tmp_path, frame_count=9))
    assert [entry["time"] for entry in view.header["frames"]] == ["0 s", "0.2 s", "0.4 s", "0.6 s", "0.8 s"]
    assert view.statement == "5 of 9 frames."


def test_run_without_particles_has_no_view(tmp_path):
    (tmp_path / "scene_as_run.yaml").write_text("title: empty\n")
    assert interactive_view(read_run(tmp_path)) is None


def test_equal_arrays_are_stored_once():
    arrays = PackedArrays()
    first = arrays.add(np.arange(5, dtype=np.uint16))
    assert arrays.add(np.arange(5, dtype=np.uint16)) == first != arrays.add(np.arange(5, dtype=np.uint8))
    assert len(decompress(b64decode(arrays.text()))) == 12 + 8


def test_edges_of_a_cube_are_its_twelve_sides():
    """Quadrilaterals and their halves have the same edges; diagonals are flat and hidden."""
    squares = FrameWalls(CUBE, (FACES,), (np.zeros(6, int),))
    halves = np.concatenate([FACES[:, [0, 1, 2]], FACES[:, [2, 0, 3]]])
    triangles = FrameWalls(CUBE, (halves,), (np.zeros(12, int),))
    for walls in (squares, triangles):
        found = geometry_of(walls)
        assert len(found.points) == 8 and len(found.triangles) == 12 and len(found.edges) == 12
        lengths = np.linalg.norm(np.diff(found.points[found.edges], axis=1), axis=2)
        np.testing.assert_array_equal(lengths, 1.0)


@pytest.mark.parametrize("corners", [3, 4])
def test_disc_without_a_hole_has_no_radial_edges(corners):
    """Facets between the circle and a hole of radius 0: halves of them, or two of their corners, are at the
    center."""
    angle = 2.0 * np.pi * np.arange(16) / 16
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(16)])
    here = np.arange(16)
    following = (np.arange(16) + 1) % 16
    facets = np.column_stack([here + 16, here, following, following + 16])
    if corners == 3:
        facets = np.concatenate([facets[:, [0, 1, 2]], facets[:, [0, 2, 3]]])
    found = geometry_of(
        FrameWalls(np.concatenate([circle, np.zeros((16, 3))]), (facets,), (np.zeros(len(facets)),))
    )
    assert len(found.points) == 17 and len(found.edges) == 16
    lengths = np.linalg.norm(np.diff(found.points[found.edges], axis=1), axis=2)
    np.testing.assert_allclose(lengths, 2.0 * np.sin(np.pi / 16), rtol=1e-6)


def test_camera_shows_particles_and_walls(tmp_path):
    record = write_run(tmp_path)
    low, high = np.array(interactive_view(record).header["extent"])
    write_walls(tmp_path, 3.0 * CUBE)
    with_walls = np.array(interactive_view(record).header["extent"])
    np.testing.assert_allclose(with_walls, [np.minimum(low, 0.0), np.maximum(high, 3.0)])
    assert (low > -1.0).all() and (high < 3.0).all()


def test_unused_points_and_separate_copies_of_points_are_merged():
    points = np.concatenate([CUBE[FACES].reshape(-1, 3), [[9.0, 9.0, 9.0]]])
    found = geometry_of(FrameWalls(points, (np.arange(24).reshape(6, 4),), (np.zeros(6, int),)))
    assert len(found.points) == 8 and len(found.edges) == 12


def test_planes_are_cut_around_the_particles():
    """A large plane is a part of its own, with a box that is unbounded along its normal except for the
    margin."""
    corners = np.array([[-50.0, -50.0, 0.0], [50.0, -50.0, 0.0], [50.0, 50.0, 0.0], [-50.0, 50.0, 0.0]])
    scene = SimpleNamespace(
        walls={"floor": SimpleNamespace(shape="plane"), "box": SimpleNamespace(shape="box")},
        domain=SimpleNamespace(on_exit="expand"),
    )
    walls = FrameWalls(
        np.concatenate([corners, CUBE]), (np.array([[0, 1, 2, 3]]), FACES + 4), (np.zeros(1), np.ones(6))
    )
    box, floor = _wall_headers(walls, scene, CUBE, PackedArrays())
    assert box["triangles"]["length"] == 36 and floor["triangles"]["length"] == 6
    low, high = np.array(floor["box"])
    np.testing.assert_allclose([low[0], high[0]], [-0.05, 1.05], atol=0.11)
    assert low[2] < 0.0 < high[2]


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_browser_draws_the_particles(tmp_path):
    """Headless Chromium with software WebGL: the page has many pixels in the colors of the particles."""
    from PIL import Image

    record = write_run(tmp_path)
    write_walls(tmp_path, CUBE)
    page = tmp_path / "page.html"
    page.write_text(report_text(record, "", SimpleNamespace(shown=(), statement="")), encoding="utf-8")
    picture = tmp_path / "page.png"
    command = [
        CHROMIUM,
        "--headless",
        "--no-sandbox",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
    ]
    command += [
        "--window-size=1200,1400",
        "--virtual-time-budget=5000",
        f"--screenshot={picture}",
        page.as_uri(),
    ]
    subprocess.run(command, capture_output=True, timeout=120, check=True)
    pixels = np.asarray(Image.open(picture).convert("RGB")).astype(int)
    is_colored = np.ptp(pixels, axis=2) > 60
    assert is_colored.mean() > 0.02, "a page without the view has 0.001 or less, in its links"
