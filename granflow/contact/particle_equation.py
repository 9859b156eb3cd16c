"""Equations of particle properties that contacts change, such as a temperature with conduction.

A contact model declares what flows through a contact (`Law.flows`), and the engine sums each flow over the
contacts of a particle, exactly. A particle equation integrates a property with such sums:

    dy/dt = rate(constants, particle, flows),       y(t + dt) = y(t) + dt rate(t)

It acts in scenes whose contact models have all flows that it names. Array, sort, checkpoints, snapshots,
files, the keys of the scene and their checks, and the ghosts of MPI ranks follow from its class. An equation
is one file, and an entry of the list in `granflow.contact.registry`; a program registers its own with
`granflow.register_particle_equation`. No Taichi.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from granflow.device_functions import DeviceObject, kind_of, ti
from granflow.fields import FieldSpec, Quantity
from granflow.schema.model import Model
from granflow.schema.quantities import Number


class MaterialProperties(Model):
    """Keys of a material that a particle equation or a contact model requires; this class has none.

    A subclass declares them as fields, each with a description, without a default.
    """


CONTENT_CHANGES = {
    "set": "{content}: part added where a stage or a program has set the {property}",
    "inserted": "{content}: part of inserted particles, with those at the start, when they were inserted",
    "deleted": "{content}: part of deleted particles, when they were deleted",
}
"""Changes of the content of all particles without a flow, and their meanings."""


class ParticleEquation(DeviceObject):
    """How one property of the particles changes; a class without options, with device functions as methods.

    name:                   name of the property, and key of a group in `particles` for its initial value
    symbol, unit, meaning:  as of a `Quantity`
    initial:                type of the initial value, which every group requires
    flows:                  names of the flows whose sums the rate reads
    material_properties:    class of the keys of a material that the rate reads
    content:                what changes with the property and is conserved, such as heat: a total of
                            snapshots, see `capacity` and `totals`; None: no totals
    """

    name: ClassVar[str]
    symbol: ClassVar[str] = ""
    unit: ClassVar[str] = "1"
    meaning: ClassVar[str]
    initial: ClassVar[Number]
    flows: ClassVar[tuple[str, ...]]
    material_properties: ClassVar[type[MaterialProperties]] = MaterialProperties
    content: ClassVar[Quantity | None] = None

    @ti.func
    def rate(self, constants, particle, flows):
        """Rate of change of the property.

        constants:  values of `material_properties`
        particle:   radius [m], mass [kg], value of the property; of a clump its mass, and the radius of its
                    largest sphere
        flows:      sum of each flow in `flows` over the contacts of the particle, by name; of a clump over
                    those of all its spheres
        """

    def title(self) -> str:
        """The equation in messages."""
        return f"the equation of the {self.name}"

    def refuse_result(self, name: str, result: Any) -> None:
        """Raise TypeError if `rate` returned something else than a number."""
        if name == "rate" and kind_of(result) != "number":
            raise TypeError(f"rate must return one number [{self.unit} / s]")

    def longest_time_step(
        self, constants: Mapping[str, float], radius: float, mass: float, slope: float
    ) -> float:
        """Time step [s] below which the explicit step is stable.

        constants:     values of `material_properties`
        radius, mass:  [m], [kg], of the smallest particle of a group, as of `rate`
        slope:         largest derivative of the sum of its flows by the property, for all its contacts
        """
        raise NotImplementedError

    def capacity(self, constants: Mapping[str, np.ndarray], mass: np.ndarray) -> np.ndarray:
        """Ratio (n,) of the content of particles to their property.

        constants:  values (n,) of `material_properties`
        mass:       (n,) [kg]
        """
        raise NotImplementedError

    @property
    def totals(self) -> tuple[Quantity, ...]:
        """The mean of the property, weighted by the capacity; the content of all particles; what has changed
        it since the start, see CONTENT_CHANGES; and the spread of the property, see `spread`."""
        if self.content is None:
            return ()
        mean = Quantity(f"{self.name}_mean", self.symbol, self.unit, f"{self.meaning}, mean by its capacity")
        changes = (self.content_change(each) for each in CONTENT_CHANGES)
        return mean, self.content, *changes, *self.spread

    @property
    def spread(self) -> tuple[Quantity, Quantity, Quantity]:
        """Standard deviation of the property about its mean, weighted by the capacity, smallest and largest
        value."""

        def quantity(end: str, kind: str) -> Quantity:
            return Quantity(f"{self.name}_{end}", "", self.unit, f"{self.meaning}, {kind}")

        return (
            quantity("deviation", "standard deviation over the particles by their capacity"),
            quantity("smallest", "smallest of all particles"),
            quantity("largest", "largest of all particles"),
        )

    def content_change(self, change: str) -> Quantity:
        """The total of one of CONTENT_CHANGES; the equation has a content."""
        assert self.content is not None
        meaning = CONTENT_CHANGES[change].format(content=self.content.meaning, property=self.name)
        return replace(self.content, name=f"{self.content.name}_{change}", symbol="", meaning=meaning)

    @property
    def material_keys(self) -> tuple[str, ...]:
        """Names of `material_properties`."""
        return tuple(self.material_properties.model_fields)

    def acts_with(self, flows: tuple[str, ...]) -> bool:
        """Whether contact models with these flows have all that the equation needs."""
        return set(self.flows).issubset(flows)

    @property
    def field(self) -> FieldSpec:
        """The property as a field of the particles; ghosts get it with positions and velocities."""
        return FieldSpec(
            self.name,
            self.symbol,
            self.unit,
            self.meaning,
            file_type="float64",
            dtype="position",
            condition=lambda features: self.acts_with(features.flows),
            block="motion",
            of_ghosts=True,
        )


def source_field(name: str, unit: str, meaning: str) -> FieldSpec:
    """A source of a flow in each particle as a field, of scenes that have one."""
    return FieldSpec(
        name,
        "",
        unit,
        meaning,
        file_type="float64",
        dtype="f64",
        condition=lambda features: name in features.sources,
    )


def flow_field(name: str, unit: str, meaning: str) -> FieldSpec:
    """The sum of a flow over the contacts of a particle as a field; exact in f64 in every precision."""
    return FieldSpec(
        name,
        "",
        unit,
        meaning,
        file_type="float64",
        dtype="f64",
        condition=lambda features: name in features.flows,
        sorted=False,
        displayed=False,
    )
