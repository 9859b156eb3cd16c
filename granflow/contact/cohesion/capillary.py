"""Capillary bridges of constant liquid volume, from first contact to the rupture distance; see `capillary_bridge`."""

import math
from dataclasses import dataclass

from granflow.contact.cohesion.bond import BondLaw
from granflow.contact.cohesion.capillary_bridge import (
    CONTACT_ANGLE,
    SOURCE,
    SURFACE_TENSION,
    bridge_attraction,
    bridge_energy,
    reference_attraction,
    rupture_factor,
)
from granflow.contact.law import ContactState, ModelRequest
from granflow.contact.material import PairMaterial
from granflow.contact.model import ContactModel
from granflow.contact.options import Amount, PairOption
from granflow.device_functions import ti


@dataclass(frozen=True)
class Capillary(BondLaw):
    """Every contact has a liquid bridge of the volume of its pair."""

    name = "capillary"
    source = SOURCE
    limits = (
        "pendular bridges with V / r^3 below 0.001, r = 2 R, and small contact angles; each pair of materials has one "
        "volume, liquid is neither shared nor lost, and the viscous force of the liquid is neglected"
    )
    constant_names = ("tension", "volume", "distance")
    """Surface tension times cosine of the contact angle [N/m], liquid volume [m3], rupture distance [m]."""

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Capillary":
        """The law that a scene requests."""
        return cls(max(_rupture_distance(pair) for pair in request.pairs), request.energy_budget)

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`; a pair without liquid has no tension."""
        volume = pair.options["liquid_volume"]
        if volume == 0.0:
            return 0.0, 1.0, 0.0
        tension = pair.options["surface_tension"] * math.cos(pair.options["contact_angle"])
        return tension, volume, _rupture_distance(pair)

    @ti.func
    def rupture_distance(self, constants, contact):
        """Rupture distance [m] of Lian et al. (1993)."""
        return constants.distance

    @ti.func
    def bond_attraction(self, constants, contact):
        """Capillary force [N]."""
        return bridge_attraction(contact, constants.tension, constants.volume)

    @ti.func
    def bond_energy(self, constants, contact):
        """Minus the work from the present distance to rupture, and the work of the overlap [J]."""
        return bridge_energy(contact, constants.tension, constants.volume, constants.distance)

    def reference_bond(self, contact: ContactState) -> tuple[float, float]:
        """Attraction and rupture distance."""
        constants = contact.constants
        force = reference_attraction(contact.radius_eff, contact.overlap, constants.tension, constants.volume)
        return force, constants.distance

    def pull_off_force(self, pair: PairMaterial, radius_eff: float) -> float:
        """Largest capillary force [N], at zero distance."""
        return 4.0 * math.pi * radius_eff * self.pair_constants(pair)[0]


def _rupture_distance(pair: PairMaterial) -> float:
    """Rupture distance [m] (Lian et al. 1993)."""
    return rupture_factor(pair.options["contact_angle"]) * float(pair.options["liquid_volume"] ** (1.0 / 3.0))


MODEL = ContactModel(
    Capillary,
    "liquid bridges of constant volume from first contact to rupture (Willett et al. 2000)",
    pair_options=(
        SURFACE_TENSION,
        CONTACT_ANGLE,
        PairOption(
            "liquid_volume",
            Amount("volume of each liquid bridge [m3]", *("10 nl", "volume", "a volume"), at_least=0),
            "give it in m3, or 0 for a pair without liquid",
        ),
    ),
)
