"""The legend strip on the right of a picture: time and color scale, outside the view of the particles."""

from collections.abc import Mapping
from textwrap import wrap
from typing import Any

import numpy as np

from granflow.studies.figures import COLORS, styled_figure
from granflow.studies.render.colors import Scale, prefixed

DPI = 100
"""Dots per inch; font sizes are proportional to the height of the picture."""

WIDTH = 0.27
"""Width of the strip over the height of the picture; all lengths below are relative to that height as well."""

LETTERS = 0.03
"""Font size over the height of the picture."""

TITLE_LETTERS = 13
"""Maximum number of characters in a line of the title."""

BAR = (0.12, 0.16, 0.17, 0.52)
"""Left, bottom, width and height of the color bar, relative to the strip."""

SCALE_BAR = (0.76, 0.055)
"""Largest length of the scale bar and its height above the bottom, relative to the strip."""

NO_VALUE = (0.6, 0.6, 0.6)
"""Color of nan (red, green, blue; 0 to 1)."""


def colors_of(values: np.ndarray, scale: Scale) -> np.ndarray:
    """Colors (n, 3) uint8 of values (n,) [SI]; gray for nan. Values outside the limits get the color of the limit."""
    from matplotlib import colormaps, colors

    if scale.names is not None:
        wheel = np.array([colors.to_rgb(color) for color in COLORS])
        shown = wheel[values.astype(np.int64) % len(wheel)]
    else:
        low, high = scale.limits
        shown = colormaps[scale.map_name](np.clip((values - low) / (high - low), 0.0, 1.0))[:, :3]
        shown[~np.isfinite(values)] = NO_VALUE
    return np.round(255.0 * shown).astype(np.uint8)


def legend_strip(scale: Scale, time: str, height: int, shown_height: float, speed: str = "") -> np.ndarray:
    """The strip as an image (height, width, 3), 0 to 255.

    `time`, `speed`: text at the top; `height` [pixels]; the width is WIDTH times the height. `shown_height` [m]: length
    that the height of the picture shows, for the scale bar.
    """
    letters = LETTERS * height * 72.0 / DPI
    size = (WIDTH * height / DPI, height / DPI)
    with styled_figure(size, {"font.size": letters}, dpi=DPI, facecolor="white") as figure:
        figure.text(BAR[0], 0.96, time, va="top", fontsize=1.15 * letters)
        figure.text(BAR[0], 0.91, speed, va="top", fontsize=0.9 * letters)
        _scale_bar(figure, shown_height, letters)
        title = "\n".join(_title_lines(scale))
        figure.text(BAR[0], BAR[1] + BAR[3] + 0.025, title, va="bottom", linespacing=1.15)
        _legend(figure, scale.names, letters) if scale.names is not None else _bar(figure, scale, letters)
        figure.canvas.draw()
        return np.asarray(figure.canvas.buffer_rgba())[:, :, :3].copy()


def _title_lines(scale: Scale) -> list[str]:
    lines = [part for line in scale.title.split("\n") for part in wrap(line, TITLE_LETTERS)]
    return [*lines, f"({scale.unit})"] if scale.unit else lines


def _bar(figure: Any, scale: Scale, letters: float) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    low, high = (limit / scale.factor for limit in scale.limits)
    ends = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
    bar = figure.colorbar(
        ScalarMappable(Normalize(low, high), scale.map_name), cax=figure.add_axes(BAR), extend=ends[scale.out_of_range]
    )
    bar.ax.locator_params(nbins=6)
    bar.ax.minorticks_off()
    bar.ax.tick_params(labelsize=letters, width=0.04 * letters, length=0.3 * letters, pad=0.25 * letters)
    bar.outline.set_linewidth(0.04 * letters)


def round_length(largest: float) -> float:
    """Largest of the lengths 1, 2 and 5 times a power of ten that is at most `largest` [m]."""
    power = 10.0 ** np.floor(np.log10(largest) + 1e-9)
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= largest * (1.0 + 1e-9)))


def _scale_bar(figure: Any, shown_height: float, letters: float) -> None:
    """A horizontal bar of a round length with its label."""
    from matplotlib.lines import Line2D

    length = round_length(SCALE_BAR[0] * WIDTH * shown_height)
    factor, unit = prefixed("m", length)
    right, bottom = BAR[0] + length / (WIDTH * shown_height), SCALE_BAR[1]
    line: dict[str, Any] = {"color": "black", "linewidth": 0.09 * letters, "marker": "|", "markersize": 0.5 * letters}
    figure.add_artist(Line2D([BAR[0], right], [bottom, bottom], **line))
    figure.text(BAR[0], bottom + 0.015, f"{length / factor:g} {unit}", va="bottom", fontsize=0.9 * letters)


def _legend(figure: Any, names: Mapping[int, str], letters: float) -> None:
    """A colored dot and a name for each material or group, as many as fit."""
    line = 1.5 * letters / (72.0 * figure.get_figheight())
    for row, (number, name) in enumerate(list(names.items())[: int(BAR[3] / line)]):
        height, color = BAR[1] + BAR[3] - (row + 0.5) * line, COLORS[number % len(COLORS)]
        figure.text(BAR[0], height, "\N{BLACK CIRCLE}", color=color, va="center", family="DejaVu Sans")
        figure.text(BAR[0] + 0.13, height, name, va="center")
