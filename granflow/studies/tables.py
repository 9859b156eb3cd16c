"""Numbers as text, and CSV tables of studies."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

Table = tuple[Sequence[str], Sequence[Sequence[str]]]
"""Column headings and rows of cells."""


def percent(share: float) -> str:
    """A fraction in percent with two digits, for example 0.5 %, 12 % or 3e−05 %."""
    value = 100.0 * share
    if value == 0.0 or value >= 10.0:
        return f"{value:.0f} %"
    return f"{value:.2g} %" if value >= 1e-4 else f"{value:.0e} %".replace("-", "−")


def write_columns(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns of equal length as CSV with a header line, numbers in full precision.

    `columns`: name -> array (rows,). Raises ValueError for columns of different length.
    """
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True))
