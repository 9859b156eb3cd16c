"""The search: trials that several workers share through a journal in the folder of the calibration."""

import json
import os
import socket
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from math import log
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.special import stdtrit

from granflow.errors import GranflowError
from granflow.io.files import replacing
from granflow.io.lock import locked
from granflow.studies.calibration.schema import CalibrationInput, Parameter
from granflow.units import in_si

# Polynomial responses of the residuals to the parameters, fitted to trials by least squares.
#
# Each residual r is a polynomial of the parameters u, scaled to [0, 1]; s is the standard deviation of the
# residual about the fit (scatter between runs), at least the root mean square of the standard errors that
# the runs give for their values.

LEVEL = 0.0027
"""Significance level of effects and slopes, two-sided: 3 standard deviations of a normal distribution."""
SURPLUS = 1.5
"""Smallest ratio of the number of trials to that of the coefficients."""
EXACT = 1e-9
"""Smallest standard deviation of a residual: the scatter of exact polynomials is 0."""


@dataclass(frozen=True)
class Response:
    """Fitted residuals: coefficients (terms, residuals), covariance factor (terms, terms), scatter
    (residuals,).

    `freedom`: number of trials less that of the terms.
    """

    degree: int
    coefficients: np.ndarray
    spread: np.ndarray
    scatter: np.ndarray
    freedom: int

    @property
    def least_ratio(self) -> float:
        """Smallest significant ratio of a slope to its standard error: quantile of Student's t, 3 for many
        trials."""
        return float(stdtrit(self.freedom, 1.0 - LEVEL / 2.0))

    def at(self, u: np.ndarray) -> np.ndarray:
        """Residuals (residuals,) at parameters u (d,)."""
        return np.asarray(terms(u[None, :], self.degree)[0] @ self.coefficients)

    def gradient(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (residuals, d) at u (d,), and its standard errors."""
        slopes = _term_slopes(u, self.degree)
        errors = np.sqrt(np.einsum("it,ts,is->i", slopes, self.spread, slopes))
        return (slopes @ self.coefficients).T, np.outer(self.scatter, errors)

    def optimum(self, start: np.ndarray) -> np.ndarray:
        """Parameters (d,) in [0, 1] with the smallest sum of squared residuals, found from `start`."""
        return optimum_of(self.at, start)


def optimum_of(residuals_at: Callable[[np.ndarray], np.ndarray], start: np.ndarray) -> np.ndarray:
    """Parameters (d,) in [0, 1] with the smallest sum of squared residuals, found from `start`.

    residuals_at:  function of parameters (d,) that returns residuals (residuals,)
    """
    return np.asarray(least_squares(residuals_at, np.clip(start, 1e-6, 1.0 - 1e-6), bounds=(0.0, 1.0)).x)


def fewest_trials(count: int, degree: int = 1) -> int:
    """Smallest number of trials for a fit of `degree` with `count` parameters."""
    return int(np.ceil(SURPLUS * terms(np.zeros((1, count)), degree).shape[1])) + 1


def fit_response(u: np.ndarray, residuals: np.ndarray, best: int) -> Response | None:
    """Fit residuals (trials, residuals) over parameters u (trials, d), near trial `best`; None with too few
    trials.

    The degree is 2 if the trials suffice for it, else 1. The trials are those of `nearest_trials`.
    """
    degree = highest_degree(*u.shape)
    if degree == 0:
        return None
    near = nearest_trials(u, best, degree)
    return fit(u[near], residuals[near], degree)


def highest_degree(trials: int, count: int) -> int:
    """Highest degree, 2 or 1, for which the trials suffice with `count` parameters; 0 if there is none."""
    return next((degree for degree in (2, 1) if trials >= fewest_trials(count, degree)), 0)


def nearest_trials(u: np.ndarray, best: int, degree: int) -> np.ndarray:
    """Indices of the half of the trials nearest to the best one, or of as many as a fit of `degree` needs."""
    return by_distance(u, best)[: max(fewest_trials(u.shape[1], degree), len(u) // 2)]


def by_distance(u: np.ndarray, best: int) -> np.ndarray:
    """Indices of all trials in the order of their distance from the best one."""
    return np.argsort(((u - u[best]) ** 2).sum(axis=1), kind="stable")


def fit(u: np.ndarray, residuals: np.ndarray, degree: int, errors: np.ndarray | None = None) -> Response:
    """Least squares of all residuals (trials, residuals) with the same terms.

    `errors`: standard errors of the residuals (trials, residuals); the scatter about the fit is at least as
    large.
    """
    matrix = terms(u, degree)
    inverse = np.linalg.pinv(matrix)
    coefficients = inverse @ residuals
    freedom = len(u) - matrix.shape[1]
    scatter = np.sqrt(((residuals - matrix @ coefficients) ** 2).sum(axis=0) / freedom)
    if errors is not None:
        scatter = np.maximum(scatter, np.sqrt((errors**2).mean(axis=0)))
    return Response(degree, coefficients, inverse @ inverse.T, np.maximum(scatter, EXACT), freedom)


def terms(u: np.ndarray, degree: int) -> np.ndarray:
    """Terms (n, terms) of a polynomial at u (n, d): 1, u_i, and for degree 2 u_i u_j."""
    columns = [np.ones(len(u)), *u.T]
    if degree == 2:
        columns += [u[:, i] * u[:, j] for i, j in combinations_with_replacement(range(u.shape[1]), 2)]
    return np.column_stack(columns)


def _term_slopes(u: np.ndarray, degree: int) -> np.ndarray:
    """Derivatives (d, terms) of the terms at u (d,)."""
    d = len(u)
    unit = np.eye(d)
    columns = [np.zeros(d), *unit]
    if degree == 2:
        columns += [unit[i] * u[j] + unit[j] * u[i] for i, j in combinations_with_replacement(range(d), 2)]
    return np.column_stack(columns)


JOURNAL = "trials.journal"
"""File with all trials."""
LOCK_GRACE = 10
"""Time [s] after which the lock of the journal is that of a killed process; others hold it for some
milliseconds."""
REFINED_SHARE = 0.3
"""Share of the trials, the last ones, that evaluate the optimum of the fitted response instead of a sampled
point."""
NEW_POINT = 1e-3
"""Smallest distance of a refined point from all trials, in the scaled parameters; a closer one would add
nothing."""
FIRST_RANDOM = 10
"""Trials with random parameters before the sampler learns from them."""


class Search:
    """Trials of a calibration. Methods may be called from several threads, and several processes share the
    journal."""

    def __init__(self, calibration: CalibrationInput, out: Path) -> None:
        self.optuna = require_optuna(calibration.search.method)
        self.calibration = calibration
        self._out = out
        self.worker = f"{socket.gethostname()}-{os.getpid()}"
        journal = self.optuna.storages.journal
        path = str(out / JOURNAL)
        # Not the default lock: with a relative path it waits for ever for the lock of a killed process.
        lock = journal.JournalFileOpenLock(path, LOCK_GRACE)
        backend = _journal_of(journal, path, lock)
        storage = self.optuna.storages.JournalStorage(backend)
        self.study = self.optuna.create_study(study_name="calibration", storage=storage, load_if_exists=True)
        self._refuse_other(calibration)
        self.study.sampler = self._sampler(len(self.study.get_trials(deepcopy=False)))

    @property
    def lock(self) -> Path:
        """Directory that is locked while this process works, so that others recognize its trials as alive."""
        return self._out / "workers" / self.worker

    def _refuse_other(self, calibration: CalibrationInput) -> None:
        """Raise GranflowError if the journal belongs to a calibration with other parameters, scenes or
        targets."""
        text = calibration.model_dump_json(by_alias=True, exclude={"search", "title", "description"})
        earlier = self.study.user_attrs.get("calibration")
        if earlier is None:
            self.study.set_user_attr("calibration", text)
        elif earlier != text:
            raise GranflowError(
                f"{self._out} contains trials of a calibration with other scenes, parameters or targets: "
                "give another directory with --out."
            )

    def refuse_changed(self, inputs: Mapping[str, str]) -> None:
        """Raise GranflowError if the trials in the journal belong to other contents of scenes or curves.

        `inputs`: digest of each, by its name in messages; that of the first worker is stored.
        """
        earlier = self.study.user_attrs.get("inputs")
        if earlier is None:
            self.study.set_user_attr("inputs", dict(inputs))
            return
        for name, digest in inputs.items():
            if earlier.get(name) != digest:
                raise GranflowError(
                    f"{self._out} contains trials with another content of {name}: it, a file that it reads, "
                    "or the version of granflow has changed. Restore it, or give another directory with "
                    "--out."
                )

    def _sampler(self, existing: int) -> Any:
        """The sampler of Optuna; `existing`: number of trials, so that a restart does not repeat random
        points."""
        samplers = self.optuna.samplers
        seed = self.calibration.search.seed + existing
        if self.calibration.search.method == "cma_es":
            return samplers.CmaEsSampler(seed=seed, n_startup_trials=1)
        if self.calibration.search.method == "gp":
            return samplers.GPSampler(seed=seed, n_startup_trials=FIRST_RANDOM)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # constant_liar and multivariate are marked as experimental
            return samplers.TPESampler(
                seed=seed, n_startup_trials=FIRST_RANDOM, multivariate=True, constant_liar=True
            )

    def release_lost(self) -> None:
        """End the trials whose process is gone, and put their parameters first in the queue."""
        states = self.optuna.trial.TrialState
        for trial in self.study.get_trials(deepcopy=False, states=(states.RUNNING,)):
            worker = trial.user_attrs.get("worker", "")
            try:
                with locked(self._out / "workers" / worker):
                    pass
            except GranflowError:
                continue  # its process is alive
            if worker != self.worker:
                self.study.tell(trial.number, state=states.FAIL)
                self.study.enqueue_trial(dict(trial.params))

    def next_trial(self) -> Any:
        """The next trial, or None if all have begun."""
        states = self.optuna.trial.TrialState
        begun = [
            t
            for t in self.study.get_trials(deepcopy=False)
            if t.state != states.WAITING and not self._is_lost(t)
        ]
        waiting = self.study.get_trials(deepcopy=False, states=(states.WAITING,))
        if len(begun) >= self.calibration.search.trials:
            return None
        if not waiting and len(begun) >= (1.0 - REFINED_SHARE) * self.calibration.search.trials:
            self._enqueue_refined()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            trial = self.study.ask(self._distributions())
        trial.set_user_attr("worker", self.worker)
        return trial

    def _is_lost(self, trial: Any) -> bool:
        """Whether the trial ended because its process was killed; its parameters are tried again."""
        return trial.state == self.optuna.trial.TrialState.FAIL and "reason" not in trial.user_attrs

    def _distributions(self) -> dict[str, Any]:
        """Distributions of the parameters by name."""
        found = self.calibration.parameters
        float_distribution = self.optuna.distributions.FloatDistribution
        return {
            name: float_distribution(each.start, each.stop, log=each.scale == "log")
            for name, each in found.items()
        }

    def completed(self) -> list[Any]:
        """All completed trials in order; their attributes contain the residuals."""
        states = self.optuna.trial.TrialState
        return list(self.study.get_trials(deepcopy=False, states=(states.COMPLETE,)))

    def stopped_early(self) -> list[Any]:
        """Trials that were stopped early, but have the residuals of some targets."""
        found = self.study.get_trials(deepcopy=False, states=(self.optuna.trial.TrialState.PRUNED,))
        return [trial for trial in found if trial.user_attrs.get("residuals")]

    def scaled(self, trials: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (trials, d) scaled to [0, 1], and weighted residuals (trials, residuals), nan where
        missing.

        The first trial has been completed.
        """
        return self._unit_parameters(trials), _by_target(trials, "residuals")

    def standard_errors(self, trials: Sequence[Any]) -> np.ndarray:
        """Standard errors (trials, residuals) of the weighted residuals, from the runs; 0 where these have
        none."""
        return _by_target(trials, "errors")

    def _unit_parameters(self, trials: Sequence[Any]) -> np.ndarray:
        """Parameters (trials, d) scaled to [0, 1]."""
        parameters = self.calibration.parameters
        u = [[to_unit(each, trial.params[name]) for name, each in parameters.items()] for trial in trials]
        return np.array(u).reshape(-1, len(parameters))

    def _enqueue_refined(self) -> None:
        """Enqueue the optimum of the response fitted to the trials near the best one, unless it was tried.

        A trial that was stopped early or failed does not change the fit: its point would be tried again
        without end.
        """
        trials = self.completed()
        if not trials:
            return
        u, residuals = self.scaled(trials)
        best = int(np.argmin([trial.value for trial in trials]))
        response = fit_response(u, residuals, best)
        if response is None:
            return
        found = response.optimum(u[best])
        tried = self._unit_parameters(
            [trial for trial in self.study.get_trials(deepcopy=False) if trial.params]
        )
        if np.abs(tried - found).max(axis=1).min() > NEW_POINT:
            named = zip(self.calibration.parameters.items(), found, strict=True)
            self.study.enqueue_trial({name: from_unit(each, share) for (name, each), share in named})


def _journal_of(journal: Any, path: str, lock: Any) -> Any:
    """The journal of Optuna in a file, without damaged lines; `journal`: its module, `lock`: of the file.

    A line that a full disk cuts off is removed before the next one is written: the operation has failed for
    the worker that wrote it, and no other worker has read it.
    """

    class Journal(journal.JournalFileBackend):
        def append_logs(self, logs: list[dict[str, Any]]) -> None:
            lines = "".join(json.dumps(log, separators=(",", ":")) + "\n" for log in logs).encode()
            lock.acquire()
            try:
                with open(path, "r+b", buffering=0) as file:
                    end = file.seek(0, os.SEEK_END)
                    file.seek(max(end - 1, 0))
                    if file.read(1) not in (b"", b"\n"):
                        file.seek(0)
                        end = file.read().rfind(b"\n") + 1
                        file.truncate(end)
                    file.seek(end)
                    try:
                        written = file.write(lines)
                        while written < len(lines):
                            written += file.write(lines[written:])
                        os.fsync(file.fileno())
                    except OSError:
                        file.truncate(end)
                        raise
            finally:
                lock.release()

    if os.path.exists(path):
        lock.acquire()
        try:
            _remove_damaged_lines(Path(path))
        finally:
            lock.release()
    return Journal(path, lock)


def _remove_damaged_lines(path: Path) -> None:
    """Remove the lines of a journal that are no operations; a whole operation behind a cut-off one is
    kept."""
    lines = path.read_bytes().splitlines(keepends=True)
    kept = []
    for line in lines:
        found = line
        while found and not _is_operation(found):
            start = found.find(OPERATION, 1)
            found = found[start:] if start > 0 else b""
        kept.append(found)
    if kept != lines:
        with replacing(path, durable=True) as temporary:
            temporary.write_bytes(b"".join(kept))


OPERATION = b'{"op_code"'
"""Start of a line of the journal."""


def _is_operation(line: bytes) -> bool:
    """Whether a line of the journal is complete."""
    try:
        content = json.loads(line)
    except ValueError:
        return False
    return line.endswith(b"\n") and isinstance(content, dict) and {"op_code", "worker_id"} <= content.keys()


def _by_target(trials: Sequence[Any], attribute: str) -> np.ndarray:
    """Numbers of all targets (trials, residuals) in an attribute of trials; nan for a target that a trial
    lacks."""
    counts = {name: len(values) for name, values in trials[0].user_attrs["residuals"].items()}
    found = [
        np.concatenate(
            [trial.user_attrs[attribute].get(name, [np.nan] * count) for name, count in counts.items()]
        )
        for trial in trials
    ]
    return np.array(found)


def require_optuna(method: str) -> Any:
    """The module optuna. Raises GranflowError if it, or a package that the method needs, is not installed."""
    try:
        import optuna
        import optuna.storages.journal
    except ImportError:
        raise GranflowError(
            "Calibration requires Optuna, which is not installed: pip install optuna cmaes"
        ) from None
    for name, package in (("cma_es", "cmaes"), ("gp", "torch")):
        if method == name:
            try:
                __import__(package)
            except ImportError:
                raise GranflowError(
                    f"search.method {name} requires {package}: pip install {package}"
                ) from None
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna


def to_unit(parameter: Parameter, value: float) -> float:
    """Position of a value between the bounds of its parameter, 0 to 1."""
    if parameter.scale == "log":
        return log(value / parameter.start) / log(parameter.stop / parameter.start)
    return (value - parameter.start) / (parameter.stop - parameter.start)


def from_unit(parameter: Parameter, share: float) -> float:
    """Value at a position between the bounds of its parameter."""
    if parameter.scale == "log":
        value = parameter.start * (parameter.stop / parameter.start) ** share
    else:
        value = parameter.start + share * (parameter.stop - parameter.start)
    return float(min(max(value, parameter.start), parameter.stop))


def deviation_in_units(parameter: Parameter, value: float, share: float) -> float:
    """Standard deviation of a parameter in its own unit, at a value, from that of its position."""
    if parameter.scale == "log":
        return float(value * log(parameter.stop / parameter.start) * share)
    return (parameter.stop - parameter.start) * share


def settings_of(calibration: CalibrationInput, scene: str, values: Mapping[str, float]) -> dict[str, Any]:
    """Values of the keys of a scene for values of the parameters [SI]; with a unit if the bounds have one."""
    given = {name: in_si(value, calibration.parameters[name].unit) for name, value in values.items()}
    keys = {key: value for name, value in given.items() for key in calibration.keys_of(name, scene)}
    return {**calibration.scenes[scene].settings, **keys}
