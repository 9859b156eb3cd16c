"""The heat map: every family a grid, every case a cell colored by its verdict and error. Needs the extra `plot`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from granflow.study.figures import draw_to
from granflow.study.stability.case_families import BOUNDS, MANY, SIZES, STEPS, STIFFNESS, UNEQUAL
from granflow.study.stability.cases import CaseOutcome, percent

HEIGHT = 13.5
SMALLEST, LARGEST = 1e-5, 1.0
"""Errors between which the colors run."""
REFUSED, DEFECT = (0.85, 0.85, 0.87), (0.80, 0.05, 0.10)
GREENS, OCHRES = "YlGn_r", "YlOrBr"

PANELS = ((STEPS, STEPS), (STIFFNESS, SIZES), (STIFFNESS, UNEQUAL), (MANY, MANY), (BOUNDS, BOUNDS))
"""Families by row of the figure; one named twice is that much larger."""
HEIGHTS = (3.4, 1.3, 1.3, 1.6, 4.2)

TITLES = {
    STEPS: "Restitution asked for (rows) at a time step over the largest allowed (columns)",
    STIFFNESS: "Young's modulus and velocity of impact, Eq. 12",
    SIZES: "Size and precision",
    UNEQUAL: "Unequal partners",
    MANY: "Many grains at once, three laws",
    BOUNDS: "Largest step at which nothing grows, over the step that the check allows (to be 1 to 2)",
}


def write_heatmap(path: Path, outcomes: Sequence[CaseOutcome]) -> None:
    """Draw all families. Raises GranflowError where matplotlib is not installed."""
    draw_to(path, lambda figure: _draw(figure, outcomes), HEIGHT)


def _draw(figure: Any, outcomes: Sequence[CaseOutcome]) -> None:
    from matplotlib.patches import Patch

    axes = figure.subplot_mosaic([list(row) for row in PANELS], height_ratios=HEIGHTS)
    for family, axis in axes.items():
        _panel(axis, [each for each in outcomes if each.family == family])
        axis.set_title(TITLES[family])
    colors = [(_color("accurate", 1e-4), "within 1 %"), (_color("error", 0.1), "stable, with the error said")]
    colors += [(REFUSED, "refused, with a message"), (DEFECT, "defect")]
    patches = [Patch(facecolor=color, edgecolor="0.4", linewidth=0.4, label=label) for color, label in colors]
    figure.legend(handles=patches, loc="outside lower center", ncols=4)


def _panel(axis: Any, outcomes: Sequence[CaseOutcome]) -> None:
    rows = list(dict.fromkeys(each.row for each in outcomes))
    columns = list(dict.fromkeys(each.column for each in outcomes))
    colors = np.ones((max(len(rows), 1), max(len(columns), 1), 3))
    for each in outcomes:
        place = rows.index(each.row), columns.index(each.column)
        colors[place] = _color(each.kind, each.error)
        axis.text(place[1], place[0], _words(each), ha="center", va="center", fontsize=5.5)
    axis.imshow(colors, aspect="auto", interpolation="nearest")
    axis.set_xticks(range(len(columns)), [_broken(column) for column in columns], fontsize=5.5)
    axis.set_yticks(range(len(rows)), rows, fontsize=6.0)
    axis.minorticks_off()
    axis.tick_params(length=0.0)


def _broken(label: str) -> str:
    """A label on two lines where it is long."""
    words, middle = label.split(" "), len(label) // 2
    if len(label) < 12 or len(words) == 1:
        return label
    cuts = range(1, len(words))
    cut = min(cuts, key=lambda n: abs(len(" ".join(words[:n])) - middle))
    return " ".join(words[:cut]) + "\n" + " ".join(words[cut:])


def _words(each: CaseOutcome) -> str:
    if each.kind == "refused" or not np.isfinite(each.error):
        return each.kind
    return f"{each.reached:.2f}" if each.family == BOUNDS else percent(each.error)


def _color(kind: str, error: float) -> Any:
    from matplotlib import colormaps

    if kind in ("refused", "defect"):
        return REFUSED if kind == "refused" else DEFECT
    share = np.log(np.clip(error, SMALLEST, LARGEST) / SMALLEST) / np.log(LARGEST / SMALLEST)
    if kind == "accurate":
        return colormaps[GREENS](0.45 + 0.5 * share)[:3]
    return colormaps[OCHRES](0.7 * share - 0.2)[:3]
