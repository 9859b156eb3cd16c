"""tools/scene_numbers.py and tools/scene_table.py: beds with known results, and tables."""

import numpy as np
import pytest
import scene_table
from scene_numbers import edge_of


def test_edge_of_a_single_layer_disc():
    """A hexagonal layer of particles of 2 mm covers pi / (2 sqrt 3) = 0.907 of the area up to 30 mm."""
    row, column = np.meshgrid(np.arange(-20, 21), np.arange(-20, 21), indexing="ij")
    position = np.stack([2e-3 * (column + row / 2), np.sqrt(3) * 1e-3 * row, 0 * row], axis=-1).reshape(-1, 3)
    position = position[np.hypot(position[:, 0], position[:, 1]) < 0.029]
    assert edge_of(position, np.full(len(position), 1e-3)) == pytest.approx(0.030, abs=1.5e-3)


def test_tables_match_the_stored_numbers():
    """If this fails, run `python tools/scene_table.py` and commit the files that it writes."""
    assert not scene_table.outdated()
