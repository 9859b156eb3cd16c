"""Lacey's mixing index of two kinds of particles, by number."""

import numpy as np

from granflow.observers.coarse_graining.field_grid import CoarseGrid


def lacey_index(position: np.ndarray, is_kind_a: np.ndarray, grid: CoarseGrid, at_least: int) -> float:
    """Return Lacey's mixing index of particles at `position` (n, 3) [m]; `is_kind_a` (n,): whether of the first kind.

        M = (S0^2 - S^2) / (S0^2 - SR^2),   S^2 = sum n_k (p_k - p)^2 / sum n_k,   S0^2 = p (1 - p),   SR^2 = S0^2 / n

    p_k is the share by number of the first kind among the n_k particles of cell k, p the share in all cells, n the mean
    of n_k; cells with fewer than `at_least` particles are excluded. 0: each cell contains one kind only; 1: randomly
    mixed, except for statistical scatter; above 1: more uniform than random. NaN without such cells or with one kind.
    (P. M. C. Lacey, J. Appl. Chem. 4 (1954) 257.)
    """
    cell, inside = grid.cells_of(position)
    number = np.bincount(cell[inside], minlength=grid.cell_count)
    kind = np.bincount(cell[inside], weights=is_kind_a[inside], minlength=grid.cell_count)
    used = number >= max(at_least, 1)
    number, kind = number[used], kind[used]
    total = number.sum()
    share = kind.sum() / total if total else np.nan
    segregated = share * (1.0 - share)
    mixed = segregated * len(number) / total if total else np.nan
    if not segregated > mixed:
        return float("nan")
    found = (number * (kind / number - share) ** 2).sum() / total
    return float((segregated - found) / (segregated - mixed))


def dropped_share(position: np.ndarray, is_kind_a: np.ndarray, grid: CoarseGrid, at_least: int) -> float:
    """Return the share by number of the particles of one kind that `lacey_index` excludes, the larger of both kinds.

    Arguments as `lacey_index`. 0 without particles in the grid.
    """
    cell, inside = grid.cells_of(position)
    number = np.bincount(cell[inside], minlength=grid.cell_count)
    is_dropped, is_kind_a = number[cell[inside]] < at_least, is_kind_a[inside]
    return max((float(is_dropped[kind].mean()) for kind in (is_kind_a, ~is_kind_a) if kind.any()), default=0.0)
