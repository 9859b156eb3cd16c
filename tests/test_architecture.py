"""ARCHITECTURE.md: all files and folders that it names exist, it is short, and README.md links it."""

import re
from itertools import product
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PLACEHOLDER = re.compile(r"\b[A-Z][A-Z_]+\b")
"""Part of a path that stands for a name to choose, as in `contact/normal/NAME.py`."""
PATH = re.compile(r"(?<![\w./*-])(?:(?:[\w-]+/)*[\w-]+\.(?:py|md)(?![\w/])|(?:[\w-]+/)+(?![\w./*{-]))")
BRACES = re.compile(r"\{([\w, -]+)\}")


def code_in(text):
    """The code blocks of a page and the words in backticks outside them."""
    blocks = re.findall(r"^```.*?$(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    return "\n".join([*blocks, *re.findall(r"`([^`\n]+)`", prose)])


def expanded(match):
    """Words such as `engine/{step,pair}.py` as `engine/step.py engine/pair.py`."""
    parts = BRACES.split(match[0])  # every second one is the inside of braces
    choices = [part.split(",") if number % 2 else [part] for number, part in enumerate(parts)]
    return " ".join("".join(each.strip() for each in chosen) for chosen in product(*choices))


def exists(name):
    """Whether a path exists in the repository or in the package; a single name, anywhere in the package."""
    if found := PLACEHOLDER.search(name):
        name = name[: found.start()].rpartition("/")[0]
    if (ROOT / name).exists() or (ROOT / "granflow" / name).exists():
        return True
    single = name.removesuffix("/")
    return "/" not in single and any((ROOT / "granflow").rglob(single))


def test_all_names_of_the_page_exist():
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    code = re.sub(r"[\w./-]*\{[\w, -]+\}[\w./{}-]*", expanded, code_in(text))
    names = set(PATH.findall(code))
    assert len(names) > 100 and not [name for name in names if not exists(name)]
    assert not exists("engine/absent.py") and not exists("absent.py")
    assert len(text.splitlines()) <= 150
    assert "ARCHITECTURE.md)" in (ROOT / "README.md").read_text(encoding="utf-8")
