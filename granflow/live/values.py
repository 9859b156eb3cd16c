"""Checks of values from Python; each raises GranflowError with one sentence."""

from collections.abc import Sequence

import numpy as np

from granflow.errors import GranflowError
from granflow.plan.plan import Plan


def finite(name: str, values: np.ndarray) -> np.ndarray:
    """The values, all of which must be finite."""
    if not np.isfinite(values).all():
        first = values[~np.isfinite(values)].flat[0]
        raise GranflowError(f"{name} contains {first}; all values must be finite.")
    return values


def array_of(name: str, given: object, count: int, width: int | None) -> np.ndarray:
    """An array (count,) or (count, width) of finite numbers, from one entry for all or one for each."""
    shape = (count,) if width is None else (count, width)
    try:
        values = np.asarray(given, dtype=np.float64)
    except (ValueError, TypeError):
        raise GranflowError(f"{name} is {given!r}, but must be an array {shape} of numbers.") from None
    if values.shape not in (shape, shape[1:]):
        remedy = f"; give its transpose, {name}.T" if values.ndim == 2 and width == len(values) else ""
        raise GranflowError(f"{name} has the shape {values.shape}, but must have {shape} or {shape[1:]}{remedy}.")
    return finite(name, np.broadcast_to(values, shape).copy())


def in_domain(plan: Plan, name: str, position: np.ndarray) -> None:
    """Positions (n, 3) [m] must be inside the domain, unless it expands."""
    if plan.domain.on_exit == "expand":
        return
    outside = np.any((position < plan.domain_low) | (position > plan.domain_high), axis=1)
    if outside.any():
        point, low, high = (
            list(map(float, each)) for each in (position[outside][0], plan.domain_low, plan.domain_high)
        )
        raise GranflowError(f"{name} contains {point} m, which is outside the domain from {low} to {high} m.")


def named(what: str, name: str, names: Sequence[str]) -> int:
    """The index of a name among `names`."""
    if name not in names:
        raise GranflowError(f"{what} is {name!r}, but must be one of {', '.join(names)}.")
    return list(names).index(name)
