"""tools/banned_words.py: banned words are found in code, comments, scenes and pages; clean files are
accepted."""

import importlib
from pathlib import Path

import pytest

TOOLS = Path(__file__).resolve().parents[2] / "tools"

PLANTED = {
    "identifier": ("granflow/probe.py", "count = 1\nneighbour_count = 2\n",
                   "granflow/probe.py:2: 'neighbour' is not used here; write: neighbor"),
    "camel case": ("tests/probe.py", "class ReversedTwins:\n    pass\n",
                   "tests/probe.py:1: 'twins' is not used here; write: references"),
    "docstring": ("tools/probe.py", '"""Reads a table.\n\nThe run is gone\n    on with later.\n"""\n',
                  "tools/probe.py:3: 'gone on with' is not used here; write: resumed, continued"),
    "comment": ("granflow/probe.py", "mass = 1.0  # Grains have unit mass\n",
                "granflow/probe.py:1: 'grains' is not used here; write: particles"),
    "scene": ("scenes/probe.yaml", "title: Probe\nseed: 7  # drawn anew\n",
              "scenes/probe.yaml:2: 'anew' is not used here; write: again"),
    "page": ("docs/probe.md", "# Walls\n\nA contact at a rim has one owner.\n",
             "docs/probe.md:3: 'rim' is not used here; write: shared edge")
}  # fmt: skip
CLEAN = {
    "README.md": "# Particles\n\nNeighbors of a particle are in its neighbor list; see `primer.md`.\n",
    "granflow/probe.py": '"""Reads a table again."""\n\nimport json\n\nneighbor_count = json.loads("1")\n',
    "scenes/probe.yaml": "title: Coffee grains in a grey drum\nseed: 7  # drawn again\n",
}


@pytest.fixture
def checker():
    return importlib.import_module("banned_words")


def write(root, name, text):
    (root / name).parent.mkdir(parents=True, exist_ok=True)
    (root / name).write_text(text, encoding="utf-8")


@pytest.mark.parametrize(("name", "text", "message"), PLANTED.values(), ids=PLANTED)
def test_planted_word_is_reported_with_its_replacement(checker, tmp_path, name, text, message):
    write(tmp_path, name, text)
    assert checker.messages(tmp_path) == [message]


def test_clean_tree_is_accepted(checker, tmp_path):
    for name, text in CLEAN.items():
        write(tmp_path, name, text)
    assert checker.messages(tmp_path) == []


def test_words_are_unique_and_have_a_replacement(checker):
    rows = [
        line.split("\t") for line in checker.WORDS.read_text(encoding="utf-8").splitlines() if line[0] != "#"
    ]
    assert all(len(row) == 3 and row[0] in ("text", "name", "both") and row[2] for row in rows)
    for kind in ("text", "name"):
        words = [word for where, word, _ in rows if where in (kind, "both")]
        assert len(set(words)) == len(words)


def test_files_with_exceptions_exist(checker):
    assert all((TOOLS.parent / name).is_file() for name in checker.ALLOWED)
