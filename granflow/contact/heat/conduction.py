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

Conduction through the gas around contacts and across small gaps is a part of its own, see `gas`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import pi, sqrt
from typing import Annotated, Any

from pydantic import Field

from granflow.contact.heat.gas import (
    GAS_SOURCE,
    Gas,
    StagnantGas,
    gas_conductance,
    gas_conductance_of_wall,
)
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
    """Conduction through the contact area, and through gas.

    from_dissipation:  whether the losses of contacts become heat
    surroundings:      temperature [K] of the surroundings to which particles radiate; 0 without radiation
    gas:               the gas between the surfaces
    """

    from_dissipation: bool = False
    surroundings: float = 0.0
    gas: Gas = Gas()

    name = "conduction"
    source = (
        "Batchelor & O'Brien 1977, Proc. R. Soc. A 355:313, doi 10.1098/rspa.1977.0100; Chaudhuri et al. "
        f"2006, Chem. Eng. Sci. 61:6348; {GAS_SOURCE}"
    )
    limits = (
        "one temperature per particle, for Biot numbers of a contact 2 k a / (k R) well below 1; the gas is "
        "at rest and has no heat capacity; no radiation between particles"
    )
    constant_names = ("conductivity", "overlap_ratio", "resistance_ratio", "wall_resistance_ratio")
    """2 k (E / E_true)^(1/3) [W/(m K)]: conductance of a contact over its radius; overlap of the true moduli
    at the same force over that of the contact, (E / E_true)^(2/3); for paths through the gas, ratios of their
    resistance in the solid to that in the gas, between particles and at a wall."""
    wall_properties = ConductingWall

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Conduction":
        """The law that a scene requests."""
        options = request.options
        gas = Gas.of(options.gas, request.radius_eff_max)
        return cls(options.from_dissipation, options.surroundings or 0.0, gas)

    @property
    def parameters(self) -> Mapping[str, float]:
        """The temperature of the surroundings, if there are some, and the numbers of the gas."""
        surroundings = {"surroundings": self.surroundings} if self.has_surroundings else {}
        return {**super().parameters, **surroundings, **self.gas.parameters}

    @property
    def relative_cost(self) -> float:
        """Measured: gas conducts between all surfaces within its film, which are more pairs than contacts."""
        return 3.5 if self.range > 0.0 else 1.0

    @property
    def range(self) -> float:
        """Largest gap [m] across which heat flows: the film of the largest particle."""
        return self.gas.reach

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
            return 0.0, 1.0, 0.0, 0.0
        true_compliance = sum(
            (1.0 - each.poisson_ratio**2) / (each.true_young_modulus or each.young_modulus)
            for each in pair.materials
        )
        softening = (pair.modulus_eff * true_compliance) ** (1.0 / 3.0)
        doubled = 4.0 * (first * second) / (first + second)
        return (
            doubled * softening,
            softening**2,
            self.gas.resistance_ratio(0.5 * doubled),
            self.gas.resistance_ratio(first),
        )

    @ti.func
    def flow(self, constants, contact, first, partner):
        """Heat flow [W] from the partner to the first particle."""
        conductance = constants.conductivity * contact.contact_radius
        if ti.static(self.gas.is_present):
            conductance += gas_conductance(constants, self._true_overlap(constants, contact), first, partner)
        return ti.Struct(heat_flow=conductance * (partner.temperature - first.temperature))

    @ti.func
    def wall_flow(self, constants, contact, first, wall):
        """Heat flow [W] from a wall: conduction from its temperature, or its flux; the effective radius at a
        wall is that of the particle."""
        conductance = constants.conductivity * contact.contact_radius
        area = pi * contact.radius_eff * contact.radius_eff
        if ti.static(self.gas.is_present):
            conductance += gas_conductance_of_wall(constants, self._true_overlap(constants, contact), first)
            area = ti.select(contact.overlap > 0.0, area, 0.0)
        conductance *= wall.temperature_given
        flow = conductance * (wall.temperature - first.temperature) + wall.heat_flux * area
        return ti.Struct(heat_flow=flow)

    @ti.func
    def _true_overlap(self, constants, contact):
        """Overlap [m] of the true moduli at the same force; minus the distance of separated surfaces."""
        return ti.select(contact.overlap > 0.0, constants.overlap_ratio, 1.0) * contact.overlap

    def flow_bounds(self, name: str, case: FlowCase) -> tuple[float, float]:
        """Flow from the highest temperature to one at 0 K, which no temperature difference exceeds without
        sources of heat, the largest flux, or the radiation of a black sphere; and the conductance of the
        largest contact and its gas with that of radiation."""
        conductance = self.pair_constants(case.pair)[0] * sqrt(case.radius_eff * case.overlap)
        conductance += self.gas.largest_conductance(case.radius_eff)
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
    gas: StagnantGas | None = optional(
        "gas at rest between the surfaces, which conducts heat around contacts and across small gaps",
        "vacuum",
        examples=[{"conductivity": "0.026 W/m/K", "min_gap": "1 um"}],
    )


MODEL = ContactModel(
    Conduction,
    "conduction through the contact area and the gas around it, between particles with temperatures and with "
    "walls",
    options=ConductionOptions,
    material_properties=ConductingMaterial,
)
