"""Fields on grids (`output.fields`) in the page: profiles along a grid of one row of cells, tables of other grids."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granflow.fields import FIELD_QUANTITIES
from granflow.io.frame_reader import listed_frames, read_mesh
from granflow.studies.figures import COLORS
from granflow.studies.report.plots import Plot, curve_layout, plain
from granflow.studies.tables import PageTable
from granflow.visible_text import readable

PROFILES = 4
"""Maximum number of frames in the plot of a profile: evenly spaced, including the last one."""

AXES = ("x", "y", "z")


class GridFrame(NamedTuple):
    """One frame of fields: time [s], centers of the cells (k, 3) [m], and arrays (k,) by name."""

    time: float
    centers: np.ndarray
    values: Mapping[str, np.ndarray]


def field_content(directory: Path, with_plots: bool) -> tuple[list[PageTable], list[Plot]]:
    """Tables and plots of all fields of a run.

    A grid with several cells along one axis only has plots of its last frames, unless `with_plots` is False; another
    has a table of its last frame. Raises GranflowError if a file cannot be read.
    """
    tables, plots = [], []
    for listing in sorted(directory.glob("fields_*.pvd")):
        series = listed_frames(directory, listing.stem)
        chosen = np.unique(np.linspace(0, len(series) - 1, PROFILES + 1).astype(int)[1:]) if series else ()
        frames = [_frame(*series[k]) for k in chosen]
        name = listing.stem.removeprefix("fields_")
        axes = [axis for axis in range(3) if frames and np.ptp(frames[-1].centers[:, axis]) > 0.0]
        if len(axes) == 1 and with_plots:
            plots += [_profile(name, quantity, axes[0], frames) for quantity in frames[-1].values]
        elif frames:
            tables.append(_range_table(name, frames[-1]))
    return tables, plots


def _frame(time: float, path: Path) -> GridFrame:
    """Frame of a file; vectors and tensors by their magnitude."""
    mesh = read_mesh(path)
    centers = np.concatenate([np.zeros((0, 3)), *(mesh.points[block.data].mean(axis=1) for block in mesh.cells)])
    arrays = {name: np.concatenate(parts) for name, parts in mesh.cell_data.items()}
    scalars = {name: np.linalg.norm(each, axis=1) if each.ndim == 2 else each for name, each in arrays.items()}
    return GridFrame(time, centers, scalars)


def _title(quantity: str) -> tuple[str, str]:
    """Name of a field for display, and its unit in parentheses."""
    known = FIELD_QUANTITIES.get(quantity)
    unit = f" ({known.unit})" if known and known.unit != "1" else ""
    return quantity.replace("_", " ") + (", magnitude" if known and known.kind != "scalar" else ""), unit


def _profile(name: str, quantity: str, axis: int, frames: Sequence[GridFrame]) -> Plot:
    """Plot of one field along one axis, a curve for each frame."""
    title, unit = _title(quantity)
    curves: list[dict[str, Any]] = []
    for frame in frames:
        order = np.argsort(frame.centers[:, axis])
        values = frame.values[quantity][order]
        is_number = np.isfinite(values)
        curves.append(
            {"type": "scatter", "mode": "lines", "name": f"{frame.time:.4g} s", "y": plain(values[is_number]),
             "x": plain(frame.centers[order, axis][is_number]), "line": {"color": COLORS[len(curves) % len(COLORS)]}}
        )  # fmt: skip
    layout = curve_layout(f"{AXES[axis]} (m)", title + unit, len(curves) > 1)
    return Plot(f"Field {name}: {title}{unit} over {AXES[axis]}", {"data": curves, "layout": layout})


def _range_table(name: str, frame: GridFrame) -> PageTable:
    """Smallest, mean and largest value of each field over the cells; cells without a number are left out."""
    rows = []
    for quantity, values in frame.values.items():
        finite = values[np.isfinite(values)]
        numbers = (finite.min(), finite.mean(), finite.max()) if len(finite) else ()
        rows.append(["".join(_title(quantity)), *(readable(float(number)) for number in numbers)])
    caption = f"Field {name} at {frame.time:.4g} s over {len(frame.centers)} cells; fields_{name}.pvd has all frames."
    return PageTable(("", "smallest", "mean", "largest"), [row for row in rows if row[1:]], caption)
