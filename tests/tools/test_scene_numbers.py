"""tools/scene_numbers.py and tools/scene_table.py: beds with known results, and tables."""

import importlib

import numpy as np
import pytest


def module(name):
    return importlib.import_module(name)


def test_edge_of_a_single_layer_disc():
    # A hexagonal layer of particles of 2 mm covers pi / (2 sqrt 3) = 0.907 of the area up to 30 mm.
    row, column = np.meshgrid(np.arange(-20, 21), np.arange(-20, 21), indexing="ij")
    position = np.stack([2e-3 * (column + row / 2), np.sqrt(3) * 1e-3 * row, 0 * row], axis=-1).reshape(-1, 3)
    position = position[np.hypot(position[:, 0], position[:, 1]) < 0.029]
    edge = module("scene_numbers").edge_of(position, np.full(len(position), 1e-3))
    assert edge == pytest.approx(0.030, abs=1.5e-3)


def test_quadrants_are_counted_in_the_plane_of_rotation():
    position = np.array(
        [[-1, 5, 1], [1, -5, 1], [1, 0, 2], [-1, 0, -1], [-2, 0, -1], [-3, 0, -1], [1, 0, -1.0]]
    )
    assert module("scene_numbers").quadrants(position).tolist() == [1, 2, 3, 1]


# ---------------------------------------------------------------- tables of scenes


def test_tables_match_the_stored_numbers():
    """If this fails, run `python tools/scene_table.py` and commit the files that it writes."""
    assert not module("scene_table").outdated()


def test_each_expectation_of_a_shipped_scene_has_a_row():
    table = module("scene_table")
    rows = [
        line.split(" | ")
        for line in table.EXPECTATIONS.read_text(encoding="utf-8").splitlines()
        if " | " in line
    ]
    for name in table.names():
        for expectation in table.load_scene(table.SCENES / f"{name}.yaml").expect:
            matching_rows = [
                each for each in rows if each[0] == f"| `{name}`" and each[1] == f"`{expectation.quantity}`"
            ]
            assert matching_rows, (name, expectation.quantity)
    stored = table.json.loads(table.RESULTS.read_text(encoding="utf-8"))
    assert set(stored) <= set(table.names())
