"""Text for terminals, logs and pages: control characters become escapes, numbers and lists readable.

ESC in a title or file name would control the terminal: `visible` replaces control characters by escapes as
in Python; newlines and tabs remain. In messages, which are one line each, `visible_line` replaces newlines as
well. The other functions write numbers, counts, lists of names and tables.
"""

import html
import logging
import math
import re
from collections.abc import Iterable, Sequence

CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")
"""Characters that are replaced: control characters, and surrogates, which UTF-8 cannot encode."""


def visible(text: object) -> str:
    """Return `str(text)` with each control character replaced by an escape."""
    return CONTROL.sub(lambda found: ascii(found[0])[1:-1], str(text))


def visible_line(text: object) -> str:
    """Return the text as one visible line: newlines are replaced as well."""
    return visible(text).replace("\n", "\\n")


class VisibleFormatter(logging.Formatter):
    """Formats log records as visible text: the message as one line, a traceback below it."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        """Return the line of the record."""
        return visible_line(super().formatMessage(record))

    def format(self, record: logging.LogRecord) -> str:
        """Return the text of the record."""
        return visible(super().format(record))


def readable(number: float) -> str:
    """The number as text: whole and large ones in groups of three digits, others with four digits.

    Large: from 1e4 to 1e12, rounded to four significant digits.
    """
    if float(number).is_integer() and abs(number) < 1e15:
        return f"{int(number):,}".replace(",", " ")
    if 1e4 <= abs(number) < 1e12:
        return f"{int(float(f'{number:.4g}')):,}".replace(",", " ")
    return f"{number:.4g}"


def in_degrees(number: float, unit: str) -> str:
    """ " (22.9 deg)" for an angle in rad, to follow it in text; "" for other units and without a number.

    Scenes take angles in degrees as well; files contain rad only.
    """
    return f" ({math.degrees(number):.4g} deg)" if unit == "rad" and math.isfinite(number) else ""


def numbered(count: int, noun: str) -> str:
    """Return a count with its noun: 1 wall, 2 walls, 12 000 particles."""
    return f"{readable(count)} {noun if count == 1 else plural(noun)}"


def plural(noun: str) -> str:
    """The plural of a noun: walls, groups of particles, walls with a temperature."""
    return re.sub(r"^(.*?)(?= (?:of|with|moved) |$)", r"\1s", noun, count=1)


def distinct_endings(names: Sequence[Sequence[str]], least: int = 1) -> list[tuple[str, ...]]:
    """The last parts of each name, as few as make all names different, but at least `least`."""
    for count in range(least, max([least, *map(len, names)]) + 1):
        found = [tuple(name[-count:]) for name in names]
        if len(set(found)) == len(found):
            break
    return found


def alternatives(names: Sequence[str]) -> str:
    """The names (one or more) as a list of alternatives: "a, b or c"."""
    return " or ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def html_table(title: str, rows: Iterable[tuple[str, object]]) -> str:
    """A table of labels and values with a heading as HTML, for notebooks; all texts are escaped."""
    cells = "".join(
        f'<tr><th style="text-align:left">{_escaped(label)}</th>'
        f'<td style="text-align:left">{_escaped(value)}</td></tr>'
        for label, value in rows
    )
    return f"<table><caption>{_escaped(title)}</caption>{cells}</table>"


def _escaped(text: object) -> str:
    return html.escape(visible_line(text))
