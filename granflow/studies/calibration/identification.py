"""What the targets determine: effects of the parameters over their bounds, and uncertainties at the best values.

1. Effect: a residual responds to a parameter if the terms with the parameter improve a polynomial fit to all trials
   that have this residual, by an F test at LEVEL, divided by the number of residuals (Bonferroni).
2. Uncertainty: the targets determine the parameters with the covariance

    C = (sum of J J^T / (1 + s^2) + 12 I)^-1

J: gradient of a residual at the best values, s: its scatter about the fit, 12 I: inverse variance of the uniform
distribution between the bounds. Fits of first and second degree, to the trials near the best one, to all and to
numbers between, predict the trials near the best one, if each of these is left out (PRESS). Of the fits whose mean
squared error is within one standard error of the smallest, each residual has the one with the most significant slopes,
of these the one with the smallest error. A component of J counts as 0 without an effect over the bounds, or if its
ratio to its standard error is below the quantile of the t-distribution.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from granflow.studies.calibration.response import (
    EXACT,
    LEVEL,
    Response,
    by_distance,
    fit,
    highest_degree,
    nearest_trials,
    optimum_of,
    terms,
)

UNIFORM_VARIANCE = 1.0 / 12.0
"""Variance of the uniform distribution on [0, 1]."""

WINDOW_FACTOR = 1.25
"""Ratio of the numbers of trials of two fits that follow each other."""

NOT_IDENTIFIED = 0.5
"""Ratio of the standard deviation of a parameter to that of the uniform distribution between its bounds, above which
the targets do not identify it."""


@dataclass(frozen=True)
class Effects:
    """Effects of the parameters on the residuals over the bounds; arrays (residuals, d).

    `change`: of a residual from the lower to the upper bound of a parameter, averaged over the other parameters;
    `error`: its standard error; `probability`: of an effect of this size by scatter alone, for all residuals together.
    `trials` (residuals,): number of trials that have each residual.
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
    """Effects of parameters u (trials, d) on residuals (trials, residuals) with standard errors of the same shape.

        F = (RSS of the fit without the terms of a parameter - RSS of the full fit) / (number of these terms s^2)

    A residual that a trial does not have is nan. Each one needs the `fewest_trials` for a fit of first degree.
    """
    known = np.isfinite(residuals)
    found = [
        _effect(u[has], r[has, None], e[has, None]) for has, r, e in zip(known.T, residuals.T, errors.T, strict=True)
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
        has_parameter = terms(np.eye(count)[[k]] + 2.0, degree)[0] != terms(np.full((1, count), 2.0), degree)[0]
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
    """What the targets determine: standard deviation (d,) of each parameter in [0, 1]; responses to each parameter.

    `optimum` (d,): parameters in [0, 1] with the smallest sum of squares of the fitted residuals. `importance` (d,):
    share of each parameter in the squared gradients of the residuals at the best values; 0 if no target responds to the
    parameter there.
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
                f"none of them responds to it between its bounds by more than the scatter between runs; {changes} "
                f"(F test of {self.effects.trials[strongest]} trials: p = {probability:.2g}, significant below {LEVEL})"
            )
        elif self.importance[index] == 0.0:
            reason = (
                f"they respond to it between its bounds ({changes}, p = {probability:.2g}), but near the best values "
                "by no more than the scatter between runs"
            )
        elif others:
            reason = f"they determine it only together with {', '.join(others)}"
        else:
            reason = "their tolerances are too large for its range"
        return f"{name} cannot be identified from the targets: {reason}."


def identification(u: np.ndarray, residuals: np.ndarray, errors: np.ndarray, best: int) -> Identification | None:
    """What the targets determine near trial `best`; see the module docstring. None with too few completed trials.

    `u`: parameters (trials, d) in [0, 1]; `residuals` and their standard `errors`: (trials, residuals), nan where a
    trial was stopped before; `best`: index of the best of the completed trials, which have all residuals.
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
    fits, squares, significant = [], [], []
    for degree in range(1, highest + 1):
        for count in _window_sizes(near, len(u)):
            used = order[:count]
            fits.append(fit(u[used], residuals[used], degree, errors[used]))
            squares.append(_left_out(u[used], residuals[used], degree)[:near] ** 2)
            significant.append((_significant(fits[-1], u[best]) != 0.0).sum(axis=1))
    error = np.mean(squares, axis=1)
    smallest, columns = error.argmin(axis=0), np.arange(residuals.shape[1])
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
    """Deviations (trials, residuals) of each trial from the fit to all other trials: e / (1 - h), h: leverage."""
    matrix = terms(u, degree)
    hat = matrix @ np.linalg.pinv(matrix)
    return np.asarray((residuals - hat @ residuals) / np.maximum(1.0 - np.diag(hat), EXACT)[:, None])
