"""Deviations of a run from the targets, in tolerances, and a lower bound of the loss during the run.

    loss = sum of weight * r^2,    r = (simulated - measured) / tolerance

For a curve, r^2 is the mean over its points.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isfinite, sqrt
from pathlib import Path

import numpy as np

from granflow.errors import FileError
from granflow.fields import unit_of
from granflow.io.tables import read_table
from granflow.io.time_series import TimeSeriesTable, read_series
from granflow.scene.schema.units import UnitError, column_factor, split_heading, to_si
from granflow.studies.calibration.schema import Target
from granflow.studies.run_processes.outcome import numbers_of
from granflow.studies.run_processes.quantities import error_name

CURVE_COLUMNS = ("time", "value")
"""Columns of a file with a curve."""


@dataclass(frozen=True)
class Measured:
    """A target with its measured values: `time` (n,) [s] of a curve, or None for a single value; `value` (n,).

    `unit`: in which the file gives the value; empty: SI. `factor`: SI value of this unit. `position`: of the quantity
    in the file.
    """

    target: Target
    time: np.ndarray | None
    value: np.ndarray
    unit: str = ""
    factor: float = 1.0
    position: str = ""

    @property
    def digest(self) -> str:
        """SHA-256 of the measured times and values."""
        times = np.zeros(0) if self.time is None else self.time
        return hashlib.sha256(times.tobytes() + b"\n" + self.value.tobytes()).hexdigest()

    @property
    def scale(self) -> float:
        """Factor of a difference in its share of the residual: sqrt(weight / n) / tolerance."""
        return sqrt(self.target.weight / len(self.value)) / self.target.tolerance


def read_target(target: Target, folder: Path, position: str) -> Measured:
    """The target with its measured values; a curve is read from its file, relative to `folder`.

    `position`: of the curve or the quantity in the file, for messages. Raises FileError for an invalid table.
    """
    if target.value is not None:
        unit = target.value.unit
        factor = to_si(f"1 {unit}".strip(), "any")
        return Measured(target, None, np.array([target.value], dtype=float), unit, factor, position)
    assert target.curve is not None
    path = folder / target.curve
    try:
        table = read_table(path)
    except OSError as error:
        raise FileError(f"{position}: curve is {target.curve}, but {path} cannot be read: {error.strerror}.") from None
    headings = [split_heading(name) for name in table.names] if table else []
    names = [name for name, _ in headings]
    missing = [name for name in CURVE_COLUMNS if name not in names]
    if table is None or missing:
        raise FileError(f"{path}: there is no column {missing[0]}; the columns are time and value.")
    factors = []
    for name, si_unit in zip(CURVE_COLUMNS, ("s", unit_of(target.quantity)), strict=True):
        try:
            factors.append(column_factor(headings[names.index(name)][1], si_unit))
        except UnitError as error:
            what = target.quantity if name == "value" else name
            unit = f"is in {si_unit}" if si_unit else "has no unit"
            raise FileError(f"{path}:{table.heading_line}: {what} {unit}, and {error}.") from None
    time, value = (table.complete().numbers(names.index(name)) for name in CURVE_COLUMNS)
    time, value = time * factors[0], value * factors[1]
    if not (len(time) and np.isfinite(time).all() and np.isfinite(value).all() and (np.diff(time) > 0.0).all()):
        raise FileError(f"{path}: the rows must be numbers with increasing time; correct the table.")
    return Measured(target, time, value)


def residuals(measured: Measured, directory: Path) -> np.ndarray:
    """Weighted residuals (n,) of a completed run, whose squares add up to its share of the loss; nan if missing."""
    return (simulated(measured, directory) - measured.value) * measured.scale


def simulated(measured: Measured, directory: Path) -> np.ndarray:
    """Simulated values (n,) of a completed run; nan if it has no such number."""
    if measured.time is None:
        return np.array([numbers_of(directory).get(measured.target.quantity, np.nan)])
    series = read_series(directory / "timeseries.csv")
    return np.full(len(measured.value), np.nan) if series is None else _at_times(measured, series)


def standard_errors(measured: Measured, directory: Path) -> np.ndarray:
    """Standard errors (n,) of the weighted residuals of a completed run; 0 where it gives no error of its values.

    The error of `angle_of_repose.left` is `angle_of_repose_error.left`, that of `angle_of_repose_mean.left` is
    `angle_of_repose_error_mean.left`.
    """
    name = error_name(measured.target.quantity)
    named = replace(measured, target=measured.target.model_copy(update={"quantity": name}))
    return np.nan_to_num(simulated(named, directory)) * measured.scale


def partial_loss(measured: Measured, directory: Path) -> float:
    """Share of the loss that a curve has already in the time that the run has simulated; 0 for a single value.

    The loss at the end is at least as large.
    """
    if measured.time is None:
        return 0.0
    series = read_series(directory / "timeseries.csv")
    if series is None:
        return 0.0
    differences = (_at_times(measured, series) - measured.value) * measured.scale
    return float(np.nansum(differences**2))


def _at_times(measured: Measured, series: TimeSeriesTable) -> np.ndarray:
    """Values of the time series at the times of a curve (n,), interpolated linearly; nan after its end."""
    assert measured.time is not None
    columns = {column.name: column.values for column in series.columns}
    starts = {name: time for time, name in series.stages}
    stage, name = measured.target.stage, measured.target.quantity
    if name not in columns or (stage is not None and stage not in starts):
        return np.full(len(measured.time), np.nan)
    times = measured.time + (0.0 if stage is None else starts[stage])
    return np.interp(times, series.time, columns[name], right=np.nan)


def shown_value(measured: Measured, values: np.ndarray) -> float:
    """One number for a table: the value, or the root mean square difference of a curve from its measurement."""
    if measured.time is None:
        return float(values[0])
    return float(np.sqrt(np.mean((values - measured.value) ** 2)))


def deviation(measured: Measured, found: Mapping[str, list[float]], name: str) -> float:
    """Deviation of a target in tolerances, from the weighted residuals of a trial; infinite without numbers."""
    values = np.array(found.get(name, [np.inf]))
    size = float(np.sqrt((values**2).sum() / measured.target.weight))
    return size if isfinite(size) else float("inf")


def given_text(measured: Measured, value: float, quantity: str, digits: int = 5) -> str:
    """Text of a value [SI] of a target, with the unit in which the calibration gives the target, or its SI unit."""
    if measured.unit:
        return f"{value / measured.factor:.{digits}g} {measured.unit}"
    return f"{value:.{digits}g} {unit_of(quantity)}".rstrip()
