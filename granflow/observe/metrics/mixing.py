"""How well two kinds of grains are mixed."""

import numpy as np

from granflow.observe.coarse_graining.field_grid import CoarseGrid


def lacey_index(position: np.ndarray, is_kind_a: np.ndarray, grid: CoarseGrid, at_least: int) -> float:
    """Lacey's mixing index of grains at `position` (n, 3) [m], `is_kind_a` (n,) telling those of the one kind.

        M = (S0^2 - S^2) / (S0^2 - SR^2),   S^2 = sum n_k (p_k - p)^2 / sum n_k,   S0^2 = p (1 - p),   SR^2 = S0^2 / n

    p_k is the share by number of the kind among the n_k grains of cell k, p that of all, n the mean of n_k; cells with
    fewer than `at_least` grains are left out. 0: each cell has grains of one kind alone; 1: as if drawn at random, up
    to chance; above 1: more even than that. Not a number where there are no such cells, or one kind alone.
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
