"""Self-contained HTML pages from the Jinja2 templates in `templates/`; they load nothing from the network.

All text is escaped, and invisible characters become visible escapes.
"""

from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from granflow.errors import GranflowError
from granflow.io.files import replacing, write_text
from granflow.io.tables import write_table
from granflow.visible_text import readable, visible

# Style and output of the figures of all studies. Requires the extra `plot`.

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8C6D31", "#7F7F7F")
"""Colors distinguishable for color-blind readers and in gray (Okabe & Ito 2008, plus two)."""
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


# Numbers as text, and CSV tables of studies.


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


MEDIA_TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".mp4": "video/mp4"}
"""Media type of each file type that a page can embed."""
LONG_CELL = 60
"""Number of characters of a cell that needs the full width of a telephone."""
SCREEN_WIDTH = 9.8
"""Width on a large screen [rem] of an inch of a figure: letters of 9 points are as large as those of the
text."""


def write_study(
    path: Path,
    template: str,
    tables: Mapping[str, Mapping[str, np.ndarray]],
    figures: Mapping[str, Drawing],
    **content: Any,
) -> str:
    """Write CSV tables, figures and the page of a study to the directory of `path`, which is created if
    necessary.

    `tables`: columns by file name; `figures`: drawings by file name; `content`: variables of the template.
    Without matplotlib, the page has no figures; returns the reason in this case, otherwise "".
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    for name, columns in tables.items():
        write_columns(path.parent / name, columns)
    missing = write_figures(path.parent, figures)
    shown = {} if missing else {name: SCREEN_WIDTH * drawing.width for name, drawing in figures.items()}
    write_page(path, template, folder=path.parent, figures=shown, missing=missing, **content)
    return missing


def write_page(path: Path, template: str, **content: Any) -> None:
    """Write a template with its variables as UTF-8, atomically.

    Raises KeyError for an image format that is not supported, OSError if an image is missing.
    """
    write_text(path, page_text(template, **content))


def page_text(template: str, **content: Any) -> str:
    """Text of a template with its variables; a page is HTML with embedded images."""
    return environment().get_template(template).render({"plotly": "", "section_titles": [], **content})


@cache
def environment() -> Environment:
    """Templates of this package and their filters; a variable that is not defined is an error."""
    found = Environment(
        loader=PackageLoader("granflow.studies"),
        autoescape=select_autoescape(["html"]),
        undefined=StrictUndefined,
        finalize=_visible,
        extensions=["jinja2.ext.do"],
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    found.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    found.filters |= {
        "data_uri": _data_uri,
        "g": _general,
        "percent": percent,
        "readable": readable,
        "repr": repr,
        "text_columns": _text_columns,
        "is_wide": _is_wide,
    }
    return found


def _visible(value: Any) -> Any:
    """Inserted text with visible escapes; HTML is unchanged."""
    return value if isinstance(value, Markup) else visible(value)


def _general(number: float, digits: int = 6) -> str:
    """Number with the given significant digits, without trailing zeros."""
    return f"{number:.{digits}g}"


def _data_uri(path: Path) -> Markup:
    """File content as a URI. Raises KeyError for a file type that is not in MEDIA_TYPES."""
    return Markup(f"data:{MEDIA_TYPES[path.suffix]};base64,{b64encode(path.read_bytes()).decode('ascii')}")


def _text_columns(table: PageTable) -> list[bool]:
    """Whether each column contains a cell that is not aligned like a number."""
    return [not all(_is_number(row[column]) for row in table.rows) for column in range(len(table.heads))]


def _is_wide(table: PageTable) -> bool:
    """Whether a table with headings is too wide for a telephone: many columns, or a long text with other
    columns."""
    longest = max((len(cell) for row in table.rows for cell in row), default=0)
    return any(table.heads) and (len(table.heads) > 4 or (len(table.heads) > 2 and longest > LONG_CELL))


def _is_number(text: str) -> bool:
    """Whether a cell is aligned like a number: it begins with a digit or sign, or is a dash or empty."""
    return not text or text[0].isdigit() or text[0] in "+−-–—±<>"
