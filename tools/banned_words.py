"""Rejects coined terms and British spelling in identifiers, comments, strings, pages and scenes.

    python tools/banned_words.py [ROOT]        one line per hit; exit code 1 if there is a hit

The words and their replacements are in banned_words.tsv. Rules for names apply to parts of identifiers: the
parts of `loadStateDict` and `load_state_dict` are load, state and dict. Rules for text apply to the comments
and strings of Python files, and to pages and scenes.
"""

import io
import re
import sys
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

WORDS = Path(__file__).with_suffix(".tsv")
FOLDERS = ("granflow", "tests", "tools", "docs", "scenes")
SUFFIXES = (".py", ".md", ".html", ".yaml", ".yml", ".toml")
ANY = "*"
ALLOWED = {
    "CHANGELOG.md": (ANY,),  # names renamed keys
    "granflow/schema/messages.py": (ANY,),  # table of renamed keys
    "granflow/particles/file.py": ("grain", "grains"),  # column names of other programs
    "tests/tools/test_banned_words.py": (ANY,),  # banned words as input
    "tools/banned_words.py": ("grain", "grains"),  # this table
    "tools/benchmark/ours.py": ("grains",),  # group name that seeds recorded beds
}
"""Words that a file may contain; ANY stands for all words."""

STANDARD_NAMES = {("json", "loads"), ("pickle", "loads")}
"""Functions of the standard library, as (module, name)."""

FREE_TEXT = re.compile(r"\s*(title|description|label)\s*:")
"""Lines of a scene in which the author may use any word."""

NAME_PART = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
TEXT_TOKENS = {"COMMENT", "STRING", "FSTRING_MIDDLE"}


class Hit(NamedTuple):
    """A banned word in a line, and its replacement."""

    line: int
    word: str
    replacement: str


class Rules(NamedTuple):
    """Replacements of banned name parts and of banned phrases, and a pattern that matches any of the
    phrases."""

    names: dict[str, str]
    phrases: dict[str, str]
    any_phrase: re.Pattern[str]


@cache
def rules() -> Rules:
    """The rules of banned_words.tsv."""
    lines = WORDS.read_text(encoding="utf-8").splitlines()
    rows = [line.split("\t") for line in lines if line and not line.startswith("#")]
    names = {word: replacement for where, word, replacement in rows if where in ("name", "both")}
    phrases = {word: replacement for where, word, replacement in rows if where in ("text", "both")}
    return Rules(names, phrases, pattern_of(phrases))


def pattern_of(phrases: dict[str, str]) -> re.Pattern[str]:
    """Pattern of any phrase as whole words; a space of a phrase matches any white space, including line
    breaks."""
    longest_first = sorted(phrases, key=len, reverse=True)
    alternatives = "|".join(r"\s+".join(map(re.escape, phrase.split())) for phrase in longest_first)
    return re.compile(rf"(?<![\w-])(?:{alternatives})(?!\w)", re.IGNORECASE)


def messages(root: Path) -> list[str]:
    """One message for each hit in the files below `root`."""
    return [
        f"{name}:{hit.line}: {hit.word!r} is not used here; write: {hit.replacement}"
        for name in checked_files(root)
        for hit in hits_in_file(root, name)
    ]


def checked_files(root: Path) -> Iterator[str]:
    """Paths relative to `root`: pages and configuration at the top, and all text files in FOLDERS."""
    for folder in (root, *(root / name for name in FOLDERS)):
        for path in sorted(folder.glob("*") if folder == root else folder.rglob("*")):
            if path.suffix in SUFFIXES and path.is_file() and "__pycache__" not in path.parts:
                yield path.relative_to(root).as_posix()


def hits_in_file(root: Path, name: str) -> Iterator[Hit]:
    """Hits in one file, except for words that it may contain."""
    allowed = ALLOWED.get(name, ())
    if ANY in allowed:
        return
    text = (root / name).read_text(encoding="utf-8")
    found = hits_in_python(text) if name.endswith(".py") else hits_in_page(text, name)
    yield from (hit for hit in found if hit.word not in allowed)


def hits_in_python(text: str) -> Iterator[Hit]:
    """Hits in the identifiers, comments and strings of Python source."""
    before = ["", ""]
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.NAME:
            if before[1] != "." or (before[0], token.string) not in STANDARD_NAMES:
                yield from hits_in_name(token.string, token.start[0])
        elif tokenize.tok_name[token.type] in TEXT_TOKENS:
            yield from hits_in_text(token.string, token.start[0])
        before = [before[1], token.string]


def hits_in_page(text: str, name: str) -> Iterator[Hit]:
    """Hits in a page or a scene, except for the free text of a scene."""
    if not name.endswith(".md"):
        text = "\n".join("" if FREE_TEXT.match(line) else line for line in text.splitlines())
    yield from hits_in_text(text, 1)


def hits_in_text(text: str, first_line: int) -> Iterator[Hit]:
    """Hits of phrases in a text that begins in line `first_line`."""
    for match in rules().any_phrase.finditer(text):
        phrase = " ".join(match.group().lower().split())
        yield Hit(first_line + text.count("\n", 0, match.start()), phrase, rules().phrases[phrase])


def hits_in_name(name: str, line: int) -> Iterator[Hit]:
    """Hits of rules for names in the parts of an identifier."""
    parts = "_" + "_".join(NAME_PART.findall(name)).lower() + "_"
    for word, replacement in rules().names.items():
        if f"_{word}_" in parts:
            yield Hit(line, word, replacement)


def main() -> int:
    """Prints the messages; returns 1 if there is one."""
    root = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent.parent
    found = messages(root)
    if found:
        print("\n".join(found))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
