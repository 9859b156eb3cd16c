"""One HTML page from text, tables and figures: everything inside the file, nothing from the network."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

MEDIA_TYPES = {".png": "image/png", ".svg": "image/svg+xml"}

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
td.words { min-width: 9rem; }
thead th { border-top: 1.5px solid #222; border-bottom: 1px solid #222; vertical-align: bottom; }
tbody tr:last-child td { border-bottom: 1.5px solid #222; }
@media print { nav { display: none; } figure, table { break-inside: avoid; } }
"""


@dataclass(frozen=True)
class Table:
    """Rows of text under heads; cells that read as numbers are set to the right, others to the left."""

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Picture:
    """An image file that goes into the page, its caption, and files beside the page to link to."""

    image: Path
    caption: str
    beside: tuple[str, ...] = ()


@dataclass(frozen=True)
class Section:
    """A title and what stands under it, in order; plain text becomes a paragraph."""

    title: str
    parts: Sequence[str | Table | Picture]


@dataclass(frozen=True)
class Page:
    """Title, a paragraph that says what this is, and sections."""

    title: str
    lead: str
    sections: Sequence[Section]


def write_page(page: Page, path: Path) -> None:
    """Write the page. Raises KeyError for an image that is neither PNG nor SVG."""
    path.write_text(html_of(page), encoding="utf-8")


def html_of(page: Page) -> str:
    """The page as HTML, images embedded."""
    links = "".join(f'<a href="#{_anchor(n)}">{escape(s.title)}</a>' for n, s in enumerate(page.sections))
    sections = "\n".join(_section(number, section) for number, section in enumerate(page.sections))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(page.title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        f'<h1>{escape(page.title)}</h1>\n<p class="lead">{escape(page.lead)}</p>\n<nav>{links}</nav>\n'
        f"{sections}\n</body>\n</html>\n"
    )


def _anchor(number: int) -> str:
    return f"section{number + 1}"


def _section(number: int, section: Section) -> str:
    parts = "\n".join(_part(part) for part in section.parts)
    return f'<section id="{_anchor(number)}">\n<h2>{escape(section.title)}</h2>\n{parts}\n</section>'


def _part(part: str | Table | Picture) -> str:
    if isinstance(part, Table):
        return _table(part)
    if isinstance(part, Picture):
        return _picture(part)
    return f"<p>{escape(part)}</p>"


def _picture(picture: Picture) -> str:
    data = b64encode(picture.image.read_bytes()).decode("ascii")
    kind = MEDIA_TYPES[picture.image.suffix]
    links = "".join(f' <a href="{escape(name)}">{escape(name)}</a>' for name in picture.beside)
    return (
        f'<figure><img alt="{escape(picture.caption)}" src="data:{kind};base64,{data}">'
        f"<figcaption>{escape(picture.caption)}{links}</figcaption></figure>"
    )


def _table(table: Table) -> str:
    words = [not all(_is_figure(row[column]) for row in table.rows) for column in range(len(table.heads))]
    heads = "".join(_cell("th", head, is_words) for head, is_words in zip(table.heads, words, strict=True))
    rows = "\n".join(
        "<tr>" + "".join(_cell("td", cell, is_words) for cell, is_words in zip(row, words, strict=True)) + "</tr>"
        for row in table.rows
    )
    return (
        f'<div class="scroll"><table><caption>{escape(table.caption)}</caption>'
        f"<thead><tr>{heads}</tr></thead>\n<tbody>\n{rows}\n</tbody></table></div>"
    )


def _cell(tag: str, text: str, is_words: bool) -> str:
    return f"<{tag}{' class=words' if is_words else ''}>{escape(text)}</{tag}>"


def _is_figure(text: str) -> bool:
    """Whether a cell is set like a number: it begins with a digit or sign, or is a dash or empty."""
    return not text or text[0].isdigit() or text[0] in "+−-–—±<>"
