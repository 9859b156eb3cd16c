"""The 3D view of the report: its arrays, chosen frames and particles, and walls."""

from base64 import b64decode
from zlib import decompress

import numpy as np
from observers.snapshots import particles_of, snapshot_of

from granflow import read_run
from granflow.io.vtu import VtuMesh, write_vtu
from granflow.observers.frames import ParticleFrames
from granflow.studies.frames import frames_of, read_particles
from granflow.studies.report_view import interactive_view

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
