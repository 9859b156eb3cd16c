"""The temperature of the particles, which the heat from their contacts changes."""

from collections.abc import Mapping
from math import inf

import numpy as np
from pydantic import Field

from granflow.contact.particle_equation import MaterialProperties, ParticleEquation
from granflow.device_functions import ti
from granflow.fields import Quantity
from granflow.schema import quantities as q
from granflow.schema.quantities import Number


class HeatCapacity(MaterialProperties):
    """Keys of materials."""

    heat_capacity: q.HeatCapacity = Field(
        description="specific heat capacity of the solid [J/kg/K]", examples=["500 J/kg/K"]
    )


class Temperature(ParticleEquation):
    """m c dT/dt = sum of the heat flows."""

    name = "temperature"
    symbol = "T"
    unit = "K"
    meaning = "temperature of the particle"
    initial = Number("temperature", above=0)
    flows = ("heat_flow",)
    material_properties = HeatCapacity
    content = Quantity("heat_content", "H", "J", "heat of the particles, the sum of m c T")

    @ti.func
    def rate(self, constants, particle, flows):
        """Rate of change [K/s]."""
        return flows.heat_flow / (particle.mass * constants.heat_capacity)

    def capacity(self, constants: Mapping[str, np.ndarray], mass: np.ndarray) -> np.ndarray:
        """m c [J/K]."""
        return mass * constants["heat_capacity"]

    def longest_time_step(
        self, constants: Mapping[str, float], radius: float, mass: float, slope: float
    ) -> float:
        """m c / (sum of the conductances) [s].

        A particle whose neighbors differ from it by the same amount decays with at most twice the rate of
        this time; the explicit step is stable up to twice its inverse.
        """
        return mass * constants["heat_capacity"] / slope if slope else inf


EQUATION = Temperature()
