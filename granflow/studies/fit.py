"""Least-squares fit of sigma and psi of Eq. 12 to measured restitution.

e(v) = exp(-sigma (v / (vlim - v))^psi)      (Zhou 2011, Eq. 12)
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from granflow.contact.material import Solid, VelocityRestitution, limit_velocity
from granflow.errors import GranflowError
from granflow.scene.schema.presets import PRESETS
from granflow.scene.suggest import suggestion_or_list
from granflow.studies.figures import COLORS, POINTS, draw_to
from granflow.studies.measurements import Measurements
from granflow.studies.tables import write_columns

NAMES = ("sigma", "psi", "limit_velocity")
"""Parameters of Eq. 12, in the order of parameter vectors."""

TOLERANCE = 1e-15
"""Convergence tolerance of the minimization (relative)."""
START_MARGINS = (0.02, 0.2, 1.0, 5.0, 50.0)
"""Initial limit velocities: relative distance above the largest measured velocity."""
FLATTEST = 0.05
"""Smallest initial psi; scattered data may give a negative slope."""
HEIGHT = 4.2
"""Height of the figure [inch]."""


@dataclass(frozen=True)
class Fit:
    """Parameters of Eq. 12 with standard errors; the error of a given limit velocity is 0.

    `curve`: sigma, psi and limit velocity [m/s]; `errors`: their standard errors in the same fields.
    """

    curve: VelocityRestitution
    errors: VelocityRestitution
    correlation: float
    """Correlation coefficient of measured and fitted restitution; nan if all measured values are equal."""
    r_squared: float
    """Coefficient of determination: fraction of the variance of the measured restitution that the curve explains."""
    residual: np.ndarray
    """Measured minus fitted restitution (n,)."""

    def snippet(self) -> str:
        """The curve as the entry of a material pair in a scene."""
        values = ", ".join(f"{name}: {getattr(self.curve, name):.6g}" for name in NAMES)
        return f"restitution: {{{values} m/s}}"


def fit(data: Measurements, limit: float | None = None) -> Fit:
    """Fit Eq. 12; if no limit velocity [m/s] is given, fit it as well.

    The weighted sum of squares of the restitution errors is minimized, from several initial limit velocities if that is
    free. Standard errors follow from the residuals, or from the standard deviations in the file if it has them.

    Raises GranflowError if the data do not determine the parameters, or if a measured restitution above 0 contradicts
    the limit velocity.
    """
    _check_determined(data, limit)
    starts = _starts(data, limit)
    found = min((_minimize(data, start, limit) for start in starts), key=lambda each: each[1])
    curve = VelocityRestitution(*found[0].tolist())
    errors = _standard_errors(data, found[0], limit)
    predicted = curve(data.velocity)
    weights = 1.0 / data.uncertainty**2
    residual = data.restitution - predicted
    scatter = data.restitution - np.average(data.restitution, weights=weights)
    total = float(weights @ scatter**2)
    return Fit(
        curve=curve,
        errors=VelocityRestitution(*errors.tolist()),
        correlation=_correlation(data.restitution, predicted, weights),
        r_squared=1.0 - float(weights @ residual**2) / total if total > 0.0 else float("nan"),
        residual=residual,
    )


def _check_determined(data: Measurements, limit: float | None) -> None:
    """Raise GranflowError if the data are too few, or contradict the limit velocity [m/s]."""
    fitted = "sigma and psi" if limit else "sigma, psi and the limit velocity"
    count = 2 if limit else 3
    if len(data) <= count:
        raise GranflowError(f"Fitting {fitted} with errors needs at least {count + 1} rows, but there are {len(data)}.")
    if limit and np.any((data.velocity >= limit) & (data.restitution > 0.0)):
        fastest = data.velocity[data.restitution > 0.0].max()
        raise GranflowError(
            f"The limit velocity is {limit:g} m/s, but the restitution measured at {fastest:g} m/s is above 0; in "
            "Eq. 12 it is 0 from the limit velocity on. Give a higher limit velocity, or fit it with --fit-limit."
        )
    informative = (data.restitution > 0.0) & (data.restitution < 1.0)
    velocities = len(np.unique(data.velocity[informative]))
    if velocities < count:
        raise GranflowError(
            f"Restitutions between 0 and 1 at {velocities} different velocities are too few for {fitted}; "
            f"give at least {count}."
        )


def _starts(data: Measurements, limit: float | None) -> list[np.ndarray]:
    """Initial parameters (3,) by linear regression: ln(-ln e) = ln sigma + psi ln(v / (vlim - v)).

    One start for a given limit velocity, otherwise one for each of START_MARGINS.
    """
    informative = (data.restitution > 0.0) & (data.restitution < 1.0)
    velocity = data.velocity[informative]
    height = np.log(-np.log(data.restitution[informative]))
    found = []
    for each in [limit] if limit else velocity.max() * (1.0 + np.array(START_MARGINS)):
        slope, level = np.polyfit(np.log(velocity / (each - velocity)), height, 1)
        found.append(np.array([np.exp(level), max(slope, FLATTEST), each]))
    return found


def _minimize(data: Measurements, start: np.ndarray, limit: float | None) -> tuple[np.ndarray, float]:
    """Parameters (3,) and sum of squares, by least squares in the logarithms of the parameters.

    The logarithms keep sigma and psi above 0. The limit velocity is represented by its difference from the largest
    velocity with a rebound.
    """
    from scipy.optimize import least_squares

    free = 2 if limit else 3
    floor = np.array([0.0, 0.0, 0.0 if limit else data.velocity[data.restitution > 0.0].max()])

    def parameters(logarithms: np.ndarray) -> np.ndarray:
        return np.append(floor[:free] + np.exp(logarithms), start[free:])

    def residual(logarithms: np.ndarray) -> np.ndarray:
        return _linearized(data, parameters(logarithms))[0]

    def jacobian(logarithms: np.ndarray) -> np.ndarray:
        point = parameters(logarithms)
        return -(_linearized(data, point)[1] * (point - floor))[:, :free]

    tolerances = dict.fromkeys(("xtol", "ftol", "gtol"), TOLERANCE)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        found = least_squares(residual, np.log((start - floor)[:free]), jacobian, method="lm", **tolerances)
    return parameters(found.x), 2.0 * float(found.cost)


def _linearized(data: Measurements, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Measured minus fitted restitution (n,) and the derivatives (n, 3) of the fit, both divided by the uncertainty.

    With u = v/(vlim - v) and e = exp(-sigma u^psi):  de/dsigma = -u^psi e,  de/dpsi = -sigma u^psi ln(u) e,
    de/dvlim = sigma psi u^psi e / (vlim - v); all 0 from the limit velocity on.
    """
    sigma, psi, limit = parameters
    e = VelocityRestitution(sigma, psi, limit)(data.velocity)
    below = np.where(data.velocity < limit, data.velocity, 0.5 * limit)
    ratio = below / (limit - below)
    power_e = ratio**psi * e
    slopes = np.stack([-power_e, -sigma * power_e * np.log(ratio), sigma * psi * power_e / (limit - below)], axis=1)
    return (data.restitution - e) / data.uncertainty, slopes / data.uncertainty[:, None]


def _standard_errors(data: Measurements, parameters: np.ndarray, limit: float | None) -> np.ndarray:
    """Standard errors (3,): square roots of the diagonal of (J^T J)^-1, from the singular values of J.

    Multiplied by the residual scatter unless standard deviations are given. Raises GranflowError if the error of the
    limit velocity exceeds its value.
    """
    free = 2 if limit else 3
    residual, slopes = _linearized(data, parameters)
    jacobian = slopes[:, :free] * parameters[:free]
    errors = np.zeros(3)
    _, stretch, directions = np.linalg.svd(jacobian, full_matrices=False)
    with np.errstate(divide="ignore"):
        errors[:free] = np.linalg.norm(directions / stretch[:, None], axis=0) * parameters[:free]
    if not data.absolute:
        errors *= np.sqrt(residual @ residual / (len(data) - free))
    if not errors[2] < parameters[2]:
        raise GranflowError(
            "The data do not determine the limit velocity: all velocities are far below it. "
            "Give it with --limit-velocity, or use --material (Zhou 2011, Eq. 11)."
        )
    return errors


def _correlation(measured: np.ndarray, predicted: np.ndarray, weights: np.ndarray) -> float:
    """Weighted correlation coefficient of measured and predicted restitution (n,); nan if either is constant."""
    a = measured - np.average(measured, weights=weights)
    b = predicted - np.average(predicted, weights=weights)
    size = float(np.sqrt((weights @ a**2) * (weights @ b**2)))
    return float(weights @ (a * b)) / size if size > 0.0 else float("nan")


def write_fit(out: Path, data: Measurements, result: Fit) -> None:
    """Write `fit.csv`, then `fit.png` into `out`. Raises GranflowError if matplotlib is not installed."""
    out.mkdir(parents=True, exist_ok=True)
    table = {"velocity": data.velocity, "measured": data.restitution, "fitted": result.curve(data.velocity)}
    write_columns(out / "fit.csv", table | {"residual": result.residual})
    draw_to(out / "fit.png", lambda figure: _draw(figure, data, result), HEIGHT)


def _draw(figure: Any, data: Measurements, result: Fit) -> None:
    axes = figure.subplots()
    low, high = data.velocity.min() / 1.5, min(data.velocity.max() * 1.5, result.curve.limit_velocity)
    velocity = np.geomspace(low, high, 300)
    axes.semilogx(velocity, result.curve(velocity), color=COLORS[0], label=_legend(result))
    bars = data.uncertainty if data.absolute else None
    axes.errorbar(data.velocity, data.restitution, bars, marker="o", color="black", label="measured", **POINTS)
    axes.set(xlabel="approach velocity $v$ [m/s]", ylabel="restitution coefficient $e$", ylim=(0.0, 1.05))
    axes.set_xlim(low, high)
    axes.legend(loc="lower left")


def _legend(result: Fit) -> str:
    curve, errors = result.curve, result.errors
    values = rf"$\sigma$ = {curve.sigma:.4g} ± {errors.sigma:.2g}, $\psi$ = {curve.psi:.4g} ± {errors.psi:.2g}"
    return f"Eq. 12: {values},\n$v_{{lim}}$ = {curve.limit_velocity:.4g} m/s, $r$ = {result.correlation:.5f}"


def fit_rows(result: Fit) -> list[tuple[str, str, str, str]]:
    """Table rows of a fit: name, value, standard error, unit."""
    units = {"sigma": "", "psi": "", "limit_velocity": "m/s"}
    found = []
    for name in NAMES:
        error = getattr(result.errors, name)
        shown = f"{error:.2g}" if error or name != "limit_velocity" else "given"
        found.append((name.replace("_", " "), f"{getattr(result.curve, name):.6g}", shown, units[name]))
    found.append(("correlation coefficient r", f"{result.correlation:.6f}", "", ""))
    found.append(("r squared", f"{result.r_squared:.6f}", "", ""))
    return found


def limit_from_materials(first: str, second: str | None = None) -> float:
    """Limit velocity of Eq. 11 [m/s] for two material presets, or for one preset with itself.

    Raises GranflowError for an unknown preset, or if neither has a yield strength.
    """
    solids = []
    for name in (first, second or first):
        if name not in PRESETS:
            raise GranflowError(f"there is no preset {name}: {suggestion_or_list(name, PRESETS, 'presets')}")
        preset = PRESETS[name]
        solids.append(Solid(preset.young_modulus, preset.poisson_ratio, preset.density, preset.yield_strength))
    try:
        return limit_velocity(*solids)
    except ValueError:
        raise GranflowError(
            f"The preset {first} has no yield strength, which the limit velocity requires "
            "(Zhou 2011, Eq. 11); give --limit-velocity or --fit-limit."
        ) from None
