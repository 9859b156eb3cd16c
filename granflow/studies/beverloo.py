"""The law of discharge of Beverloo, fitted to mass flow rates through orifices of several sizes.

    W = C rho sqrt(g) (D - k d)^(5/2)      (Beverloo, Leniger & van de Velde, Chem. Eng. Sci. 15 (1961) 260)

with the orifice D, the particle diameter d and the bulk density rho. The fitted quantity is ln W, so that
small flows have the same weight as large ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from granflow import GranflowError, read_run
from granflow.io.tables import read_table
from granflow.units import UnitError, split_heading, to_si, with_unit

EXPONENT = 2.5
"""Exponent of Beverloo's law."""

GRAVITY = 9.81
"""Default gravitational acceleration [m/s2]."""

K_LOWEST = -10.0
"""Smallest k of the search; published values lie between 1 and 3."""

K_START = 1.4
"""Initial k of the fit, for orifices that are wider."""

COLUMNS = {"orifice": "length", "mass_flow": "mass_flow"}
"""Columns of a table of flows, with the dimension of their units."""


@dataclass(frozen=True)
class Discharge:
    """Mass flows [kg/s] (n,) through orifices of diameter (n,) [m]."""

    orifice: np.ndarray
    mass_flow: np.ndarray


@dataclass(frozen=True)
class BeverlooFit:
    """C, k and the exponent, each with its standard error; the error of a given exponent is 0.

    `residual` (n,): ln of measured over fitted flow. Errors are nan unless the number of flows exceeds that
    of parameters.
    """

    c: float
    k: float
    exponent: float
    c_error: float
    k_error: float
    exponent_error: float
    residual: np.ndarray


def fit_beverloo(
    data: Discharge,
    particle_diameter: float,
    bulk_density: float,
    gravity: float = GRAVITY,
    exponent: float | None = EXPONENT,
) -> BeverlooFit:
    """Fit C and k, and the exponent if it is None, to mass flow rates.

        W = C rho sqrt(g) d^(5/2) (D/d - k)^n

    This is Beverloo's law for n = 5/2, with d = `particle_diameter` [m], rho = `bulk_density` [kg/m3], g =
    `gravity` [m/s2].

    Raises GranflowError if the flows are not positive or if there are fewer different orifices than
    parameters.
    """
    orifices = len(np.unique(data.orifice))
    needed = 2 if exponent is not None else 3
    if orifices < needed:
        raise GranflowError(
            f"Flows through {orifices} different orifices are too few: give {needed} or more."
        )
    if not (np.all(data.mass_flow > 0.0) and np.all(data.orifice > 0.0)):
        raise GranflowError("A flow or an orifice is not above 0: leave out orifices that were blocked.")
    ratio = data.orifice / particle_diameter
    height = np.log(data.mass_flow / (bulk_density * np.sqrt(gravity) * particle_diameter**EXPONENT))
    values, covariance = _fit_logarithms(ratio, height, exponent)
    level, k, power = (*values, exponent)[:3]
    residual = height - level - power * np.log(ratio - k)
    errors = np.sqrt(np.diag(covariance)) if len(ratio) > needed else np.full(needed, np.nan)
    c = float(np.exp(level))
    free = float(errors[2]) if exponent is None else 0.0
    return BeverlooFit(c, float(k), float(power), c * float(errors[0]), float(errors[1]), free, residual)


def _fit_logarithms(
    ratio: np.ndarray, height: np.ndarray, exponent: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Best ln C, k and, if it is free, exponent n (p,), and their covariance (p, p).

        height = ln C + n ln(D/d - k)

    `ratio`: D/d (n,), `height` (n,): ln of the dimensionless flow; k lies between K_LOWEST and all D/d.
    """
    import warnings

    from scipy.optimize import OptimizeWarning, curve_fit

    def line(at: np.ndarray, level: float, k: float, power: float = exponent or EXPONENT) -> np.ndarray:
        return np.asarray(level + power * np.log(at - k))

    def slopes(at: np.ndarray, level: float, k: float, power: float = exponent or EXPONENT) -> np.ndarray:
        return np.stack([np.ones_like(at), -power / (at - k), np.log(at - k)][:count], axis=1)

    count = 2 if exponent is not None else 3
    largest = float(ratio.min())
    k = min(K_START, 0.5 * largest)
    start = (float(np.mean(height - EXPONENT * np.log(ratio - k))), k, EXPONENT)[:count]
    bounds = ((-np.inf, K_LOWEST, -np.inf)[:count], (np.inf, largest, np.inf)[:count])
    tolerances = {"xtol": 1e-13, "ftol": None, "gtol": None}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OptimizeWarning)  # as many flows as parameters: no covariance
        return curve_fit(line, ratio, height, start, bounds=bounds, jac=slopes, **tolerances)


def read_discharges(sources: Sequence[Path]) -> Discharge:
    """Read flows from runs (directories written by `granflow run`) and CSV files.

    Of a run: twice the radius of its flow meter, and its steady mass flow rate. A CSV file has the columns
    `orifice` and `mass_flow`, in SI or with units.

    Raises GranflowError for a run without exactly one flow meter with a radius, or for an invalid table.
    """
    rows = [row for source in sources for row in (_of_run(source) if source.is_dir() else _of_table(source))]
    table = np.array(rows, dtype=float).reshape(-1, 2)
    return Discharge(table[:, 0], table[:, 1])


def _of_run(source: Path) -> list[tuple[float, float]]:
    """Orifice [m] and mass flow rate [kg/s] of a run. Raises GranflowError."""
    run = read_run(source)
    if run.result is None:
        raise GranflowError(f"{source} has no result.json; give the directory of a finished run.")
    meters = run.scene.output.flow_meters
    numbers = run.result.flow_meters
    found = [
        (2.0 * meter.radius, numbers[name]["mass_flow"])
        for name, meter in meters.items()
        if meter.radius is not None
    ]
    if len(found) != 1:
        raise GranflowError(
            f"{source} has {len(found)} flow meters with a radius; one is needed, as wide as the orifice."
        )
    return found


def _of_table(source: Path) -> list[tuple[float, float]]:
    """Orifices [m] and mass flow rates [kg/s] of a CSV file. Raises GranflowError with the line number."""
    table = read_table(source)
    headings = [split_heading(name) for name in table.names] if table else []
    names = [name for name, _ in headings]
    missing = [name for name in COLUMNS if name not in names]
    if table is None or missing:
        raise GranflowError(f"{source} has no column {missing[0]}; the columns are orifice and mass_flow.")
    units = dict(headings)
    found = []
    for line, cells in table.rows:
        row = dict(zip(names, cells, strict=False))
        try:
            orifice, flow = (
                to_si(with_unit(row.get(name, ""), units[name]), dimension)
                for name, dimension in COLUMNS.items()
            )
            found.append((orifice, flow))
        except UnitError as error:
            raise GranflowError(f"{source}:{line}: {error}.") from None
    return found


def beverloo_rows(fits: Sequence[BeverlooFit]) -> list[tuple[str, ...]]:
    """Table rows of several fits: name, then value and standard error for each fit; last the relative
    scatter."""
    rows = []
    for name in ("c", "k", "exponent"):
        cells = [_with_error(getattr(fit, name), getattr(fit, f"{name}_error")) for fit in fits]
        rows.append((name.upper() if name == "c" else name, *cells))
    scatter = [f"{np.sqrt((fit.residual**2).mean()):.2%}" for fit in fits]
    return [*rows, ("scatter", *scatter)]


def _with_error(value: float, error: float) -> str:
    """Value and standard error; an error of 0 marks a given value."""
    return f"{value:.4g} ± {error:.2g}" if error else f"{value:.4g} given"
