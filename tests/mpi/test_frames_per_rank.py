"""Frames in one file for each rank: the same particles as in a single file, for all readers."""

import numpy as np
import pytest
import rank_launcher
from rank_launcher import alone, on_ranks
from scene_builders import build_scene, moving_lattice, vibrating_box

from granflow import read_run
from granflow.errors import SceneError
from granflow.io.files import FormatError
from granflow.io.frames import FrameSeries, Piece, piece_path, read_pvtu
from granflow.io.vtu import VtuMesh, write_vtu
from granflow.particles.file import read_particles


@pytest.mark.slow
@pytest.mark.skipif(bool(rank_launcher.MISSING), reason=rank_launcher.MISSING or "ranks can be started")
def test_frames_of_ranks_equal_those_without_mpi(tmp_path):
    scene = build_scene(
        {"lattice": moving_lattice((3, 3, 3), largest=0.0062, speed=1.0)}, vibrating_box(0.021),
        output={"interval": 1e-3, "frames_per_rank": True}, run={"duration": 2e-3, "velocity_max": 4.0},
    )  # fmt: skip
    path = scene.save(tmp_path / "scene.yaml")
    for done in (
        alone("-m", "granflow", "run", path, "--out", tmp_path / "one"),
        on_ranks(2, "-m", "granflow", "run", path, "--mpi", "--out", tmp_path / "two", "--until", "0.001"),
        on_ranks(3, "-m", "granflow", "resume", tmp_path / "two", "--mpi"),
    ):
        assert done.returncode == 0, done.stderr[-2000:]
    one, two = (read_run(tmp_path / name) for name in ("one", "two"))
    assert [path.name for path in one.frames.paths] == [f"particles_000{k}.vtu" for k in range(3)]
    assert [path.name for path in two.frames.paths] == [f"particles_000{k}.pvtu" for k in range(3)]
    assert len([*(tmp_path / "two").glob("particles_0000.*.vtu")]) == 2
    assert len([*(tmp_path / "two").glob("particles_0002.*.vtu")]) == 3
    for expected, found in zip(one.frames, two.frames, strict=True):
        assert expected.particles.keys() == found.particles.keys()
        for name, values in expected.particles.items():
            np.testing.assert_array_equal(values, found.particles[name], name)
            assert values.dtype == found.particles[name].dtype
    tables = [(tmp_path / name / "timeseries.csv").read_bytes() for name in ("one", "two")]
    assert tables[0] == tables[1]
    reads = "import pyvista, sys; assert len(pyvista.read(sys.argv[1])['velocity']) == 27"
    assert alone("-c", reads, two.frames.paths[0]).returncode == 0
    metric = "output.metrics.bed={kind: coordination}"
    for verb, *options in (("report",), ("analyze", "--set", metric), ("render",)):
        done = alone("-m", "granflow", verb, tmp_path / "two", *options)
        assert done.returncode == 0, done.stderr[-2000:]


def mesh_of(ids):
    """A mesh of particles with ids and positions that follow from them."""
    ids = np.array(ids, np.int64)
    points = np.stack([ids, 2.0 * ids, 0.0 * ids], axis=1).astype(np.float32)
    return VtuMesh.of_points(points, {"id": ids, "velocity": points, "radius": points[:, 1]})


@pytest.fixture
def series(tmp_path):
    """The series with one frame in three pieces, one of them without particles."""
    series = FrameSeries(tmp_path, "particles")

    def write(directory, frame):
        pieces = []
        for rank, ids in enumerate(([5, 1], [], [4, 2])):
            path = piece_path(directory, frame, rank)
            write_vtu(path, mesh_of(ids))
            pieces.append(Piece.of(path.name, mesh_of(ids)))
        return pieces

    series.write_pieces(write, 0.5)
    return series


def test_pieces_are_joined_in_the_order_of_the_ids(series, tmp_path):
    found = read_pvtu(tmp_path / "particles_0000.pvtu")
    expected = mesh_of([1, 2, 4, 5])
    np.testing.assert_array_equal(found.points, expected.points)
    assert found.points.dtype == np.float32
    for name, values in expected.point_data.items():
        np.testing.assert_array_equal(found.point_data[name], values)
    assert 'file="particles_0000.pvtu"' in (tmp_path / "particles.pvd").read_text()


def test_pieces_of_removed_frames_are_removed_and_missing_ones_refused(series, tmp_path):
    kept = {path.name for path in tmp_path.iterdir()}
    for name in ("particles_0001.pvtu", "particles_0001.0000.vtu", "particles_0001.0001.vtu"):
        (tmp_path / name).write_text("")
    series.truncate()
    assert {path.name for path in tmp_path.iterdir()} == kept
    path = tmp_path / "particles_0000.pvtu"
    with pytest.raises(SceneError, match="particles are not read from the files of several ranks"):
        read_particles(path)
    (tmp_path / "particles_0000.0002.vtu").unlink()
    with pytest.raises(FormatError, match="needs particles_0000.0002.vtu, which cannot be read"):
        read_pvtu(path)
    path.write_text("<VTKFile/>")
    with pytest.raises(FormatError, match="is not a PVTU file with pieces"):
        read_pvtu(path)
