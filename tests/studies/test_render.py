"""Pictures of a run: frame selection, colors, camera, and what VTK draws."""

import subprocess
import sys
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest
from observers.snapshots import contacts_of, particles_of, snapshot_of, turned

from granflow.errors import GranflowError
from granflow.io.vtu import VtuMesh, write_vtu
from granflow.observers.frames import ContactFrames, ParticleFrames, WallFrames
from granflow.studies.frames import (
    OPENING,
    VIEWS,
    FrameWalls,
    camera_for,
    corners_of,
    drawn_boxes,
    frames_of,
    read_force_chains,
    read_particles,
    read_walls,
    selected_frames,
    view_of,
)
from granflow.studies.render import scale_for, values_of

FLOOR = (np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
INTERVAL, COUNT = 0.25, 30


@pytest.fixture
def run(tmp_path):
    """A directory with four frames; the first one has no particles."""
    writers = (
        ParticleFrames(tmp_path, INTERVAL),
        WallFrames(tmp_path, INTERVAL, {"floor": FLOOR}),
        ContactFrames(tmp_path, INTERVAL),
    )
    for k in range(4):
        snapshot = snapshot_of(
            time=INTERVAL * k, particles=particles_of(COUNT if k else 0, seed=k), contacts=contacts_of(7),
            walls={"floor": turned(0)}
        )  # fmt: skip
        for writer in writers:
            writer.observe(snapshot)
    return tmp_path


def test_each_frame_has_its_walls_and_contacts(run):
    frames = frames_of(run)
    assert [frame.time for frame in frames] == [0, 0.25, 0.5, 0.75]
    assert len(read_particles(frames[0]).radius) == 0
    expected = particles_of(COUNT, seed=2)
    np.testing.assert_allclose(read_particles(frames[2]).position, expected["position"], rtol=1e-6)
    np.testing.assert_array_equal(read_walls(frames[2]).polygons[0], FLOOR[1])
    chains = read_force_chains(frames[2])
    contacts = contacts_of(7)
    np.testing.assert_allclose(chains.ends[:, 1], contacts["position_j"], rtol=1e-6)
    np.testing.assert_allclose(chains.normal_force, contacts["normal_force"], rtol=1e-6)


@pytest.mark.parametrize(("text", "numbers"), [
    ("last", [3]), ("first", [0]), ("2", [2]), ("0.45s", [2]), ("240 ms", [1]), ("0.6", [2]),
    ("all", [0, 1, 2, 3]), ("1,last", [1, 3]), ("9s", None), ("7", None), ("3 mm", None)
])  # fmt: skip
def test_frames_are_selected_by_position_number_or_time(run, text, numbers):
    frames = frames_of(run)
    if numbers is None:
        with pytest.raises(GranflowError, match=f"--frame {text}"):
            selected_frames(frames, text)
    else:
        assert [frame.number for frame in selected_frames(frames, text)] == numbers


def test_range_contains_98_percent_of_the_values_and_zero_if_near():
    values = np.arange(101.0)
    scale = scale_for("force", [values[:50], values[50:]], is_vector=True)
    assert scale.limits == (0.0, 99.0) and scale.out_of_range == (False, True)
    narrow = scale_for("radius", [2e-3 + 1e-5 * values])
    assert narrow.limits == pytest.approx((2.01e-3, 2.99e-3)) and (narrow.unit, narrow.factor) == ("mm", 1e-3)
    assert scale_for("velocity.z", [10.0 - values]).limits == (-89.0, 89.0)
    arrays = {"velocity": np.array([[3.0, 4.0, 12.0]])}
    assert (values_of(arrays, "velocity"), values_of(arrays, "velocity.z")) == ([13.0], [12.0])


@pytest.mark.parametrize("text", [*VIEWS, "1,-2,0.8"])
def test_all_points_are_visible_and_fill_the_picture(text):
    """Every point projects into the picture (pinhole formula); the outermost lies within 10 % of the edge. The
    right of the front view is along x."""
    points = corners_of(np.array([[-1.0, 2.0, 0.0], [1.0, 2.5, 4.0]]))
    view = view_of(text)
    for aspect in (0.6, 1.8):
        camera = camera_for(view, points, aspect)
        projected = view.projected(points - camera.eye)
        half = -np.tan(0.5 * OPENING) * projected[:, 2:] if view.perspective else camera.half_height
        distances = np.abs(projected[:, :2] / half / [aspect, 1.0])
        assert 0.9 < distances.max() < 1.0
        assert np.all(projected[:, 2] < 0.0), "a point is behind the viewer"
    sideways = view_of("front", gravity=np.array([0.1, -9.8, 0.0]))
    assert (sideways.up.tolist(), sideways.right.tolist()) == ([0, 1, 0], [1, 0, 0])


def test_faces_of_a_box_end_at_its_other_faces():
    """Planes of half width 10 m at x = 0, x = 3 and z = -1, around particles from 0 to 2; the top is open."""
    square = np.array([[-10.0, -10.0], [10.0, -10.0], [10.0, 10.0], [-10.0, 10.0]])
    points = [np.insert(square, axis, at, axis=1) for axis, at in ((0, 0.0), (0, 3.0), (2, -1.0), (2, -2.0))]
    walls = FrameWalls(np.concatenate(points), (np.arange(16).reshape(4, 4),), (np.arange(4),))
    plane = SimpleNamespace(shape="plane")
    scene = SimpleNamespace(walls=dict.fromkeys(("bin.left", "bin.right", "bin.bottom", "floor"), plane))
    particles = corners_of(np.array([[0.0] * 3, [2.0] * 3]))
    boxes = drawn_boxes(walls, scene, particles)
    over = 0.05 * 2.0
    np.testing.assert_allclose(boxes[0], [[-np.inf, -over, -1.0], [np.inf, 2.0 + over, 2.0 + over]])
    np.testing.assert_allclose(boxes[2], [[0.0, -over, -np.inf], [3.0, 2.0 + over, np.inf]])
    np.testing.assert_allclose(boxes[3], [[-over, -over, -np.inf], [2.0 + over, 2.0 + over, np.inf]])


@pytest.mark.skipif(find_spec("imageio_ffmpeg") is None, reason="needs the plot extra")
def test_pictures_and_film(run):
    """A film has all frames. In a separate process: if no picture can be drawn, VTK aborts instead of raising."""
    import imageio_ffmpeg
    from PIL import Image

    cells = {"wall": np.zeros(2, np.int32), "wear_depth": np.array([1e-6, 4e-6])}
    write_vtu(run / "walls_0003.vtu", VtuMesh.of_cells("triangle", *FLOOR, cells))
    chains = ["--chains", "--view=top", "--cut", "--color=velocity.z", "--size=640x480", f"--out={run}/a.png"]
    worn = ["--walls=wear_depth", "--view=top", "--size=640x480", f"--out={run}/worn.png"]
    edge_on = ["--walls=wear_depth", "--view=front"]
    film = ["--film", "--size=320x240", "--fps=4"]
    program = "import sys\nfrom granflow.cli.main import main\n"
    program += "\n".join(f"assert main({['render', str(run), *each]}) == 0" for each in (chains, worn, film))
    program += f"\nassert main({['render', str(run), *edge_on]}) == 2"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "--view front: all walls with wear_depth are edge-on" in done.stderr
    for name in ("a.png", "worn.png"):
        picture = np.asarray(Image.open(run / name))
        assert picture.shape == (480, 640, 3)
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100, "the picture is blank"
    found = imageio_ffmpeg.count_frames_and_secs(str(run / "pictures" / "film_velocity_iso.mp4"))
    assert found == (4, pytest.approx(1.0, abs=0.05))
