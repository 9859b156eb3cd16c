"""Columns of numbers by name, such as the rows of a time series, as numpy arrays or as a pandas DataFrame."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from granflow.errors import GranflowError

if TYPE_CHECKING:
    from pandas import DataFrame


class Columns(Mapping[str, np.ndarray]):
    """Columns of equal length by name, (rows,) each, in SI units; `units`: unit by name, "" for a number.

    >>> import granflow as gf
    >>> columns = gf.read_run("out/two").timeseries_arrays
    >>> round(columns["time"][-1].item(), 3), columns.units["kinetic_energy"]
    (0.02, 'J')
    """

    def __init__(self, arrays: Mapping[str, np.ndarray], units: Mapping[str, str]) -> None:
        self._arrays, self.units = dict(arrays), dict(units)

    def __getitem__(self, name: str) -> np.ndarray:
        return self._arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __repr__(self) -> str:
        """Number of rows and names of the columns."""
        rows = len(next(iter(self._arrays.values()), ()))
        return f"<Columns: {rows} rows of {', '.join(self._arrays)}>"

    def part(self, name: str) -> "Columns":
        """The columns of one flow meter, wall or metric by quantity, with `time` and `stage`; empty without such."""
        found = {key.partition(".")[0]: key for key in self._arrays if key.partition(".")[2] == name}
        keys = {key: key for key in ("time", "stage") if key in self._arrays} | found if found else {}
        return Columns(
            {quantity: self._arrays[key] for quantity, key in keys.items()},
            {quantity: self.units[key] for quantity, key in keys.items()},
        )

    def to_pandas(self) -> "DataFrame":
        """The columns as a pandas DataFrame; `attrs["units"]` has the units. Raises GranflowError without pandas."""
        try:
            import pandas
        except ImportError:
            raise GranflowError(
                "A DataFrame requires pandas, which is not installed: pip install pandas, or use the numpy "
                "arrays of timeseries_arrays."
            ) from None
        frame = pandas.DataFrame(dict(self._arrays))
        frame.attrs["units"] = dict(self.units)
        return frame
