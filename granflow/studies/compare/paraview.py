"""Script for ParaView and pvpython that shows the PVD files of all variants side by side.

The script finds the files at their absolute path, or in its directory if they were moved together.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from granflow import Scene
from granflow.studies.compare.runs import VariantRun
from granflow.studies.page import write_page

SCRIPT = "side_by_side.py"
"""Name of the script."""

GAP = 0.25
"""Gap between two variants, over the width of the domain."""


def write_script(out: Path, scene: Scene, runs: Sequence[VariantRun], speed: float) -> None:
    """Write the script into `out`; `speed` [m/s] is the upper end of the color scale.

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
    write_page(
        out / SCRIPT,
        "side_by_side.py.jinja",
        title=scene.title.replace('"', "'"),
        names={run.variant.key: run.variant.title + (" (aborted)" if run.stopped else "") for run in runs},
        script=SCRIPT,
        directory=str(out.resolve()),
        shift=shift.tolist(),
        speed=speed,
        top=top.tolist(),
        view_axis=view_axis.tolist(),
        up=axis.tolist(),
    )
