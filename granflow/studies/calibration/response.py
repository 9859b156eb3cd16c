"""Polynomial responses of the residuals to the parameters, fitted to trials by least squares.

Each residual r is a polynomial of the parameters u, scaled to [0, 1]; s is the standard deviation of the residual about
the fit (scatter between runs), at least the root mean square of the standard errors that the runs give for their
values.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy.optimize import least_squares
from scipy.special import stdtrit

LEVEL = 0.0027
"""Significance level of effects and slopes, two-sided: 3 standard deviations of a normal distribution."""

SURPLUS = 1.5
"""Smallest ratio of the number of trials to that of the coefficients."""

EXACT = 1e-9
"""Smallest standard deviation of a residual: the scatter of exact polynomials is 0."""


@dataclass(frozen=True)
class Response:
    """Fitted residuals: coefficients (terms, residuals), covariance factor (terms, terms), scatter (residuals,).

    `freedom`: number of trials less that of the terms.
    """

    degree: int
    coefficients: np.ndarray
    spread: np.ndarray
    scatter: np.ndarray
    freedom: int

    @property
    def least_ratio(self) -> float:
        """Smallest significant ratio of a slope to its standard error: quantile of Student's t, 3 for many trials."""
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
    """Fit residuals (trials, residuals) over parameters u (trials, d), near trial `best`; None with too few trials.

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

    `errors`: standard errors of the residuals (trials, residuals); the scatter about the fit is at least as large.
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
