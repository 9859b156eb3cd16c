"""Trials of a calibration: the runs of all scenes with the parameters of the trial, and the loss.

    loss = sum of weight * r^2,    r = (simulated - measured) / tolerance

`Measured` is a target with its measured values; for a curve, r^2 is the mean over its points. `TrialRunner`
runs trials and compares the runs with the targets, also while they run: a trial whose loss already exceeds
the median of the earlier ones is stopped early.
"""

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite, sqrt
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from granflow.errors import FileError, GranflowError, SceneError
from granflow.io.tables import TimeSeriesTable, read_series, read_table
from granflow.scene.blocks.output import unit_of
from granflow.studies.calibration.schema import CalibrationInput, Target, from_unit, settings_of
from granflow.studies.calibration.search import FIRST_RANDOM, Search
from granflow.studies.checked_run import CheckedRun, RunSettings, checked_run, relocated
from granflow.studies.run_process import (
    NOT_RUN,
    Outcome,
    error_name,
    execute,
    numbers_of,
    reason_without,
    warnings_of,
)
from granflow.studies.sweep_table import standard_error_of_mean
from granflow.units import UnitError, column_factor, factor_of, split_heading

# Targets with their measured values


@dataclass(frozen=True)
class Measured:
    """A target with its measured values.

    time (n,):   times of a curve [s]; None for a single value
    value (n,):  measured values [SI]
    unit:        in which the file gives the value; empty: SI
    factor:      SI value of this unit
    position:    of the quantity in the file, for messages
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


CURVE_COLUMNS = ("time", "value")
"""Columns of a file with a curve."""


def _is_curve(names: Sequence[str]) -> bool:
    return {split_heading(name)[0] for name in names} >= set(CURVE_COLUMNS)


def read_target(target: Target, folder: Path, position: str) -> Measured:
    """The target with its measured values; a curve is read from its file, relative to `folder`.

    `position`: of the curve or the quantity in the file, for messages. Raises FileError for an invalid table.
    """
    if target.value is not None:
        unit = target.value.unit
        factor = factor_of(unit, "any")
        return Measured(target, None, np.array([target.value], dtype=float), unit, factor, position)
    assert target.curve is not None
    path = folder / target.curve
    try:
        table = read_table(path, _is_curve)
    except OSError as error:
        raise FileError(
            f"{position}: curve is {target.curve}, but {path} cannot be read: {error.strerror}."
        ) from None
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
    time = time * factors[0]
    value = value * factors[1]
    if not (
        len(time) and np.isfinite(time).all() and np.isfinite(value).all() and (np.diff(time) > 0.0).all()
    ):
        raise FileError(f"{path}: the rows must be numbers with increasing time; correct the table.")
    return Measured(target, time, value)


def residuals(measured: Measured, values: np.ndarray) -> np.ndarray:
    """Weighted residuals (n,) of simulated values (n,), whose squares add up to their share of the loss."""
    return np.asarray((values - measured.value) * measured.scale)


def simulated(measured: Measured, directory: Path) -> np.ndarray:
    """Simulated values (n,) of a completed run; nan if it has no such number."""
    if measured.time is None:
        return np.array([numbers_of(directory).get(measured.target.quantity, np.nan)])
    series = read_series(directory / "timeseries.csv")
    return np.full(len(measured.value), np.nan) if series is None else _at_times(measured, series)


def standard_errors(measured: Measured, values: np.ndarray, directories: Sequence[Path]) -> np.ndarray:
    """Standard errors (n,) of the weighted residuals of the mean over completed runs with different seeds.

    values:   (runs, n) simulated values
    Returns:  see `standard_error_of_mean`; 0 for a single run that gives no error of its values. The error of
              `angle_of_repose.left` is `angle_of_repose_error.left`, that of `angle_of_repose_mean.left` is
              `angle_of_repose_error_mean.left`.
    """
    name = error_name(measured.target.quantity)
    named = replace(measured, target=measured.target.model_copy(update={"quantity": name}))
    errors = np.array([simulated(named, each) for each in directories])
    known = [column[np.isfinite(column)].tolist() for column in errors.T]
    found = [standard_error_of_mean(each.tolist(), own) for each, own in zip(values.T, known, strict=True)]
    return np.nan_to_num(found) * measured.scale


def partial_loss(measured: Measured, directory: Path) -> float:
    """Share of the loss that a curve has already in the time that the run has simulated.

    It is 0 for a single value. The loss at the end is at least as large.
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
    stage = measured.target.stage
    name = measured.target.quantity
    if name not in columns or (stage is not None and stage not in starts):
        return np.full(len(measured.time), np.nan)
    times = measured.time + (0.0 if stage is None else starts[stage])
    return np.interp(times, series.time, columns[name], right=np.nan)


def shown_value(measured: Measured, values: np.ndarray) -> float:
    """One number for a table: the value, or the root mean square difference of a curve from its
    measurement."""
    if measured.time is None:
        return float(values[0])
    return float(np.sqrt(np.mean((values - measured.value) ** 2)))


def deviation(measured: Measured, found: Mapping[str, list[float]], name: str) -> float:
    """Deviation of a target in tolerances, from the weighted residuals of a trial.

    It is infinite without numbers.
    """
    values = np.array(found.get(name, [np.inf]))
    size = float(np.sqrt((values**2).sum() / measured.target.weight))
    return size if isfinite(size) else float("inf")


def given_text(measured: Measured, value: float, quantity: str, digits: int = 5) -> str:
    """Text of a value [SI] of a target, with the unit in which the calibration gives the target, or its SI
    unit."""
    if measured.unit:
        return f"{value / measured.factor:.{digits}g} {measured.unit}"
    return f"{value:.{digits}g} {unit_of(quantity)}".rstrip()


# Trials

CHECK_INTERVAL = 2.0
"""Interval [s] at which the time series of a run is compared with the targets."""


class TrialStopped(Exception):
    """The calibration stops; the trial remains open and is repeated when it continues."""


class Unpromising(Exception):
    """The loss of the trial is already above the limit."""


class TrialFailed(Exception):
    """The trial has no loss; the message gives the reason."""


def checked_scene(
    calibration: CalibrationInput,
    scene: str,
    path: Path,
    targets: Mapping[str, Measured],
    values: Mapping[str, float],
    common: RunSettings,
    seed_offset: int = 0,
) -> CheckedRun:
    """A checked run of a scene of a calibration with values of the parameters by name, and the seed of the
    scene plus `seed_offset`; raises as `checked_run`."""
    own = [each for each in targets.values() if each.target.scene == scene and each.time is None]
    read = {each.target.quantity: each.position for each in own}
    return checked_run(path, settings_of(calibration, scene, values), read, common, seed_offset)


@dataclass(frozen=True)
class TrialRunner:
    """Runs trials. `scenes`: scene files by name; `positions`: of keys in the calibration file, for messages.

    `stop`: function that returns True when the calibration stops.
    """

    search: Search
    scenes: Mapping[str, Path]
    targets: Mapping[str, Measured]
    positions: Mapping[str, str]
    common: RunSettings
    stop: Callable[[], bool]

    @property
    def _calibration(self) -> CalibrationInput:
        return self.search.calibration

    def check(self) -> None:
        """Check all scenes with the middle values of the parameters, and that they are those of all earlier
        trials.

        Curves are compared as they were read at the start. Raises GranflowError with the reason of the first
        refusal.
        """
        middle = {name: from_unit(each, 0.5) for name, each in self._calibration.parameters.items()}
        inputs = {}
        for scene in self.scenes:
            try:
                name = f"the scene {scene} ({self._calibration.scenes[scene].scene})"
                inputs[name] = self._checked(scene, middle).directory.name
            except SceneError as error:
                raise relocated(error, self.positions) from None
        curves = {name: each for name, each in self.targets.items() if each.time is not None}
        inputs |= {f"the curve of {name} ({each.target.curve})": each.digest for name, each in curves.items()}
        self.search.refuse_changed(inputs)

    def _checked(self, scene: str, values: Mapping[str, float], seed_offset: int = 0) -> CheckedRun:
        """A checked run of a scene."""
        path = self.scenes[scene]
        return checked_scene(self._calibration, scene, path, self.targets, values, self.common, seed_offset)

    def _targets_of(self, scene: str) -> dict[str, Measured]:
        """The targets of a scene by name."""
        return {name: each for name, each in self.targets.items() if each.target.scene == scene}

    def run(self, trial: Any) -> str:
        """Run a trial, record its loss, and return its state in words; the trial remains open if all stop."""
        states = self.search.optuna.trial.TrialState
        try:
            loss = self._loss(trial)
        except TrialStopped:
            return "stopped"
        except Unpromising:
            self.search.study.tell(trial, state=states.PRUNED)
            return "stopped early"
        except (TrialFailed, GranflowError) as error:
            trial.set_user_attr("reason", str(error))
            self.search.study.tell(trial, state=states.FAIL)
            return f"failed: {error}"
        self.search.study.tell(trial, loss)
        return f"loss {loss:.4g}"

    def _loss(self, trial: Any) -> float:
        """The loss of a trial, that of the means over its seeds.

        Residuals, simulated values and run directories become attributes of the trial.
        """
        limit = self._limit()
        found: dict[str, list[float]] = {}
        shown: dict[str, float] = {}
        errors: dict[str, list[float]] = {}
        warnings: list[str] = []
        for number, scene in enumerate(self.scenes):
            runs = [
                self._checked(scene, trial.params, offset) for offset in range(self._calibration.repeat.seeds)
            ]
            directories = [run.directory for run in runs]
            trial.set_user_attr(f"run.{scene}", " ".join(each.name for each in directories))
            before = sum(float(np.sum(np.square(each))) for each in found.values())
            try:
                for run in runs:
                    self._carry_out(trial, number, run, scene, before, limit)
            except Unpromising:
                self._record(trial, found, shown, errors)
                raise
            sentences = [sentence for each in directories for sentence in warnings_of(each)]
            warnings += [f"{scene}: {sentence}" for sentence in dict.fromkeys(sentences)]
            trial.set_user_attr("warnings", warnings)
            for name, measured in self._targets_of(scene).items():
                values = np.array([simulated(measured, each) for each in directories])
                lacking = np.flatnonzero(~np.isfinite(values).all(axis=1))
                if len(lacking):
                    raise TrialFailed(_missing_reason(name, measured, directories[lacking[0]]))
                mean = values.mean(axis=0)
                errors[name] = standard_errors(measured, values, directories).tolist()
                found[name] = residuals(measured, mean).tolist()
                shown[name] = shown_value(measured, mean)
        self._record(trial, found, shown, errors)
        return sum(float(np.sum(np.square(each))) for each in found.values())

    def _record(
        self,
        trial: Any,
        found: Mapping[str, list[float]],
        shown: Mapping[str, float],
        errors: Mapping[str, list[float]],
    ) -> None:
        """Make the weighted residuals, simulated values and standard errors so far attributes of the
        trial."""
        known = [name for name in self.targets if name in found]
        trial.set_user_attr("residuals", {name: found[name] for name in known})
        trial.set_user_attr("simulated", dict(shown))
        trial.set_user_attr("errors", {name: errors[name] for name in known})

    def _limit(self) -> float:
        """Loss above which a trial is stopped: the median of the completed trials.

        It is infinite for the first ones.
        """
        losses = [trial.value for trial in self.search.completed()]
        return median(losses) if len(losses) >= FIRST_RANDOM else float("inf")

    def _carry_out(
        self, trial: Any, number: int, run: CheckedRun, scene: str, before: float, limit: float
    ) -> None:
        """Run a scene to its end, unless the calibration stops or the loss exceeds the limit.

        `before`: loss of the scenes before; `number`: of the scene in the trial. Raises TrialStopped,
        Unpromising, or TrialFailed.
        """
        checked_at = time.monotonic()
        bound = before

        def is_unpromising() -> bool:
            nonlocal checked_at, bound
            if time.monotonic() - checked_at > CHECK_INTERVAL:
                checked_at = time.monotonic()
                if self._calibration.repeat.seeds == 1:  # one run bounds the loss of no mean
                    bound = before + sum(
                        partial_loss(each, run.directory) for each in self._targets_of(scene).values()
                    )
            return bound > limit

        if bound <= limit:
            outcome = execute(run.request, lambda: self.stop() or is_unpromising())
            self._raise_unless_completed(outcome)
        if bound > limit:
            trial.report(bound, number)
            raise Unpromising

    def _raise_unless_completed(self, outcome: Outcome) -> None:
        """Raise TrialFailed for a run without a result, and TrialStopped if the calibration stops."""
        if outcome.status == NOT_RUN:
            if (
                self.stop() or outcome.reason
            ):  # with a reason: an input has changed, which the next check reports
                raise TrialStopped
        elif not outcome.has_numbers:
            raise TrialFailed(f"{outcome.status}: {outcome.reason}")


def _missing_reason(name: str, measured: Measured, directory: Path) -> str:
    """Why a completed run has no value for the target `name`: with the warnings of the run on its metric."""
    quantity = measured.target.quantity
    if measured.time is not None:
        return f"{directory}: {quantity} is NaN, or missing, at some time of the target {name}."
    return f"{directory}: target {name}: {reason_without(quantity, directory)}"
