"""Search for close pairs of spheres with a cell list. numpy only.

The cells are cubes with an edge of the largest contact distance plus the reach, so that partners are in the
27 cells around a sphere. Packings, insertions and checks of given positions use the search.
"""

from collections.abc import Iterator
from itertools import product

import numpy as np

from granflow.geometry.rows import expanded


class CellKeys:
    """Cell keys of a grid, numbered row by row along x, with a margin of one cell.

    `low`, `high` (3,) [m]: corners of the grid; `cell` [m]: edge of a cell. The neighbors of a cell along x
    have the keys key - 1 and key + 1; because of the margin, no neighbor is in another row.
    """

    def __init__(self, low: np.ndarray, high: np.ndarray, cell: float) -> None:
        self.low = low
        self.cell = cell
        self.shape = np.floor((high - low) / cell).astype(np.int64) + 3

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """The key (n,) int64 of the cell of each point (n, 3) [m]; the points must lie between `low` and
        `high`."""
        x, y, z = np.floor((points - self.low) / self.cell).astype(np.int64).T + 1
        return x + self.shape[0] * (y + self.shape[1] * z)

    def adjacent_rows(self) -> list[int]:
        """Key offsets from a cell to the middle cells of the nine rows of three cells around it."""
        return [int(self.shape[0] * (y + self.shape[1] * z)) for y, z in product((-1, 0, 1), repeat=2)]


def near_pairs(position: np.ndarray, radius: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Indices (p,), (p,) of all pairs of spheres with a gap below `reach` [m], each pair once.

    `position` (n, 3) [m], `radius` (n,) [m]. Size classes with a factor of 2 between them keep the cells
    small if a few large spheres are mixed with many small ones. The order of the pairs, and of the two
    indices in a pair, depends on the size classes.
    """
    classes = list(size_classes(radius))
    found: list[np.ndarray] = [np.empty((2, 0), dtype=np.int64)]
    for class_index, larger in enumerate(classes):
        for smaller in classes[class_index:]:
            if smaller is larger:
                first, second = pairs_within(position[larger], radius[larger], reach)
            else:
                first, second = cross_pairs(
                    position[smaller], radius[smaller], position[larger], radius[larger], reach
                )
            found.append(np.stack([smaller[first], larger[second]]))
    first, second = np.concatenate(found, axis=1)
    return first, second


def size_classes(radius: np.ndarray) -> Iterator[np.ndarray]:
    """Indices (k,) of the spheres of each class, largest first; `radius` (n,) [m].

    Within a class radii differ by a factor of 2 at most. Empty without spheres.
    """
    if len(radius) == 0:
        return
    level = np.floor(np.log2(radius.max() / radius)).astype(int)
    for each in np.unique(level):
        yield np.flatnonzero(level == each)


def pairs_within(position: np.ndarray, radius: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Indices (p,), (p,) of all pairs of spheres with a gap below `reach` [m], each pair once, smaller index
    first.

    `position` (n, 3) [m], `radius` (n,) [m], n > 0. Visits the rest of the own row of cells and four of the
    eight adjacent rows. The pairs have the order in which the smaller indices find their partners in all nine
    rows.
    """
    key_of = CellKeys(position.min(axis=0), position.max(axis=0), 2 * radius.max() + reach)
    keys = key_of(position)
    count = len(position)
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    columns = np.ascontiguousarray(position[order].T)
    radius = radius[order]
    found = []
    places = []
    for row, shift in list(enumerate(key_of.adjacent_rows()))[4:]:
        start = (
            np.arange(1, count + 1) if shift == 0 else np.searchsorted(keys, keys + (shift - 1), side="left")
        )
        stop = np.searchsorted(keys, keys + (shift + 1), side="right")
        querying, entry = expanded(start, stop - start)
        one, other = close_pairs(columns, radius, columns, radius, reach, querying, entry)
        pair = np.stack([order[one], order[other]])
        reversed_pair = pair[0] > pair[1]
        found.append(np.where(reversed_pair, pair[::-1], pair))
        rows = np.where(reversed_pair, 8 - row, row)
        entries = np.where(reversed_pair, one, other)
        places.append((rows * count + found[-1][0]) * count + entries)
    first, second = np.concatenate(found, axis=1)[:, np.argsort(np.concatenate(places))]
    return first, second


def cross_pairs(
    first: np.ndarray, first_radius: np.ndarray, second: np.ndarray, second_radius: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Indices (p,), (p,) into the first and the second set of all pairs between them with a gap below `reach`
    [m].

    `first` (n, 3), `second` (m, 3) [m]: centers; radii (n,), (m,) [m]. A sphere in both sets is a pair with
    itself.
    """
    if len(first) == 0 or len(second) == 0:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    cell = first_radius.max() + second_radius.max() + reach
    low = np.minimum(first.min(axis=0), second.min(axis=0))
    key_of = CellKeys(low, np.maximum(first.max(axis=0), second.max(axis=0)), cell)
    keys = key_of(second)
    order = np.argsort(keys, kind="stable")
    columns = np.ascontiguousarray(first.T)
    other_columns = np.ascontiguousarray(second.T)
    found = [
        close_pairs(columns, first_radius, other_columns, second_radius, reach, *members)
        for members in cell_neighbors(key_of, key_of(first), keys[order], order)
    ]
    return np.concatenate([i for i, _ in found]), np.concatenate([j for _, j in found])


def overlaps_any(
    points: np.ndarray, radius: np.ndarray, others: np.ndarray, other_radius: np.ndarray
) -> np.ndarray:
    """Whether each sphere (n,) overlaps any of the others.

    `points` (n, 3), `others` (m, 3): centers [m]; `radius` (n,), `other_radius` (m,) [m].
    """
    overlaps = np.zeros(len(points), dtype=bool)
    first, _ = cross_pairs(points, radius, others, other_radius, 0.0)
    overlaps[first] = True
    return overlaps


def cell_neighbors(
    key_of: CellKeys, query: np.ndarray, keys: np.ndarray, order: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """For each of the nine rows: indices of the query points and of all members of the three cells in that
    row.

    `query` (n,): cell keys of the query points; `keys` (m,): sorted cell keys of the members; `order` (m,):
    index of the member with each sorted key. Each of the nine results is two arrays of equal length.
    """
    rank = np.empty(len(query), dtype=np.int64)
    ascending = np.argsort(query, kind="stable")
    rank[ascending] = np.arange(len(query))
    sorted_query = query[ascending]  # searchsorted is several times as fast with sorted queries
    for shift in key_of.adjacent_rows():
        start = np.searchsorted(keys, sorted_query + (shift - 1), side="left")[rank]
        count = np.searchsorted(keys, sorted_query + (shift + 1), side="right")[rank] - start
        querying, entry = expanded(start, count)
        yield querying, order[entry]


def close_pairs(
    first: np.ndarray,
    first_radius: np.ndarray,
    second: np.ndarray,
    second_radius: np.ndarray,
    reach: float,
    i: np.ndarray,
    j: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The pairs (i, j) with a gap below `reach` [m].

    `first`, `second` (3, n), (3, m) [m]: centers, one row for each coordinate; `i`, `j` (p,): indices of
    candidate pairs. Distances are compared as squares.
    """
    squared = sum((row[i] - other_row[j]) ** 2 for row, other_row in zip(first, second, strict=True))
    limit = first_radius[i] + second_radius[j] + reach
    close = squared < limit * limit
    return i[close], j[close]
