"""Results of a calibration: best values with uncertainties, targets, conflicts, and the scenes with the best
values."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.special import fdtrc

from granflow import Scene, load_scene
from granflow.io.files import replacing, write_text
from granflow.io.tables import write_table
from granflow.load import copied_scene
from granflow.studies.calibration.schema import CalibrationInput, Parameter
from granflow.studies.calibration.search import (
    EXACT,
    LEVEL,
    Response,
    Search,
    by_distance,
    deviation_in_units,
    fewest_trials,
    fit,
    from_unit,
    highest_degree,
    nearest_trials,
    optimum_of,
    settings_of,
    terms,
)
from granflow.studies.calibration.trials import Measured, deviation, given_text
from granflow.studies.run_process import overrides_of

# What the targets determine: effects of the parameters over their bounds, and uncertainties at the best
# values.
#
# 1. Effect: a residual responds to a parameter if the terms with the parameter improve a polynomial fit to
#    all trials that have this residual, by an F test at LEVEL, divided by the number of residuals
#    (Bonferroni).
# 2. Uncertainty: the targets determine the parameters with the covariance
#
#     C = (sum of J J^T / (1 + s^2) + 12 I)^-1
#
# J: gradient of a residual at the best values, s: its scatter about the fit, 12 I: inverse variance of the
# uniform distribution between the bounds. Fits of first and second degree, to the trials near the best one,
# to all and to numbers between, predict the trials near the best one, if each of these is left out (PRESS).
# Of the fits whose mean squared error is within one standard error of the smallest, each residual has the
# one with the most significant slopes, of these the one with the smallest error. A component of J counts as
# 0 without an effect over the bounds, or if its ratio to its standard error is below the quantile of the
# t-distribution.

UNIFORM_VARIANCE = 1.0 / 12.0
"""Variance of the uniform distribution on [0, 1]."""
WINDOW_FACTOR = 1.25
"""Ratio of the numbers of trials of two fits that follow each other."""
NOT_IDENTIFIED = 0.5
"""Ratio of the standard deviation of a parameter to that of the uniform distribution between its bounds,
above which the targets do not identify it."""


@dataclass(frozen=True)
class Effects:
    """Effects of the parameters on the residuals over the bounds; arrays (residuals, d).

    `change`: of a residual from the lower to the upper bound of a parameter, averaged over the other
    parameters; `error`: its standard error; `probability`: of an effect of this size by scatter alone, for
    all residuals together. `trials` (residuals,): number of trials that have each residual.
    """

    change: np.ndarray
    error: np.ndarray
    probability: np.ndarray
    trials: np.ndarray

    @property
    def significant(self) -> np.ndarray:
        """Whether each residual responds to each parameter."""
        return np.asarray(self.probability < LEVEL)

    def strongest(self, parameter: int) -> int:
        """Index of the residual with the most significant effect of a parameter."""
        return int(np.argmin(self.probability[:, parameter]))


def effects(u: np.ndarray, residuals: np.ndarray, errors: np.ndarray) -> Effects:
    """Effects of parameters u (trials, d) on residuals (trials, residuals) with standard errors of the same
    shape.

        F = (RSS of the fit without the terms of a parameter - RSS of the full fit) / (number of these terms
        s^2)

    A residual that a trial does not have is nan. Each one needs the `fewest_trials` for a fit of first
    degree.
    """
    known = np.isfinite(residuals)
    found = [
        _effect(u[has], r[has, None], e[has, None])
        for has, r, e in zip(known.T, residuals.T, errors.T, strict=True)
    ]
    change, error, probability = np.array(found).transpose(1, 0, 2)
    return Effects(change, error, np.minimum(probability * len(found), 1.0), known.sum(axis=0))


def _effect(u: np.ndarray, residual: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Change, its standard error and probability (3, d) of one residual (trials, 1)."""
    count = u.shape[1]
    degree = highest_degree(*u.shape)
    response = fit(u, residual, degree, error)
    matrix = terms(u, degree)
    full = _squares(matrix, residual)
    found = np.empty((3, count))
    for k in range(count):
        low = np.full((1, count), 0.5)
        high = low.copy()
        low[0, k], high[0, k] = 0.0, 1.0
        contrast = (terms(high, degree) - terms(low, degree))[0]
        has_parameter = (
            terms(np.eye(count)[[k]] + 2.0, degree)[0] != terms(np.full((1, count), 2.0), degree)[0]
        )
        excess = _squares(matrix[:, ~has_parameter], residual) - full
        ratio = max(excess, 0.0) / (has_parameter.sum() * response.scatter[0] ** 2)
        found[0, k] = contrast @ response.coefficients[:, 0]
        found[1, k] = response.scatter[0] * np.sqrt(contrast @ response.spread @ contrast)
        found[2, k] = fdtrc(has_parameter.sum(), response.freedom, ratio)
    return found


def _squares(matrix: np.ndarray, residual: np.ndarray) -> float:
    """Sum of squared deviations from the best fit with the terms of `matrix` (trials, terms)."""
    return float(((residual - matrix @ (np.linalg.pinv(matrix) @ residual)) ** 2).sum())


@dataclass(frozen=True)
class Identification:
    """What the targets determine: standard deviation (d,) of each parameter in [0, 1]; responses to each
    parameter.

    `optimum` (d,): parameters in [0, 1] with the smallest sum of squares of the fitted residuals.
    `importance` (d,):
    share of each parameter in the squared gradients of the residuals at the best values; 0 if no target
    responds to the parameter there.
    """

    deviation: np.ndarray
    optimum: np.ndarray
    importance: np.ndarray
    effects: Effects

    def is_identified(self, index: int) -> bool:
        """Whether the targets determine a parameter."""
        return bool(self.deviation[index] < NOT_IDENTIFIED * np.sqrt(UNIFORM_VARIANCE))

    def statement(self, names: Sequence[str], index: int, changes: str) -> str:
        """A sentence on a parameter that the targets do not identify; empty for an identified one.

        `changes`: text of the effect of the parameter on a target.
        """
        if self.is_identified(index):
            return ""
        name = names[index]
        strongest = self.effects.strongest(index)
        probability = self.effects.probability[strongest, index]
        others = [other for k, other in enumerate(names) if k != index and self.importance[k] > 0.0]
        if not self.effects.significant[:, index].any():
            reason = (
                "none of them responds to it between its bounds by more than the scatter between runs; "
                f"{changes} (F test of {self.effects.trials[strongest]} trials: p = {probability:.2g}, "
                f"significant below {LEVEL})"
            )
        elif self.importance[index] == 0.0:
            reason = (
                f"they respond to it between its bounds ({changes}, p = {probability:.2g}), but near the "
                "best values by no more than the scatter between runs"
            )
        elif others:
            reason = f"they determine it only together with {', '.join(others)}"
        else:
            reason = "their tolerances are too large for its range"
        return f"{name} cannot be identified from the targets: {reason}."


def identification(
    u: np.ndarray, residuals: np.ndarray, errors: np.ndarray, best: int
) -> Identification | None:
    """What the targets determine near trial `best`; see the module docstring. None with too few completed
    trials.

    `u`: parameters (trials, d) in [0, 1]; `residuals` and their standard `errors`: (trials, residuals), nan
    where a trial was stopped before; `best`: index of the best of the completed trials, which have all
    residuals.
    """
    completed = np.isfinite(residuals).all(axis=1)
    if highest_degree(int(completed.sum()), u.shape[1]) == 0:
        return None
    found = effects(u, residuals, errors)
    number = int(completed[:best].sum())
    fits = _local_fits(u[completed], residuals[completed], errors[completed], number)
    at = u[best]
    slopes = np.array([_significant(each, at)[k] for k, each in enumerate(fits)])
    slopes = np.where(found.significant, slopes, 0.0)
    scatter = np.array([each.scatter[k] for k, each in enumerate(fits)])
    information = (slopes.T / (1.0 + scatter**2)) @ slopes + np.eye(u.shape[1]) / UNIFORM_VARIANCE
    squares = (slopes**2).sum(axis=0)
    total = float(squares.sum()) or 1.0
    optimum = optimum_of(lambda u: np.array([each.at(u)[k] for k, each in enumerate(fits)]), at)
    return Identification(np.sqrt(np.diag(np.linalg.inv(information))), optimum, squares / total, found)


def _local_fits(u: np.ndarray, residuals: np.ndarray, errors: np.ndarray, best: int) -> list[Response]:
    """The fit of each residual near trial `best`; see the module docstring."""
    highest = highest_degree(*u.shape)
    near = len(nearest_trials(u, best, highest))
    order = by_distance(u, best)
    fits = []
    squares = []
    significant = []
    for degree in range(1, highest + 1):
        for count in _window_sizes(near, len(u)):
            used = order[:count]
            fits.append(fit(u[used], residuals[used], degree, errors[used]))
            squares.append(_left_out(u[used], residuals[used], degree)[:near] ** 2)
            significant.append((_significant(fits[-1], u[best]) != 0.0).sum(axis=1))
    error = np.mean(squares, axis=1)
    smallest = error.argmin(axis=0)
    columns = np.arange(residuals.shape[1])
    spread = np.std(squares, axis=1, ddof=1)[smallest, columns] / np.sqrt(near)
    allowed = error <= error[smallest, columns] + spread
    rank = np.where(allowed, significant, -1)
    chosen = np.where(rank == rank.max(axis=0), error, np.inf).argmin(axis=0)
    return [fits[k] for k in chosen]


def _window_sizes(smallest: int, largest: int) -> list[int]:
    """Numbers of trials of the fits, from the smallest to the largest."""
    sizes = [smallest]
    while sizes[-1] < largest:
        sizes.append(min(int(np.ceil(WINDOW_FACTOR * sizes[-1])), largest))
    return sizes


def _significant(response: Response, at: np.ndarray) -> np.ndarray:
    """Gradient (residuals, d) at the parameters `at` (d,), 0 where it is not significant."""
    slopes, errors = response.gradient(at)
    return np.where(np.abs(slopes) >= response.least_ratio * errors, slopes, 0.0)


def _left_out(u: np.ndarray, residuals: np.ndarray, degree: int) -> np.ndarray:
    """Deviations (trials, residuals) of each trial from the fit to all other trials: e / (1 - h), h:
    leverage."""
    matrix = terms(u, degree)
    hat = matrix @ np.linalg.pinv(matrix)
    return np.asarray((residuals - hat @ residuals) / np.maximum(1.0 - np.diag(hat), EXACT)[:, None])


FEWEST_TRIALS = 20
"""Smallest number of completed trials for a statement on conflicts."""


@dataclass(frozen=True)
class BestValue:
    """Value of a parameter in the best trial, optimum of the fit to all trials, and standard deviation of the
    latter.

    `optimum`: nan without a fit and for a parameter that the targets do not identify; `deviation`: nan
    without a fit; `importance`: share of the parameter in the response of the targets, 0 to 1, nan without a
    fit; `not_identified`: a sentence if the targets do not identify the parameter, otherwise empty; `shown`:
    texts of value, optimum and standard deviation in the unit of the bounds.
    """

    name: str
    value: float
    optimum: float
    deviation: float
    importance: float
    not_identified: str
    shown: tuple[str, str, str]


class BestTarget(NamedTuple):
    """A target at the best values: measured (nan for a curve) and simulated value, deviation in tolerances.

    `error`: standard error that the run gives for the simulated value, in tolerances; 0 if it has none.
    `shown`: texts of the measured and the simulated value, with its error, in the unit in which the
    calibration gives the target.
    """

    name: str
    quantity: str
    measured: float
    simulated: float
    deviation: float
    error: float
    shown: tuple[str, str]

    @property
    def noise(self) -> str:
        """A sentence if the scatter of the simulated value exceeds the tolerance; otherwise empty."""
        if self.error <= 1.0:
            return ""
        return (
            f"{self.name}: the standard error of {self.quantity} in the best trial is {self.error:.2g} times "
            "the tolerance, so its deviation says little: simulate more particles, a larger region or a time "
            "average."
        )


@dataclass(frozen=True)
class CalibrationResult:
    """Best values, targets, sentences on conflicts, and all trials of Optuna; `loss`: the smallest one.

    `warnings`: of the runs of the best trial.
    """

    loss: float
    parameters: tuple[BestValue, ...]
    targets: tuple[BestTarget, ...]
    conflicts: tuple[str, ...]
    trials: tuple[Any, ...]
    warnings: tuple[str, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on parameters that are not identified, on scatter above a tolerance, on conflicts, and
        warnings."""
        unidentified = [each.not_identified for each in self.parameters if each.not_identified]
        return (
            *unidentified,
            *(each.noise for each in self.targets if each.noise),
            *self.conflicts,
            *(f"Warning of the best trial, {sentence}" for sentence in self.warnings),
        )

    @property
    def is_met(self) -> bool:
        """Whether each target is met within its tolerance."""
        return all(each.deviation <= 1.0 for each in self.targets)


def result_of(search: Search, targets: Mapping[str, Measured]) -> CalibrationResult | None:
    """The result of all trials so far; None without a completed trial."""
    completed = search.completed()
    if not completed:
        return None
    best = int(np.argmin([trial.value for trial in completed]))
    found = [_best_target(name, each, completed[best]) for name, each in targets.items()]
    trials = tuple(search.study.get_trials(deepcopy=False))
    parameters = tuple(_best_values(search, targets, completed, best))
    return CalibrationResult(
        completed[best].value,
        parameters,
        tuple(found),
        tuple(_conflicts(targets, completed)),
        trials,
        warnings_of_trial(completed[best]),
    )


def _best_values(
    search: Search, targets: Mapping[str, Measured], completed: Sequence[Any], best: int
) -> list[BestValue]:
    """Best values of all parameters, with their uncertainties."""
    parameters = search.calibration.parameters
    values = completed[best].params
    trials = [*completed, *search.stopped_early()]
    u, residuals = search.scaled(trials)
    known = identification(u, residuals, search.standard_errors(trials), best)
    if known is None:
        few = (
            f"{len(completed)} completed trials are too few, at least {fewest_trials(len(parameters))} are "
            "needed"
        )
        return [
            _best_value(
                name,
                each,
                values[name],
                (nan, nan, nan),
                f"{name} cannot be identified from the targets: {few}.",
            )
            for name, each in parameters.items()
        ]
    found = []
    for k, (name, each) in enumerate(parameters.items()):
        error = deviation_in_units(each, values[name], float(known.deviation[k]))
        optimum = from_unit(each, float(known.optimum[k])) if known.is_identified(k) else nan
        sentence = known.statement(list(parameters), k, _strongest_change(targets, known.effects, k))
        found.append(
            _best_value(name, each, values[name], (optimum, error, float(known.importance[k])), sentence)
        )
    return found


def _strongest_change(targets: Mapping[str, Measured], effects: Effects, index: int) -> str:
    """Text of the most significant effect of a parameter over its bounds, such as
    `angle changes by 2 ± 1 deg`."""
    names = [name for name, each in targets.items() for _ in each.value]
    strongest = effects.strongest(index)
    measured = targets[names[strongest]]
    change, error = (each[strongest, index] / measured.scale for each in (effects.change, effects.error))
    text = given_text(measured, change, measured.target.quantity, 2)
    return f"{names[strongest]} changes by {text} \N{PLUS-MINUS SIGN} {error / measured.factor:.2g}"


def _best_value(
    name: str, parameter: Parameter, value: float, fitted: tuple[float, float, float], not_identified: str
) -> BestValue:
    """The best value of a parameter with its texts; `fitted`: optimum, standard deviation, importance."""
    optimum, error, importance = fitted
    shown = parameter.text(value, 5), parameter.text(optimum, 5), parameter.text(error, 2)
    return BestValue(name, value, optimum, error, importance, not_identified, shown)


def _best_target(name: str, measured: Measured, trial: Any) -> BestTarget:
    """A target at the best trial."""
    value = float(measured.value[0]) if measured.time is None else nan
    size = deviation(measured, trial.user_attrs["residuals"], name)
    error = deviation(measured, trial.user_attrs["errors"], name)
    quantity = measured.target.quantity
    simulated = trial.user_attrs["simulated"][name]
    shown = given_text(measured, simulated, quantity)
    if error > 0.0 and measured.time is None:
        shown += f" \N{PLUS-MINUS SIGN} {error * measured.target.tolerance / measured.factor:.2g}"
    given = "curve" if measured.time is not None else given_text(measured, value, quantity)
    return BestTarget(name, quantity, value, simulated, size, error, (given, shown))


def _conflicts(targets: Mapping[str, Measured], completed: Sequence[Any]) -> list[str]:
    """Sentences on pairs of targets of which trials meet each one, but none both."""
    if len(completed) < FEWEST_TRIALS:
        return []
    sizes = {
        name: np.array([deviation(each, trial.user_attrs["residuals"], name) for trial in completed])
        for name, each in targets.items()
    }
    found = []
    for first, second in combinations(targets, 2):
        met = sizes[first] <= 1.0, sizes[second] <= 1.0
        if met[0].any() and met[1].any() and not (met[0] & met[1]).any():
            found.append(
                f"{first} and {second} conflict: of {len(completed)} trials, {int(met[0].sum())} meet "
                f"{first} and {int(met[1].sum())} meet {second} within the tolerance, but none meets both."
            )
    return found


def write_best_scenes(
    out: Path, calibration: CalibrationInput, scenes: Mapping[str, Path], values: Mapping[str, float]
) -> list[Path]:
    """Write each scene with the best values, ready to run: `best.yaml`, or `best_NAME.yaml` of several
    scenes."""
    written = []
    taken = dict[str, Path]()
    for name, path in scenes.items():
        scene = load_scene(path, overrides_of(settings_of(calibration, name, values)))
        copied = copied_scene(scene, taken)
        target = out / ("best.yaml" if len(scenes) == 1 else f"best_{name}.yaml")
        write_text(target, copied.to_yaml())
        _copy_inputs(scene, copied, out)
        written.append(target)
    return written


def _copy_inputs(scene: Scene, copied: Scene, out: Path) -> None:
    """Copy the input files of a scene to the directory, to the paths that `copied` contains."""
    for (_, name), (_, copy) in zip(scene.input_names(), copied.input_names(), strict=True):
        source = (scene.folder / name).resolve()
        target = out / copy
        if source.exists() and target.resolve() != source:
            target.parent.mkdir(parents=True, exist_ok=True)
            with replacing(target) as temporary:
                shutil.copyfile(source, temporary)


def trial_columns(result: CalibrationResult) -> dict[str, list[Any]]:
    """Columns of `trials.csv`: number, state, loss, parameters, simulated values, reason, warnings, runs.

    None if missing.
    """
    names = [each.name for each in result.parameters]
    targets = [each.name for each in result.targets]
    found: dict[str, list[Any]] = {"trial": [trial.number for trial in result.trials]}
    found["state"] = [state_of(trial) for trial in result.trials]
    found["loss"] = [trial.value if trial.state.name == "COMPLETE" else None for trial in result.trials]
    for name in names:
        found[name] = [trial.params.get(name) for trial in result.trials]
    for name in targets:
        found[f"target.{name}"] = [trial.user_attrs.get("simulated", {}).get(name) for trial in result.trials]
    found["reason"] = [trial.user_attrs.get("reason") for trial in result.trials]
    found["warnings"] = [" ".join(warnings_of_trial(trial)) for trial in result.trials]
    found["runs"] = [" ".join(runs_of(trial).values()) for trial in result.trials]
    return found


def runs_of(trial: Any) -> dict[str, str]:
    """Names of the run directories of a trial by scene."""
    return {key[4:]: value for key, value in trial.user_attrs.items() if key.startswith("run.")}


def warnings_of_trial(trial: Any) -> tuple[str, ...]:
    """Warnings of the runs of a trial, each with the name of its scene."""
    return tuple(trial.user_attrs.get("warnings", ()))


def state_of(trial: Any) -> str:
    """State of a trial in words."""
    words = {"COMPLETE": "completed", "PRUNED": "stopped early", "FAIL": "failed", "RUNNING": "running"}
    return words.get(trial.state.name, "waiting")


def write_result(out: Path, result: CalibrationResult) -> None:
    """Write `trials.csv` and `best.csv`, each atomically."""
    best = {
        "parameter": [each.name for each in result.parameters],
        "value": [each.value for each in result.parameters],
        "optimum_of_fit": [_number(each.optimum) for each in result.parameters],
        "standard_deviation": [_number(each.deviation) for each in result.parameters],
        "identified": [not each.not_identified for each in result.parameters],
        "remark": [each.not_identified for each in result.parameters],
    }
    for name, columns in (("trials.csv", trial_columns(result)), ("best.csv", best)):
        with replacing(out / name) as temporary:
            write_table(temporary, columns, zip(*columns.values(), strict=True))


def _number(value: float) -> float | None:
    return value if -inf < value < inf else None
