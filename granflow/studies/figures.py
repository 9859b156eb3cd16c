"""Figures and tables of all studies: style and output of matplotlib, CSV files, and the table of a page.

Figures require the extra `plot`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granflow.errors import GranflowError
from granflow.io.files import replacing
from granflow.io.tables import write_table

# Figures

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8C6D31", "#7F7F7F")
"""Colors distinguishable for color-blind readers and in gray (Okabe & Ito 2008, plus two)."""
COLOR_NAMES = dict(
    zip(
        ("blue", "red", "green", "pink", "orange", "lightblue", "black", "brown", "gray"), COLORS, strict=True
    )
)
"""Colors by the name of a group or material that is called like a color."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">")
"""Markers by index of the series."""
POINTS = {"linestyle": "none", "markersize": 4.0, "markerfacecolor": "white", "markeredgewidth": 0.9}
"""Style of simulated points: open markers without a line."""
WIDTH = 4.5
"""Width of a figure [inch]: on a screen of 400 pixels, letters of 9 points then have a size of 10 pixels."""
FULL_WIDTH = 6.7
"""Width of a figure with many columns [inch]: two journal columns."""
RESOLUTION = 300
"""Resolution of a figure [dots per inch]."""
STYLE: dict[str, Any] = {
    "font.family": "serif",
    "font.serif": ["STIXGeneral", "Times New Roman", "DejaVu Serif"],
    "mathtext.fontset": "stix",
    "font.size": 9.0,
    "axes.linewidth": 0.6,
    "axes.labelsize": 9.5,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "legend.handlelength": 2.2,
    "lines.linewidth": 1.1,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.top": True,
    "ytick.right": True,
    "xtick.minor.visible": True,
    "ytick.minor.visible": True,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "savefig.bbox": "tight",
    "savefig.pad_inches": 0.04,
}
"""Settings of matplotlib that all figures share."""


class Drawing(NamedTuple):
    """Function that draws on an empty matplotlib figure, and height and width of the figure [inch]."""

    draw: Callable[[Any], None]
    height: float
    width: float = WIDTH


def require_plotting() -> None:
    """Raise GranflowError if matplotlib is not installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise GranflowError(
            "Figures require matplotlib, which is not installed: pip install matplotlib"
        ) from None


def require_pandas(function: str) -> Any:
    """The module pandas. Raises GranflowError, which names the function, if it is not installed."""
    try:
        import pandas
    except ImportError:
        raise GranflowError(
            f"{function} returns a DataFrame of pandas, which is not installed: pip install pandas"
        ) from None
    return pandas


def write_figures(out: Path, figures: Mapping[str, Drawing]) -> str:
    """Write figures by file name; without matplotlib, write none and return the reason, otherwise ""."""
    try:
        for name, (draw, height, width) in figures.items():
            draw_to(out / name, draw, height, width)
    except GranflowError as error:
        return str(error)
    return ""


def draw_to(path: Path, draw: Callable[[Any], None], height: float, width: float = WIDTH) -> None:
    """Write an image: call `draw` with an empty matplotlib figure of `width` by `height` [inch] in the common
    style.

    The suffix of `path` is the type, such as .png; the resolution is RESOLUTION [dots per inch]. The file is
    written atomically: a link at `path` is replaced, and the file to which it leads stays unchanged. Raises
    GranflowError if matplotlib is not installed.
    """
    with styled_figure((width, height), layout="constrained") as figure:
        draw(figure)
        with replacing(path) as temporary:
            figure.savefig(temporary, dpi=RESOLUTION, format=path.suffix.removeprefix("."))


def stacked_panels(figure: Any, count: int, **shared: Any) -> Any:
    """Axes (count,) of panels one below the other; `shared`: as `sharex` of matplotlib."""
    return figure.subplots(count, 1, squeeze=False, **shared)[:, 0]


@contextmanager
def styled_figure(
    size: tuple[float, float], settings: Mapping[str, Any] | None = None, **more: Any
) -> Iterator[Any]:
    """An empty matplotlib figure of `size` [inch]; in the block, matplotlib has the common style and
    `settings`.

    `more`: keyword arguments of the figure. Raises GranflowError if matplotlib is not installed.
    """
    require_plotting()
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE | dict(settings or {})):
        figure = Figure(figsize=size, **more)
        FigureCanvasAgg(figure)
        yield figure


# Tables


class PageTable(NamedTuple):
    """Column headings, rows of cells, and a caption if the page has none for it."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""


def percent(share: float) -> str:
    """A fraction in percent with two digits, for example 0.5 %, 12 % or 3e−05 %."""
    value = 100.0 * share
    if value == 0.0 or value >= 10.0:
        return f"{value:.0f} %"
    return f"{value:.2g} %" if value >= 1e-4 else f"{value:.0e} %".replace("-", "−")


def write_columns(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns of equal length as CSV with a header line, numbers in full precision.

    `columns`: name -> array (rows,). Raises ValueError for columns of different length.
    """
    write_table(
        path, columns, zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
    )


def attribute_columns(items: Iterable[Any], names: Iterable[str]) -> dict[str, np.ndarray]:
    """Columns with one row per item and one column per attribute."""
    items = list(items)
    return {name: np.array([getattr(each, name) for each in items]) for name in names}


def stacked(names: Sequence[str], parts: Iterable[Sequence[Any]]) -> dict[str, np.ndarray]:
    """Columns from parts that follow each other; a part has an array (rows,) or a constant for each name."""
    blocks = [np.broadcast_arrays(*part) for part in parts]
    return {
        name: np.concatenate([block[k] for block in blocks] or [np.empty(0)]) for k, name in enumerate(names)
    }


def without_empty_ends(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> PageTable:
    """A table of a page without those of its last two columns, reasons and warnings, that are empty."""
    kept = [k for k in range(len(heads)) if k < len(heads) - 2 or any(row[k] for row in rows)]
    return PageTable([heads[k] for k in kept], [[row[k] for k in kept] for row in rows])
