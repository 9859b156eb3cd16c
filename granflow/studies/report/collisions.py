"""Collisions by impact energy (`output.collision_energies`) in the page: a plot of their numbers, and a table."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from granflow.io.tables import Table, read_table
from granflow.studies.figures import COLORS
from granflow.studies.report.plots import Plot, curve_layout, plain
from granflow.studies.report.topics import Topic
from granflow.studies.tables import PageTable
from granflow.visible_text import readable

FILE = "collision_energies.csv"
TITLE = "Collisions by impact energy"


def collision_topics(directory: Path, with_plots: bool) -> Iterator[Topic]:
    """The section on the collisions of a run since its start; none without `output.collision_energies`.

    Raises GranflowError if the file cannot be read.
    """
    path = directory / FILE
    table = read_table(path) if path.exists() else None
    if table is None or not table.complete().rows:
        return
    numbers = _numbers_at_end(table.complete())
    kinds = list(numbers)
    edges = next(iter(numbers.values()))[0]
    rows = [
        (f"{low:.3g} to {high:.3g} J", *(readable(float(numbers[kind][1][row])) for kind in kinds))
        for row, (low, high) in enumerate(edges)
        if any(numbers[kind][1][row] for kind in kinds)
    ]
    caption = "Contacts that began since the start of the run, by impact energy; classes without collisions are absent."
    heads = ("impact energy", *(f"with a {kind}" for kind in kinds))
    plots = [Plot(TITLE, _figure(numbers))] if with_plots else []
    yield Topic(TITLE, (), [], plots, (PageTable(heads, rows, caption),))


def _numbers_at_end(table: Table) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Edges (n, 2) [J] and numbers of collisions (n,) since the start, in the last interval, by kind of contact."""
    end, low, high, total = (
        table.numbers(table.names.index(name))
        for name in ("time_end [s]", "energy_min [J]", "energy_max [J]", "count_total")
    )
    kind, last = np.array(table.texts(table.names.index("contact"))), end == end[-1]
    return {
        str(each): (np.stack([low, high], axis=1)[last & (kind == each)], total[last & (kind == each)])
        for each in dict.fromkeys(kind[last].tolist())
    }


def _figure(numbers: dict[str, tuple[np.ndarray, np.ndarray]]) -> dict[str, Any]:
    """Numbers of collisions over the centers of their classes, both logarithmic, in the format of plotly."""
    curves = []
    for color, (kind, (edges, counts)) in zip(COLORS, numbers.items(), strict=False):
        inner = slice(1, -1)  # the first and the last class have an open end
        curves.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "name": f"with a {kind}",
                "x": plain(np.sqrt(edges[inner, 0] * edges[inner, 1])),
                "y": [count or None for count in plain(counts[inner])],
                "line": {"color": color, "width": 1.8},
            }
        )
    layout = curve_layout("impact energy (J)", "collisions per class", True)
    for axis in ("xaxis", "yaxis"):
        layout[axis] = layout[axis] | {"type": "log", "exponentformat": "power"}
    return {"data": curves, "layout": layout}
