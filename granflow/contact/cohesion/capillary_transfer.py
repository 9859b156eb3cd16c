"""Capillary bridges that take their liquid from films on the particles, and return it at rupture.

The films of both particles give a part to the bridge that forms (Shi & McCarthy 2008, Powder Technol.
184:64):

    L_i = V_i / 2 [1 - sqrt(1 - R_j^2 / (R_i + R_j)^2)]

Force and rupture distance follow the volume of the bridge, see `capillary`. The engine moves the
liquid, see `granflow.engine.liquid`; `form` gets the volume from it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from granflow.contact.cohesion.bond import at_overlap
from granflow.contact.cohesion.capillary import (
    SOURCE,
    Wetting,
    bridge_attraction,
    bridge_energy,
    reference_attraction,
    rupture_factor,
)
from granflow.contact.cohesion.lubrication import (
    VISCOUS_SOURCE,
    Lubrication,
    ViscousOptions,
    lubrication_force,
)
from granflow.contact.law import CohesionLaw, ContactModel, ContactState, HistoryField, ModelRequest
from granflow.contact.material import PairMaterial
from granflow.contact.step_corrections import (
    reference_share_before_rupture,
    reference_share_in_contact,
    share_before_rupture,
    share_in_contact,
)
from granflow.device_functions import power, ti
from granflow.schema.quantities import Number


@dataclass(frozen=True)
class CapillaryTransfer(CohesionLaw):
    """A bridge per contact, with a volume of its own.

    max_bridge_volume:  largest volume [m3] of a bridge
    bridge_range:       largest rupture distance [m] of all pairs
    energy_budget:      whether the energy lost by the formation of bridges is saved
    """

    max_bridge_volume: float
    bridge_range: float
    energy_budget: bool
    lubrication: Lubrication = Lubrication()

    name = "capillary_transfer"
    source = f"{SOURCE}; Shi & McCarthy 2008, Powder Technol. 184:64; {VISCOUS_SOURCE}"
    limits = (
        "pendular bridges with V / r^3 below 0.001, r = 2 R, and small contact angles; walls have no film; "
        "liquid does not flow along surfaces or between bridges, and its mass is neglected; a viscous force "
        "acts only if the option is given, and only in bridges: not before first contact"
    )
    constant_names = ("tension", "rupture_factor")
    """Surface tension times cosine of the contact angle [N/m], rupture distance over the cube root of the
    volume."""
    transfers_liquid = True

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "CapillaryTransfer":
        """The law that a scene requests."""
        largest = request.options.max_bridge_volume
        factor = max(rupture_factor(pair.properties["contact_angle"]) for pair in request.pairs)
        return cls(
            largest,
            factor * float(largest ** (1.0 / 3.0)),
            request.energy_budget,
            Lubrication.of(request.options.viscous_force),
        )

    @property
    def range(self) -> float:
        """Slightly above the largest rupture distance, so that every bridge breaks within the range."""
        return 1.001 * self.bridge_range

    @property
    def parameters(self) -> Mapping[str, float]:
        """The range, the largest volume of a bridge, and the numbers of the viscous force."""
        return {
            **super().parameters,
            "max_bridge_volume": self.max_bridge_volume,
            **self.lubrication.parameters,
        }

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """Volume of the bridge, whether it has acted before, and with the energy budget the lost energy."""
        volume = HistoryField("bridge_volume", "liquid volume of the bridge", "m3", in_output=True)
        has_acted = HistoryField("has_acted", "1 from the step after the formation of the bridge on")
        lost = HistoryField("lost", "energy lost by the formation of the bridge", "J")
        return (volume, has_acted, lost) if self.energy_budget else (volume, has_acted)

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`."""
        angle = pair.properties["contact_angle"]
        return pair.properties["surface_tension"] * math.cos(angle), rupture_factor(angle)

    @ti.func
    def rupture_distance(self, constants, volume):
        """Rupture distance [m] of a bridge with a volume [m3] (Lian et al. 1993)."""
        return constants.rupture_factor * power(volume, 1.0 / 3.0)

    @ti.func
    def energy(self, constants, contact, volume):
        """Energy [J] of a bridge with a volume [m3]; 0 without volume, and from the rupture distance on."""
        positive = ti.select(volume > 0.0, volume, constants.max_bridge_volume)
        distance = self.rupture_distance(constants, positive)
        energy = bridge_energy(contact, constants.tension, positive, distance)
        return ti.select((volume > 0.0) & (contact.overlap > -distance), energy, 0.0)

    @ti.func
    def form(self, constants, contact, history, volume):
        """The history after a bridge of a volume [m3] has formed."""
        history_new = history
        history_new.bridge_volume = volume
        return history_new

    @ti.func
    def force(self, constants, contact, history):
        """Attraction [N] of the bridge, and its history: at rupture the volume becomes 0.

        It acts from first contact to rupture, within steps, or since half a step before liquid arrives. The
        energy of a bridge is lost where it begins to act.
        """
        history_new = history
        volume = history.bridge_volume
        positive = ti.select(volume > 0.0, volume, constants.max_bridge_volume)
        attraction = bridge_attraction(contact, constants.tension, positive)
        left = contact.overlap + self.rupture_distance(constants, positive)
        share = ti.select(
            history.has_acted > 0.0,
            share_before_rupture(left, attraction, contact),
            share_in_contact(contact.overlap, contact.overlap_rate, contact.time_step),
        )
        holds = (volume > 0.0) & (left > 0.0)
        history_new.bridge_volume = ti.select(holds, volume, 0.0)
        history_new.has_acted = ti.select(holds, 1.0, 0.0)
        if ti.static(self.energy_budget):
            since = contact.overlap - (share - 0.5) * contact.overlap_rate * contact.time_step
            energy = self.energy(constants, at_overlap(contact, since), volume)
            history_new.lost -= ti.select(history.has_acted > 0.0, 0.0, energy)
        return ti.select(holds, share * attraction, 0.0), history_new

    @property
    def is_viscous(self) -> bool:
        """Whether the viscous force of the liquid acts."""
        return self.lubrication.acts

    @ti.func
    def viscous_force(self, constants, contact, history):
        """Viscous force [N] of the bridge, if it exists."""
        normal, tangential = lubrication_force(constants, contact)
        exists = ti.select(history.bridge_volume > 0.0, 1.0, 0.0)
        return exists * normal, exists * tangential

    def resistance(self, pair: PairMaterial, radius_eff: float) -> tuple[float, float]:
        """Largest ratios of viscous force to velocity [N s/m]."""
        return self.lubrication.resistance(radius_eff)

    def reference_viscous_force(self, contact: ContactState) -> tuple[float, np.ndarray]:
        """Reference implementation of `viscous_force`."""
        normal, tangential = self.lubrication.reference(contact)
        exists = float(contact.history.bridge_volume > 0.0)
        return exists * normal, exists * tangential

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Energy of the bridge [J], minus the work up to its rupture."""
        return self.energy(constants, contact, history.bridge_volume)

    @ti.func
    def lost_energy(self, constants, contact, history):
        """Energy lost by the formation of bridges of this contact [J]; rupture loses none."""
        energy = 0.0 * contact.overlap
        if ti.static(self.energy_budget):
            energy = history.lost
        return energy

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, Any]]:
        """Reference implementation of `force` without the lost energy."""
        constants = contact.constants
        volume = getattr(contact.history, "bridge_volume", 0.0)
        left = contact.overlap + constants.rupture_factor * volume ** (1.0 / 3.0)
        if volume <= 0.0 or left <= 0.0:
            return 0.0, {"bridge_volume": 0.0, "has_acted": 0.0}
        force = reference_attraction(contact.radius_eff, contact.overlap, constants.tension, volume)
        if getattr(contact.history, "has_acted", 0.0) > 0.0:
            share = reference_share_before_rupture(left, force, contact)
        else:
            share = reference_share_in_contact(contact.overlap, contact.overlap_rate, contact.time_step)
        return share * force, {"bridge_volume": volume, "has_acted": 1.0}

    def pull_off_force(self, pair: PairMaterial, radius_eff: float) -> float:
        """Largest capillary force [N], at zero distance; it does not depend on the volume."""
        return 4.0 * math.pi * radius_eff * self.pair_constants(pair)[0]


class CapillaryTransferOptions(ViscousOptions):
    """Options of the model."""

    max_bridge_volume: Annotated[float, Number("volume", noun="a volume", above=0)] = Field(
        description="largest volume of a bridge [m3]: the films keep the rest; it determines the range of "
        "the neighbor lists",
        examples=["10 nl"],
    )


MODEL = ContactModel(
    CapillaryTransfer,
    "liquid bridges that take their volume from films on the particles and return it at rupture",
    options=CapillaryTransferOptions,
    pair_properties=Wetting,
)
