"""Conduction through the contact area of two particles (Batchelor & O'Brien 1977).

The heat flow from j to i is that through a circle of radius a between two half spaces of equal conductivity,
with the harmonic mean for different ones:

    Q = 2 k a (T_j - T_i),      k = 2 k_i k_j / (k_i + k_j)

`a` is the contact radius of the contact models. A simulation with softened particles has too large contacts:
at the same force, the area of a Hertz contact of the real moduli is smaller, by

    a_true / a = (E / E_true)^(1/3)

A wall with a temperature is a body of its material that stays at it; a wall with a heat flux q gives a
particle q times its projected area pi R^2.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import pi, sqrt
from typing import Annotated, Any

from pydantic import Field

from granflow.contact.law import ContactModel, FlowCase, HeatLaw, ModelRequest, Options, WallProperties
from granflow.contact.material import PairMaterial
from granflow.contact.particle_equation import MaterialProperties
from granflow.device_functions import ti
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, redundant
from granflow.schema.model import Flag
from granflow.schema.quantities import Number


class ConductingWall(WallProperties):
    """Keys of walls; one without them is insulated."""

    temperature: q.Temperature = Field(
        description="temperature of the wall [K], for contact.heat; without it and heat_flux, the wall is "
        "insulated",
        examples=["400 K"],
    )
    heat_flux: q.HeatFlux = Field(
        description="heat [W/m2] that the wall gives to touching particles, per projected area pi R^2 of a "
        "particle; negative for cooling; for contact.heat",
        examples=["1 kW/m2"],
    )

    @classmethod
    def wall_faults(cls, wall: Any) -> Iterator[Fault]:
        """A wall has a temperature or a heat flux."""
        if wall.temperature is not None and wall.heat_flux is not None:
            yield redundant("heat_flux", "temperature")


class ConductingMaterial(MaterialProperties):
    """Keys of materials."""

    thermal_conductivity: q.ThermalConductivity = Field(
        description="thermal conductivity of the solid [W/m/K]", examples=["50 W/m/K"]
    )
    true_young_modulus: Annotated[float | None, Number("pressure", noun="Young's modulus", above=0)] = Field(
        None,
        description="Young's modulus of the real material [Pa], if young_modulus is a smaller one: contact "
        "areas of conduction are reduced to those of Hertz contacts of this modulus at the same force",
        examples=["200 GPa"],
    )


@dataclass(frozen=True)
class Conduction(HeatLaw):
    """Conduction through the contact area.

    from_dissipation:  whether the losses of contacts become heat
    """

    from_dissipation: bool = False

    name = "conduction"
    source = (
        "Batchelor & O'Brien 1977, Proc. R. Soc. A 355:313, doi 10.1098/rspa.1977.0100; Chaudhuri et al. "
        "2006, Chem. Eng. Sci. 61:6348"
    )
    limits = (
        "one temperature per particle, for Biot numbers of a contact 2 k a / (k R) well below 1; no "
        "conduction through the gas between the surfaces, no radiation between particles"
    )
    constant_names = ("conductivity",)
    """2 k (E / E_true)^(1/3) [W/(m K)]: conductance of a contact over its radius."""
    wall_properties = ConductingWall

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Conduction":
        """The law that a scene requests."""
        return cls(request.options.from_dissipation)

    @property
    def loss_flow(self) -> str:
        """The heat flow, if losses become heat."""
        return "heat_flow" if self.from_dissipation else ""

    @ti.func
    def wall_share(self, wall):
        """Half of the losses, if the wall has a temperature; an insulated wall takes none."""
        return 0.5 * wall.temperature_given

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`; 0 if a material has no conductivity, which is that of an insulated
        wall."""
        first, second = (each.thermal_conductivity or 0.0 for each in pair.materials)
        if first * second == 0.0:
            return (0.0,)
        true_compliance = sum(
            (1.0 - each.poisson_ratio**2) / (each.true_young_modulus or each.young_modulus)
            for each in pair.materials
        )
        softening = (pair.modulus_eff * true_compliance) ** (1.0 / 3.0)
        return (4.0 * (first * second) / (first + second) * softening,)

    @ti.func
    def flow(self, constants, contact, first, partner):
        """Heat flow [W] from the partner to the first particle."""
        conductance = constants.conductivity * contact.contact_radius
        return ti.Struct(heat_flow=conductance * (partner.temperature - first.temperature))

    @ti.func
    def wall_flow(self, constants, contact, first, wall):
        """Heat flow [W] from a wall: conduction from its temperature, or its flux; the effective radius at a
        wall is that of the particle."""
        conductance = constants.conductivity * contact.contact_radius * wall.temperature_given
        area = pi * contact.radius_eff * contact.radius_eff
        flow = conductance * (wall.temperature - first.temperature) + wall.heat_flux * area
        return ti.Struct(heat_flow=flow)

    def flow_bounds(self, name: str, case: FlowCase) -> tuple[float, float]:
        """Flow from the highest temperature to one at 0 K, which no temperature difference exceeds without
        sources of heat, or the largest flux; and the conductance of the largest contact."""
        conductance = self.pair_constants(case.pair)[0] * sqrt(case.radius_eff * case.overlap)
        flux = max(map(abs, case.wall_values["heat_flux"]))
        highest = case.values["temperature"][1]
        return max(conductance * highest, flux * pi * case.radius_eff**2), conductance


class ConductionOptions(Options):
    """Options of the model."""

    from_dissipation: Flag = Field(
        False,
        description="true: the losses of contacts by friction, rolling, damping and plastic work become heat "
        "of both partners in equal shares",
    )


MODEL = ContactModel(
    Conduction,
    "conduction through the contact area, between particles with temperatures and with walls",
    options=ConductionOptions,
    material_properties=ConductingMaterial,
)
