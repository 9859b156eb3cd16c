"""sigma and psi of Eq. 12 from measured restitution, by least squares.

    e(v) = exp(-sigma (v / (vlim - v))^psi)      (Zhou 2011, Eq. 12)

Three parameters at most and derivatives in closed form: Levenberg-Marquardt in numpy, so that nobody needs scipy.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from granflow.errors import GranflowError
from granflow.laws.material import VelocityRestitution
from granflow.study.measurements import Measurements

NAMES = ("sigma", "psi", "limit_velocity")
ITERATIONS = 500
SMALLEST_STEP = 1e-10
"""Relative to the parameters; the search ends there."""
START_MARGINS = (0.02, 0.2, 1.0, 5.0, 50.0)
"""Limit velocities to start from: this far above the largest velocity measured, relative to it."""


@dataclass(frozen=True)
class Fit:
    """Parameters of Eq. 12 with their standard errors; a limit velocity that was given has the error 0."""

    curve: VelocityRestitution
    errors: VelocityRestitution
    correlation: float
    """Between measured and fitted restitution; nan where all measured are equal."""
    r_squared: float
    """Share of the scatter of the measured restitution that the curve explains."""
    residual: np.ndarray
    """Measured minus fitted restitution (n,)."""

    def snippet(self) -> str:
        """The curve as a pair of materials says it in a scene."""
        values = ", ".join(f"{name}: {getattr(self.curve, name):.6g}" for name in NAMES)
        return f"restitution: {{{values} m/s}}"


def fit(data: Measurements, limit_velocity: float | None = None) -> Fit:
    """Fit Eq. 12; the limit velocity [m/s] is fitted, too, where none is given.

    Standard errors come from the scatter about the curve, or from the deviations measured where the file has them.
    Raises GranflowError where the data do not determine the parameters.
    """
    _refuse_undetermined(data, limit_velocity)
    starts = _starts(data, limit_velocity)
    found = min((_minimize(data, start, limit_velocity) for start in starts), key=lambda each: each[1])
    curve = VelocityRestitution(*found[0])
    errors = _standard_errors(data, found[0], limit_velocity)
    predicted = curve(data.velocity)
    weights = 1.0 / data.spread**2
    residual = data.restitution - predicted
    scatter = data.restitution - np.average(data.restitution, weights=weights)
    total = float(weights @ scatter**2)
    return Fit(
        curve=curve,
        errors=VelocityRestitution(*errors),
        correlation=_correlation(data.restitution, predicted, weights),
        r_squared=1.0 - float(weights @ residual**2) / total if total > 0.0 else float("nan"),
        residual=residual,
    )


def _refuse_undetermined(data: Measurements, limit_velocity: float | None) -> None:
    fitted = "sigma and psi" if limit_velocity else "sigma, psi and the limit velocity"
    count = 2 if limit_velocity else 3
    if len(data) <= count:
        raise GranflowError(f"{len(data)} rows are too few for {fitted} and their errors: give {count + 1} or more.")
    if limit_velocity and np.any((data.velocity >= limit_velocity) & (data.restitution > 0.0)):
        fastest = data.velocity[data.restitution > 0.0].max()
        raise GranflowError(
            f"The spheres rebound at {fastest:g} m/s, but a limit velocity of {limit_velocity:g} m/s is given, "
            "from which on Eq. 12 says that they do not: give a higher one, or let --fit-limit find it."
        )
    telling = (data.restitution > 0.0) & (data.restitution < 1.0)
    velocities = len(np.unique(data.velocity[telling]))
    if velocities < count:
        raise GranflowError(
            f"Restitutions between 0 and 1 at {velocities} different velocities are too few for {fitted}: "
            f"give {count} or more."
        )


def _starts(data: Measurements, limit_velocity: float | None) -> list[np.ndarray]:
    """Parameters to start from: ln(-ln e) = ln sigma + psi ln(v / (vlim - v)) is a straight line."""
    telling = (data.restitution > 0.0) & (data.restitution < 1.0)
    velocity = data.velocity[telling]
    height = np.log(-np.log(data.restitution[telling]))
    found = []
    for limit in [limit_velocity] if limit_velocity else velocity.max() * (1.0 + np.array(START_MARGINS)):
        slope, level = np.polyfit(np.log(velocity / (limit - velocity)), height, 1)
        found.append(np.array([np.exp(level), max(slope, 0.05), limit]))
    return found


def _minimize(data: Measurements, start: np.ndarray, limit_velocity: float | None) -> tuple[np.ndarray, float]:
    """Parameters and sum of squares, by Levenberg-Marquardt in their logarithms: they stay above 0.

    The limit velocity moves as its margin above the fastest rebound.
    """
    fastest = 0.0 if limit_velocity else float(data.velocity[data.restitution > 0.0].max())
    free = 2 if limit_velocity else 3
    floor = np.array([0.0, 0.0, fastest])
    point, damping = start, 1e-3
    residual, slopes = _linearized(data, point)
    cost = float(residual @ residual)
    for _ in range(ITERATIONS):
        jacobian = (slopes * (point - floor))[:, :free]
        normal = jacobian.T @ jacobian
        step = np.zeros(3)
        step[:free] = np.linalg.lstsq(
            normal + damping * np.diag(np.diag(normal)), jacobian.T @ residual, rcond=None
        )[0].clip(-1.0, 1.0)  # fmt: skip
        trial = floor + (point - floor) * np.exp(step)
        new_residual, new_slopes = _linearized(data, trial)
        new_cost = float(new_residual @ new_residual)
        if new_cost <= cost:
            point, residual, slopes, cost, damping = trial, new_residual, new_slopes, new_cost, 0.3 * damping
        else:
            damping *= 4.0
        if np.abs(step).max() < SMALLEST_STEP:
            break
    return point, cost


def _linearized(data: Measurements, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Measured minus fitted restitution (n,) and its slopes (n, 3) by the parameters, both over the spread.

    With u = v/(vlim - v) and e = exp(-sigma u^psi):  de/dsigma = -u^psi e,  de/dpsi = -sigma u^psi ln(u) e,
    de/dvlim = sigma psi u^psi e / (vlim - v); all 0 from the limit velocity on.
    """
    sigma, psi, limit = parameters
    e = VelocityRestitution(sigma, psi, limit)(data.velocity)
    below = np.where(data.velocity < limit, data.velocity, 0.5 * limit)
    ratio = below / (limit - below)
    power_e = ratio**psi * e
    slopes = np.stack([-power_e, -sigma * power_e * np.log(ratio), sigma * psi * power_e / (limit - below)], axis=1)
    return (data.restitution - e) / data.spread, slopes / data.spread[:, None]


def _standard_errors(data: Measurements, parameters: np.ndarray, limit_velocity: float | None) -> np.ndarray:
    """Square roots of the diagonal of (J^T J)^-1, times the scatter about the curve unless deviations are known."""
    free = 2 if limit_velocity else 3
    residual, slopes = _linearized(data, parameters)
    jacobian = slopes[:, :free] * parameters[:free]
    errors = np.zeros(3)
    try:
        errors[:free] = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian))) * parameters[:free]
    except np.linalg.LinAlgError:
        errors[:free] = np.inf
    if not data.absolute:
        errors *= np.sqrt(residual @ residual / (len(data) - free))
    if not errors[2] < parameters[2]:
        raise GranflowError(
            "These data do not determine the limit velocity: all velocities are far below it. "
            "Give it with --limit-velocity, or --material for Eq. 11."
        )
    return errors


def _correlation(measured: np.ndarray, predicted: np.ndarray, weights: np.ndarray) -> float:
    """Weighted correlation coefficient."""
    a = measured - np.average(measured, weights=weights)
    b = predicted - np.average(predicted, weights=weights)
    size = float(np.sqrt((weights @ a**2) * (weights @ b**2)))
    return float(weights @ (a * b)) / size if size > 0.0 else float("nan")


def write_fit(out: Path, data: Measurements, result: Fit) -> list[Path]:
    """Write `fit.csv`, and `fit.png` where matplotlib is there; returns what was written."""
    out.mkdir(parents=True, exist_ok=True)
    table = np.stack([data.velocity, data.restitution, result.curve(data.velocity), result.residual], axis=1)
    path = out / "fit.csv"
    np.savetxt(path, table, "%.9g", ",", header="velocity,measured,fitted,residual", comments="")
    picture = out / "fit.png"
    return [path, picture] if draw_fit(picture, data, result) else [path]


def draw_fit(path: Path, data: Measurements, result: Fit) -> bool:
    """Draw measurements and curve into a PNG; False where matplotlib is missing."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return False
    figure = Figure(figsize=(5.5, 4.0), dpi=160, layout="constrained")
    axes = figure.subplots()
    low, high = data.velocity.min() / 1.5, min(data.velocity.max() * 1.5, result.curve.limit_velocity)
    velocity = np.geomspace(low, high, 300)
    axes.semilogx(velocity, result.curve(velocity), color="C0", label=_legend(result))
    bars = data.spread if data.absolute else None
    axes.errorbar(data.velocity, data.restitution, yerr=bars, fmt="o", color="k", ms=4, mfc="w", label="measured")
    axes.set(xlabel="approach velocity [m/s]", ylabel="restitution coefficient", ylim=(0.0, 1.02), xlim=(low, high))
    axes.grid(alpha=0.25)
    axes.legend(frameon=False)
    figure.savefig(path)
    return True


def _legend(result: Fit) -> str:
    curve, errors = result.curve, result.errors
    values = rf"$\sigma$ = {curve.sigma:.4g} ± {errors.sigma:.2g}, $\psi$ = {curve.psi:.4g} ± {errors.psi:.2g}"
    return f"Eq. 12: {values}\n$v_{{lim}}$ = {curve.limit_velocity:.4g} m/s, r = {result.correlation:.4f}"


def rows(result: Fit, fitted_limit: bool) -> Sequence[tuple[str, str, str, str]]:
    """The table of a fit: name, value, standard error, unit."""
    units = {"sigma": "", "psi": "", "limit_velocity": "m/s"}
    found = []
    for name in NAMES:
        error = getattr(result.errors, name)
        shown = f"{error:.2g}" if name != "limit_velocity" or fitted_limit else "given"
        found.append((name.replace("_", " "), f"{getattr(result.curve, name):.6g}", shown, units[name]))
    found.append(("correlation coefficient r", f"{result.correlation:.6f}", "", ""))
    found.append(("r squared", f"{result.r_squared:.6f}", "", ""))
    return found
