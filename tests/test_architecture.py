"""ARCHITECTURE.md: all files, folders and modules that it names exist, it is short, and README.md links it."""

import ast
import re
from itertools import product
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "ARCHITECTURE.md"
LONGEST_PAGE = 150
"""Largest number of lines."""
PLACEHOLDER = re.compile(r"\b[A-Z][A-Z_]+\b")
"""Part of a path that stands for a name to choose, as in `contact/normal/NAME.py`."""
PATH = re.compile(r"(?<![\w./*-])(?:[\w-]+/)*[\w-]+\.(?:py|md)(?![\w/])")
FOLDER = re.compile(r"(?<![\w./*-])(?:[\w-]+/)+(?![\w./*{-])")
MODULE = re.compile(r"(?<![\w./-])granflow(?:\.\w+)+")
BRACES = re.compile(r"\{([\w, -]+)\}")


def code_in(text):
    """The code blocks of a page and the words in backticks outside them, one after the other."""
    blocks = re.findall(r"^```.*?$(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    return [*blocks, *re.findall(r"`([^`\n]+)`", prose)]


def expanded(text):
    """The text, with words such as `engine/{step,pair}.py` replaced by `engine/step.py engine/pair.py`."""

    def words_of(match):
        parts = BRACES.split(match[0])
        choices = [
            part.split(",") if number % 2 else [part] for number, part in enumerate(parts)
        ]  # every second part is the inside of braces
        return " ".join("".join(each.strip() for each in chosen) for chosen in product(*choices))

    return re.sub(r"[\w./-]*\{[\w, -]+\}[\w./{}-]*", words_of, text)


def names_in(text):
    """Paths of files and folders, and dotted names of modules, in the code of a page."""
    code = "\n".join(expanded(each) for each in code_in(text))
    return {pattern: sorted(set(pattern.findall(code))) for pattern in (PATH, FOLDER, MODULE)}


def path_exists(name):
    """Whether a path exists in the repository or in the package; a single name, anywhere in the package."""
    if PLACEHOLDER.search(name):
        name = name[: PLACEHOLDER.search(name).start()].rpartition("/")[0]
    places = [ROOT, ROOT / "granflow"]
    if any((place / name).exists() for place in places):
        return True
    single = name.removesuffix("/")
    return "/" not in single and any((ROOT / "granflow").rglob(single))


def module_exists(name):
    """Whether a dotted name is a module of the package, or a definition in one."""
    parts = name.split(".")
    path = ROOT.joinpath(*parts)
    if path.is_dir() or path.with_suffix(".py").is_file():
        return True
    for count in range(len(parts) - 1, 0, -1):
        path = ROOT.joinpath(*parts[:count])
        path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        if path.is_file():
            return parts[count] in names_defined_in(path)
    return False


def names_defined_in(path):
    """Names that a module defines, imports or lists as texts, such as a table of public names."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    names = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.alias)}
    names |= {node.id for node in nodes if isinstance(node, ast.Name)}
    return names | {node.value for node in nodes if isinstance(node, ast.Constant)}


def page():
    """The text of ARCHITECTURE.md; empty before it exists."""
    return PAGE.read_text(encoding="utf-8")


def test_all_names_of_the_page_exist():
    names = names_in(page())
    assert not [name for name in (*names[PATH], *names[FOLDER]) if not path_exists(name)]
    assert not [name for name in names[MODULE] if not module_exists(name)]


def test_page_is_short_and_linked_in_the_readme():
    assert len(page().splitlines()) <= LONGEST_PAGE
    links = re.findall(r"\]\(([^)]*)\)", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert any(link.partition("#")[0].endswith("ARCHITECTURE.md") for link in links)


SAMPLE = """Words outside code, such as engine/absent.py, are no names. `granflow/simulation.py` is one.

```
io/{files,lock}.py      run/
io/   NAME.py of contact/normal/NAME.py, granflow.io.lock.locked
```
"""


@pytest.mark.parametrize(("exists", "present", "absent"), [
    (path_exists,
     ["granflow/io/lock.py", "io/lock.py", "lock.py", "tests/test_architecture.py", "contact/normal/NAME.py", "io/",
      "cohesion/"],
     ["contact/absent/NAME.py", "io/absent.py", "absent.py", "absent/"]),
    (module_exists, ["granflow.io", "granflow.io.lock", "granflow.io.lock.locked", "granflow.Simulation"],
     ["granflow.io.absent", "granflow.io.lock.absent"]),
])  # fmt: skip
def test_paths_and_modules_are_searched_in_the_repository_and_in_the_package(exists, present, absent):
    assert [name for name in present if not exists(name)] == []
    assert [name for name in absent if exists(name)] == []


def test_names_are_those_in_code():
    names = names_in(SAMPLE)
    assert names[PATH] == [
        "NAME.py",
        "contact/normal/NAME.py",
        "granflow/simulation.py",
        "io/files.py",
        "io/lock.py",
    ]
    assert names[FOLDER] == ["io/", "run/"]
    assert names[MODULE] == ["granflow.io.lock.locked"]
