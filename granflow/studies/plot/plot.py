"""Files of `granflow plot`: an image by matplotlib, or a page with interactive plots by plotly."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from granflow.errors import GranflowError
from granflow.studies.figures import COLORS, FULL_WIDTH, draw_to, stacked_panels
from granflow.studies.page import write_page
from granflow.studies.plot.curves import Panel
from granflow.studies.report.plots import DASHES, Plot, curve_layout, escaped, library, plain
from granflow.studies.report.series import thinned
from granflow.visible_text import visible

IMAGES = (".png", ".svg", ".pdf")
"""File types that matplotlib writes."""

PANEL_HEIGHT = 3.2
"""Height of a panel in an image [inch]."""

LINE_STYLES = ("-", "--")
"""Line styles of an image: one for each repetition of the colors."""


def default_path(source: Path, x: str, y: Sequence[str]) -> Path:
    """File for the plot of these quantities in the directory of the first source."""
    folder = source if source.is_dir() else source.parent
    name = re.sub(r"[^\w.]+", "_", f"{'_'.join(y)}_over_{x}").strip("_")
    return folder / f"plot_{name[:100]}.png"


def write_plot(path: Path, panels: Sequence[Panel], logarithmic: str, title: str) -> None:
    """Write the panels, one below the other, as an image or, if the file type is .html, as an interactive page.

    `logarithmic`: axes with a logarithmic scale: "", "x", "y" or "xy"; `title`: of a page.
    Raises GranflowError for another file type, for a logarithmic axis without positive values, or if the library is not
    installed.
    """
    if path.suffix not in (*IMAGES, ".html"):
        types = ", ".join((*IMAGES, ".html"))
        raise GranflowError(f"--out {path} is not of a supported type; the name must end in one of {types}.")
    for axis in logarithmic:
        _refuse_without_positive(panels, axis)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".html":
        _write_page(path, panels, logarithmic, title)
    else:
        draw_to(path, lambda figure: _draw(figure, panels, logarithmic), PANEL_HEIGHT * len(panels), FULL_WIDTH)


def _refuse_without_positive(panels: Sequence[Panel], axis: str) -> None:
    """Raise GranflowError for a panel without a positive value along a logarithmic `axis`, x or y."""
    for panel in panels:
        values = np.concatenate([getattr(curve, axis) for curve in panel.curves])
        if not (values > 0.0).any():
            title = getattr(panel, f"{axis}_title")
            raise GranflowError(f"--log {axis} needs positive values, but {title} has none: omit --log {axis}.")


def _draw(figure: Any, panels: Sequence[Panel], logarithmic: str) -> None:
    """Draw the panels on an empty matplotlib figure."""
    for panel, axes in zip(panels, stacked_panels(figure, len(panels), sharex=True), strict=True):
        for number, curve in enumerate(panel.curves):
            look = {"color": COLORS[number % len(COLORS)], "linestyle": LINE_STYLES[number // len(COLORS)]}
            point = {"marker": "o", "markersize": 3.0} if len(curve.x) == 1 else {}
            axes.plot(curve.x, curve.y, label=_without_formulas(curve.name), **look, **point)
        axes.set_xlabel(_without_formulas(panel.x_title))
        axes.tick_params(labelbottom=True)
        axes.set_ylabel(_without_formulas(panel.y_title))
        for axis in logarithmic:
            getattr(axes, f"set_{axis}scale")("log")
        if len(panel.curves) > 1:
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _without_formulas(text: str) -> str:
    """Text for matplotlib, which reads text between dollar signs as a formula."""
    return visible(text).replace("$", r"\$")


def _write_page(path: Path, panels: Sequence[Panel], logarithmic: str, title: str) -> None:
    """Write a page with an interactive plot for each panel."""
    script = library()
    if not script:
        raise GranflowError("Interactive plots require plotly, which is not installed: pip install plotly")
    plots = [_plot(panel, logarithmic) for panel in panels]
    if "x" not in logarithmic:
        _share_x(plots, np.concatenate([curve.x for panel in panels for curve in panel.curves]))
    write_page(path, "plot.html", plotly=script, title=title, plots=plots)


def _share_x(plots: Sequence[Plot], x: np.ndarray) -> None:
    """Give all plots the range of x, since curves may begin late or end early."""
    known = x[np.isfinite(x)]
    if len(known) and known.min() < known.max():
        for plot in plots:
            plot.figure["layout"]["xaxis"]["range"] = [float(known.min()), float(known.max())]


def _plot(panel: Panel, logarithmic: str) -> Plot:
    """A panel in the format of plotly."""
    data = []
    for number, curve in enumerate(panel.curves):
        known = np.isfinite(curve.x)
        x, y = thinned(curve.x[known], curve.y[known])
        color, dash = COLORS[number % len(COLORS)], DASHES[number // len(COLORS)]
        data.append(
            {"type": "scatter", "mode": "lines" if len(x) > 1 else "markers", "name": escaped(visible(curve.name)),
             "x": plain(x), "y": plain(y),
             "line": {"color": color, "width": 1.8, "dash": dash}}
        )  # fmt: skip
    x_title, y_title = escaped(visible(panel.x_title)), escaped(visible(panel.y_title))
    layout = curve_layout(x_title, y_title, len(data) > 1) | {"hovermode": "closest", "height": 460}
    for axis in logarithmic:
        layout[f"{axis}axis"]["type"] = "log"
    return Plot(f"{panel.y_title} over {panel.x_title}", {"data": data, "layout": layout})
