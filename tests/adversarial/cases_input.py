"""Tables of particles, meshes and measurements that are damaged, inconsistent or huge."""

import base64
import os
import struct
import zlib

import meshio
import numpy as np
from geometry.meshes import cube, sheet

from adversarial.beads import BEADS, changed
from adversarial.case import Case

FROM_TABLE = changed(
    BEADS,
    ("    count: 10\n    diameter: 4 mm\n", ""),
    ("{kind: lattice, region: {box: {min: [0, 0, 0], max: [2 cm, 2 cm, 1 cm]}}}", "{kind: file, file: FILE}"),
)
WITH_MESH = changed(
    BEADS, ("{shape: plane, point: [0, 0, 0], normal: [0, 0, 1]", "{shape: mesh, file: FILE, scale: 0.01")
)
ROWS = "x,y,z,r\n0.005,0.005,0.01,0.002\n0.015,0.015,0.01,0.002\n"


def table(
    name: str, text: str, content: str | bytes, *patterns: str, file: str = "beads.csv", **more
) -> Case:
    """Case of `granflow check` of a scene with particles from a file with this content."""

    def prepare(sandbox):
        sandbox.write("beads.yaml", FROM_TABLE.replace("FILE", f"'{file}'"))
        sandbox.write(file, content)

    return Case(
        "tables of particles",
        f"table_{name}",
        text,
        ("check beads.yaml",),
        patterns=patterns,
        **({"prepare": prepare} | more),
    )


def mesh(name: str, text: str, file: str, content, *patterns: str, **more) -> Case:
    """Case of `granflow check` of a scene with a mesh wall; `content`: bytes, or a function that writes the
    file."""

    def prepare(sandbox):
        sandbox.write("beads.yaml", WITH_MESH.replace("FILE", f"'{file}'"))
        if callable(content):
            content(sandbox.path(file))
        else:
            sandbox.write(file, content)

    command = "check beads.yaml"
    return Case(
        "meshes", f"mesh_{name}", text, (command,), patterns=patterns, **({"prepare": prepare} | more)
    )


def dangling_link(sandbox):
    """Writes a symbolic link in the directory of the scene to a file that does not exist."""
    sandbox.write("beads.yaml", FROM_TABLE.replace("FILE", "beads.csv"))
    sandbox.path("beads.csv").symlink_to("none.csv")


def loop(file: str, text: str):
    """A `prepare` with a loop of symbolic links as input file."""

    def prepare(sandbox):
        sandbox.write("beads.yaml", text.replace("FILE", file))
        sandbox.path(file).symlink_to(file)

    return prepare


def vtu(points: int) -> bytes:
    """A VTU file with a compressed array of points that expands to 24 zero bytes per point."""
    block = 2**20
    raw_size = 24 * points
    count, rest = divmod(raw_size, block)
    packed = zlib.compress(b"\0" * block, 9)
    last = zlib.compress(b"\0" * rest, 9) if rest else b""
    sizes = [len(packed)] * count + ([len(last)] if rest else [])
    header = struct.pack(f"<{3 + len(sizes)}I", len(sizes), block, rest, *sizes)
    text = base64.b64encode(header).decode() + base64.b64encode(packed * count + last).decode()
    return (
        '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian" '
        'compressor="vtkZLibDataCompressor"><UnstructuredGrid>'
        f'<Piece NumberOfPoints="{points}" NumberOfCells="1"><Points><DataArray type="Float64" Name="Points" '
        f'NumberOfComponents="3" format="binary">{text}</DataArray></Points><Cells>'
        '<DataArray type="Int64" Name="connectivity" format="ascii">0</DataArray>'
        '<DataArray type="Int64" Name="offsets" format="ascii">1</DataArray>'
        '<DataArray type="UInt8" Name="types" format="ascii">1</DataArray></Cells></Piece>'
        "</UnstructuredGrid></VTKFile>\n"
    ).encode()


def as_stl(points, corners) -> bytes:
    """Binary STL of triangles."""
    triangles = np.asarray(points, np.float32)[np.asarray(corners)]
    records = np.zeros(len(triangles), [("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    records["c"] = triangles
    return b"\0" * 80 + struct.pack("<I", len(triangles)) + records.tobytes()


def obj(points, corners, relative: bool = False) -> str:
    """Text of an OBJ file; indices from 1, or relative to the last vertex."""
    shift = -len(points) if relative else 1
    lines = [f"v {x} {y} {z}" for x, y, z in points]
    return (
        "\n".join([*lines, *(f"f {a + shift} {b + shift} {c + shift}" for a, b, c in np.asarray(corners))])
        + "\n"
    )


def tables() -> list[Case]:
    """Text and VTU files of particles."""
    return [
        table("empty", "an empty file", "", "no particle|empty"),
        table("header_only", "column names without rows", "x,y,z,r\n", "no particle"),
        table("no_names", "numbers without column names", "1,2,3,4\n", "must be a header with the columns"),
        table("missing_column", "no column for z", "x,y,r\n1,2,3\n", "must be a header with the columns"),
        table(
            "text",
            "a word where a number belongs",
            ROWS + "a,0,0.01,0.002\n",
            r"beads.csv:4: x is a",
            quick=True,
        ),
        table("nan", "NaN as a position", ROWS + "nan,0,0.01,0.002\n", r"beads.csv:4: .*finite"),
        table("huge_number", "1e400 as a radius", ROWS + "0,0,0.01,1e400\n", r"beads.csv:4: .*finite"),
        table("negative_radius", "a negative radius", ROWS + "0,0,0.01,-0.002\n", r"beads.csv:4: .*above 0"),
        table("short_row", "a row with too few values", ROWS + "0,0\n", r"beads.csv:4: the row has 2 values"),
        table("unit", "a unit of mass for a length", ROWS.replace("x,", "x [kg],"), "unit of x"),
        table("outside", "a position outside the domain", ROWS + "9,9,9,0.002\n", "domain"),
        table("1e30", "a position of 1e30 m", ROWS + "1e30,0,0.01,0.002\n", "domain"),
        table(
            "overlap",
            "two particles at the same position",
            ROWS + "0.005,0.005,0.01,0.002\n",
            "overlap",
            code=(0, 2),
        ),
        table("binary", "random bytes", bytes(range(256)) * 100, "beads.csv"),
        table(
            "many_bad",
            "100 000 bad rows: twenty are shown",
            "x,y,z,r\n" + "a,b,c,d\n" * 100_000,
            "more rows have problems",
            seconds=200,
        ),
        table(
            "no_file",
            "no such file",
            "",
            "no such file",
            prepare=lambda s: s.write("beads.yaml", FROM_TABLE.replace("FILE", "no.csv")),
        ),
        table(
            "above",
            "a missing file outside the directory of the scene",
            "",
            "no such file",
            prepare=lambda s: s.write("beads.yaml", FROM_TABLE.replace("FILE", "../none.csv")),
        ),
        table(
            "link_dangling",
            "a symbolic link to a file that does not exist",
            "",
            "no such file",
            prepare=dangling_link,
        ),
        table(
            "link_loop", "a loop of symbolic links", "", "beads.csv", prepare=loop("beads.csv", FROM_TABLE)
        ),
        table(
            "pipe",
            "a named pipe without a writer",
            "",
            "regular file",
            seconds=300,
            prepare=lambda s: (
                s.write("beads.yaml", FROM_TABLE.replace("FILE", "beads.csv")),
                os.mkfifo(s.path("beads.csv")),
            ),
        ),
        table("vtu_text", "a VTU file that is text", "hello", "VTU", file="beads.vtu"),
        table("vtu_no_radius", "a VTU file without radii", vtu(2), "radius", file="beads.vtu"),
        table(
            "vtu_bomb",
            "a VTU file of 8 MB that expands to 6 GB",
            vtu(250_000_000),
            "large|expand|size|MB|GB",
            file="beads.vtu",
            megabytes=1500,
            seconds=300,
        ),
    ]


def holes(path):
    """Writes a cube of 2 cm without its top; open meshes are valid."""
    points, corners = cube()
    path.write_bytes(as_stl(2 * points, corners[:-2]))


def meshes() -> list[Case]:
    """Files of triangles."""
    points, corners = cube()
    whole = as_stl(points, corners)
    return [
        mesh("empty", "an empty file", "m.stl", b"", "empty"),
        mesh("random", "random bytes", "m.stl", bytes(range(256)) * 40, "m.stl"),
        mesh("cut", "a binary STL file cut in half", "m.stl", whole[: len(whole) // 2], "truncated"),
        mesh(
            "count",
            "an STL file that claims 4e9 triangles",
            "m.stl",
            whole[:80] + b"\xff" * 4 + whole[84:],
            "truncated|damaged",
            quick=True,
        ),
        mesh(
            "text_cut",
            "a text STL file cut in a number",
            "m.stl",
            "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0",
            "m.stl",
        ),
        mesh(
            "nan",
            "NaN as a corner",
            "m.stl",
            as_stl(np.where(points > 0, np.nan, points), corners),
            "finite|no numbers",
        ),
        mesh("1e30", "corners at 1e30 m", "m.stl", as_stl(1e30 * points, corners), "m.stl|walls.floor"),
        mesh(
            "1e-30",
            "a cube of 1e-30 m",
            "m.obj",
            obj(1e-30 * points, corners),
            "walls.floor|m.obj",
            "small|size|coincide|area|degenerate",
        ),
        mesh(
            "flat",
            "triangles without area only",
            "m.obj",
            "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n",
            "area|surface|triangle",
        ),
        mesh(
            "index",
            "an OBJ file with a corner that does not exist",
            "m.obj",
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
            "m.obj",
        ),
        mesh(
            "relative",
            "an OBJ file with relative indices, which are valid",
            "m.obj",
            obj(points, corners, True),
            "no errors, 1 warning",
            code=0,
        ),
        mesh(
            "points", "an OBJ file with corners and no triangles", "m.obj", "v 0 0 0\nv 1 0 0\n", "triangle"
        ),
        mesh("kind", "an unknown kind of file", "m.step", "ISO-10303", "unsupported format"),
        mesh(
            "many",
            "two million triangles",
            "m.stl",
            lambda path: path.write_bytes(as_stl(*sheet(1000))),
            "1[ ,_]?000[ ,_]?000|triangles",
            seconds=200,
        ),
        mesh("missing", "no such file", "m.stl", lambda path: None, "does not exist|no such"),
        mesh(
            "link_loop", "a loop of symbolic links", "m.stl", b"", "m.stl", prepare=loop("m.stl", WITH_MESH)
        ),
        mesh("directory", "a directory", "m.stl", lambda path: path.mkdir(), "it is a directory"),
        mesh(
            "ply_huge",
            "a PLY file that claims 1e12 vertices",
            "m.ply",
            "ply\nformat ascii 1.0\nelement vertex 1000000000000\nproperty float x\nproperty float y\n"
            "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n",
            "m.ply",
            seconds=200,
        ),
        mesh("vtk_text", "a VTK file that is text", "m.vtk", "hello\n", "m.vtk"),
        mesh(
            "vtu_bomb",
            "a VTU file of 8 MB that expands to 6 GB",
            "m.vtu",
            vtu(250_000_000),
            "large|expand|size|MB|GB",
            seconds=300,
        ),
        mesh("open", "a cube without its top (a mesh with a hole)", "m.stl", holes, "no problems", code=0),
        mesh(
            "quads",
            "a VTK file of quadrilaterals, which are cut into triangles",
            "m.vtk",
            lambda path: meshio.write(
                path, meshio.Mesh(points, [("quad", [[0, 1, 3, 2]])]), file_format="vtk"
            ),
            "no problems",
            code=0,
        ),
    ]


def fit(name: str, text: str, content: str, *patterns: str) -> Case:
    """Case of `granflow fit` with this file of measurements."""
    return Case(
        "measurements",
        f"fit_{name}",
        text,
        ("fit data.csv --fit-limit",),
        patterns=patterns,
        prepare=lambda sandbox: sandbox.write("data.csv", content),
    )


def measurements() -> list[Case]:
    """Tables for `granflow fit`."""
    return [
        fit("empty", "an empty file", "", "no rows"),
        fit(
            "above_one",
            "a restitution of 1.5",
            "velocity,restitution\n1,0.9\n2,1.5\n",
            r"data.csv:3: .*\[0, 1\]",
        ),
        fit(
            "one_row",
            "one row for three parameters",
            "velocity,restitution\n1,0.9\n",
            "rows|measurements|few",
        ),
        fit(
            "equal",
            "the same velocity in every row",
            "velocity,restitution\n" + "1,0.9\n" * 5,
            "velocit|data|fit",
        ),
        fit("unit", "velocities in km/h", "velocity [km/h],restitution\n1,0.9\n", "km/h"),
    ]


CASES = [*tables(), *meshes(), *measurements()]
