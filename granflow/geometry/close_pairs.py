"""Close pairs of spheres by the k-d tree of scipy, for packings, insertions and checks of positions."""

from collections.abc import Iterator

import numpy as np

ROUNDING = 1.0 + 1e-12
"""Factor of the distances in which the tree searches, so that its rounding loses no pair."""
FEW = 256
"""Up to this number of spheres, all pairs are compared: that takes less time than the import of the tree."""


def near_pairs(position: np.ndarray, radius: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Indices (p,), (p,) of all pairs of spheres with a gap below `reach` [m], each pair once.

    `position` (n, 3) [m], `radius` (n,) [m]. The pairs are in ascending order, the smaller index first. Size
    classes keep the distances small if a few large spheres are mixed with many small ones.
    """
    if len(radius) <= FEW:
        pairs = np.stack(np.triu_indices(len(radius), 1), axis=1)
    else:
        pairs = np.sort(_pairs_by_tree(position, radius, reach), axis=1)
    first, second = pairs[_are_close(position, radius, position, radius, reach, *pairs.T)].T
    order = np.lexsort((second, first))
    return first[order], second[order]


def _pairs_by_tree(position: np.ndarray, radius: np.ndarray, reach: float) -> np.ndarray:
    """Candidates (p, 2) for `near_pairs`."""
    from scipy.spatial import cKDTree  # imported here: small scenes do not need it to be checked

    classes = list(size_classes(radius))
    found = [np.empty((0, 2), dtype=np.int64)]
    for k, larger in enumerate(classes):
        distance = ROUNDING * (2 * radius[larger].max() + reach)
        found.append(larger[cKDTree(position[larger]).query_pairs(distance, output_type="ndarray")])
        for smaller in classes[k + 1 :]:
            i, j = _between(position[larger], radius[larger], position[smaller], radius[smaller], reach)
            found.append(np.stack([larger[i], smaller[j]], axis=1))
    return np.concatenate(found)


def overlaps_any(
    points: np.ndarray, radius: np.ndarray, others: np.ndarray, other_radius: np.ndarray
) -> np.ndarray:
    """Whether each sphere (n,) overlaps any of the others.

    `points` (n, 3), `others` (m, 3): centers [m]; `radius` (n,), `other_radius` (m,) [m].
    """
    overlaps = np.zeros(len(points), dtype=bool)
    for own in size_classes(radius):
        for each in size_classes(other_radius):
            i, _ = _between(points[own], radius[own], others[each], other_radius[each], 0.0)
            overlaps[own[i]] = True
    return overlaps


def size_classes(radius: np.ndarray) -> Iterator[np.ndarray]:
    """Indices (k,) of the spheres of each class, largest first; `radius` (n,) [m].

    Within a class radii differ by a factor of 2 at most. Empty without spheres.
    """
    if len(radius) == 0:
        return
    level = np.floor(np.log2(radius.max() / radius)).astype(int)
    for each in np.unique(level):
        yield np.flatnonzero(level == each)


def _between(
    first: np.ndarray, first_radius: np.ndarray, second: np.ndarray, second_radius: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Indices (p,), (p,) into two sets of spheres of all pairs between them with a gap below `reach` [m]."""
    from scipy.spatial import cKDTree

    distance = ROUNDING * (first_radius.max() + second_radius.max() + reach)
    near = cKDTree(first).sparse_distance_matrix(cKDTree(second), distance, output_type="ndarray")
    i, j = near["i"], near["j"]
    close = _are_close(first, first_radius, second, second_radius, reach, i, j)
    return i[close], j[close]


def _are_close(
    first: np.ndarray,
    first_radius: np.ndarray,
    second: np.ndarray,
    second_radius: np.ndarray,
    reach: float,
    i: np.ndarray,
    j: np.ndarray,
) -> np.ndarray:
    """Whether each candidate pair (i, j) has a gap below `reach` [m]; distances are compared as squares."""
    squared = sum((first[i, axis] - second[j, axis]) ** 2 for axis in range(3))
    limit = first_radius[i] + second_radius[j] + reach
    return np.asarray(squared < limit * limit)
