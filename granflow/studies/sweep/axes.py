"""Layout and parts that the interactive plots of sweeps and calibrations share, in the format of plotly."""

from collections.abc import Sequence
from math import isfinite
from typing import Any

from granflow.studies.report.plots import AXIS, LEGEND, STANDOFF
from granflow.visible_text import distinct_endings

FONT = {"family": "system-ui, sans-serif", "size": 13}

COLOR_SCALE = "Viridis"

CELL_WIDTH, GAP = 1.0, 0.28
"""Width of a plot in a row of plots, and of the gap between two, in the same unit."""


def layout(height: int, **more: Any) -> dict[str, Any]:
    """Layout of a plot with the style of all pages; `height` [pixels]."""
    return {
        "height": height, "margin": {"l": 70, "r": 20, "t": 30, "b": 55}, "font": FONT,
        "showlegend": False, "legend": LEGEND, "hovermode": "closest",
        **more,
    }  # fmt: skip


def axis(title: str, **more: Any) -> dict[str, Any]:
    """An axis with a title."""
    return {
        **AXIS,
        "title": {"text": title, "standoff": STANDOFF},
        "exponentformat": "power",
        "automargin": True,
        **more,
    }


def row_of_axes(titles: Sequence[str], y_title: str) -> dict[str, Any]:
    """Axes of plots side by side: xaxis, yaxis, xaxis2, yaxis2, ...; the first one has the title `y_title`."""
    count = len(titles)
    unit = 1.0 / (count * CELL_WIDTH + (count - 1) * GAP)
    axes: dict[str, Any] = {}
    for k, title in enumerate(titles):
        start, number = k * (CELL_WIDTH + GAP) * unit, str(k + 1) if k else ""
        axes[f"xaxis{number}"] = axis(title, domain=[start, min(start + CELL_WIDTH * unit, 1.0)], anchor=f"y{number}")
        axes[f"yaxis{number}"] = axis("" if k else y_title, anchor=f"x{number}", **({"matches": "y"} if k else {}))
    return axes


def plain(value: Any, digits: int = 6) -> Any:
    """A number with few digits for the page, None if it is not finite; other values as text."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    return float(f"{value:.{digits}g}") if isfinite(value) else None


def level_text(value: Any, digits: int = 6) -> str:
    """Text of a value of a parameter: 18 for the float 18.0, and other values as they are."""
    number = plain(value, digits)
    return f"{number:.{digits}g}" if isinstance(number, int | float) else str(value)


def short_names(names: Sequence[str]) -> dict[str, str]:
    """Short name of each parameter for an axis: the last two keys of its path, or as many as make all different."""
    endings = distinct_endings([name.split(".") for name in names], least=2)
    return {name: ".".join(parts) for name, parts in zip(names, endings, strict=True)}
