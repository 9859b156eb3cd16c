"""Files of other programs and damaged ones: read, or rejected with one message; control characters in
output."""

import subprocess
import sys

import meshio
import numpy as np
import pytest

from granflow.cli.arguments import say
from granflow.cli.main import main
from granflow.errors import SceneError
from granflow.geometry.mesh_file import read_triangles
from granflow.io.files import FormatError, resolved
from granflow.io.log import run_log
from granflow.io.vtu import read_vtu
from granflow.particles.file import read_particles
from granflow.visible_text import visible

WRITTEN_BY_VTK = """
import itertools, sys, vtk
modes, compressors = ("Ascii", "Binary", "Appended", "Raw"), ("None", "ZLib", "LZMA")
for count, mode, packed in itertools.product((7, 8), modes, compressors):
    grid, points, radius = vtk.vtkUnstructuredGrid(), vtk.vtkPoints(), vtk.vtkFloatArray()
    radius.SetName("radius")
    for k in range(count):
        points.InsertNextPoint(k, k * k, -0.5)
        radius.InsertNextValue(0.25 + k)
    grid.SetPoints(points)
    grid.GetPointData().AddArray(radius)
    for k in range(count - 2):
        grid.InsertNextCell(vtk.VTK_TRIANGLE, 3, [k, k + 1, k + 2])
    writer = vtk.vtkXMLUnstructuredGridWriter()
    writer.SetInputData(grid)
    getattr(writer, f"SetDataModeTo{mode.replace('Raw', 'Appended')}")()
    writer.SetEncodeAppendedData(mode == "Appended")
    getattr(writer, f"SetCompressorTypeTo{packed}")()
    getattr(writer, "SetHeaderTypeToUInt64" if count % 2 else "SetHeaderTypeToUInt32")()
    writer.SetFileName(f"{sys.argv[1]}/{count}_{mode}_{packed}.vtu")
    writer.Write()
"""


def test_files_of_vtk_are_read_in_every_mode(tmp_path):
    """ParaView's default is raw appended data with zlib."""
    pytest.importorskip("vtk")
    subprocess.run([sys.executable, "-c", WRITTEN_BY_VTK, str(tmp_path)], check=True)
    files = sorted(tmp_path.glob("*.vtu"))
    assert len(files) == 24
    for path in files:
        k = np.arange(int(path.name.partition("_")[0]))
        found = read_vtu(path)
        np.testing.assert_array_equal(found.points, np.stack([k, k * k, k * 0 - 0.5], axis=1), path.name)
        np.testing.assert_array_equal(found.point_data["radius"], 0.25 + k, path.name)
        (block,) = found.cells
        assert block.data.tolist() == [[n, n + 1, n + 2] for n in k[:-2]], path.name


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"</Points>", b"", "cannot be read as VTU: "),
        (b'NumberOfPoints="4"', b'NumberOfPoints="5"', "cannot reshape"),
        (b'type="UnstructuredGrid"', b'type="ImageData"', "Expected type UnstructuredGrid"),
        (b"</Piece>", b"</Piece><Piece />", "has 2 pieces"),
        (b'NumberOfCells="2"', b'NumberOfCells="0"', "has no cells"),
    ],
)
def test_damaged_vtu_is_rejected(tmp_path, old, new, message):
    path = tmp_path / "a.vtu"
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    meshio.write(path, meshio.Mesh(points, [("triangle", np.array([[0, 1, 2], [1, 3, 2]]))]))
    assert len(read_triangles(path).corners) == 2
    path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(FormatError, match=message):
        read_triangles(path)
    with pytest.raises(SceneError, match=message):
        read_particles(path)


def test_negative_indices_of_obj_count_from_the_preceding_vertex(tmp_path):
    """In the OBJ format -1 is the last vertex before the face: the second face uses vertices 2, 3 and 4."""
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 1 1 0\nf -3//-1 -1/1 -2\nf 1 2 4 3\n"
    (tmp_path / "a.obj").write_text(text)
    triangles = read_triangles(tmp_path / "a.obj")
    assert triangles.corners.tolist() == [[0, 1, 2], [1, 3, 2], [0, 1, 3], [0, 3, 2]]
    assert triangles.quad_count == 1


@pytest.mark.parametrize(
    ("face", "message"),
    [
        ("f 1 2 0", "does not contain in line 4"),
        ("f 1 2 9", "does not contain"),
        ("f 1 2 x", "line 4 has the corner 'x'"),
        ("f 1 2 3 1 2", "face of 5 corners in line 4"),
        ("v 1 2", "line 4 needs three coordinates"),
    ],
)
def test_invalid_lines_of_obj_are_reported(tmp_path, face, message):
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{face}\n")
    with pytest.raises(FormatError, match=message):
        read_triangles(tmp_path / "a.obj")


def test_circular_links_are_rejected_without_traceback(tmp_path, capsys):
    loop = tmp_path / "loop.stl"
    loop.symlink_to(loop)
    with pytest.raises(OSError, match="symbolic links"):
        resolved(loop)
    for command in ("check", "run", "report", "resume"):
        assert main([command, str(loop)]) == 2
        assert "Traceback" not in capsys.readouterr().err
    with pytest.raises(FormatError, match="cannot be read"):
        read_triangles(loop)


def test_control_characters_and_newlines_are_escaped(tmp_path, capsys):
    text = "a\x00b\x1b[2Jc\x9bd"
    assert visible(text) == "a\\x00b\\x1b[2Jc\\x9bd"
    assert visible("Schüttgut 砂 μm²\tä\n") == "Schüttgut 砂 μm²\tä\n"
    say(text)
    assert capsys.readouterr().out == visible(text) + "\n"
    with pytest.raises(SceneError), run_log(tmp_path) as log:
        log.info("out\nput")
        raise SceneError(["a\nb", "c"])
    lines = [line.partition(": ")[2] for line in (tmp_path / "run.log").read_text().splitlines()]
    assert lines == ["out\\nput", "ended by SceneError: a\\nb", "ended by SceneError: c"]
