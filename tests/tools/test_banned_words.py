"""tools/banned_words.py: banned words are found in code, comments, scenes and pages; clean files are
accepted."""

import banned_words as checker

PLANTED = {
    "granflow/a.py": ("count = 1\nneighbour_count = 2\n", "granflow/a.py:2: 'neighbour' is not used here; write: neighbor"),
    "tests/b.py": ("class ReversedTwins:\n    pass\n", "tests/b.py:1: 'twins' is not used here; write: references"),
    "tools/c.py": ('"""Reads a table.\n\nThe run is gone\n    on with later.\n"""\n',
                   "tools/c.py:3: 'gone on with' is not used here; write: resumed, continued"),
    "scenes/d.yaml": ("title: Probe\nseed: 7  # drawn anew\n", "scenes/d.yaml:2: 'anew' is not used here; write: again"),
    "docs/e.md": ("# Walls\n\nA contact at a rim has one owner.\n", "docs/e.md:3: 'rim' is not used here; write: shared edge")
}  # fmt: skip
CLEAN = {
    "README.md": "# Particles\n\nNeighbors of a particle are in its neighbor list; see `primer.md`.\n",
    "scenes/probe.yaml": "title: Coffee grains in a grey drum\nseed: 7  # drawn again\n",
}


def test_planted_words_are_reported_with_their_replacements(tmp_path):
    texts = CLEAN | {name: text for name, (text, _) in PLANTED.items()}
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert sorted(checker.messages(tmp_path)) == sorted(message for _, message in PLANTED.values())
