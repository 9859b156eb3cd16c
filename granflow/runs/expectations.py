"""Evaluates the `expect:` block of a scene with the numbers of the completed run."""

import difflib
from collections.abc import Iterable, Mapping
from typing import NamedTuple, Protocol

from granflow.fields import unit_of
from granflow.visible_text import in_degrees


class Expectation(Protocol):
    """One entry of the `expect:` block of a scene; exactly one of the four bounds is not None.

    `tolerance`: relative, for `equals`; None requires equality.
    """

    @property
    def quantity(self) -> str:
        """Name of the quantity, as in `Result.numbers`."""

    @property
    def between(self) -> tuple[float, float] | None:
        """Smallest and largest permitted value."""

    @property
    def below(self) -> float | None:
        """Strict upper bound."""

    @property
    def above(self) -> float | None:
        """Strict lower bound."""

    @property
    def equals(self) -> float | None:
        """Target value, within the tolerance."""

    @property
    def tolerance(self) -> float | None:
        """Largest relative difference for `equals`."""


class ExpectationResult(NamedTuple):
    """Result of one expectation: a sentence with the value and its unit, and whether the expectation is satisfied."""

    sentence: str
    met: bool


def evaluate(expectations: Iterable[Expectation], numbers: Mapping[str, float]) -> list[ExpectationResult]:
    """Evaluate all expectations with the numbers of the completed run (`Result.numbers`), in the same order.

    An expectation on NaN, or on a quantity that the run lacks, is not satisfied; the sentence then lists similar names.
    Raises ValueError for an expectation without any bound.
    """
    return [_evaluate_one(expectation, numbers) for expectation in expectations]


def _evaluate_one(expectation: Expectation, numbers: Mapping[str, float]) -> ExpectationResult:
    """Evaluate one expectation; numbers in the sentence have six digits."""
    name = expectation.quantity
    if name not in numbers:
        return ExpectationResult(_unknown(name, numbers), False)
    number = numbers[name]
    unit = f" {unit_of(name)}".rstrip()
    met, requirement = _compare(expectation, number, unit)
    relation = "as expected" if met else "but should be"
    degrees = in_degrees(number, unit.strip())
    return ExpectationResult(f"{name} is {number:.6g}{unit}{degrees}, {relation} {requirement}.", met)


def _compare(expectation: Expectation, number: float, unit: str) -> tuple[bool, str]:
    """Return whether the number satisfies the bound of the expectation, and the text of the bound.

    `unit`: empty, or a space and the unit. `between` includes both ends, `below` and `above` exclude the bound.
    """
    if expectation.between is not None:
        low, high = expectation.between
        return low <= number <= high, f"between {low:g} and {high:g}{unit}"
    if expectation.below is not None:
        return number < expectation.below, f"below {expectation.below:g}{unit}"
    if expectation.above is not None:
        return number > expectation.above, f"above {expectation.above:g}{unit}"
    if expectation.equals is None:
        raise ValueError(f"The expectation on {expectation.quantity} has no bound.")
    return _compare_equal(number, expectation.equals, expectation.tolerance or 0.0, unit)


def _compare_equal(number: float, target: float, tolerance: float, unit: str) -> tuple[bool, str]:
    """Return whether |number - target| <= tolerance |target|, and the text of the requirement."""
    within = f" within {100.0 * tolerance:g} %" if tolerance else ""
    return abs(number - target) <= tolerance * abs(target), f"equal to {target:.10g}{unit}{within}"


def _unknown(name: str, numbers: Mapping[str, float]) -> str:
    """Return a sentence for a quantity that the run lacks, with at most three similar names, or else with all names."""
    suggestions = difflib.get_close_matches(name, numbers, n=3)
    if suggestions:
        return f"{name} is not a number of this run. Did you mean {' or '.join(suggestions)}?"
    return f"{name} is not a number of this run. It has {', '.join(sorted(numbers))}."
