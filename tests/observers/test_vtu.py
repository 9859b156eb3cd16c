"""Frames contain the numbers of the snapshot, and the PVD file lists exactly the frames on disk."""

import ast
import errno
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from io import FileIO

import meshio
import numpy as np
import pytest
from observers.snapshots import contacts_of, particles_of, snapshot_of, turned

from granflow.fields import CONTACT_QUANTITIES, PARTICLE_QUANTITIES
from granflow.io.frames import TAIL, FrameSeries, is_empty
from granflow.io.vtu import VtuMesh, read_vtu, write_vtu
from granflow.observers.frames import ContactFrames, ParticleFrames, WallFrames

SQUARE = (np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
TRIANGLE = (np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]]), np.array([[0, 1, 2]]))


def listed(path):
    rows = ElementTree.parse(path).getroot().iter("DataSet")
    return [(float(row.get("timestep")), row.get("file")) for row in rows]


@pytest.mark.parametrize("count", [1, 5000])
def test_particles_are_read_back_exactly(tmp_path, count):
    snapshot = snapshot_of(particles=particles_of(count))
    ParticleFrames(tmp_path, 0.1).observe(snapshot)
    mesh = meshio.read(tmp_path / "particles_0000.vtu")
    particles = dict(snapshot.particles)
    particles["diameter"] = 2 * particles["radius"]
    particles["kinetic_energy"] = 0.5 * particles["mass"] * (particles["velocity"] ** 2).sum(axis=1)
    assert [block.type for block in mesh.cells] == ["vertex"]
    np.testing.assert_array_equal(mesh.cells[0].data[:, 0], np.arange(count))
    np.testing.assert_array_equal(mesh.points, particles["position"].astype(np.float32))
    assert set(mesh.point_data) == {
        "id", "radius", "diameter", "velocity", "angular_velocity", "force", "material", "group", "coordination_number",
        "wall_contact_count", "kinetic_energy", "fixed", "clump", "orientation", "liquid_film",
        "temperature",
        "heat_source", "attached_to",
    }  # fmt: skip
    for name, values in mesh.point_data.items():
        np.testing.assert_array_equal(values, PARTICLE_QUANTITIES[name].for_file(particles[name]))
        assert values.dtype == PARTICLE_QUANTITIES[name].file_type


@pytest.mark.parametrize("count", [0, 3])
def test_field_data_state_the_unit_of_each_array(tmp_path, count):
    """Dimensionless arrays have none; histories of contact models have the unit of their declaration."""
    contacts = contacts_of(count) | {"overlap_max": np.ones(count)}
    ContactFrames(tmp_path, 0.1, history_units={"overlap_max": "m"}).observe(snapshot_of(contacts=contacts))
    ParticleFrames(tmp_path, 0.1).observe(snapshot_of(particles=particles_of(3)))
    stated = {
        "particles": "radius [m], diameter [m], velocity [m/s], angular_velocity [rad/s], force [N], "
        "kinetic_energy [J], liquid_film [m3], temperature [K], heat_source [W]",
        "contacts": "force [N], normal_force [N], tangential_force [N], overlap [m], overlap_max [m]",
    }
    for stem, names in stated.items():
        read = meshio.read(tmp_path / f"{stem}_0000.vtu")
        assert set(read.field_data) == set(names.split(", ")), stem


READ_BY_PYVISTA = """
import pyvista, sys
for path in sys.argv[1:]:
    mesh = pyvista.read(path)
    values = {name: mesh[name].tolist() for name in ("id", "velocity", 'a<b&"é') if name in mesh.array_names}
    print((mesh.n_points, mesh.n_cells, mesh.points.tolist(), values, sorted(mesh.field_data)))
"""


def test_paraview_reads_what_meshio_writes_with_units_and_any_name(tmp_path):
    """Names are not restricted to letters: they come from contact models of other packages."""
    pytest.importorskip("pyvista")
    points = np.array([[0, 0.5, 1], [2, 0, 0]], np.float32)
    expected, files = [], []
    for compression, count in (("zlib", 2), ("none", 2), ("zlib", 0)):
        arrays = {"id": np.arange(count), "velocity": points[:count], 'a<b&"é': np.ones(count, np.float32)}
        units = {"velocity": "m/s", 'a<b&"é': "N/µm^1.5", "absent": "m"}
        files.append(str(tmp_path / f"{compression}{count}.vtu"))
        write_vtu(tmp_path / files[-1], VtuMesh.of_points(points[:count], arrays, units), compression)
        stated = sorted(["velocity [m/s]", 'a<b&"é [N/µm^1.5]'])
        values = {name: array.tolist() for name, array in arrays.items()}
        expected.append((count, max(count, 1), points[:count].tolist(), values, stated))
        raw = (tmp_path / files[-1]).read_bytes()
        if count:
            assert b"created by meshio" in raw and (b"vtkZLibDataCompressor" in raw) == (
                compression == "zlib"
            )
    done = subprocess.run(
        [sys.executable, "-c", READ_BY_PYVISTA, *files], capture_output=True, text=True, check=True
    )
    assert [ast.literal_eval(line) for line in done.stdout.splitlines()] == expected


@pytest.mark.parametrize(
    ("reach", "radius", "file_type"), [(1, 1e-3, "f4"), (1, 1e-4, "f8"), (1e3, 1e-1, "f8")]
)
def test_positions_use_f64_only_if_f32_does_not_resolve_the_smallest_particle(
    tmp_path, reach, radius, file_type
):
    snapshot = snapshot_of(particles=particles_of(9, radius=np.full(9, radius)))
    ParticleFrames(tmp_path, 0.1, reach=reach).observe(snapshot)
    assert meshio.read(tmp_path / "particles_0000.vtu").points.dtype == file_type


def test_contacts_are_read_back_exactly_as_lines(tmp_path):
    contacts = contacts_of(50)
    ContactFrames(tmp_path, 0.1).observe(snapshot_of(contacts=contacts))
    mesh = meshio.read(tmp_path / "contacts_0000.vtu")
    lines = mesh.cells_dict["line"]
    np.testing.assert_array_equal(mesh.points[lines[:, 0]], contacts["position_i"])
    np.testing.assert_array_equal(mesh.points[lines[:, 1]], contacts["position_j"])
    assert set(mesh.cell_data) == set(contacts) - {"position_i", "position_j"}
    for name, (values,) in mesh.cell_data.items():
        np.testing.assert_array_equal(values, CONTACT_QUANTITIES[name].for_file(contacts[name]))


def test_walls_follow_their_pose_and_absent_walls_are_omitted(tmp_path):
    triangles = {"floor": SQUARE, "gate": TRIANGLE, "lid": SQUARE}
    walls = {
        "floor": turned(0.3, offset=(0, 0, 0.1)),
        "gate": turned(0, present=False),
        "lid": turned(0, offset=(0, 0, 2)),
    }
    WallFrames(tmp_path, 0.1, triangles).observe(snapshot_of(walls=walls))
    mesh = meshio.read(tmp_path / "walls_0000.vtu")
    np.testing.assert_array_equal(mesh.points[:4], walls["floor"].moved(SQUARE[0]))
    np.testing.assert_array_equal(mesh.points[4:], SQUARE[0] + [0, 0, 2])
    np.testing.assert_array_equal(mesh.cells_dict["triangle"], [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    np.testing.assert_array_equal(mesh.cell_data["wall"][0], [0, 0, 2, 2])
    names = {name: int(number[0]) for name, number in mesh.field_data.items() if name.startswith("wall.")}
    assert names == {"wall.floor": 0, "wall.gate": 1, "wall.lid": 2}


def test_pvd_lists_exactly_the_frames_on_disk_with_their_times(tmp_path):
    (tmp_path / "particles_0007.vtu").write_text("left by an earlier run")
    (tmp_path / "particles_mine.vtu").write_text("not a frame of this run")
    frames = ParticleFrames(tmp_path, 0.1)
    times = [0.0, 0.1, 0.30000000000000004, 1 / 3]
    for time in [*times, times[-1]]:
        frames.observe(snapshot_of(time=time))
    frames.finish()
    rows = listed(tmp_path / "particles.pvd")
    assert [time for time, _ in rows] == times
    assert [name for _, name in rows] == sorted(path.name for path in tmp_path.glob("particles_[0-9]*.vtu"))


def test_frame_that_cannot_be_written_leaves_the_series_unchanged(tmp_path, monkeypatch):
    frames = ParticleFrames(tmp_path, 0.1)
    frames.observe(snapshot_of(time=0.0))
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def half_of_the_file(path, mesh, compression):
        path.write_bytes(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(meshio.vtu, "write", half_of_the_file)
    with pytest.raises(OSError, match="disk full"):
        frames.observe(snapshot_of(time=0.1))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


POINT = VtuMesh.of_points(np.zeros((1, 3)), {})


def test_frame_adds_one_write_of_constant_size_to_the_pvd_file(tmp_path, monkeypatch):
    """The frames themselves are not written; the file is valid after each frame, and not replaced."""
    monkeypatch.setattr("granflow.io.frames.write_vtu", lambda path, *_: path.touch())
    written = []
    series = FrameSeries(tmp_path, "particles")

    class Counted(FileIO):
        def write(self, data):
            written.append(len(data))
            return super().write(data)

    monkeypatch.setattr("granflow.io.frames.FileIO", Counted)
    inodes = set()
    for index in range(100):
        series.write(POINT, 0.1 * index)
        assert listed(series.listing) == series.frames and len(series.frames) == index + 1
        inodes.add(series.listing.stat().st_ino)
    assert len(inodes) <= 2, "only the first frame makes the file"
    assert len(written) in (99, 100) and max(written) < 150, (
        "one write of an entry and the closing tags per frame"
    )


def test_truncated_and_continued_pvd_file_equals_that_of_an_uninterrupted_run(tmp_path):
    uninterrupted = FrameSeries(tmp_path / "whole", "walls")
    interrupted = FrameSeries(tmp_path / "stopped", "walls")
    for series, times in ((uninterrupted, range(6)), (interrupted, range(5))):
        for time in times:
            series.write(POINT, time / 3)
    resumed = FrameSeries(tmp_path / "stopped", "walls")
    resumed.frames = interrupted.frames[:3]
    resumed.frame_count = 3
    resumed.truncate()
    assert listed(resumed.listing) == interrupted.frames[:3]
    for time in range(3, 6):
        resumed.write(POINT, time / 3)
    assert resumed.listing.read_bytes() == uninterrupted.listing.read_bytes()


@pytest.mark.parametrize(
    "damage", [lambda pvd: pvd.unlink(), lambda pvd: pvd.write_text("edited"), lambda pvd: None]
)
def test_modified_pvd_file_is_rewritten(tmp_path, damage):
    series = FrameSeries(tmp_path, "particles")
    for time in range(4):
        series.write(POINT, time)
        damage(series.listing)
    series.write(POINT, 4)
    assert listed(series.listing) == series.frames and len(series.frames) == 5


@pytest.mark.parametrize("free_bytes", [0, 40])
def test_a_full_disk_leaves_a_valid_pvd_file(tmp_path, monkeypatch, free_bytes):
    """The disk accepts `free_bytes` bytes of an entry and its closing tags; before the next frame, space is
    freed."""
    series = FrameSeries(tmp_path, "particles")
    series.write(POINT, 0.0)
    before = series.listing.read_bytes()

    class Full(FileIO):
        left = free_bytes

        def write(self, data):
            if self.tell() < len(before) - len(TAIL) + Full.left:
                return super().write(data[: Full.left])
            if data == TAIL:
                return super().write(data)
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("granflow.io.frames.FileIO", Full)
    with pytest.raises(OSError, match="No space left"):
        series.write(POINT, 1e300)
    assert series.listing.read_bytes() == before
    monkeypatch.setattr("granflow.io.frames.FileIO", FileIO)
    series.write(POINT, 2.0)
    assert [time for time, _ in listed(series.listing)] == [0.0, 2.0]


@pytest.mark.parametrize(
    ("make", "snapshot"),
    [
        (lambda path: ParticleFrames(path, 0.1), snapshot_of(particles=particles_of(0))),
        (lambda path: ContactFrames(path, 0.1), snapshot_of(contacts=contacts_of(0))),
        (lambda path: ContactFrames(path, 0.1), snapshot_of(contacts=None)),
        (lambda path: WallFrames(path, 0.1, {"lid": SQUARE}),
         snapshot_of(walls={"lid": turned(0, present=False)}))
    ],
    ids=["particles", "contacts", "no contacts", "walls"]
)  # fmt: skip
def test_empty_frame_is_a_valid_file_without_points(tmp_path, make, snapshot):
    """meshio cannot read a VTU file without cells: the file has a polygon without corners, which granflow
    ignores."""
    make(tmp_path).observe(snapshot)
    (path,) = tmp_path.glob("*.vtu")
    mesh = meshio.read(path)
    assert len(mesh.points) == 0 and sum(block.data.size for block in mesh.cells) == 0
    read = read_vtu(path)
    assert len(read.points) == 0 and not read.cells and not read.cell_data
    assert is_empty(path)


def test_infinite_plane_moves_along_its_normal_only(tmp_path):
    """A conveyor belt: the part that is written remains in the domain."""
    walls = {"belt": turned(0, offset=(5.0, -3.0, 0.25))}
    WallFrames(tmp_path, 0.1, {"belt": SQUARE}, unbounded=["belt"]).observe(snapshot_of(walls=walls))
    np.testing.assert_allclose(
        meshio.read(tmp_path / "walls_0000.vtu").points, SQUARE[0] + [0, 0, 0.25], atol=1e-12
    )
