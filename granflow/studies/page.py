"""Self-contained HTML pages from the Jinja2 templates in `templates/`; they load nothing from the network.

All text is escaped, and invisible characters become visible escapes.
"""

from base64 import b64encode
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from granflow.io.files import write_text
from granflow.studies.figures import Drawing, PageTable, percent, write_columns, write_figures
from granflow.visible_text import readable, visible

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
