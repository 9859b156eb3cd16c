"""Script for ParaView and pvpython that shows the PVD files of all variants side by side.

The script finds the files at their absolute path, or in its directory if they were moved together.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from granflow.load import Scene
from granflow.studies.compare.runs import VariantRun

SCRIPT = "side_by_side.py"
"""Name of the script."""

GAP = 0.25
"""Gap between two variants, over the width of the domain."""

_TEXT = '''\
"""{title}: {names}, from left to right.

In ParaView: File > Load State, and select this file. For an image: pvpython {script} picture.png [TIME]
"""

import sys
from pathlib import Path

from paraview.simple import *

HERE = Path({directory!r})
if not HERE.exists() and "__file__" in globals():  # the script and its directories were moved
    HERE = Path(__file__).resolve().parent
SHIFT = {shift!r}  # offset between successive variants [m]
NAMES = {names_by_key!r}

view = GetActiveViewOrCreate("RenderView")
view.Background = [1, 1, 1]
view.UseColorPaletteForBackground = 0
view.OrientationAxesVisibility = 0
picture = sys.argv[1] if len(sys.argv) > 1 and sys.argv[1].endswith(".png") else None
if picture:
    view.ViewSize = [1800, 900]
for number, (key, name) in enumerate(NAMES.items()):
    offset = [number * each for each in SHIFT]
    particles = Transform(Input=PVDReader(FileName=str(HERE / key / "particles.pvd")))
    particles.Transform.Translate = offset
    speed = Calculator(Input=particles)
    speed.ResultArrayName, speed.Function = "speed", "mag(velocity)"
    spheres = Show(speed, view)
    spheres.SetRepresentationType("Point Gaussian")
    spheres.ScaleByArray, spheres.GaussianRadius = 1, 1.0
    spheres.SetScaleArray = ["POINTS", "radius"]
    spheres.ScaleTransferFunction = "PiecewiseFunction"
    spheres.UseScaleFunction = 0
    ColorBy(spheres, ("POINTS", "speed"))
    colors = GetColorTransferFunction("speed")
    colors.ApplyPreset("Viridis (matplotlib)", True)
    colors.RescaleTransferFunction(0.0, {speed!r})
    if (HERE / key / "walls.pvd").exists():
        walls = Transform(Input=PVDReader(FileName=str(HERE / key / "walls.pvd")))
        walls.Transform.Translate = offset
        surface = Show(walls, view)
        surface.Opacity, surface.DiffuseColor, surface.AmbientColor = 0.12, [0.4, 0.4, 0.4], [0.4, 0.4, 0.4]
    label = Show(Text(Text=name), view)
    label.TextPropMode = "Billboard 3D Text"
    label.BillboardPosition = [a + b for a, b in zip({top!r}, offset)]
    label.Justification, label.Color, label.FontSize = "Center", [0, 0, 0], 16

spheres.SetScalarBarVisibility(view, True)
bar = GetScalarBar(colors, view)
bar.Title, bar.ComponentTitle, bar.TitleColor, bar.LabelColor = "speed (m/s)", "", [0, 0, 0], [0, 0, 0]
scene = GetAnimationScene()
scene.UpdateAnimationUsingDataTimeSteps()
scene.GoToFirst()
ResetCamera(view)
camera = GetActiveCamera()
focus, distance = camera.GetFocalPoint(), camera.GetDistance()
view_axis, up = {view_axis!r}, {up!r}
camera.SetPosition(*(a + distance * b for a, b in zip(focus, view_axis)))
camera.SetViewUp(*up)
ResetCamera(view)
camera.Zoom(1.3)
Render(view)
if picture:
    times = list(scene.TimeKeeper.TimestepValues)
    scene.AnimationTime = float(sys.argv[2]) if len(sys.argv) > 2 else times[len(times) // 2]
    SaveScreenshot(picture, view, ImageResolution=[1800, 900])
'''
"""Text of the script with placeholders for `str.format`."""


def write_script(out: Path, scene: Scene, runs: Sequence[VariantRun], speed: float) -> Path:
    """Write the script into `out` and return its path; `speed` [m/s] is the upper end of the color scale.

    The variants are shifted along the horizontal axis by the width of the domain plus a gap.
    """
    low, high = np.array(scene.domain.min), np.array(scene.domain.max)
    up = -np.array(scene.gravity, dtype=float)
    vertical = int(np.argmax(np.abs(up))) if up.any() else 2
    horizontal = 0 if vertical != 0 else 1
    depth = 3 - vertical - horizontal
    shift, axis, view_axis = np.zeros(3), np.zeros(3), np.zeros(3)
    shift[horizontal] = (1.0 + GAP) * (high - low)[horizontal]
    axis[vertical] = 1.0 if up[vertical] >= 0.0 else -1.0
    view_axis[depth] = -1.0 if (horizontal, vertical, depth) == (0, 2, 1) else 1.0
    top = 0.5 * (low + high)
    top[vertical] = high[vertical] if axis[vertical] > 0.0 else low[vertical]
    path = out / SCRIPT
    names = {run.variant.key: run.variant.title + (" (aborted)" if run.stopped else "") for run in runs}
    path.write_text(
        _TEXT.format(
            title=scene.title.replace('"', "'"),
            names=", ".join(names.values()),
            script=SCRIPT,
            directory=str(out.resolve()),
            shift=shift.tolist(),
            names_by_key=names,
            speed=speed,
            top=top.tolist(),
            view_axis=view_axis.tolist(),
            up=axis.tolist(),
        ),
        encoding="utf-8",
    )
    return path
