"""Conduction through the contact area of two particles (Batchelor & O'Brien 1977).

The heat flow from j to i is that through a circle of radius a between two half spaces of equal conductivity,
with the harmonic mean for different ones:

    Q = 2 k a (T_j - T_i),      k = 2 k_i k_j / (k_i + k_j)

`a` is the contact radius of the contact models. A simulation with softened particles has too large contacts:
at the same force, the area of a Hertz contact of the real moduli is smaller, by

    a_true / a = (E / E_true)^(1/3)

Particles radiate to surroundings of the temperature T_s as gray bodies of the emissivity e:

    Q = e s 4 pi R^2 (T_s^4 - T^4),      s = 5.670e-8 W/(m2 K4)

A wall with a temperature is a body of its material that stays at it; a wall with a heat flux q gives a
particle q times its projected area pi R^2.
"""

from collections.abc import Iterator, Mapping
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
from granflow.schema.model import Flag, optional
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
    emissivity: Annotated[float | None, Number(noun="an emissivity", at_least=0, at_most=1)] = Field(
        None,
        description="emissivity of the surface, in [0, 1]; required with contact.heat.surroundings",
        examples=["0.8"],
    )
    true_young_modulus: Annotated[float | None, Number("pressure", noun="Young's modulus", above=0)] = Field(
        None,
        description="Young's modulus of the real material [Pa], if young_modulus is a smaller one: contact "
        "areas of conduction are reduced to those of Hertz contacts of this modulus at the same force",
        examples=["200 GPa"],
    )


STEFAN_BOLTZMANN = 5.670374419e-8
"""Constant of Stefan and Boltzmann [W/(m2 K4)]."""


@dataclass(frozen=True)
class Conduction(HeatLaw):
    """Conduction through the contact area.

    from_dissipation:  whether the losses of contacts become heat
    surroundings:      temperature [K] of the surroundings to which particles radiate; 0 without radiation
    """

    from_dissipation: bool = False
    surroundings: float = 0.0

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
        return cls(request.options.from_dissipation, request.options.surroundings or 0.0)

    @property
    def parameters(self) -> Mapping[str, float]:
        """The temperature of the surroundings, if there are some."""
        return {"surroundings": self.surroundings} if self.has_surroundings else {}

    @property
    def has_surroundings(self) -> bool:
        """Whether particles radiate."""
        return self.surroundings > 0.0

    @ti.func
    def surroundings_flow(self, constants, particle):
        """Radiation [W] of a gray sphere, of which nothing hides a part: e s 4 pi R^2 (T_s^4 - T^4)."""
        there = constants.surroundings * constants.surroundings
        here = particle.temperature * particle.temperature
        area = 4.0 * pi * particle.radius * particle.radius
        return ti.Struct(
            heat_flow=constants.emissivity * STEFAN_BOLTZMANN * area * (there * there - here * here)
        )

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
        sources of heat, the largest flux, or the radiation of a black sphere; and the conductance of the
        largest contact with that of radiation."""
        conductance = self.pair_constants(case.pair)[0] * sqrt(case.radius_eff * case.overlap)
        flux = max(map(abs, case.wall_values["heat_flux"]))
        highest = case.values["temperature"][1]
        radiated = slope = 0.0
        if self.has_surroundings:
            hottest = max(highest, self.surroundings)
            radiated = STEFAN_BOLTZMANN * 4.0 * pi * case.radius_eff**2 * hottest**4
            slope = 4.0 * radiated / hottest
        largest = max(conductance * highest, flux * pi * case.radius_eff**2, radiated)
        return largest, conductance + slope


class ConductionOptions(Options):
    """Options of the model."""

    from_dissipation: Flag = Field(
        False,
        description="true: the losses of contacts by friction, rolling, damping and plastic work become heat "
        "of both partners in equal shares",
    )
    surroundings: q.Temperature | None = optional(
        "temperature of the surroundings [K] to which every particle radiates, as a gray body of the "
        "emissivity of its material",
        "no radiation",
        examples=["300 K"],
    )


MODEL = ContactModel(
    Conduction,
    "conduction through the contact area, between particles with temperatures and with walls",
    options=ConductionOptions,
    material_properties=ConductingMaterial,
)
