"""Mesh walls of a scene: supported files, and messages for invalid or doubtful ones."""

import struct

import meshio
import numpy as np
import pytest
from geometry.meshes import cube, sheet, write

from granflow.errors import SceneError
from granflow.load import load_scene
from granflow.plan.build import plan_for
from granflow.plan.explain import explain

SCENE = """\
title: A ball on a mesh
gravity: [0, 0, -9.81]
materials: {glass: {preset: glass}}
pairs: {glass-glass: {restitution: 0.9, friction: 0.2}}
contact: {normal: zhou, tangential: mindlin, rolling: none}
walls:
  floor: {shape: mesh, file: FILE, material: glass}
particles:
  ball: {material: glass, count: 1, diameter: 10 mm, insert: {kind: positions, positions: [[0.5, 0.5, 1.5]]}}
domain: {min: [-1, -1, -1], max: [2, 2, 2], on_exit: delete}
run: {duration: 1 s}
output: {interval: 1 s}
"""


def plan_of(folder, file, more=""):
    """Plan of a scene in `folder` with a mesh wall of `file`; `more` appends keys to the wall."""
    path = folder / "scene.yaml"
    path.write_text(SCENE.replace("file: FILE", f"file: {file}{more}"), encoding="utf-8")
    return plan_for(load_scene(path))


def problem(folder, file, more=""):
    """Message about the file, after its name."""
    with pytest.raises(SceneError) as error:
        plan_of(folder, file, more)
    head = f"{folder / 'scene.yaml'}:7:30: walls.floor.file is {file}, which "
    (message,) = error.value.problems
    assert message.startswith(head)
    return message.removeprefix(head)


def binary_stl(path, triangles, count=None, head=b"made by hand"):
    """A binary STL file of triangles (t, 3, 3) that declares `count` triangles."""
    parts = [head.ljust(80), struct.pack("<I", len(triangles) if count is None else count)]
    parts += [struct.pack("<12fH", 0.0, 0.0, 0.0, *np.ravel(triangle), 0) for triangle in triangles]
    path.write_bytes(b"".join(parts))


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "vtk", "vtu"])
def test_each_file_format_gives_the_same_mesh(tmp_path, kind):
    points, corners = cube()
    write(tmp_path / f"cube.{kind}", points, corners)
    (mesh,) = plan_of(tmp_path, f"cube.{kind}").meshes.values()
    assert (mesh.triangle_count, len(mesh.points), mesh.adjacency.open_count) == (12, 8, 0)
    order = np.lexsort(mesh.points.T[::-1])
    np.testing.assert_array_equal(mesh.points[order], points)


def test_stl_is_read_with_any_header_and_from_any_folder(tmp_path):
    points, corners = cube()
    write(tmp_path / "text.stl", points, corners)
    commented = f"# part 7\n; mm\n\n{(tmp_path / 'text.stl').read_text()}\n// end\n"
    (tmp_path / "text.stl").write_text(commented)
    for name, head in (("solid", b"solid cube"), ("empty", b""), ("zero", b"solid \0")):
        binary_stl(tmp_path / f"{name}.stl", points[corners], head=head)
    folder = tmp_path / "scenes"
    folder.mkdir()
    (folder / "link.stl").symlink_to(tmp_path / "empty.stl")
    for path in ("../text.stl", "../solid.stl", "../zero.stl", "link.stl", str(tmp_path / "empty.stl")):
        mesh = plan_of(folder, path).meshes[0]
        assert (mesh.triangle_count, len(mesh.points)) == (12, 8), path


def test_meshes_are_scaled_then_rotated_then_translated(tmp_path):
    """A quarter turn about z takes (x, y) to (-y, x), one about x then takes (y, z) to (-z, y)."""
    points, corners = cube()
    write(tmp_path / "cube.ply", points * [1.0, 2.0, 3.0], corners)
    rotations = "[{axis: [0, 0, 2], angle: 90 deg}, {axis: [1, 0, 0], angle: 90 deg}]"
    more = f", scale: 0.1, rotate: {rotations}, translate: [0, 0, 1 cm]"
    (mesh,) = plan_of(tmp_path, "cube.ply", more).meshes.values()
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    np.testing.assert_allclose(low, [-0.2, -0.3, 0.01], atol=1e-15)
    np.testing.assert_allclose(high, [0.0, 0.0, 0.11], atol=1e-15)


def test_invalid_mesh_files_are_rejected(tmp_path):
    points, corners = cube()
    triangles = points[corners]
    (tmp_path / "empty.stl").write_bytes(b"")
    (tmp_path / "short.stl").write_bytes(b"\0" * 50)
    binary_stl(tmp_path / "lies.stl", triangles, count=2**32 - 1)
    binary_stl(tmp_path / "nan.stl", np.where(triangles == 1.0, np.nan, triangles))
    binary_stl(tmp_path / "flat.stl", triangles * [1, 0, 0])
    (tmp_path / "mesh.step").write_text("ISO-10303-21")
    meshio.write(tmp_path / "solid.vtu", meshio.Mesh(points, [("tetra", [[0, 1, 2, 4]])]))
    binary_stl(tmp_path / "large.stl", 1000.0 * triangles)
    write(tmp_path / "cut.ply", points, corners)
    (tmp_path / "cut.ply").write_bytes((tmp_path / "cut.ply").read_bytes()[:300])
    for name, message in {
        "none.stl": "is missing: there is no such file.",
        "empty.stl": "is empty.",
        "lies.stl": "declares 4294967295 triangles, but its size allows 12: it is truncated or damaged.",
        "short.stl": "is truncated: it has 50 bytes, fewer than the header of an STL file.",
        "nan.stl": "has 12 triangles with coordinates that are not finite.",
        "flat.stl": "has no triangle with nonzero area.",
        "mesh.step": "has an unsupported format; the supported formats are stl, obj, ply, vtk, vtu.",
        "solid.vtu": "contains 1 tetra, but a wall consists of triangles; export the surface only.",
        "large.stl": "is 1.73e+03 m large, 333 times the domain: if the file is in millimeters, set scale: 0.001.",
        "cut.ply": "cannot be read as PLY: ",
    }.items():
        assert problem(tmp_path, name).startswith(message)
    # The scale of a file in millimeters is 0.001, not 1000.
    assert problem(tmp_path, "large.stl", ", scale: 1000").endswith("set scale: 0.001.")


def test_doubtful_sizes_places_and_triangles_are_reported(tmp_path):
    """A cube of 1 m in a domain of 3 m; a sheet with a reversed, a repeated and a flat triangle."""
    points, corners = cube()
    binary_stl(tmp_path / "cube.stl", points[corners])
    for more, warning in (
        ("", None),
        ("scale: 20", "34.6 m large, 6.67 times the domain: if the file is in millimeters, set scale: 0.02."),
        ("scale: 1e-3", "0.00173 m large, less than the smallest particle; see scale."),
        ("translate: [5, 0, 0]", "wholly outside the domain; see scale and translate."),
    ):
        found = plan_of(tmp_path, "cube.stl", f", {more}" if more else "").warnings
        assert found == ((f"walls.floor: {warning}",) if warning else ())
    # The pressure of a servo refers to all six faces, of which two cover 1 m2 across the direction.
    servo = "motion: {kind: servo, direction: [0, 0, 1], pressure: 1 kPa, velocity_max: 0.1}"
    forecasts = [each.warning or "" for each in plan_of(tmp_path, "cube.stl", f", {servo}").forecasts]
    assert any("6 m2, is 6e+03 N, but the wall covers only 1 m2" in each for each in forecasts)
    points, corners = sheet(4)
    triangles = points[corners]
    removed = [triangles[0][::-1], triangles[3], [[0, 0, 0], [1, 0, 0], [0.5, 0, 0]]]
    binary_stl(tmp_path / "sheet.stl", np.concatenate([triangles, removed]))
    plan = plan_of(tmp_path, "sheet.stl")
    assert plan.warnings == (
        "walls.floor: 1 triangle of zero area removed.", "walls.floor: 2 duplicate triangles removed."
    )  # fmt: skip
    assert "floor 32 triangles 1 x 1 x 0 m 16 open edges" in " ".join(explain(plan).split())
