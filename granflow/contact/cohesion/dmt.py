"""Derjaguin, Muller & Toporov (1975): a constant attraction during contact, for small and stiff particles."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from granflow.contact.law import CohesionLaw, ContactModel, ContactState, WorkOfAdhesion
from granflow.contact.material import PairMaterial
from granflow.contact.step_corrections import reference_share_in_contact, share_in_contact
from granflow.device_functions import ti


@dataclass(frozen=True)
class Dmt(CohesionLaw):
    """F = 2 pi w R as long as the spheres overlap, w the work of adhesion of the pair [J/m2]."""

    name = "dmt"
    source = "Derjaguin, Muller & Toporov 1975, doi 10.1016/0021-9797(75)90018-1; Maugis 1992"
    limits = (
        "for small, stiff particles (Tabor parameter below 0.1); no attraction before first contact or after "
        "separation, so that adhesion dissipates no energy"
    )
    constant_names = ("work_of_adhesion",)

    @ti.func
    def attraction(self, constants, contact):
        """Attraction [N] of an overlap."""
        return 2.0 * math.pi * constants.work_of_adhesion * contact.radius_eff

    @ti.func
    def force(self, constants, contact, history):
        """Attraction 2 pi w R [N], in the steps of first contact and separation for a part of the step."""
        share = share_in_contact(contact.overlap, contact.overlap_rate, contact.time_step)
        return share * self.attraction(constants, contact), history

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Minus the work of the attraction since first contact [J]."""
        return -self.attraction(constants, contact) * contact.overlap

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force`."""
        share = reference_share_in_contact(contact.overlap, contact.overlap_rate, contact.time_step)
        return share * 2.0 * math.pi * contact.radius_eff * contact.constants.work_of_adhesion, {}

    def pull_off_force(self, pair: PairMaterial, radius_eff: float) -> float:
        """Pull-off force [N], 2 pi w R."""
        return 2.0 * math.pi * pair.properties["work_of_adhesion"] * radius_eff


MODEL = ContactModel(
    Dmt,
    "constant attraction during contact (Derjaguin, Muller & Toporov 1975)",
    pair_properties=WorkOfAdhesion,
)
