"""Links from the pages to the generated reference: keys of scenes, commands and classes, where a page names each
first."""

import posixpath
import re
from functools import cache

from docsite import api_page, command_page
from docsite.scene_reference import OVERVIEW, key_anchor, page_of, pages
from granflow.scene.reference import places_of

SKIPPED = ("reference/", "notebooks/", "changelog.md", "benchmark.md", "gallery.md")
"""Beginnings of the paths of pages without such links."""
AMBIGUOUS = ("run", "contact", "damping", "motion")
"""Blocks whose names are also those of a function, an argument or another key."""
PIECE = re.compile(
    r"^```.*?^```[^\n]*|^#[^\n]*|^\|[ :|-]+\|$|!?\[[^\]]*\]\([^)]*\)|\$\$.*?\$\$|<!--.*?-->|`(?P<code>[^`\n]+)`",
    re.DOTALL | re.MULTILINE,
)
"""What is not changed, and code within a line."""
KEY_PATH = re.compile(r"([a-z_]+(?:\.[A-Za-z_]+|\[\])*)(?::(?: .*)?)?")
CLASS = re.compile(r"(?:gf\.|granflow\.)?([A-Z]\w+)(?:[.(].*)?", re.DOTALL)
COMMAND = re.compile(r"granflow ([a-z]+)(?: .*)?")


def linked(markdown: str, path: str) -> str:
    """The text of the page at `path` with a link at the first code that names each key, command or class."""
    if path.startswith(SKIPPED):
        return markdown
    named = set[str]()

    def link(found: re.Match[str]) -> str:
        target = target_of(found["code"]) if found["code"] else ""
        if not target or target in named:
            return found[0]
        named.add(target)
        page, _, part = target.partition("#")
        address = posixpath.relpath(page, posixpath.dirname(path) or ".")
        return f"[{found[0]}]({address}{'#' + part if part else ''})"

    return PIECE.sub(link, markdown)


@cache
def target_of(code: str) -> str:
    """Path of the page of a key, a command or a class, with its anchor; empty for other code.

    A key is named by its path, such as `output.wall_forces`, or by that of a block of the first level.
    """
    if (found := COMMAND.fullmatch(code)) and found[1] in command_page.commands():
        return f"reference/commands.md#{found[1]}"
    if (found := CLASS.fullmatch(code)) and found[1] in api_page.class_pages():
        return f"reference/python/{found[1]}.md"
    found = KEY_PATH.fullmatch(code)
    if found is None:
        return ""
    if "." not in found[1]:
        page = f"{OVERVIEW}/{found[1]}"
        return f"reference/{page}.md" if page in pages() and found[1] not in AMBIGUOUS else ""
    keys = [place.key for place in places_of(found[1]) if place.key is not None and place.key.schema]
    return f"reference/{page_of(keys[0].part)}.md#{key_anchor(keys[0])}" if keys else ""
