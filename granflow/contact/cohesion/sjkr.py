"""Simplified Johnson-Kendall-Roberts cohesion (SJKR): an attraction proportional to the contact area.

Cohesion energy density times the intersection area of the undeformed spheres, while they overlap. The
attraction does not press the surfaces together, so the friction limit uses the normal force without it, as
Luding (2008) uses f_n + k_c d.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from granflow.contact.law import CohesionLaw, ContactModel, ContactState, PairProperties, Remedy
from granflow.device_functions import ti
from granflow.schema.quantities import Number


@dataclass(frozen=True)
class Sjkr(CohesionLaw):
    """F = w A with the area A = 2 pi R d, and the cohesion energy density w [J/m3] of the pair."""

    name = "sjkr"
    source = "SJKR as in LIGGGHTS, after Johnson, Kendall & Roberts 1971"
    limits = (
        "no attraction before first contact or after separation; the contact area is that of undeformed "
        "spheres"
    )
    constant_names = ("cohesion_energy_density",)

    @ti.func
    def attraction(self, constants, contact):
        """Attraction w A [N] of an overlap."""
        return 2.0 * math.pi * constants.cohesion_energy_density * contact.radius_eff * contact.overlap

    @ti.func
    def force(self, constants, contact, history):
        """Attraction w A [N]."""
        return self.attraction(constants, contact), history

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Minus the surface energy pi w R d^2 [J]."""
        return -0.5 * self.attraction(constants, contact) * contact.overlap

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force`."""
        area = 2.0 * math.pi * contact.radius_eff * contact.overlap
        return contact.constants.cohesion_energy_density * area, {}


class CohesionEnergy(PairProperties):
    """Properties of pairs of the model."""

    cohesion_energy_density: Annotated[
        float,
        Number("energy_density", noun="a cohesion energy density", at_least=0),
        Remedy("give it in J/m3, or 0 to disable cohesion"),
    ] = Field(description="cohesion energy density [J/m3]", examples=["1e4 J/m3"])


MODEL = ContactModel(
    Sjkr,
    "force: cohesion energy density times contact area",
    pair_properties=CohesionEnergy,
)
