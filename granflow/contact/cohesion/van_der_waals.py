"""Van der Waals attraction of two spheres (Hamaker 1937) up to a cut-off."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from granflow.contact import theory
from granflow.contact.law import CohesionLaw, ContactModel, ContactState, ModelRequest, PairProperties, Remedy
from granflow.contact.material import PairMaterial
from granflow.device_functions import ti
from granflow.schema.quantities import Number

CUTOFF = 30.0
"""Distance over s_0 beyond which the force is 0; it is 0.1 % of the force in contact there."""


@dataclass(frozen=True)
class VanDerWaals(CohesionLaw):
    """F = A R / (6 s^2), s = s_0 + distance of the surfaces, with the Hamaker constant A [J]; s_0 in overlap.

    largest_cutoff:  largest cut-off distance [m] of all pairs
    """

    largest_cutoff: float

    name = "van_der_waals"
    source = "Hamaker 1937, Physica 4:1058; Israelachvili 2011, Intermolecular and Surface Forces, Table 13.1"
    limits = (
        "without retardation, for distances far below the radius; the time step must resolve the separation "
        "s_0 in contact: otherwise approaching particles gain or lose energy"
    )
    constant_names = ("hamaker_constant", "separation")

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "VanDerWaals":
        """The law that a scene requests."""
        return cls(CUTOFF * max(pair.properties["separation"] for pair in request.pairs))

    @property
    def range(self) -> float:
        """The largest cut-off [m]."""
        return self.largest_cutoff

    @ti.func
    def force(self, constants, contact, history):
        """Attraction A R / (6 s^2) [N] up to the cut-off."""
        separation = constants.separation + ti.max(-contact.overlap, 0.0)
        attraction = constants.hamaker_constant * contact.radius_eff / (6.0 * separation * separation)
        return ti.select(contact.overlap > -CUTOFF * constants.separation, attraction, 0.0), history

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Potential [J], -A R / 6 (1/s - 1/s_c), and minus the work of the overlap; 0 at the cut-off s_c."""
        smallest = constants.separation
        largest = (1.0 + CUTOFF) * constants.separation
        separation = ti.min(smallest + ti.max(-contact.overlap, 0.0), largest)
        inverse = (largest - separation) / (separation * largest)
        inverse += ti.max(contact.overlap, 0.0) / (smallest * smallest)
        return -constants.hamaker_constant * contact.radius_eff / 6.0 * inverse

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force`."""
        distance = max(-contact.overlap, 0.0)
        smallest = contact.constants.separation
        if distance >= CUTOFF * smallest:
            return 0.0, {}
        separation = smallest + distance
        return contact.constants.hamaker_constant * contact.radius_eff / 6.0 * separation**-2, {}

    def pull_off_force(self, pair: PairMaterial, radius_eff: float) -> float:
        """Force in contact [N]."""
        return pair.properties["hamaker_constant"] * radius_eff / (6.0 * pair.properties["separation"] ** 2)

    def equivalent_velocity(self, pair: PairMaterial, radius_eff: float, mass_eff: float) -> float:
        """Larger of the velocity at rest, and that for the stiffness A R / (3 s_0^3) = 2 E a."""
        contact_radius = (
            self.pull_off_force(pair, radius_eff) / pair.properties["separation"] / pair.modulus_eff
        )
        by_slope = theory.velocity_for_radius(pair.modulus_eff, radius_eff, mass_eff, contact_radius)
        return max(super().equivalent_velocity(pair, radius_eff, mass_eff), by_slope)


class HamakerAttraction(PairProperties):
    """Properties of pairs of the model."""

    hamaker_constant: Annotated[
        float,
        Number("energy", noun="an energy", at_least=0),
        Remedy("give it in J, or 0 to disable cohesion"),
    ] = Field(description="Hamaker constant [J]", examples=["65 zJ"])
    separation: Annotated[float, Number("length", noun="a distance", above=0), Remedy("give it in m")] = (
        Field(
            description="separation s_0 [m] of the surfaces in contact: 0.165 nm for smooth spheres, larger "
            "for rough ones",
            examples=["0.165 nm"],
        )
    )


MODEL = ContactModel(
    VanDerWaals,
    "van der Waals attraction up to a cut-off (Hamaker 1937)",
    pair_properties=HamakerAttraction,
)
