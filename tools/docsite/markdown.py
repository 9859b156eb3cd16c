"""Markdown text: tables, cells and anchors."""

import re
from collections.abc import Iterable, Sequence


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; cells are on one line, and their bars are escaped."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(cell(each) for each in line) + " |" for line in lines) + "\n"


def cell(text: str) -> str:
    """Text on one line with escaped bars."""
    return " ".join(text.split()).replace("|", "\\|")


def code(text: str) -> str:
    """Text in backticks."""
    return f"`{text}`"


def anchor(text: str) -> str:
    """Identifier of a heading or a key in a page: lowercase letters, digits, hyphens."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
