"""Forces on particles that a program adds with device functions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

ParameterValue = float | tuple[float, float, float]
"""Value of a parameter of a force: a number or a vector."""


@dataclass(frozen=True)
class ExternalForce:
    """One force: its name, device function, and the number of components of each parameter, 1 or 3, by name.

    `values`: present values of the parameters, which may change while the simulation runs; the compiled kernels depend
    on all other attributes.
    """

    name: str
    function: Callable[..., Any]
    layout: tuple[tuple[str, int], ...]
    values: Mapping[str, ParameterValue] = field(compare=False)

    @property
    def numbers(self) -> list[float]:
        """All values one after the other."""
        found: list[float] = []
        for name, _ in self.layout:
            value = self.values[name]
            found += value if isinstance(value, tuple) else (value,)
        return found


def parameter_count(forces: Sequence[ExternalForce]) -> int:
    """Number of values of all parameters."""
    return sum(width for force in forces for _, width in force.layout)
