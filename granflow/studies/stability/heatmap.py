"""Heat map: one grid per family, one cell per case, colored by assessment and error.

Requires the extra `plot`.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from granflow.studies.figures import FULL_WIDTH, Drawing
from granflow.studies.stability.case_families import BOUNDS, MANY, SIZES, STEPS, STIFFNESS, UNEQUAL
from granflow.studies.stability.cases import CaseOutcome
from granflow.studies.tables import percent

SMALLEST, LARGEST = 1e-5, 1.0
"""Range of errors of the color scale."""
REFUSED, DEFECT = (0.85, 0.85, 0.87), (0.80, 0.05, 0.10)
"""Colors of refused cases and of defects (red, green, blue; 0 to 1)."""

GREENS, OCHRES = "YlGn_r", "YlOrBr"
"""Color maps of accurate cases and of cases with an error."""


PANELS = ((STEPS, STEPS), (STIFFNESS, SIZES), (STIFFNESS, UNEQUAL), (MANY, MANY), (BOUNDS, BOUNDS))
"""Families by row of the figure; a repeated family spans two columns."""
HEIGHTS = (3.4, 1.3, 1.3, 1.6, 4.2)
"""Relative heights of the rows of panels."""


TITLES = {
    STEPS: "Target restitution (rows) against time step over the largest permitted one (columns)",
    STIFFNESS: "Young's modulus and impact velocity, Eq. 12",
    SIZES: "Size and precision",
    UNEQUAL: "Unequal partners",
    MANY: "Many particles, three contact models",
    BOUNDS: "Measured stability limit of the time step over the limit of the check (required: 1 to 2)",
}
"""Titles of the panels by family."""


def heatmap(outcomes: Sequence[CaseOutcome]) -> Drawing:
    """Drawing of all families."""
    return Drawing(lambda figure: _draw(figure, outcomes), 8.6, FULL_WIDTH)


def _draw(figure: Any, outcomes: Sequence[CaseOutcome]) -> None:
    """Draw one panel per family, and the legend."""
    from matplotlib.patches import Patch

    axes = figure.subplot_mosaic([list(row) for row in PANELS], height_ratios=HEIGHTS)
    for family, axis in axes.items():
        _panel(axis, [each for each in outcomes if each.family == family])
        axis.set_title(TITLES[family])
    colors = [(_color("accurate", 1e-4), "within 1 %"), (_color("error", 0.1), "stable, error reported")]
    colors += [(REFUSED, "refused with a message"), (DEFECT, "defect")]
    patches = [Patch(facecolor=color, edgecolor="0.4", linewidth=0.4, label=label) for color, label in colors]
    figure.legend(handles=patches, loc="outside lower center", ncols=4)


def _panel(axis: Any, outcomes: Sequence[CaseOutcome]) -> None:
    """Draw the grid of one family with one cell per case."""
    rows = list(dict.fromkeys(each.row for each in outcomes))
    columns = list(dict.fromkeys(each.column for each in outcomes))
    colors = np.ones((max(len(rows), 1), max(len(columns), 1), 3))
    for each in outcomes:
        cell = rows.index(each.row), columns.index(each.column)
        colors[cell] = _color(each.kind, each.error)
        axis.text(cell[1], cell[0], _cell_text(each), ha="center", va="center", fontsize=5.5)
    axis.imshow(colors, aspect="auto", interpolation="nearest")
    axis.set_xticks(range(len(columns)), [_split(column) for column in columns], fontsize=5.5)
    axis.set_yticks(range(len(rows)), rows, fontsize=6.0)
    axis.minorticks_off()
    axis.tick_params(length=0.0)


def _split(label: str) -> str:
    """Split a long label into two lines."""
    words, middle = label.split(" "), len(label) // 2
    if len(label) < 12 or len(words) == 1:
        return label
    cuts = range(1, len(words))
    cut = min(cuts, key=lambda n: abs(len(" ".join(words[:n])) - middle))
    return " ".join(words[:cut]) + "\n" + " ".join(words[cut:])


def _cell_text(each: CaseOutcome) -> str:
    """Text of a cell: ratio of stability limits, error, or kind of assessment."""
    if each.kind == "refused" or not np.isfinite(each.error):
        return each.kind
    return f"{each.reached:.2f}" if each.family == BOUNDS else percent(each.error)


def _color(kind: str, error: float) -> Any:
    """Color of a cell by kind of assessment and error."""
    from matplotlib import colormaps

    if kind in ("refused", "defect"):
        return REFUSED if kind == "refused" else DEFECT
    share = np.log(np.clip(error, SMALLEST, LARGEST) / SMALLEST) / np.log(LARGEST / SMALLEST)
    if kind == "accurate":
        return colormaps[GREENS](0.45 + 0.5 * share)[:3]
    return colormaps[OCHRES](0.7 * share - 0.2)[:3]
