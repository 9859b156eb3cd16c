"""`granflow fit`: sigma and psi of Eq. 12, fitted by least squares to measured restitution.

    e(v) = exp(-sigma (v / (vlim - v))^psi)      (Zhou 2011, Eq. 12)

`read_measurements` reads a CSV file of velocities and restitutions and reports all invalid rows; `fit` gives
the parameters with their standard errors; `write_fit` writes `fit.csv` and `fit.png`.
"""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from granflow.contact.material import VelocityRestitution, limit_velocity
from granflow.errors import FileError, GranflowError
from granflow.io.files import read_file
from granflow.io.tables import table_in
from granflow.scene.blocks.materials import PRESETS, Material
from granflow.schema.messages import suggestion_or_list
from granflow.studies.figures import COLORS, POINTS, draw_to, write_columns
from granflow.units import UnitError, to_si, with_unit

# ---------------------------------------------------------------- measurements

HEADINGS = {
    "velocity": ("velocity", "v", "approach_velocity", "impact_velocity"),
    "restitution": ("restitution", "e", "restitution_coefficient"),
    "deviation": ("deviation", "standard_deviation", "error", "std"),
    "weight": ("weight", "w"),
}
"""Accepted names of each column; the first one is preferred."""
DIMENSION = {"velocity": "velocity", "restitution": "number", "deviation": "number", "weight": "number"}
"""Dimension of each column, in which units of values are converted to SI."""
SEPARATORS = (";", "\t", ",")
"""Separators of cells, in the order of precedence."""


@dataclass(frozen=True)
class Measurements:
    """Rows of a file: approach velocity (n,) [m/s], restitution (n,), and uncertainty of the restitution
    (n,).

    `uncertainty` is the standard deviation; if `absolute` is False, only its ratios are meaningful.
    """

    velocity: np.ndarray
    restitution: np.ndarray
    uncertainty: np.ndarray
    absolute: bool

    def __len__(self) -> int:
        return len(self.velocity)


def read_measurements(path: Path) -> Measurements:
    """Read a table with the columns `velocity` and `restitution`, and optionally `deviation` or `weight`.

    Columns are separated by commas, semicolons or tabs; empty lines and lines that begin with # are ignored;
    a value or the name of a column may have a unit. Velocities are converted to m/s.

    Raises FileError with all invalid rows as `file:line: sentence`, and GranflowError if the file is not
    UTF-8 text.
    """
    table_read = table_in(_text(path), path, SEPARATORS)
    if table_read is None:
        raise FileError(
            f"{path}: the file has no rows; the first row must name the columns: velocity,restitution."
        )
    width = len(table_read.names)
    columns = _columns(path, table_read.heading_line, table_read.names)
    units = _units(path, table_read.heading_line, table_read.names, columns)
    problems: list[str] = []
    values: list[dict[str, float]] = []
    for line, cells in table_read.rows:
        problems_of_row = _extra_cells(cells, width) or list(_read_row(cells, columns, units, values))
        problems.extend(f"{path}:{line}: {fault}." for fault in problems_of_row)
    if problems:
        raise FileError(problems)
    if not values:
        raise FileError(f"{path}: the file has no measurements below the header.")
    table = {name: np.array([row[name] for row in values]) for name in columns}
    return Measurements(table["velocity"], table["restitution"], _spread(table), "deviation" in table)


def _spread(table: Mapping[str, np.ndarray]) -> np.ndarray:
    """Uncertainty (n,) of each row: the given deviation, 1 / sqrt(weight), or 1."""
    if "deviation" in table:
        return table["deviation"]
    return 1.0 / np.sqrt(table["weight"]) if "weight" in table else np.ones(len(table["velocity"]))


def _text(path: Path) -> str:
    """Text of a UTF-8 file, without a byte order mark. Raises GranflowError for another encoding."""
    try:
        return read_file(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise GranflowError(f"{path} is not UTF-8 text; save it as CSV in UTF-8.") from None


def _columns(path: Path, line: int, cells: Sequence[str]) -> dict[str, int]:
    """Index of each known column by its name in HEADINGS.

    Units in brackets are no part of the names. Raises FileError if a column is missing or duplicated.
    """
    names = [cell.split("[")[0].split("(")[0].strip().lower().replace(" ", "_") for cell in cells]
    found: dict[str, int] = {}
    for name, aliases in HEADINGS.items():
        columns = [n for n, each in enumerate(names) if each in aliases]
        if len(columns) > 1:
            raise FileError(f"{path}:{line}: the header has {len(columns)} columns for {name}; keep one.")
        if columns:
            found[name] = columns[0]
    missing = [name for name in ("velocity", "restitution") if name not in found]
    if missing:
        raise FileError(
            f"{path}:{line}: the header is {', '.join(cells)}, which does not name {' and '.join(missing)}; "
            "the first row must name the columns, such as velocity,restitution."
        )
    if "deviation" in found and "weight" in found:
        raise FileError(f"{path}:{line}: the header has both deviation and weight; keep one.")
    return found


def _units(path: Path, line: int, cells: Sequence[str], columns: Mapping[str, int]) -> dict[str, str]:
    """Unit of each column from its heading, empty without one. Raises FileError for a unit of another
    dimension."""
    units = {
        name: cells[place].replace("(", "[").partition("[")[2].rstrip(")] ")
        for name, place in columns.items()
    }
    for name, unit in units.items():
        try:
            to_si(with_unit("1", unit if unit not in ("-", "1") else ""), DIMENSION[name])
        except UnitError as error:
            raise FileError(f"{path}:{line}: the column of {name} is in {unit}, but {error}.") from None
    return {name: unit if unit not in ("-", "1") else "" for name, unit in units.items()}


def _extra_cells(cells: Sequence[str], width: int) -> list[str]:
    """Message for a row that is longer than the header."""
    if not any(cells[width:]):
        return []
    return [
        f"the row has {len(cells)} values, but the header has {width} columns; use a point as decimal "
        "separator"
    ]


def _read_row(
    cells: Sequence[str], columns: Mapping[str, int], units: Mapping[str, str], values: list[dict[str, float]]
) -> Iterator[str]:
    """Append the numbers of a row to `values`; yield a message for each invalid number."""
    numbers = {}
    for name, place in columns.items():
        text = cells[place] if place < len(cells) else ""
        try:
            numbers[name] = _number(name, with_unit(text, units[name]))
        except UnitError as error:
            yield f"{name} is {text or 'empty'}, but {error}"
    if len(numbers) == len(columns):
        values.append(numbers)


def _number(name: str, text: str) -> float:
    """Number of a cell in SI units. Raises UnitError if it is missing, not finite or out of range."""
    value = to_si(text, DIMENSION[name]) if text else float("nan")
    if not isfinite(value):
        raise UnitError("a number is required; remove the row if nothing was measured")
    if name == "restitution" and not 0.0 <= value <= 1.0:
        raise UnitError("a restitution coefficient must be in [0, 1]")
    if name != "restitution" and not value > 0.0:
        raise UnitError("it must be above 0")
    return value


# ---------------------------------------------------------------- fit

NAMES = ("sigma", "psi", "limit_velocity")
"""Parameters of Eq. 12, in the order of parameter vectors."""
TOLERANCE = 1e-14
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
    """Coefficient of determination: fraction of the variance of the measured restitution that the curve
    explains."""
    residual: np.ndarray
    """Measured minus fitted restitution (n,)."""

    def snippet(self) -> str:
        """The curve as the entry of a material pair in a scene."""
        values = ", ".join(f"{name}: {getattr(self.curve, name):.6g}" for name in NAMES)
        return f"restitution: {{{values} m/s}}"


def fit(data: Measurements, limit: float | None = None) -> Fit:
    """Fit Eq. 12; if no limit velocity [m/s] is given, fit it as well.

    The weighted sum of squares of the restitution errors is minimized, from several initial limit velocities
    if that is free. Standard errors follow from the residuals, or from the standard deviations in the file if
    it has them.

    Raises GranflowError if the data do not determine the parameters, or if a measured restitution above 0
    contradicts the limit velocity.
    """
    _check_determined(data, limit)
    fitted = [each for start in _starts(data, limit) if (each := _minimize(data, start, limit))]
    parameters, errors, _ = min(
        fitted, key=lambda each: each[2], default=(np.ones(3), np.full(3, np.inf), 0.0)
    )
    if not errors[2] < parameters[2]:
        raise GranflowError(
            "The data do not determine the limit velocity: all velocities are far below it. "
            "Give it with --limit-velocity, or use --material (Zhou 2011, Eq. 11)."
        )
    curve = VelocityRestitution(*parameters.tolist())
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
        raise GranflowError(
            f"Fitting {fitted} with errors needs at least {count + 1} rows, but there are {len(data)}."
        )
    if limit and np.any((data.velocity >= limit) & (data.restitution > 0.0)):
        fastest = data.velocity[data.restitution > 0.0].max()
        raise GranflowError(
            f"The limit velocity is {limit:g} m/s, but the restitution measured at {fastest:g} m/s is above "
            "0; in Eq. 12 it is 0 from the limit velocity on. Give a higher limit velocity, or fit it with "
            "--fit-limit."
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


def _minimize(
    data: Measurements, start: np.ndarray, limit: float | None
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Parameters (3,), their standard errors (3,) and the sum of squares; None if it does not converge.

    The logarithms of the parameters are fitted, which keeps sigma and psi above 0. The limit velocity is
    represented by its difference from the largest velocity with a rebound.
    """
    from scipy.optimize import OptimizeWarning, curve_fit

    free = 2 if limit else 3
    floor = np.array([0.0, 0.0, 0.0 if limit else data.velocity[data.restitution > 0.0].max()])

    def parameters(logarithms: np.ndarray) -> np.ndarray:
        return np.append(floor[:free] + np.exp(logarithms), start[free:])

    def curve(velocity: np.ndarray, *logarithms: float) -> np.ndarray:
        return VelocityRestitution(*parameters(np.array(logarithms)))(velocity)

    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", OptimizeWarning)  # the errors are infinite then
        try:
            best, covariance, info, *_ = curve_fit(
                curve,
                data.velocity,
                data.restitution,
                np.log((start - floor)[:free]),
                data.uncertainty,
                data.absolute,
                full_output=True,
                **dict.fromkeys(("xtol", "ftol"), TOLERANCE),
            )
        except RuntimeError:
            return None
    found = parameters(best)
    errors = np.append(np.sqrt(np.diag(covariance)) * (found - floor)[:free], np.zeros(3 - free))
    return found, errors, float(info["fvec"] @ info["fvec"])


def _correlation(measured: np.ndarray, predicted: np.ndarray, weights: np.ndarray) -> float:
    """Weighted correlation coefficient of measured and predicted restitution (n,); nan if either is
    constant."""
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
    axes.errorbar(
        data.velocity, data.restitution, bars, marker="o", color="black", label="measured", **POINTS
    )
    axes.set(xlabel="approach velocity $v$ [m/s]", ylabel="restitution coefficient $e$", ylim=(0.0, 1.05))
    axes.set_xlim(low, high)
    axes.legend(loc="lower left")


def _legend(result: Fit) -> str:
    curve = result.curve
    errors = result.errors
    values = (
        rf"$\sigma$ = {curve.sigma:.4g} ± {errors.sigma:.2g}, $\psi$ = {curve.psi:.4g} ± {errors.psi:.2g}"
    )
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
        solids.append(Material.model_validate({"preset": name}))
    try:
        return limit_velocity(*solids)
    except ValueError:
        raise GranflowError(
            f"The preset {first} has no yield strength, which the limit velocity requires "
            "(Zhou 2011, Eq. 11); give --limit-velocity or --fit-limit."
        ) from None
