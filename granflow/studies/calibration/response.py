"""Local response of the residuals to the parameters, from the trials near the best one, and what follows from it.

Each residual r is a polynomial of the parameters u, scaled to [0, 1]; its coefficients are fitted by least squares. The
targets determine the parameters with the covariance

    C = (sum of J J^T / (1 + s^2) + 12 I)^-1

J: gradient of a residual at the best values, s: standard deviation of the residual about the fit (scatter between
runs), at least the root mean square of the standard errors that the runs give for their values; 12 I: inverse variance
of the uniform distribution between the bounds. A component of J counts as 0 unless its ratio to its standard error
exceeds the quantile of the t-distribution with the degrees of freedom of the fit, for the confidence of SIGNIFICANT
standard deviations: few trials need a larger ratio.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr, stdtrit

SIGNIFICANT = 3.0
"""Standard deviations of a normal distribution with the confidence of a slope, 99.73 %."""

SURPLUS = 1.5
"""Smallest ratio of the number of trials to that of the coefficients."""

UNIFORM_VARIANCE = 1.0 / 12.0
"""Variance of the uniform distribution on [0, 1]."""

NOT_IDENTIFIED = 0.5
"""Ratio of the standard deviation of a parameter to that of the uniform distribution between its bounds, above which
the targets do not identify it."""

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
        """Smallest significant ratio of a slope to its standard error: SIGNIFICANT with many trials."""
        return float(stdtrit(self.freedom, ndtr(SIGNIFICANT)))

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
        return np.asarray(least_squares(self.at, np.clip(start, 1e-6, 1.0 - 1e-6), bounds=(0.0, 1.0)).x)


def fewest_trials(count: int, degree: int = 1) -> int:
    """Smallest number of trials for a fit of `degree` with `count` parameters."""
    return int(np.ceil(SURPLUS * terms(np.zeros((1, count)), degree).shape[1])) + 1


def fit_response(u: np.ndarray, residuals: np.ndarray, best: int, errors: np.ndarray | None = None) -> Response | None:
    """Fit residuals (trials, residuals) over parameters u (trials, d), near trial `best`; None with too few trials.

    `errors`: standard errors of the residuals (trials, residuals); the scatter about the fit is at least as large. The
    degree is 2 if the trials suffice for it, else 1. The trials are the half nearest to the best one, or as many as the
    fit needs.
    """
    order = np.argsort(((u - u[best]) ** 2).sum(axis=1), kind="stable")
    for degree in (2, 1):
        needed = fewest_trials(u.shape[1], degree)
        if len(u) >= needed:
            near = order[: max(needed, len(u) // 2)]
            return _fit(
                u[near], residuals[near], degree, np.zeros_like(residuals[near]) if errors is None else errors[near]
            )
    return None


def _fit(u: np.ndarray, residuals: np.ndarray, degree: int, errors: np.ndarray) -> Response:
    """Least squares of all residuals with the same terms."""
    matrix = terms(u, degree)
    inverse = np.linalg.pinv(matrix)
    coefficients = inverse @ residuals
    freedom = len(u) - matrix.shape[1]
    scatter = np.sqrt(((residuals - matrix @ coefficients) ** 2).sum(axis=0) / freedom)
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


@dataclass(frozen=True)
class Identification:
    """What the targets determine: standard deviation (d,) of each parameter in [0, 1]; responses to each parameter.

    `importance` (d,): share of each parameter in the squared gradients of the residuals at the best values; 0 if no
    target responds to the parameter.
    """

    deviation: np.ndarray
    importance: np.ndarray

    def is_identified(self, index: int) -> bool:
        """Whether the targets determine a parameter."""
        return bool(self.deviation[index] < NOT_IDENTIFIED * np.sqrt(UNIFORM_VARIANCE))

    def statement(self, names: Sequence[str], index: int) -> str:
        """A sentence on a parameter that the targets do not identify; empty for an identified one."""
        if self.is_identified(index):
            return ""
        name = names[index]
        others = [other for k, other in enumerate(names) if k != index and self.importance[k] > 0.0]
        if self.importance[index] == 0.0:
            return (
                f"{name} cannot be identified from the targets: none of them responds to it by more than the scatter "
                "between runs."
            )
        if others:
            together = ", ".join(others)
            return f"{name} cannot be identified from the targets: they determine it only together with {together}."
        return f"{name} cannot be identified from the targets: their tolerances are too large for its range."


def identification(response: Response, best: np.ndarray) -> Identification:
    """What the targets determine at the parameters `best` (d,); see the module docstring."""
    slopes, errors = response.gradient(best)
    slopes = np.where(np.abs(slopes) >= response.least_ratio * errors, slopes, 0.0)
    information = (slopes.T / (1.0 + response.scatter**2)) @ slopes + np.eye(len(best)) / UNIFORM_VARIANCE
    squares = (slopes**2).sum(axis=0)
    total = float(squares.sum()) or 1.0
    return Identification(np.sqrt(np.diag(np.linalg.inv(information))), squares / total)
