r"""Text for terminals, logs and pages: control, bidirectional and zero-width characters become visible escapes.

Titles, headers and names of files come from elsewhere. As they are, ESC would control the terminal, and a
right-to-left override would show another text than the file holds. `visible` turns each such character into \x1b or
\u202e; line feeds and tabs stay.
"""

import logging
import re

HIDDEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u070f\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff"
    "\ufff9-\ufffb\ud800-\udfff\U000e0000-\U000e007f]"
)


def visible(text: object) -> str:
    """The text with every character that could not be seen, or would act on the display, as an escape."""
    return HIDDEN.sub(lambda found: _escape(ord(found[0])), str(text))


def _escape(code: int) -> str:
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


class VisibleFormatter(logging.Formatter):
    """Formats log records as visible text."""

    def format(self, record: logging.LogRecord) -> str:
        """The record as one text."""
        return visible(super().format(record))
