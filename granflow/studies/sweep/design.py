"""Points of a sweep: combinations of the parameter values by grid, Latin hypercube or Saltelli's design."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from math import ulp
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import qmc

from granflow.scene.schema.given_numbers import in_si
from granflow.studies.run_processes.settings import si_value
from granflow.studies.sweep.schema import Grid, LatinHypercube, SobolSampling, SweepInput, ValueList, ValueRange


@dataclass(frozen=True)
class DesignPoint:
    """One point: value of each parameter by its name, SI, and value of each key of the scene, which may have a unit."""

    values: Mapping[str, Any]
    settings: Mapping[str, Any]


class _Level(NamedTuple):
    """One value of a parameter, and the values of the keys of the scene that it sets."""

    value: Any
    settings: Mapping[str, Any]


def design_points(sweep: SweepInput) -> list[DesignPoint]:
    """All points in a fixed order; of a grid, the last parameter varies fastest.

    Values of parameters are SI numbers where the text is a number with a unit; the scene gets values with units, so
    that it refuses those of another dimension. The points of a Sobol sampling are in the order of SALib without
    second-order indices: for each base point A, each A with one value of B, and B.
    """
    if isinstance(sweep.sampling, Grid):
        levels = [list(_grid_levels(name, variation)) for name, variation in sweep.vary.items()]
        return [_point(sweep, combination) for combination in product(*levels)]
    return [
        _point(sweep, [_level_at(*entry, share) for entry, share in zip(sweep.vary.items(), row, strict=True)])
        for row in unit_samples(sweep.sampling, len(sweep.vary)).tolist()
    ]


def _point(sweep: SweepInput, levels: Any) -> DesignPoint:
    """The point with one level of each parameter."""
    settings = dict(sweep.settings)
    for level in levels:
        settings.update(level.settings)
    return DesignPoint({name: level.value for name, level in zip(sweep.vary, levels, strict=True)}, settings)


def unit_samples(sampling: LatinHypercube | SobolSampling, parameters: int) -> np.ndarray:
    """Samples (points, parameters) in [0, 1).

    Saltelli's design (Saltelli et al., Comput. Phys. Commun. 181 (2010) 259): rows A_i, AB_i1, ..., AB_id, B_i for each
    base point i, where AB_ij is A_i with component j of B_i; A and B are the halves of a Sobol sequence.
    """
    if isinstance(sampling, LatinHypercube):
        return np.asarray(qmc.LatinHypercube(parameters, seed=sampling.seed).random(sampling.count))
    both = qmc.Sobol(2 * parameters, scramble=True, seed=sampling.seed).random(sampling.count)
    first, second = both[:, :parameters], both[:, parameters:]
    mixed = np.repeat(first[:, None, :], parameters + 2, axis=1)
    for j in range(parameters):
        mixed[:, 1 + j, j] = second[:, j]
    mixed[:, -1] = second
    return np.asarray(mixed.reshape(-1, parameters))


def _grid_levels(name: str, variation: Any) -> Iterator[_Level]:
    """All values of a parameter in a grid."""
    if isinstance(variation, ValueRange):
        count = variation.count or 1
        yield from (_level_at(name, variation, Fraction(k, max(count - 1, 1))) for k in range(count))
    else:
        values = variation.values if isinstance(variation, ValueList) else variation
        yield from (_listed(name, variation, k) for k in range(len(values)))


def _level_at(name: str, variation: Any, share: float | Fraction) -> _Level:
    """The value at a fraction `share` of the range, or of the list, in which all values are equally probable."""
    if isinstance(variation, ValueRange):
        value = value_at(variation, share)
        given = in_si(value, variation.start.unit or variation.stop.unit)
        return _Level(value, dict.fromkeys(variation.keys or (name,), given))
    values = variation.values if isinstance(variation, ValueList) else variation
    return _listed(name, variation, int(share * len(values)))


SHORT = 9
"""Significant digits of a value that a person would type."""


def value_at(bounds: ValueRange, share: float | Fraction) -> float:
    """The value at a fraction of a range; fractions 0 and 1 give the bounds exactly.

    Linear values are those of exact arithmetic with the decimals of the bounds: 0.3, not 0.30000000000000004, and
    between 10 deg and 30 deg the same number as for 20 deg.
    Logarithmic values that differ from a decimal of SHORT digits by rounding only are that decimal.
    """
    if share in (0.0, 1.0):
        return float(bounds.stop if share else bounds.start)
    if bounds.scale == "log":
        value = float(bounds.start * (bounds.stop / bounds.start) ** float(share))
        short = float(f"{value:.{SHORT}g}")
        return short if abs(short - value) <= 4.0 * ulp(value) else value
    start, stop = bounds.start.exact, bounds.stop.exact
    return float(start + Fraction(share) * (stop - start))


def _listed(name: str, variation: Any, index: int) -> _Level:
    """The value of a list at an index, and the values that change with it."""
    if not isinstance(variation, ValueList):
        value = variation[index]
        return _Level(si_value(value), {name: value})
    value = variation.values[index]
    along = {key: values[index] for key, values in variation.along.items()}
    return _Level(si_value(value), dict.fromkeys(variation.keys or (name,), value) | along)
