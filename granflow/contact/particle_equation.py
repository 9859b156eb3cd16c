"""Equations of particle properties that contacts change, such as a temperature with conduction.

A contact model declares what flows from the partner to a particle (`Law.adds`), and the engine sums it over
the contacts of the particle, exactly. A particle equation reads such sums:

    dy/dt = rate(constants, particle, sums),       y(t + dt) = y(t) + dt rate(t)

It acts in scenes whose contact models add all sums that it reads. Array, sort, checkpoints, snapshots, files,
the keys of the scene and the ghosts of MPI ranks follow from its class. No Taichi.
"""

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

from granflow import fields
from granflow.device_functions import DeviceObject, ti
from granflow.fields import FieldSpec
from granflow.schema.model import is_name
from granflow.schema.quantities import Number

_EQUATIONS: dict[str, "ParticleEquation"] = {}


class ParticleEquation(DeviceObject):
    """How one property of the particles changes; a class without options, with device functions as methods.

    name:           name of the property, and key of a group in `particles` for its initial value
    symbol, unit, meaning:  as of a `Quantity`
    initial:        type of the initial value, which every group requires
    reads:          names of the sums that the rate reads
    material_keys:  type and description of the keys of a material that the rate reads, by name
    """

    name: ClassVar[str]
    symbol: ClassVar[str] = ""
    unit: ClassVar[str] = "1"
    meaning: ClassVar[str]
    initial: ClassVar[Number]
    reads: ClassVar[tuple[str, ...]]
    material_keys: ClassVar[Mapping[str, tuple[Number, str]]] = {}

    @ti.func
    def rate(self, constants, particle, sums):
        """Rate of change of the property.

        constants:  values of `material_keys`
        particle:   radius [m], mass [kg], value of the property
        sums:       of `reads`, by name
        """

    def longest_time_step(
        self, constants: Mapping[str, float], radius: float, mass: float, slope: float
    ) -> float:
        """Time step [s] below which the explicit step is stable.

        constants:     values of `material_keys`
        radius, mass:  [m], [kg], of the smallest particle of a group
        slope:         largest derivative of the sum of its flows by the property, for all its contacts
        """
        raise NotImplementedError

    @property
    def field(self) -> FieldSpec:
        """The property as a field of the particles; ghosts get it with positions and velocities."""
        storage = {"dtype": "position", "block": "motion", "of_ghosts": True}
        return _field(self.name, self.symbol, self.unit, self.meaning, **storage)


def add(equation: ParticleEquation) -> None:
    """Register an equation. Raises ValueError for a name that exists or is not valid."""
    if not is_name(equation.name):
        raise ValueError(f"particle equation {equation.name}: a name has lowercase letters, digits and _")
    fields.add(equation.field)
    _EQUATIONS[equation.name] = equation


def remove(equation: ParticleEquation) -> None:
    """Remove an equation that was added."""
    fields.remove(equation.name)
    del _EQUATIONS[equation.name]


def equations() -> tuple[ParticleEquation, ...]:
    """All registered equations."""
    return tuple(_EQUATIONS.values())


def equations_of(sums: Iterable[str]) -> tuple[ParticleEquation, ...]:
    """The equations that act if contact models add these sums."""
    known = set(sums)
    return tuple(each for each in _EQUATIONS.values() if known.issuperset(each.reads))


def sum_field(name: str, unit: str, meaning: str) -> FieldSpec:
    """A sum over the contacts of a particle as a field; exact in f64 in every precision."""
    return _field(name, "", unit, meaning, dtype="f64", sorted=False, displayed=False)


def _field(name: str, symbol: str, unit: str, meaning: str, **storage: Any) -> FieldSpec:
    """Field of a property or sum, which exists in scenes with the feature."""
    return FieldSpec(
        name,
        symbol,
        unit,
        meaning,
        file_type="float64",
        condition=lambda features: name in features.transported,
        **storage,
    )
