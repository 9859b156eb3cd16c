"""Untrusted mesh files, tables and paths: bounded memory and time, one message, no traceback."""

import base64
import os
import resource
import struct
import subprocess
import sys
import zlib

import meshio
import numpy as np
import pytest

from granflow.cli.arguments import say
from granflow.cli.main import main
from granflow.errors import SceneError
from granflow.geometry.mesh_file import read_triangles
from granflow.io.files import FormatError, open_regular, read_regular, resolved
from granflow.io.log import run_log
from granflow.io.vtu import read_vtu
from granflow.particles.file import read_particles
from granflow.visible_text import visible

POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])


def array(name, kind, data, components=1, blocks=None, block_size=None):
    """A compressed DataArray; `blocks`: the compressed bytes instead of those of `data`."""
    packed = [zlib.compress(data)] if blocks is None else blocks
    sizes = [len(each) for each in packed]
    head = struct.pack(f"<{3 + len(packed)}I", len(packed), block_size or len(data), 0, *sizes)
    text = (base64.b64encode(head) + base64.b64encode(b"".join(packed))).decode()
    return f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" format="binary">{text}</DataArray>'


def vtu(point_count=4, points=None, radius="", before=""):
    """The text of a VTU file with two triangles; `before` precedes the root element."""
    points = array("Points", "Float64", POINTS.tobytes(), 3) if points is None else points
    cells = (
        array("connectivity", "Int64", np.array([0, 1, 2, 1, 3, 2]).tobytes())
        + array("offsets", "Int64", np.array([3, 6]).tobytes())
        + array("types", "UInt8", bytes([5, 5]))
    )
    return (
        f'<?xml version="1.0"?>{before}<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian" '
        f'header_type="UInt32" compressor="vtkZLibDataCompressor"><UnstructuredGrid>'
        f'<Piece NumberOfPoints="{point_count}" NumberOfCells="2"><Points>{points}</Points><Cells>{cells}</Cells>'
        f"<PointData>{radius}</PointData></Piece></UnstructuredGrid></VTKFile>"
    )


WRITTEN_BY_VTK = """
import itertools, sys, vtk
modes, compressors = ("Ascii", "Binary", "Appended", "Raw"), ("None", "ZLib", "LZMA")
for count, mode, packed in itertools.product((0, 1, 7), modes, compressors):
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
    """ParaView's default is raw appended data, in which meshio confuses arrays of small files; and it fails
    for files without cells, compressed arrays without values, and drops all pieces but the last."""
    pytest.importorskip("vtk")
    subprocess.run([sys.executable, "-c", WRITTEN_BY_VTK, str(tmp_path)], check=True)
    files = sorted(tmp_path.glob("*.vtu"))
    assert len(files) == 36
    for path in files:
        k = np.arange(int(path.name.partition("_")[0]))
        found = read_vtu(path, 2**20)
        np.testing.assert_array_equal(found.points, np.stack([k, k * k, k * 0 - 0.5], axis=1), path.name)
        np.testing.assert_array_equal(found.point_data["radius"], 0.25 + k, path.name)
        expected = [("triangle", [[n, n + 1, n + 2] for n in k[:-2]])] if len(k) > 2 else []
        assert [(block.type, block.data.tolist()) for block in found.cells] == expected, path.name


def test_pieces_are_merged(tmp_path):
    """Two pieces of two triangles each: the second has other indices after the four points of the first."""
    piece = vtu().partition("<Piece")[2].partition("</UnstructuredGrid>")[0]
    (tmp_path / "a.vtu").write_text(vtu().replace("</UnstructuredGrid>", f"<Piece{piece}</UnstructuredGrid>"))
    found = read_vtu(tmp_path / "a.vtu", 2**20)
    np.testing.assert_array_equal(found.points, [*POINTS, *POINTS])
    corners = np.concatenate([block.data for block in found.cells])
    np.testing.assert_array_equal(corners, [[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6]])


def bomb(size):
    """Compressed bytes that expand to `size` zeros."""
    packer = zlib.compressobj(9)
    piece = bytes(2**20)
    return b"".join(packer.compress(piece) for _ in range(size // len(piece))) + packer.flush()


ENTITIES = '<!DOCTYPE a [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]>'
VTUS = {
    "more than it declares": (
        vtu(radius=array("radius", "Float64", b"", blocks=[bomb(2**27)])),
        "longer than its numbers",
    ),
    "many points declared": (vtu(10**9, points=array("Points", "Float64", b"", 3, [bomb(2**27)])), "MiB"),
    "fewer points": (vtu(5), "cannot reshape"),
    "negative points": (vtu(-1), "invalid number of points"),
    "entities": (vtu(before=ENTITIES), "document type"),
    "billion blocks": (
        vtu().replace(vtu().split('format="binary">')[1][:8], "////////", 1),
        "incomplete compressed array",
    ),
    "nested": ("<a>" * 100_000, "nested elements"),
    "no XML": ("solid", "not XML"),
    "another grid": ('<VTKFile type="ImageData"/>', "no UnstructuredGrid"),
}


@pytest.mark.parametrize("name", VTUS)
def test_crafted_vtu_is_rejected_within_256_mib(tmp_path, name):
    text, message = VTUS[name]
    (tmp_path / "a.vtu").write_text(text)
    with limited_memory(2**28), pytest.raises(FormatError, match=message):
        read_triangles(tmp_path / "a.vtu")
    with pytest.raises(SceneError, match=message):
        read_particles(tmp_path / "a.vtu")


class limited_memory:
    """Context manager that limits further allocations of this process to `more` bytes."""

    def __init__(self, more):
        self._more = more

    def __enter__(self):
        with open("/proc/self/statm") as file:
            used = int(file.read().split()[0]) * resource.getpagesize()
        self._before = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (used + self._more, self._before[1]))

    def __exit__(self, *_):
        resource.setrlimit(resource.RLIMIT_AS, self._before)


def test_valid_vtu_is_read(tmp_path):
    (tmp_path / "a.vtu").write_text(vtu())
    assert len(read_triangles(tmp_path / "a.vtu").corners) == 2


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
        ("f -4 -1 -2", "does not contain in line 4"),
        ("f 1 2 0", "does not contain in line 4"),
        ("f 1 2 9", "does not contain"),
        ("f 1 2 x", "line 4 has the corner 'x'"),
        ("f 1 2", "face of 2 corners in line 4"),
        ("f 1 2 3 1 2", "face of 5 corners in line 4"),
        ("v 1 2", "line 4 needs three coordinates"),
    ],
)
def test_invalid_lines_of_obj_are_reported(tmp_path, face, message):
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{face}\n")
    with pytest.raises(FormatError, match=message):
        read_triangles(tmp_path / "a.obj")


def test_only_regular_files_are_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.stl")
    for path in (tmp_path / "pipe.stl", "/dev/zero"):
        with pytest.raises(OSError, match="not a regular file"):
            open_regular(path)
    with pytest.raises(OSError, match="directory"):
        open_regular(tmp_path)
    with pytest.raises(OSError, match="null"):
        open_regular("a\0b")
    (tmp_path / "long").write_bytes(bytes(100))
    with pytest.raises(OSError, match="larger"):
        read_regular(tmp_path / "long", 99)


def test_circular_links_are_rejected_without_traceback(tmp_path, capsys):
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    with pytest.raises(OSError, match="symbolic links"):
        resolved(loop)
    for command in (("check",), ("run",), ("analyze",), ("report",), ("render",), ("resume",)):
        assert main([*command, str(loop)]) == 2
        assert "Traceback" not in capsys.readouterr().err
    for suffix in ("stl", "obj", "vtu", "ply", "vtk"):
        (tmp_path / f"loop.{suffix}").symlink_to(tmp_path / f"loop.{suffix}")
        with pytest.raises(FormatError, match="cannot be read"):
            read_triangles(tmp_path / f"loop.{suffix}")


CONTROL_CHARACTERS = "a\x00b\x1b[2Jc\u202ed\u200be\x9bf\u2066g\ufeff"


def test_control_characters_are_escaped(capsys):
    assert visible(CONTROL_CHARACTERS) == "a\\x00b\\x1b[2Jc\\u202ed\\u200be\\x9bf\\u2066g\\ufeff"
    assert visible("Schüttgut 砂 μm²\tä\n") == "Schüttgut 砂 μm²\tä\n"
    say(CONTROL_CHARACTERS)
    assert capsys.readouterr().out == visible(CONTROL_CHARACTERS) + "\n"


def test_commands_print_only_through_say():
    """`say` escapes control characters."""
    from pathlib import Path

    import granflow.cli

    folder = Path(granflow.cli.__file__).parent
    found = [(path.name, path.read_text().count(" print(")) for path in folder.glob("*.py")]
    assert [each for each in found if each[1]] == [("arguments.py", 1)]


@pytest.mark.parametrize("verb", ["check", "report"])
def test_messages_escape_file_names(tmp_path, capsys, verb):
    assert main([*verb.split(), str(tmp_path / "a\x1b[2J\u202e\n.yaml")]) == 2
    error = capsys.readouterr().err
    assert "\x1b" not in error and "\u202e" not in error and "\\x1b[2J\\u202e\\n.yaml" in error


def test_log_escapes_newlines(tmp_path):
    with pytest.raises(SceneError), run_log(tmp_path) as log:
        log.info("out\nput")
        raise SceneError(["a\nb", "c"])
    lines = [line.partition(": ")[2] for line in (tmp_path / "run.log").read_text().splitlines()]
    assert lines == ["out\\nput", "ended by SceneError: a\\nb", "ended by SceneError: c"]


FUZZ = """
import resource, sys
from pathlib import Path
import numpy as np
resource.setrlimit(resource.RLIMIT_AS, (3 * 2**30, 3 * 2**30))
from granflow.errors import GranflowError
from granflow.io.files import FormatError
from granflow.particles.file import read_particles
from granflow.geometry.mesh_file import read_triangles
random, folder = np.random.default_rng(5), Path(sys.argv[1])
for path in sorted(folder.iterdir()):
    whole = path.read_bytes()
    for _ in range(40):
        data = bytearray(whole)
        for offset in random.integers(0, len(whole), random.integers(1, 5)):
            data[offset] = random.integers(256)
        target = folder / ("flipped" + path.suffix)
        target.write_bytes(bytes(data))
        try:
            read_particles(target) if path.stem == "table" else read_triangles(target)
        except (GranflowError, FormatError):
            pass
        target.unlink()
print("done")
"""


@pytest.mark.slow
def test_random_bytes_in_files_never_give_a_traceback(tmp_path):
    mesh = meshio.Mesh(POINTS, [("triangle", np.array([[0, 1, 2], [1, 3, 2]]))])
    for name, options in (
        ("stl", {"binary": True}),
        ("ply", {"binary": True}),
        ("vtk", {}),
        ("vtu", {}),
        ("obj", {}),
    ):
        meshio.write(tmp_path / f"mesh.{name}", mesh, **options)
    meshio.write(tmp_path / "ascii.stl", mesh, binary=False)
    meshio.write(tmp_path / "ascii.ply", mesh, binary=False)
    (tmp_path / "table.csv").write_text("x,y,z,r\n0,0,0,1\n3,0,0,1\n")
    meshio.write(tmp_path / "table.vtu", meshio.Mesh(POINTS, [], point_data={"radius": np.ones(4)}))
    run = subprocess.run(
        [sys.executable, "-c", FUZZ, str(tmp_path)], capture_output=True, text=True, timeout=240
    )
    assert (run.returncode, run.stdout[-5:]) == (0, "done\n"), run.stderr[-2000:]
