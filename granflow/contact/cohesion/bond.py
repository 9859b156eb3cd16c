"""Cohesive bonds: they form at first contact and break at a rupture distance.

`BondLaw` is the base class of `jkr` and `capillary`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from granflow.contact.law import CohesionLaw, ContactState, HistoryField
from granflow.contact.step_corrections import (
    reference_share_before_rupture,
    reference_share_in_contact,
    share_before_rupture,
    share_in_contact,
)
from granflow.device_functions import ti


@ti.func
def at_overlap(contact, overlap):
    """The contact at another overlap [m]."""
    return ti.Struct(radius_eff=contact.radius_eff, overlap=overlap)


@dataclass(frozen=True)
class BondLaw(CohesionLaw):
    """A bond: no attraction before first contact, then one until the distance exceeds the rupture distance.

    bond_range:     largest rupture distance [m] of all pairs and sizes
    energy_budget:  whether the energy lost by formation and rupture of bonds is saved
    """

    bond_range: float
    energy_budget: bool

    @property
    def range(self) -> float:
        """Slightly above the largest rupture distance, so that every bond breaks within the range."""
        return 1.001 * self.bond_range

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """1 while the bond exists, and with the energy budget the lost energy."""
        lost = (HistoryField("lost", "energy lost by formation and rupture of the bond", "J"),)
        return HistoryField("bonded", "1 while the bond exists", in_output=True), *(
            lost if self.energy_budget else ()
        )

    @ti.func
    def rupture_distance(self, constants, contact):
        """Distance [m] between the surfaces at which the bond breaks."""

    @ti.func
    def bond_attraction(self, constants, contact):
        """Attraction [N] of an existing bond."""

    @ti.func
    def bond_energy(self, constants, contact):
        """Energy [J] of an existing bond, 0 for separated particles."""

    @ti.func
    def rupture_energy(self, constants, contact):
        """Energy of the bond [J] at rupture, which is lost."""
        return self.bond_energy(constants, at_overlap(contact, -self.rupture_distance(constants, contact)))

    @ti.func
    def force(self, constants, contact, history):
        """Attraction [N] of the bond, from first contact to rupture within steps, and its history."""
        history_new = history
        attraction = self.bond_attraction(constants, contact)
        left = contact.overlap + self.rupture_distance(constants, contact)
        share = ti.select(
            history.bonded > 0.0,
            share_before_rupture(left, attraction, contact),
            share_in_contact(contact.overlap, contact.overlap_rate, contact.time_step),
        )
        holds = left > 0.0
        bonded = ti.select(contact.overlap > 0.0, 1.0, ti.select(holds, history.bonded, 0.0))
        if ti.static(self.energy_budget):
            formed = ti.max(bonded - history.bonded, 0.0)
            broken = ti.max(history.bonded - bonded, 0.0)
            formation_energy = -self.bond_energy(constants, at_overlap(contact, 0.0 * contact.overlap))
            history_new.lost += formed * formation_energy + broken * self.rupture_energy(constants, contact)
        history_new.bonded = bonded
        return share * bonded * attraction, history_new

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Energy of the bond [J]."""
        return history.bonded * self.bond_energy(constants, contact)

    @ti.func
    def lost_energy(self, constants, contact, history):
        """Energy lost by formation, and by rupture if the contact has opened [J]."""
        energy = 0.0 * contact.overlap
        if ti.static(self.energy_budget):
            open_now = ti.select(
                contact.overlap < -self.rupture_distance(constants, contact), history.bonded, 0.0
            )
            energy = history.lost + open_now * self.rupture_energy(constants, contact)
        return energy

    def reference_bond(self, contact: ContactState) -> tuple[float, float]:
        """Reference implementation of `bond_attraction` [N] and `rupture_distance` [m]."""
        raise NotImplementedError

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, Any]]:
        """Reference implementation of `force` without the lost energy."""
        attraction, distance = self.reference_bond(contact)
        left = contact.overlap + distance
        if getattr(contact.history, "bonded", 0.0) == 0.0:
            if contact.overlap <= 0.0:
                return 0.0, {"bonded": 0.0}
            share = reference_share_in_contact(contact.overlap, contact.overlap_rate, contact.time_step)
        else:
            if contact.overlap <= 0.0 and left <= 0.0:
                return 0.0, {"bonded": 0.0}
            share = reference_share_before_rupture(left, attraction, contact)
        return share * attraction, {"bonded": 1.0}
