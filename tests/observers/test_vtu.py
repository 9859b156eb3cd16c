"""Frames contain the numbers of the snapshot, and the PVD file lists exactly the frames on disk."""

import errno
import xml.etree.ElementTree as ElementTree
from io import FileIO

import meshio
import numpy as np
import pytest
from observers.snapshots import contacts_of, particles_of, snapshot_of, turned

from granflow.fields import CONTACT_QUANTITIES, PARTICLE_QUANTITIES
from granflow.io.frames import TAIL, FrameSeries, is_empty
from granflow.io.vtu import VtuMesh, read_vtu
from granflow.observers.frames import ContactFrames, ParticleFrames, WallFrames

SQUARE = (np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
TRIANGLE = (np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]]), np.array([[0, 1, 2]]))
POINT = VtuMesh.of_points(np.zeros((1, 3)), {})


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


def test_contacts_are_read_back_exactly_as_lines(tmp_path):
    """Histories of contact models have the unit of their declaration; dimensionless arrays have none."""
    contacts = contacts_of(50)
    ContactFrames(tmp_path, 0.1, history_units={"overlap_max": "m"}).observe(snapshot_of(contacts=contacts))
    mesh = meshio.read(tmp_path / "contacts_0000.vtu")
    lines = mesh.cells_dict["line"]
    np.testing.assert_array_equal(mesh.points[lines[:, 0]], contacts["position_i"])
    np.testing.assert_array_equal(mesh.points[lines[:, 1]], contacts["position_j"])
    assert set(mesh.cell_data) == set(contacts) - {"position_i", "position_j"}
    for name, (values,) in mesh.cell_data.items():
        np.testing.assert_array_equal(values, CONTACT_QUANTITIES[name].for_file(contacts[name]))
    units = "force [N], normal_force [N], tangential_force [N], overlap [m], overlap_max [m]"
    assert set(mesh.field_data) == set(units.split(", "))


@pytest.mark.parametrize(
    ("reach", "radius", "file_type"), [(1, 1e-3, "f4"), (1, 1e-4, "f8"), (1e3, 1e-1, "f8")]
)
def test_positions_use_f64_only_if_f32_does_not_resolve_the_smallest_particle(
    tmp_path, reach, radius, file_type
):
    snapshot = snapshot_of(particles=particles_of(9, radius=np.full(9, radius)))
    ParticleFrames(tmp_path, 0.1, reach=reach).observe(snapshot)
    assert meshio.read(tmp_path / "particles_0000.vtu").points.dtype == file_type


def test_walls_follow_their_pose_and_absent_walls_are_omitted(tmp_path):
    """A conveyor belt is an infinite plane, which moves along its normal only: the part that is written remains in
    the domain."""
    triangles = {"floor": SQUARE, "gate": TRIANGLE, "belt": SQUARE}
    walls = {
        "floor": turned(0.3, offset=(0, 0, 0.1)),
        "gate": turned(0, present=False),
        "belt": turned(0, offset=(5.0, -3.0, 2)),
    }
    frames = WallFrames(tmp_path, 0.1, triangles, unbounded=["belt"], temperatures={"belt": 320.0})
    frames.observe(snapshot_of(walls=walls))
    mesh = meshio.read(tmp_path / "walls_0000.vtu")
    np.testing.assert_array_equal(mesh.points[:4], walls["floor"].moved(SQUARE[0]))
    np.testing.assert_allclose(mesh.points[4:], SQUARE[0] + [0, 0, 2], atol=1e-12)
    np.testing.assert_array_equal(mesh.cells_dict["triangle"], [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    np.testing.assert_array_equal(mesh.cell_data["wall"][0], [0, 0, 2, 2])
    np.testing.assert_array_equal(mesh.cell_data["temperature"][0], [np.nan, np.nan, 320.0, 320.0])
    names = {name: int(number[0]) for name, number in mesh.field_data.items() if name.startswith("wall.")}
    assert names == {"wall.floor": 0, "wall.gate": 1, "wall.belt": 2}


@pytest.mark.parametrize(
    "damage", [lambda pvd: pvd.unlink(), lambda pvd: pvd.write_text("edited"), lambda pvd: None]
)
def test_pvd_lists_the_frames_on_disk_also_after_it_is_modified(tmp_path, damage):
    (tmp_path / "particles_0007.vtu").write_text("left by an earlier run")
    series = FrameSeries(tmp_path, "particles")
    times = [0.0, 0.1, 0.30000000000000004, 1 / 3]
    for time in times:
        series.write(POINT, time)
        damage(series.listing)
    series.write(POINT, 4.0)
    names = sorted(path.name for path in tmp_path.glob("*.vtu"))
    assert listed(series.listing) == list(zip([*times, 4.0], names, strict=True))


@pytest.mark.parametrize("free_bytes", [0, 40])
def test_a_full_disk_leaves_a_valid_pvd_file(tmp_path, monkeypatch, free_bytes):
    """The disk accepts `free_bytes` bytes of an entry and its closing tags; before the next frame, space is
    freed."""
    series = FrameSeries(tmp_path, "particles")
    series.write(POINT, 0.0)
    before = series.listing.read_bytes()

    class Full(FileIO):
        def write(self, data):
            if self.tell() < len(before) - len(TAIL) + free_bytes:
                return super().write(data[:free_bytes])
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


def test_empty_frame_is_a_valid_file_without_points(tmp_path):
    """meshio cannot read a VTU file without cells: the file has a polygon without corners, which granflow
    ignores."""
    ParticleFrames(tmp_path, 0.1).observe(snapshot_of(particles=particles_of(0)))
    ContactFrames(tmp_path, 0.1).observe(snapshot_of(contacts=None))
    absent = {"lid": turned(0, present=False)}
    WallFrames(tmp_path, 0.1, {"lid": SQUARE}).observe(snapshot_of(walls=absent))
    for stem in ("particles", "contacts", "walls"):
        path = tmp_path / f"{stem}_0000.vtu"
        mesh, read = meshio.read(path), read_vtu(path)
        assert len(mesh.points) == 0 and sum(block.data.size for block in mesh.cells) == 0
        assert len(read.points) == 0 and not read.cells and not read.cell_data and is_empty(path)
