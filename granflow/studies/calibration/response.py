"""Polynomial responses of the residuals to the parameters, and what the targets determine.

Each residual r is a polynomial of the parameters u, scaled to [0, 1], fitted to trials by least squares; s is
the standard deviation of the residual about the fit (scatter between runs), at least the root mean square of
the standard errors that the runs give for their values. `fit_response` fits near the best trial, for the
search. `identification` says what the targets determine:

1. Effect over the bounds: a residual responds to a parameter if the terms with the parameter improve a
   polynomial fit to all trials that have this residual, by an F test at LEVEL, divided by the number of
   residuals (Bonferroni).
2. Uncertainty at the best values: the targets determine the parameters with the covariance

       C = (sum of J J^T / (1 + s^2) + 12 I)^-1

   J: gradient of a residual at the best values, s: its scatter about the fit, 12 I: inverse variance of the
   uniform distribution between the bounds. Fits of first and second degree, to the trials near the best one,
   to all and to numbers between, predict the trials near the best one, if each of these is left out (PRESS).
   Of the fits whose mean squared error is within one standard error of the smallest, each residual has the
   one with the most significant slopes, of these the one with the smallest error. A component of J counts
   as 0 without an effect over the bounds, or if its ratio to its standard error is below the quantile of the
   t-distribution.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy.optimize import least_squares
from scipy.special import fdtrc, stdtrit

LEVEL = 0.0027
"""Significance level of effects and slopes, two-sided: 3 standard deviations of a normal distribution."""

# Fits

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


def fit_response(u: np.ndarray, residuals: np.ndarray, best: int) -> Response | None:
    """Fit residuals (trials, residuals) over parameters u (trials, d), near trial `best`.

    Returns None with too few trials. The degree is 2 if the trials suffice for it, else 1. The trials are
    those of `nearest_trials`.
    """
    degree = highest_degree(*u.shape)
    if degree == 0:
        return None
    near = nearest_trials(u, best, degree)
    return fit(u[near], residuals[near], degree)


def highest_degree(trials: int, count: int) -> int:
    """Highest degree, 2 or 1, for which the trials suffice with `count` parameters; 0 if there is none."""
    return next((degree for degree in (2, 1) if trials >= fewest_trials(count, degree)), 0)


def fewest_trials(count: int, degree: int = 1) -> int:
    """Smallest number of trials for a fit of `degree` with `count` parameters."""
    return int(np.ceil(SURPLUS * terms(np.zeros((1, count)), degree).shape[1])) + 1


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


# Effects over the bounds


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


# Identification at the best values

UNIFORM_VARIANCE = 1.0 / 12.0
"""Variance of the uniform distribution on [0, 1]."""
WINDOW_FACTOR = 1.25
"""Ratio of the numbers of trials of two fits that follow each other."""
NOT_IDENTIFIED = 0.5
"""Ratio of the standard deviation of a parameter to that of the uniform distribution between its bounds,
above which the targets do not identify it."""


@dataclass(frozen=True)
class Identification:
    """What the targets determine about the parameters, which are scaled to [0, 1].

    deviation (d,):   standard deviation of each parameter
    optimum (d,):     parameters with the smallest sum of squares of the fitted residuals
    importance (d,):  share of each parameter in the squared gradients of the residuals at the best values;
                      0 if no target responds to the parameter there
    effects:          of the parameters on the residuals over the bounds
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
    """What the targets determine near trial `best`; see the module docstring.

    Returns None with too few completed trials. `u`: parameters (trials, d) in [0, 1]; `residuals` and their
    standard `errors`: (trials, residuals), nan where a trial was stopped before; `best`: index of the best of
    the completed trials, which have all residuals.
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
