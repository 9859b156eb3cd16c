"""VTK opens the series and renders each particle at its size. Slow; needs the plot extra or ParaView."""

import shutil
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest
from observers.snapshots import particles_of, snapshot_of, turned

from granflow.observers.frames import ParticleFrames, WallFrames

INTERVAL = 0.1
FRAME_COUNT = 4
FLOOR = (np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))

# Runs in a separate process: without a display, VTK aborts instead of raising.
PYVISTA = """
import sys
import numpy as np
import pyvista
out = sys.argv[1]
particles, walls = pyvista.PVDReader(out + "/particles.pvd"), pyvista.PVDReader(out + "/walls.pvd")
counts = []
for time in particles.time_values:
    particles.set_active_time_value(time)
    walls.set_active_time_value(time)
    mesh, wall = particles.read()[0], walls.read()[0]
    counts.append(mesh.n_points)
ball = pyvista.Sphere(radius=0.5, theta_resolution=60, phi_resolution=61)
balls = mesh.glyph(scale="diameter", orient=False, factor=1.0, geom=ball)
plotter = pyvista.Plotter(off_screen=True, window_size=(400, 300))
plotter.add_mesh(balls, scalars="kinetic_energy")
plotter.add_mesh(wall, opacity=0.3)
plotter.screenshot(out + "/picture.png")
print(particles.time_values, counts, list(np.round(balls.bounds, 2) + 0.0), sep=chr(10))
"""
PARAVIEW = """
import sys
from paraview.simple import *
out = sys.argv[1]
particles, walls = PVDReader(FileName=out + "/particles.pvd"), PVDReader(FileName=out + "/walls.pvd")
times = list(particles.TimestepValues)
counts = []
for time in times:
    particles.UpdatePipeline(time)
    walls.UpdatePipeline(time)
    counts.append(particles.GetDataInformation().GetNumberOfPoints())
balls = Glyph(Input=particles, GlyphType="Sphere")
balls.GlyphMode, balls.ScaleFactor = "All Points", 1.0
balls.ScaleArray, balls.OrientationArray = ["POINTS", "diameter"], ["POINTS", "No orientation array"]
balls.GlyphType.ThetaResolution, balls.GlyphType.PhiResolution = 60, 61
balls.UpdatePipeline(times[-1])
bounds = [round(bound, 2) + 0.0 for bound in balls.GetDataInformation().GetBounds()]
view = CreateRenderView(ViewSize=[400, 300])
GetAnimationScene().UpdateAnimationUsingDataTimeSteps()
GetAnimationScene().AnimationTime = times[-1]
Show(balls, view)
Show(walls, view).Opacity = 0.3
view.CameraPosition, view.CameraViewUp = [4, -3, 2], [0, 0, 1]
ResetCamera(view)
SaveScreenshot(out + "/picture.png", view)
print(times, counts, bounds, sep=chr(10))
"""


def write_series(path):
    """Writes an empty frame and three frames of 200 particles; returns the bounds of the particles in the
    last."""
    particles = ParticleFrames(path, INTERVAL, reach=1.0)
    walls = WallFrames(path, INTERVAL, {"floor": FLOOR, "gate": FLOOR})
    for k in range(FRAME_COUNT):
        arrays = particles_of(200 if k else 0, seed=k)
        arrays["radius"] = arrays["radius"] / 10
        poses = {"floor": turned(0.1 * k), "gate": turned(0, offset=(0, 0, k), present=k < 2)}
        snapshot = snapshot_of(time=k * INTERVAL, particles=arrays, walls=poses)
        particles.observe(snapshot)
        walls.observe(snapshot)
    low = (arrays["position"] - arrays["radius"][:, None]).min(axis=0)
    high = (arrays["position"] + arrays["radius"][:, None]).max(axis=0)
    return np.stack([low, high], axis=1).ravel()


def read_by(command, script, path):
    """Runs the script on the series; returns times, particle counts and bounds of the glyphs."""
    (path / "open.py").write_text(script)
    run = subprocess.run([*command, path / "open.py", path], capture_output=True, text=True, timeout=200)
    assert run.returncode == 0, run.stderr[-2000:]
    return [[float(word) for word in line.strip("[]").split(",")] for line in printed_lists(run.stdout)]


def printed_lists(text):
    return [
        line.replace("np.float64(", "").replace(")", "") for line in text.splitlines() if line.startswith("[")
    ]


def assert_shown(path, times, counts, bounds, expected):
    assert times == [k * INTERVAL for k in range(FRAME_COUNT)]
    assert counts == [0, 200, 200, 200]
    np.testing.assert_allclose(bounds, expected, atol=0.006)
    assert (path / "picture.png").stat().st_size > 5000, "the picture is blank"


@pytest.mark.slow
@pytest.mark.skipif(find_spec("pyvista") is None, reason="needs the plot extra")
def test_pyvista_renders_the_series(tmp_path):
    expected = write_series(tmp_path)
    assert_shown(tmp_path, *read_by([sys.executable], PYVISTA, tmp_path), expected)


@pytest.mark.slow
@pytest.mark.skipif(
    not shutil.which("pvbatch") or not shutil.which("xvfb-run"), reason="needs ParaView and xvfb"
)
def test_paraview_renders_the_series(tmp_path):
    expected = write_series(tmp_path)
    assert_shown(tmp_path, *read_by(["xvfb-run", "-a", "pvbatch"], PARAVIEW, tmp_path), expected)
