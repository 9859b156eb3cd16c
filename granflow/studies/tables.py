"""Numbers as text, and CSV tables of studies."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granflow.io.tables import write_table


class PageTable(NamedTuple):
    """Column headings, rows of cells, and a caption if the page has none for it."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""


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
    write_table(
        path, columns, zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
    )


def attribute_columns(items: Iterable[Any], names: Iterable[str]) -> dict[str, np.ndarray]:
    """Columns with one row per item and one column per attribute."""
    items = list(items)
    return {name: np.array([getattr(each, name) for each in items]) for name in names}


def stacked(names: Sequence[str], parts: Iterable[Sequence[Any]]) -> dict[str, np.ndarray]:
    """Columns from parts that follow each other; a part has an array (rows,) or a constant for each name."""
    blocks = [np.broadcast_arrays(*part) for part in parts]
    return {
        name: np.concatenate([block[k] for block in blocks] or [np.empty(0)]) for k, name in enumerate(names)
    }


def without_empty_ends(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> PageTable:
    """A table of a page without those of its last two columns, reasons and warnings, that are empty."""
    kept = [k for k in range(len(heads)) if k < len(heads) - 2 or any(row[k] for row in rows)]
    return PageTable([heads[k] for k in kept], [[row[k] for k in kept] for row in rows])
