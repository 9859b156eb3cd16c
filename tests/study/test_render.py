"""Pictures of a run: which frames, what the colors mean, what the camera sees; drawing is slow, as it needs VTK."""

import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest
from observe.snapshots import contacts_of, particles_of, snapshot_of, turned

from granflow.cli import main
from granflow.cli.render import FITS
from granflow.errors import GranflowError
from granflow.observe import ContactFrames, ParticleFrames, WallFrames
from granflow.study.render import frames_of, selected_frames
from granflow.study.render.bounding_points import bounding_points, corners_of, outermost_points
from granflow.study.render.camera import OPENING, VIEWS, aspect_of, camera_for, view_of
from granflow.study.render.colors import prefixed, scale_for, values_of
from granflow.study.render.frames import FrameParticles, read_force_chains, read_particles, read_walls
from granflow.study.render.render import decimals_of

FLOOR = (np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
INTERVAL, COUNT = 0.25, 30
needs_plot = pytest.mark.skipif(find_spec("pyvista") is None, reason="needs the plot extra")


@pytest.fixture
def run(tmp_path):
    """A directory with four frames, the first of them empty."""
    series = (
        ParticleFrames(tmp_path, INTERVAL),
        WallFrames(tmp_path, INTERVAL, {"floor": FLOOR}),
        contact_frames(tmp_path),
    )
    for k in range(4):
        snapshot = snapshot_of(
            time=INTERVAL * k,
            particles=particles_of(COUNT if k else 0, seed=k),
            contacts=contacts_of(7),
            walls={"floor": turned(0)},
        )
        for each in series:
            each.observe(snapshot)
    return tmp_path


def contact_frames(path):
    return ContactFrames(path, INTERVAL)


def test_frames_come_with_their_walls_and_contacts(run):
    frames = frames_of(run)
    assert [frame.time for frame in frames] == [0, 0.25, 0.5, 0.75]
    assert frames[2].walls.name == "walls_0002.vtu" and frames[2].contacts.name == "contacts_0002.vtu"
    assert len(read_particles(frames[0]).radius) == 0
    expected = particles_of(COUNT, seed=2)
    np.testing.assert_allclose(read_particles(frames[2]).position, expected["position"], rtol=1e-6)
    np.testing.assert_array_equal(read_walls(frames[2]).polygons[0], FLOOR[1])
    chains, contacts = read_force_chains(frames[2]), contacts_of(7)
    np.testing.assert_allclose(chains.ends[:, 1], contacts["position_j"], rtol=1e-6)
    np.testing.assert_allclose(chains.normal_force, contacts["normal_force"], rtol=1e-6)


def test_each_fit_gives_other_points(run):
    """`all` adds the walls to the points of `particles`; `domain` gives the corners of the box."""
    box = np.array([[0.0, 0.0, 0.0], [2.0, 2.0, 2.0]])
    points = {fit: bounding_points(fit, None, frames_of(run), box) for fit in FITS}
    np.testing.assert_array_equal(points["domain"], corners_of(box))
    assert len(points["all"]) > len(points["particles"]) > 0


def test_frames_taken_away_are_left_out(run):
    (run / "particles_0001.vtu").unlink()
    (run / "walls_0002.vtu").unlink()
    assert [(frame.number, frame.walls is None) for frame in frames_of(run)] == [(0, False), (2, True), (3, False)]


@pytest.mark.parametrize(
    ("words", "numbers"),
    [
        ("last", [3]),
        ("first", [0]),
        ("2", [2]),
        ("0.45s", [2]),
        ("240 ms", [1]),
        ("0.6", [2]),
        ("all", [0, 1, 2, 3]),
        ("1,last", [1, 3]),
    ],
)
def test_frames_are_named_by_place_number_or_time(run, words, numbers):
    assert [frame.number for frame in selected_frames(frames_of(run), words)] == numbers


@pytest.mark.parametrize(
    ("words", "sentence"),
    [("7", "no such frame; the frames are 0 to 3"), ("soon", "a time is expected"), ("3 mm", "give last, first, all")],
)
def test_a_frame_that_there_is_not_is_refused(run, words, sentence):
    with pytest.raises(GranflowError, match=sentence):
        selected_frames(frames_of(run), words)


def test_what_is_no_run_is_refused(tmp_path, capsys):
    assert main(["render", str(tmp_path / "none")]) == 2
    assert "there is no such directory" in capsys.readouterr().err
    assert main(["render", str(tmp_path)]) == 2
    assert "contains no particle frames" in capsys.readouterr().err


def test_a_frame_cut_short_is_refused(run):
    path = run / "particles_0003.vtu"
    path.write_bytes(path.read_bytes()[:700])
    with pytest.raises(GranflowError, match=r"particles_0003.vtu cannot be read"):
        read_particles(frames_of(run)[-1])


def test_one_file_holds_one_picture(run, capsys):
    assert main(["render", str(run), "--frame", "all", "--out", "a.png"]) == 2
    assert "--frame all selects 4 images" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [["--size", "1600"], ["--size", "9x9"], ["--range", "2,1"], ["--range", "fast"], ["--zoom", "0"], ["--fps", "-1"]],
)
def test_invalid_arguments_are_refused_with_a_remedy(run, words, capsys):
    with pytest.raises(SystemExit):
        main(["render", str(run), *words])
    assert "is not a " in capsys.readouterr().err


def test_without_the_extra_it_says_what_to_install(run, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    assert main(["render", str(run)]) == 2
    assert "pip install granflow[plot]" in capsys.readouterr().err


def test_vectors_are_shown_by_magnitude_or_component():
    arrays = {"velocity": np.array([[3.0, 4.0, 12.0]]), "radius": np.array([0.5])}
    assert values_of(arrays, "velocity")[0] == 13.0 and values_of(arrays, "velocity.z")[0] == 12.0
    for color, hint in (("velocty", "Did you mean velocity"), ("radius.x", "no such array"), ("velocity.w", "no such")):
        with pytest.raises(GranflowError, match=hint):
            values_of(arrays, color)


def test_the_range_holds_98_of_100_values_and_zero_if_near():
    values = np.arange(101.0)
    scale = scale_for("force", [values[:50], values[50:]], is_vector=True)
    assert scale.limits == (0.0, 99.0) and scale.out_of_range == (False, True)
    assert (scale.title, scale.unit) == ("force\nmagnitude", "N")
    narrow = scale_for("radius", [2e-3 + 1e-5 * values])
    assert narrow.limits == pytest.approx((2.01e-3, 2.99e-3)) and (narrow.unit, narrow.factor) == ("mm", 1e-3)
    signed = scale_for("velocity.z", [values - 10.0])
    assert signed.limits == (-89.0, 89.0)
    assert scale_for("radius", [values], limits=(1.0, 2.0)).limits == (1.0, 2.0)


@pytest.mark.parametrize("values", [[], [0.0], [0.4], [-0.4], [np.nan]])
def test_a_range_is_never_empty(values):
    low, high = scale_for("velocity", [np.array(values)]).limits
    assert low < high


def test_materials_and_groups_have_names():
    scale = scale_for("material", [np.array([1, 1, 3])], names={"material": ("glass", "steel")})
    assert scale.names == {1: "steel", 3: "material 3"}


@pytest.mark.parametrize(
    ("unit", "largest", "factor", "shown"),
    [("m", 2.8e-3, 1e-3, "mm"), ("N", 999.0, 1.0, "N"), ("N", 1000.0, 1e3, "kN"), ("kg", 0.5e-3, 1e-6, "mg"),
     ("kg", 2.0, 1.0, "kg"), ("m^2", 1e-6, 1.0, "m^2"), ("", 5.0, 1.0, ""), ("J", 0.0, 1.0, "J")],
)  # fmt: skip
def test_units_take_the_prefix_that_suits(unit, largest, factor, shown):
    assert prefixed(unit, largest) == (pytest.approx(factor), shown)


@pytest.mark.parametrize("words", [*VIEWS, "1,-2,0.8", "0,0,1", "0,0,-3"])
@pytest.mark.parametrize("aspect", [0.6, 1.8])
def test_everything_is_in_sight_and_fills_the_picture(words, aspect):
    """Every point projects into the picture, by the pinhole formula; the outermost come within 10 % of its edge."""
    points = corners_of(np.array([[-1.0, 2.0, 0.0], [1.0, 2.5, 4.0]]))
    view = view_of(words)
    camera = camera_for(view, points, aspect)
    seen = view.projected(points - camera.eye)
    half = -np.tan(0.5 * OPENING) * seen[:, 2:] if view.perspective else camera.half_height
    shares = np.abs(seen[:, :2] / half / [aspect, 1.0])
    assert 0.9 < shares.max() < 1.0
    assert np.all(seen[:, 2] < 0.0), "a point is behind the viewer"


def test_views_stand_where_their_names_say():
    assert view_of("front").toward.tolist() == [0, -1, 0] and view_of("front").right.tolist() == [1, 0, 0]
    assert view_of("side").toward.tolist() == [1, 0, 0] and view_of("side").right.tolist() == [0, 1, 0]
    assert view_of("top").toward.tolist() == [0, 0, 1] and view_of("top").right.tolist() == [1, 0, 0]
    sideways = view_of("front", gravity=np.array([0.1, -9.8, 0.0]))
    assert sideways.up.tolist() == [0, 1, 0] and sideways.right.tolist() == [1, 0, 0]
    assert aspect_of(view_of("front"), corners_of(np.array([[0.0, 0, 0], [3, 9, 1]]))) == 3.0


@pytest.mark.parametrize("words", ["behind", "1,2", "0,0,0", "1,nan,2"])
def test_other_views_are_refused(words):
    with pytest.raises(GranflowError, match="--view"):
        view_of(words)


def test_the_outermost_points_reach_as_far_as_the_spheres():
    particles = FrameParticles(np.array([[0.0, 0, 0], [2.0, 0, 0], [1.0, 0, 0]]), np.array([1.0, 0.5, 0.2]), {})
    points = outermost_points(particles)
    np.testing.assert_allclose(points.max(axis=0), [2.5, 1, 1])
    np.testing.assert_allclose(points.min(axis=0), [-1, -1, -1])


def test_the_time_has_digits_that_tell_frames_apart():
    assert [decimals_of(times) for times in ([0, 0.02, 0.04], [0, 1e-4, 2e-4, 3.1e-4], [5.0], [0.0], [0, 60, 120])] == [
        2,
        4,
        0,
        1,
        0,
    ]


# Run in a process of its own: where no picture can be drawn, VTK aborts instead of raising.
AREAS = """
import sys
import numpy as np
from granflow.study.render.camera import camera_for, view_of
from granflow.study.render.frames import FrameParticles
from granflow.study.render.renderer import Renderer
for words in ("front", "iso"):
    for radius in (0.07, 0.4):
        view = view_of(words)
        camera = camera_for(view, np.array([[-1.0, -1, -1], [1, 1, 1]]) * 0.7, 1.0)
        painter = Renderer((600, 600), camera)
        particles = FrameParticles(np.zeros((1, 3)), np.array([radius]), {})
        painter.set_particles(particles, np.array([[0, 0, 0]], np.uint8))
        share = np.mean(painter.draw().min(axis=2) < 128)
        distance = np.linalg.norm(camera.eye)
        seen = np.tan(np.arcsin(radius / distance)) / np.tan(np.radians(12))
        slope = seen if view.perspective else radius / camera.half_height
        print(share / (np.pi / 4 * slope**2))
"""


@pytest.mark.slow
@needs_plot
def test_spheres_cover_what_spheres_of_their_radius_do():
    """A sphere covers a disc of half angle asin(R / distance) in perspective, of radius R without."""
    run = subprocess.run([sys.executable, "-c", AREAS], capture_output=True, text=True, timeout=250)
    assert run.returncode == 0, run.stderr[-2000:]
    np.testing.assert_allclose([float(line) for line in run.stdout.split()], 1.0, atol=0.02)


@pytest.mark.slow
@needs_plot
@pytest.mark.parametrize(
    "words", [("--color", "group"), ("--chains",), ("--view", "top", "--cut", "--color", "velocity.z")]
)
def test_pictures_are_drawn(run, words):
    from PIL import Image

    out = run / "a.png"
    command = [sys.executable, "-m", "granflow", "render", str(run), "--out", str(out), "--size", "640x480", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stderr[-2000:]
    picture = np.asarray(Image.open(out))
    assert picture.shape == (480, 640, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100, "the picture is blank"


@pytest.mark.slow
@needs_plot
@pytest.mark.skipif(find_spec("imageio_ffmpeg") is None, reason="needs the plot extra")
def test_a_film_holds_every_frame(run):
    import imageio_ffmpeg

    command = [sys.executable, "-m", "granflow", "render", str(run), "--film", "--size", "640x480", "--fps", "4"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stderr[-2000:]
    film = run / "pictures" / "film_velocity_iso.mp4"
    assert imageio_ffmpeg.count_frames_and_secs(str(film)) == (4, pytest.approx(1.0, abs=0.05))
