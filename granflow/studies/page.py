"""A self-contained HTML page from text, tables, figures and plots; loads nothing from the network."""

import html
import json
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from granflow.visible_text import visible

MEDIA_TYPES = {".png": "image/png", ".svg": "image/svg+xml", ".jpg": "image/jpeg", ".mp4": "video/mp4"}
"""Media type of each file type that a page can embed."""


STYLE = """
:root { color-scheme: light; }
body { max-width: 52rem; margin: 2.5rem auto; padding: 0 1.2rem; color: #1a1a1a; background: #fff;
  font: 1.05rem/1.55 Charter, "Bitstream Charter", "Source Serif 4", Georgia, serif; }
h1 { font-size: 1.9rem; line-height: 1.2; margin-bottom: .3rem; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .6rem; border-top: 1px solid #ccc; padding-top: 1.2rem; }
p.lead { font-size: 1.12rem; color: #333; }
nav { font: .9rem/1.7 system-ui, sans-serif; columns: 2; margin: 1.2rem 0; }
nav a { display: block; }
a { color: #0b5394; text-decoration: none; } a:hover { text-decoration: underline; }
figure { margin: 1.4rem 0; } figure img { width: 100%; height: auto; }
figcaption, caption { font: .9rem/1.45 system-ui, sans-serif; color: #333; }
caption { text-align: left; padding-bottom: .4rem; }
.scroll { overflow-x: auto; margin: 1.4rem 0; }
table { border-collapse: collapse; font: .88rem/1.4 system-ui, sans-serif; font-variant-numeric: tabular-nums; }
th, td { padding: .28rem .8rem .28rem 0; text-align: right; vertical-align: top; }
th:first-child, td:first-child, td.words, th.words { text-align: left; }
td:not(.words) { white-space: nowrap; }
td.words { min-width: 9rem; }
thead th { border-top: 1.5px solid #222; border-bottom: 1px solid #222; vertical-align: bottom; }
caption + tbody tr:first-child td { border-top: 1.5px solid #222; }
tbody tr:last-child td { border-bottom: 1.5px solid #222; }
.gallery { display: flex; flex-wrap: wrap; gap: 1rem; } .gallery figure { margin: 0; width: calc(50% - .5rem); }
.gallery video { width: 100%; height: auto; }
pre { font: .8rem/1.45 ui-monospace, Menlo, Consolas, monospace; overflow-x: auto;
  background: #f7f7f5; padding: .8rem 1rem; }
pre i { color: #8a8a8a; font-style: normal; user-select: none; }
@media print { nav { display: none; } figure, table { break-inside: avoid; } }
"""


@dataclass(frozen=True)
class PageTable:
    """Table of text with column headings; numbers are aligned right, other cells left."""

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Picture:
    """An embedded image file, its caption, and files in the directory of the page to link to."""

    image: Path
    caption: str
    linked_files: tuple[str, ...] = ()


@dataclass(frozen=True)
class Gallery:
    """Pictures and films, side by side."""

    pictures: Sequence[Picture]


@dataclass(frozen=True)
class Plot:
    """An interactive plot; `figure` contains data and layout in the format of plotly."""

    caption: str
    figure: dict[str, Any]


@dataclass(frozen=True)
class Code:
    """Verbatim text of a file, with or without line numbers."""

    text: str
    numbered: bool = True


PagePart = str | PageTable | Picture | Gallery | Plot | Code
"""Content of a section."""


@dataclass(frozen=True)
class Section:
    """A title and its content in order; plain text becomes a paragraph."""

    title: str
    parts: Sequence[PagePart]


@dataclass(frozen=True)
class Page:
    """Title, introductory paragraph, and sections."""

    title: str
    lead: str
    sections: Sequence[Section]
    script: str = ""
    """JavaScript of plotly, for pages with plots."""


def escape(text: str) -> str:
    """Text as HTML; invisible characters become escapes."""
    return html.escape(visible(text))


DRAW_PLOTS = """
for (const plot of document.querySelectorAll("figure.plot")) {
  const {data, layout} = JSON.parse(plot.querySelector("script").textContent);
  const look = {responsive: true, displaylogo: false, showSendToCloud: false};
  Plotly.newPlot(plot.querySelector("div"), data, layout, look);
}
"""
"""JavaScript that draws all plots of a page."""


def write_page(page: Page, path: Path) -> None:
    """Write the page as UTF-8.

    Raises KeyError for an image format that is not supported, OSError if an image is missing.
    """
    path.write_text(html_of(page), encoding="utf-8")


def html_of(page: Page) -> str:
    """The page as HTML with embedded images, without references to other files except `linked_files`."""
    links = "".join(f'<a href="#{_anchor(n)}">{escape(s.title)}</a>' for n, s in enumerate(page.sections))
    sections = "\n".join(_section(number, section) for number, section in enumerate(page.sections))
    scripts = f"<script>{page.script}</script>\n<script>{DRAW_PLOTS}</script>\n" if page.script else ""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(page.title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        f'<h1>{escape(page.title)}</h1>\n<p class="lead">{escape(page.lead)}</p>\n<nav>{links}</nav>\n'
        f"{sections}\n{scripts}</body>\n</html>\n"
    )


def _anchor(number: int) -> str:
    return f"section{number + 1}"


def _section(number: int, section: Section) -> str:
    """HTML of a section with its anchor."""
    parts = "\n".join(_part(part) for part in section.parts)
    return f'<section id="{_anchor(number)}">\n<h2>{escape(section.title)}</h2>\n{parts}\n</section>'


def _part(part: PagePart) -> str:
    """HTML of one part; the type of the part determines the element."""
    match part:
        case PageTable():
            return _table(part)
        case Picture():
            return _picture(part)
        case Gallery():
            return f'<div class="gallery">{"".join(map(_picture, part.pictures))}</div>'
        case Plot():
            return _plot(part)
        case Code():
            return _code(part)
    return f"<p>{escape(part)}</p>"


def _plot(plot: Plot) -> str:
    """HTML of an interactive plot: its data as JSON, which the script of the page draws."""
    figure = json.dumps(plot.figure, separators=(",", ":")).replace("</", "<\\/")
    return (
        f'<figure class="plot"><div></div><script type="application/json">{figure}</script>'
        f"<figcaption>{escape(plot.caption)}</figcaption></figure>"
    )


def _code(code: Code) -> str:
    lines = code.text.rstrip("\n").split("\n")
    if not code.numbered:
        return f"<pre>{escape(code.text)}</pre>"
    width = len(str(len(lines)))
    return "<pre>" + "\n".join(f"<i>{n:>{width}}</i>  {escape(line)}" for n, line in enumerate(lines, 1)) + "</pre>"


def _picture(picture: Picture) -> str:
    """HTML of an image or film, embedded in base64. Raises KeyError for a file type that is not in MEDIA_TYPES."""
    data = b64encode(picture.image.read_bytes()).decode("ascii")
    kind = MEDIA_TYPES[picture.image.suffix]
    links = "".join(f' <a href="{escape(name)}">{escape(name)}</a>' for name in picture.linked_files)
    source = f'src="data:{kind};base64,{data}"'
    shown = f"<video controls loop muted {source}></video>"
    if not kind.startswith("video"):
        shown = f'<img alt="{escape(picture.caption)}" {source}>'
    return f"<figure>{shown}<figcaption>{escape(picture.caption)}{links}</figcaption></figure>"


def _table(table: PageTable) -> str:
    """HTML of a table; a column of numbers only is aligned right."""
    text_columns = [not all(_is_figure(row[column]) for row in table.rows) for column in range(len(table.heads))]
    heads = "".join(_cell("th", head, is_text) for head, is_text in zip(table.heads, text_columns, strict=True))
    rows = "\n".join(
        "<tr>" + "".join(_cell("td", cell, is_text) for cell, is_text in zip(row, text_columns, strict=True)) + "</tr>"
        for row in table.rows
    )
    return (
        f'<div class="scroll"><table><caption>{escape(table.caption)}</caption>'
        f"{f'<thead><tr>{heads}</tr></thead>' if any(table.heads) else ''}\n<tbody>\n{rows}\n</tbody></table></div>"
    )


def _cell(tag: str, text: str, is_text: bool) -> str:
    return f"<{tag}{' class=words' if is_text else ''}>{escape(text)}</{tag}>"


def _is_figure(text: str) -> bool:
    """Whether a cell is aligned like a number: it begins with a digit or sign, or is a dash or empty."""
    return not text or text[0].isdigit() or text[0] in "+−-–—±<>"
