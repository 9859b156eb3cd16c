"""Compressed rows: row k of a table has the entries start[k] to start[k + 1] - 1. numpy only."""

import numpy as np


def starts_of(sorted_numbers: np.ndarray, count: int) -> np.ndarray:
    """Start (count + 1,) of each of the numbers 0 to `count` - 1 in a sorted array."""
    return np.searchsorted(sorted_numbers, np.arange(count + 1))


def row_entries(start: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All entries of the rows `wanted` (n,): positions in `wanted` (r,), ascending, and entries (r,)."""
    return expanded(start[wanted], start[wanted + 1] - start[wanted])


def expanded(first: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of n ranges (n,), (n,): indices of the ranges (r,), and numbers (r,) from `first` on."""
    index = np.repeat(np.arange(len(count)), count)
    rank = np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count)
    return index, first[index] + rank
