"""Polynomial responses of the residuals to the parameters, and what the targets determine.

Each residual r is a polynomial of the parameters u, scaled to [0, 1], fitted to the trials near the best one
by least squares; s is the standard deviation of the residual about the fit (scatter between runs), at least
the root mean square of the standard errors that the runs give for their values. The search takes its last
points from a fit of second degree. With one of first degree, the targets determine the parameters with the
covariance

    C = (sum of J J^T / (1 + s^2) + 12 I)^-1

J: gradient of a residual at the best values, 12 I: inverse variance of the uniform distribution between the
bounds. A component of J counts as 0 if its ratio to its standard error is below the quantile of the
t-distribution at LEVEL.
"""

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy.optimize import least_squares
from scipy.special import stdtrit

LEVEL = 0.0027
"""Significance level of slopes, two-sided: 3 standard deviations of a normal distribution."""
SURPLUS = 1.5
"""Smallest ratio of the number of trials to that of the coefficients."""
EXACT = 1e-9
"""Smallest standard deviation of a residual: the scatter of exact polynomials is 0."""
UNIFORM_VARIANCE = 1.0 / 12.0
"""Variance of the uniform distribution on [0, 1]."""
NOT_IDENTIFIED = 0.5
"""Ratio of the standard deviation of a parameter to that of the uniform distribution between its bounds,
above which the targets do not identify it."""


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

    def at(self, u: np.ndarray) -> np.ndarray:
        """Residuals (residuals,) at parameters u (d,)."""
        return np.asarray(_terms(u[None, :], self.degree)[0] @ self.coefficients)

    def optimum(self, start: np.ndarray) -> np.ndarray:
        """Parameters (d,) in [0, 1] with the smallest sum of squared residuals, found from `start`."""
        return np.asarray(least_squares(self.at, np.clip(start, 1e-6, 1.0 - 1e-6), bounds=(0.0, 1.0)).x)

    def significant_gradient(self, u: np.ndarray) -> np.ndarray:
        """Gradient (residuals, d) at u (d,); 0 for a component that the scatter explains."""
        slopes = _term_slopes(u, self.degree)
        errors = np.outer(self.scatter, np.sqrt(np.einsum("it,ts,is->i", slopes, self.spread, slopes)))
        gradient = (slopes @ self.coefficients).T
        return np.where(np.abs(gradient) >= self.least_ratio * errors, gradient, 0.0)

    @property
    def least_ratio(self) -> float:
        """Smallest ratio of a slope to its standard error that the scatter does not explain."""
        return float(stdtrit(self.freedom, 1.0 - LEVEL / 2.0))

    def deviation(self, u: np.ndarray) -> np.ndarray:
        """Standard deviations (d,) with which the residuals determine the parameters at u (d,)."""
        gradient = self.significant_gradient(u)
        information = (gradient.T / (1.0 + self.scatter**2)) @ gradient + np.eye(len(u)) / UNIFORM_VARIANCE
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))


def is_identified(deviation: float) -> bool:
    """Whether the targets determine a parameter with this standard deviation in [0, 1]."""
    return bool(deviation < NOT_IDENTIFIED * np.sqrt(UNIFORM_VARIANCE))


def fit_response(
    u: np.ndarray, residuals: np.ndarray, best: int, errors: np.ndarray | None = None, highest: int = 2
) -> Response | None:
    """Fit residuals (trials, residuals) over parameters u (trials, d), near trial `best`.

    `errors`: standard errors of the residuals (trials, residuals). Returns None with too few trials. The
    degree is `highest`, or 1 if the trials do not suffice for 2. Used is the half of the trials nearest to
    the best one, or as many as the degree needs.
    """
    count = u.shape[1]
    degree = next((degree for degree in (highest, 1) if len(u) >= fewest_trials(count, degree)), 0)
    if degree == 0:
        return None
    order = np.argsort(((u - u[best]) ** 2).sum(axis=1), kind="stable")
    near = order[: max(fewest_trials(count, degree), len(u) // 2)]
    matrix = _terms(u[near], degree)
    inverse = np.linalg.pinv(matrix)
    coefficients = inverse @ residuals[near]
    freedom = len(near) - matrix.shape[1]
    scatter = np.sqrt(((residuals[near] - matrix @ coefficients) ** 2).sum(axis=0) / freedom)
    if errors is not None:
        scatter = np.maximum(scatter, np.sqrt((errors[near] ** 2).mean(axis=0)))
    return Response(degree, coefficients, inverse @ inverse.T, np.maximum(scatter, EXACT), freedom)


def fewest_trials(count: int, degree: int = 1) -> int:
    """Smallest number of trials for a fit of `degree` with `count` parameters."""
    return int(np.ceil(SURPLUS * _terms(np.zeros((1, count)), degree).shape[1])) + 1


SUFFICIENT_FREEDOM = 5
"""Trials near the best one beyond the coefficients of a linear fit from which a slope counts that is 5.5
times its standard error or more; with 2 it must be 19 times, with many 3 times."""


def sufficient_trials(count: int) -> int:
    """Number of trials from which the half of them gives SUFFICIENT_FREEDOM to a linear fit with `count`
    parameters."""
    return 2 * (count + 1 + SUFFICIENT_FREEDOM)


def _terms(u: np.ndarray, degree: int) -> np.ndarray:
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
