"""Collisions by impact energy (`output.collision_energies`) in the page: a plot of their numbers, and a table."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from granflow.io.collision_energies import FILE, collision_table
from granflow.io.tables import read_table
from granflow.studies.figures import COLORS
from granflow.studies.report.plots import Plot, curve_layout, plain
from granflow.studies.report.topics import Topic
from granflow.studies.tables import PageTable
from granflow.visible_text import readable

TITLE = "Collisions by impact energy"


def collision_topics(directory: Path, with_plots: bool) -> Iterator[Topic]:
    """The section on the collisions of a run since its start; none without `output.collision_energies`.

    Raises GranflowError if the file cannot be read.
    """
    path = directory / FILE
    table = read_table(path) if path.exists() else None
    collisions = None if table is None else collision_table(table)
    if collisions is None:
        return
    total = {kind: counts[-1] for kind, counts in collisions.totals.items()}
    rows = [
        (f"{low:.3g} to {high:.3g} J", *(readable(float(counts[row])) for counts in total.values()))
        for row, (low, high) in enumerate(collisions.edges)
        if any(counts[row] for counts in total.values())
    ]
    caption = "Contacts that began since the start of the run, by impact energy; classes without collisions are absent."
    heads = ("impact energy", *(f"with a {kind}" for kind in total))
    plots = [Plot(TITLE, _figure(collisions.energy, total))] if with_plots else []
    yield Topic(TITLE, (), [], plots, (PageTable(heads, rows, caption),))


def _figure(energy: np.ndarray, total: dict[str, np.ndarray]) -> dict[str, Any]:
    """Numbers of collisions over the centers of their classes, both logarithmic, in the format of plotly."""
    known = np.isfinite(energy)
    curves = [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "name": f"with a {kind}",
            "x": plain(energy[known]),
            "y": [count or None for count in plain(counts[known])],
            "line": {"color": color, "width": 1.8},
        }
        for color, (kind, counts) in zip(COLORS, total.items(), strict=False)
    ]
    layout = curve_layout("impact energy (J)", "collisions per class", True)
    for axis in ("xaxis", "yaxis"):
        layout[axis] = layout[axis] | {"type": "log", "exponentformat": "power"}
    return {"data": curves, "layout": layout}
