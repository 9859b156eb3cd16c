"""tools/banned_words.py finds planted words; the tables of tools/scene_table.py are those of the scenes."""

import banned_words as checker
import numpy as np
import pytest
import scene_table
from scene_numbers import edge_of

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


def test_edge_of_a_single_layer_disc():
    """A hexagonal layer of particles of 2 mm covers pi / (2 sqrt 3) = 0.907 of the area up to 30 mm."""
    row, column = np.meshgrid(np.arange(-20, 21), np.arange(-20, 21), indexing="ij")
    position = np.stack([2e-3 * (column + row / 2), np.sqrt(3) * 1e-3 * row, 0 * row], axis=-1).reshape(-1, 3)
    position = position[np.hypot(position[:, 0], position[:, 1]) < 0.029]
    assert edge_of(position, np.full(len(position), 1e-3)) == pytest.approx(0.030, abs=1.5e-3)


def test_tables_match_the_stored_numbers():
    """If this fails, run `python tools/scene_table.py` and commit the files that it writes."""
    assert not scene_table.outdated()
