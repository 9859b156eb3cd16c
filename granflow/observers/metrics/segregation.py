"""Intensity of segregation of two kinds of particles, by volume."""

import numpy as np

from granflow.observers.coarse_graining.field_grid import CoarseGrid


def segregation_intensity(position: np.ndarray, volume: np.ndarray, is_kind_a: np.ndarray, grid: CoarseGrid) -> float:
    """Return the intensity of segregation of particles at `position` (n, 3) [m] with volumes (n,) [m3].

        I = sum V_k (c_k - c)^2 / (c (1 - c) sum V_k)

    V_k: volume of the particles with centers in cell k; c_k, c: share by volume of the first kind (`is_kind_a` (n,)) in
    cell k and in all cells. 1: each cell contains one kind only; 0: the same share in all cells. No cell is excluded.
    NaN with one kind. (sigma^2 / (c (1 - c)) of P. V. Danckwerts, Appl. Sci. Res. A 3 (1952) 279, with samples
    weighted by their volume.)
    """
    cell, inside = grid.cells_of(position)
    total = np.bincount(cell[inside], weights=volume[inside], minlength=grid.cell_count)
    first = np.bincount(cell[inside], weights=(volume * is_kind_a)[inside], minlength=grid.cell_count)
    first, total = first[total > 0.0], total[total > 0.0]
    share = first.sum() / total.sum() if len(total) else np.nan
    segregated = share * (1.0 - share) * total.sum()
    if not segregated > 0.0:
        return float("nan")
    return float((total * (first / total - share) ** 2).sum() / segregated)


def random_intensity(position: np.ndarray, volume: np.ndarray, is_kind_a: np.ndarray, grid: CoarseGrid) -> float:
    """Return the expected intensity of segregation of a random mixture of the same particles in the same cells.

        I_R = K (c v_b + (1 - c) v_a) / sum V_k,      v_a, v_b = sum v^2 / sum v

    K: number of cells with particles; v_a, v_b: mean volumes of the particles of each kind, weighted by volume. In a
    random mixture, the volumes V_a and V_b in a cell are sums over independent particles, with the variances V_a v_a
    and V_b v_b. To first order, the variance of c = V_a / (V_a + V_b) = V_a / V is

        ((1 - c)^2 V_a v_a + c^2 V_b v_b) / V^2 = c (1 - c) (c v_b + (1 - c) v_a) / V

    For equal volumes v, it is that of Lacey, c (1 - c) v / V. Arguments as `segregation_intensity`; NaN with one kind.
    """
    cell, inside = grid.cells_of(position)
    volume, is_kind_a = volume[inside], is_kind_a[inside]
    if is_kind_a.all() or not is_kind_a.any():
        return float("nan")
    mean_a, mean_b = ((volume[kind] ** 2).sum() / volume[kind].sum() for kind in (is_kind_a, ~is_kind_a))
    share = volume[is_kind_a].sum() / volume.sum()
    return float(len(np.unique(cell[inside])) * (share * mean_b + (1.0 - share) * mean_a) / volume.sum())
