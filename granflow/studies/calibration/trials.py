"""One trial: the runs of all scenes with the parameters of the trial, and its loss."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from granflow.errors import GranflowError, SceneError
from granflow.studies.calibration.schema import CalibrationInput
from granflow.studies.calibration.search import FIRST_RANDOM, Search, from_unit, settings_of
from granflow.studies.calibration.targets import (
    Measured,
    partial_loss,
    residuals,
    shown_value,
    simulated,
    standard_errors,
)
from granflow.studies.run_processes.checked import CheckedRun, RunSettings, checked_run
from granflow.studies.run_processes.outcome import NOT_RUN, Outcome, reason_without, warnings_of
from granflow.studies.run_processes.process import execute
from granflow.studies.run_processes.settings import relocated

CHECK_INTERVAL = 2.0
"""Interval [s] at which the time series of a run is compared with the targets."""


class TrialStopped(Exception):
    """The calibration stops; the trial remains open and is repeated when it continues."""


class Unpromising(Exception):
    """The loss of the trial is already above the limit."""


class TrialFailed(Exception):
    """The trial has no loss; the message gives the reason."""


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
        """Check all scenes with the middle values of the parameters, and that they are those of all earlier trials.

        Curves are compared as they were read at the start. Raises GranflowError with the reason of the first refusal.
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

    def _checked(self, scene: str, values: Mapping[str, float]) -> CheckedRun:
        """A checked run of a scene."""
        settings = settings_of(self._calibration, scene, values)
        targets = self._targets_of(scene).values()
        read = {each.target.quantity: each.position for each in targets if each.time is None}
        return checked_run(self.scenes[scene], settings, read, self.common)

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
        """The loss of a trial; residuals, simulated values and run directories become attributes of the trial."""
        limit = self._limit()
        found: dict[str, list[float]] = {}
        shown: dict[str, float] = {}
        errors: dict[str, list[float]] = {}
        warnings: list[str] = []
        for number, scene in enumerate(self.scenes):
            run = self._checked(scene, trial.params)
            trial.set_user_attr(f"run.{scene}", run.directory.name)
            before = sum(float(np.sum(np.square(each))) for each in found.values())
            try:
                self._carry_out(trial, number, run, scene, before, limit)
            except Unpromising:
                self._record(trial, found, shown, errors)
                raise
            warnings += [f"{scene}: {sentence}" for sentence in warnings_of(run.directory)]
            trial.set_user_attr("warnings", warnings)
            for name, measured in self._targets_of(scene).items():
                values = simulated(measured, run.directory)
                if not np.isfinite(values).all():
                    raise TrialFailed(_missing_reason(name, measured, run.directory))
                errors[name] = standard_errors(measured, run.directory).tolist()
                found[name] = residuals(measured, run.directory).tolist()
                shown[name] = shown_value(measured, values)
        self._record(trial, found, shown, errors)
        return sum(float(np.sum(np.square(each))) for each in found.values())

    def _record(
        self, trial: Any, found: Mapping[str, list[float]], shown: Mapping[str, float],
        errors: Mapping[str, list[float]],
    ) -> None:  # fmt: skip
        """Make the weighted residuals, simulated values and standard errors so far attributes of the trial."""
        known = [name for name in self.targets if name in found]
        trial.set_user_attr("residuals", {name: found[name] for name in known})
        trial.set_user_attr("simulated", dict(shown))
        trial.set_user_attr("errors", {name: errors[name] for name in known})

    def _limit(self) -> float:
        """Loss above which a trial is stopped: the median of the completed trials; infinite for the first ones."""
        losses = [trial.value for trial in self.search.completed()]
        return median(losses) if len(losses) >= FIRST_RANDOM else float("inf")

    def _carry_out(self, trial: Any, number: int, run: CheckedRun, scene: str, before: float, limit: float) -> None:
        """Run a scene to its end, unless the calibration stops or the loss exceeds the limit.

        `before`: loss of the scenes before; `number`: of the scene in the trial. Raises TrialStopped, Unpromising, or
        TrialFailed.
        """
        checked_at, bound = time.monotonic(), before

        def is_unpromising() -> bool:
            nonlocal checked_at, bound
            if time.monotonic() - checked_at > CHECK_INTERVAL:
                checked_at = time.monotonic()
                bound = before + sum(partial_loss(each, run.directory) for each in self._targets_of(scene).values())
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
            if self.stop() or outcome.reason:  # with a reason: an input has changed, which the next check reports
                raise TrialStopped
        elif not outcome.has_numbers:
            raise TrialFailed(f"{outcome.status}: {outcome.reason}")


def _missing_reason(name: str, measured: Measured, directory: Path) -> str:
    """Why a completed run has no value for the target `name`: with the warnings of the run on its metric."""
    quantity = measured.target.quantity
    if measured.time is not None:
        return f"{directory}: {quantity} is NaN, or missing, at some time of the target {name}."
    return f"{directory}: target {name}: {reason_without(quantity, directory)}"
