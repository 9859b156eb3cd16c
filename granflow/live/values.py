"""Checks of values from Python; each raises GranflowError with one sentence."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from granflow.arguments import shown
from granflow.errors import GranflowError
from granflow.plan.plan import Plan

LARGEST = 1e30
"""Largest magnitude of a number [SI], as in a scene; squares of larger ones overflow in single precision."""


def real_array(name: str, given: Any) -> np.ndarray:
    """The numbers in a value as a new float64 array of any shape.

    Raises GranflowError for what is not real numbers: text, None, truth values, complex numbers, masked entries.
    """
    try:
        values = np.array(given)
        if values.dtype.kind not in "iuf" and not (values.dtype.kind == "O" and None not in values.ravel().tolist()):
            raise TypeError
        if np.ma.is_masked(given):
            raise GranflowError(f"{name} has masked entries, whose values are unknown: fill them.")
        return values.astype(np.float64)
    except (ValueError, TypeError, OverflowError):
        kind = "complex numbers" if np.iscomplexobj(given) else shown(given)
        raise GranflowError(f"{name} is {kind}, but must be real numbers, such as 0.5 or [0, 0, 1].") from None


def finite(name: str, values: np.ndarray) -> np.ndarray:
    """The values, all of which must be finite and of a magnitude that occurs."""
    if not np.isfinite(values).all():
        first = values[~np.isfinite(values)].flat[0]
        raise GranflowError(f"{name} contains {first}; all values must be finite.")
    if (np.abs(values) > LARGEST).any():
        first = values[np.abs(values) > LARGEST].flat[0]
        raise GranflowError(f"{name} contains {first:g}; a value of this magnitude is out of range.")
    return values


def array_of(name: str, given: object, count: int, width: int | None) -> np.ndarray:
    """An array (count,) or (count, width) of finite numbers, from one entry for all or one for each."""
    shape = (count,) if width is None else (count, width)
    values = real_array(name, given)
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
