"""Capillary bridges of constant liquid volume, from first contact to the rupture distance.

    F = 2 pi r g cos(t) / (1 + 1.05 u + 2.5 u^2),   u = s sqrt(r / V),   r = 2 R    (Willett 2000, Eq. 12)
    s_c = (1 + t/2) V^(1/3)                                              (Lian, Thornton & Adams 1993)

R is the effective radius, so that r is the radius of equal spheres, and twice that of a sphere at a wall. The
distance between the surfaces is s, 0 during overlap; s_c is the rupture distance, V the volume, g the surface
tension, t the contact angle. `capillary_transfer` uses the same bridges, with a volume per contact.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from granflow.contact.cohesion.bond import BondLaw
from granflow.contact.cohesion.lubrication import (
    VISCOUS_SOURCE,
    Lubrication,
    ViscousOptions,
    lubrication_force,
)
from granflow.contact.law import ContactModel, ContactState, ModelRequest, PairProperties, Remedy
from granflow.contact.material import PairMaterial
from granflow.device_functions import ti
from granflow.schema.quantities import Number

# Force, energy and rupture distance of a bridge of a given volume

LINEAR = 1.05
SQUARE = 2.5
"""Coefficients of u and u^2 in the force (Willett 2000)."""
ROOT = math.sqrt(4.0 * SQUARE - LINEAR**2)
"""Square root of minus the discriminant of the denominator, for its integral."""
HALVINGS = 3
"""Halvings of an angle below pi/2, so that its tangent is below 0.2."""
SERIES = 12
"""Terms of the series of the arctangent; the next one is 1e-18."""
SOURCE = (
    "Willett et al. 2000, Langmuir 16:9396, doi 10.1021/la000657y; Lian, Thornton & Adams 1993, JCIS 161:138"
)


@ti.func
def arctangent(x):
    """atan(x) for x >= 0 from + - * / sqrt, which every backend has in f64.

    atan(x) = 2 atan(x / (1 + sqrt(1 + x^2))),   atan(x) = x - x^3/3 + x^5/5 - ...
    """
    half = x
    for _ in ti.static(range(HALVINGS)):
        half = half / (1.0 + ti.sqrt(1.0 + half * half))
    square = half * half
    series = 0.0 * x
    for n in ti.static(range(SERIES, -1, -1)):
        series = 1.0 / (2 * n + 1) - square * series
    return 2.0**HALVINGS * half * series


@ti.func
def bridge_attraction(contact, tension, volume):
    """Capillary force [N]; tension: surface tension times cosine of contact angle [N/m]; volume [m3] > 0."""
    u = ti.max(-contact.overlap, 0.0) * ti.sqrt(2.0 * contact.radius_eff / volume)
    return 4.0 * math.pi * contact.radius_eff * tension / (1.0 + LINEAR * u + SQUARE * u * u)


@ti.func
def bridge_energy(contact, tension, volume, rupture_distance):
    """Minus the work from the present distance to rupture, and the work of the overlap [J].

    The integral of 1 / (1 + b u + c u^2) is 2 / q atan((2 c u + b) / q),   q^2 = 4 c - b^2
    """
    scale = ti.sqrt(2.0 * contact.radius_eff / volume)
    here = (2.0 * SQUARE * ti.max(-contact.overlap, 0.0) * scale + LINEAR) / ROOT
    end = (2.0 * SQUARE * rupture_distance * scale + LINEAR) / ROOT
    # the difference of two arctangents as one, without cancellation
    distance = 2.0 / ROOT * arctangent((end - here) / (1.0 + end * here)) / scale + ti.max(
        contact.overlap, 0.0
    )
    return -4.0 * math.pi * contact.radius_eff * tension * distance


def reference_attraction(radius_eff: float, overlap: float, tension: float, volume: float) -> float:
    """Capillary force [N], with half the distance S and the volume in units of r as in the paper.

    F / (2 pi r g) = cos(t) / (1 + 2.1 S / sqrt(V) + 10 S^2 / V)
    """
    radius = 2.0 * radius_eff
    half = 0.5 * max(-overlap, 0.0) / radius
    relative_volume = volume / radius**3
    ratio = 1.0 + 2.1 * half / math.sqrt(relative_volume) + 10.0 * half**2 / relative_volume
    return 2.0 * math.pi * radius * tension / ratio


def rupture_factor(contact_angle: float) -> float:
    """Rupture distance over the cube root of the volume (Lian et al. 1993), for a contact angle [rad]."""
    return 1.0 + 0.5 * contact_angle


# The model


class Wetting(PairProperties):
    """Liquid between two surfaces, for the models of liquid bridges."""

    surface_tension: Annotated[
        float,
        Number("surface_energy", noun="a surface tension", at_least=0),
        Remedy("give it in N/m, or 0 to disable cohesion"),
    ] = Field(description="surface tension of the liquid [J/m2], the same as N/m", examples=["72 mN/m"])
    contact_angle: Annotated[
        float,
        Number("angle", noun="an angle", at_least=0, at_most=1.57),
        Remedy("give the angle, or 0 for a liquid that wets completely"),
    ] = Field(description="contact angle of the liquid [rad]", examples=["20 deg"])


@dataclass(frozen=True)
class Capillary(BondLaw):
    """Every contact has a liquid bridge of the volume of its pair."""

    lubrication: Lubrication = Lubrication()

    name = "capillary"
    source = f"{SOURCE}; {VISCOUS_SOURCE}"
    limits = (
        "pendular bridges with V / r^3 below 0.001, r = 2 R, and small contact angles; each pair of "
        "materials has one volume, liquid is neither shared nor lost; a viscous force acts only if the "
        "option is given, and only in bridges: not before first contact"
    )
    constant_names = ("tension", "volume", "distance")
    """Surface tension times cosine of the contact angle [N/m], liquid volume [m3], rupture distance [m]."""

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Capillary":
        """The law that a scene requests."""
        return cls(
            max(_rupture_distance(pair) for pair in request.pairs),
            request.energy_budget,
            Lubrication.of(request.options.viscous_force),
        )

    @property
    def parameters(self) -> Mapping[str, float]:
        """The range, and the numbers of the viscous force."""
        return {**super().parameters, **self.lubrication.parameters}

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`; a pair without liquid has no tension."""
        volume = pair.properties["liquid_volume"]
        if volume == 0.0:
            return 0.0, 1.0, 0.0
        tension = pair.properties["surface_tension"] * math.cos(pair.properties["contact_angle"])
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

    @property
    def is_viscous(self) -> bool:
        """Whether the viscous force of the liquid acts."""
        return self.lubrication.acts

    @ti.func
    def viscous_force(self, constants, contact, history):
        """Viscous force [N] of the bridge."""
        normal, tangential = lubrication_force(constants, contact)
        wet = ti.select(constants.distance > 0.0, history.bonded, 0.0)
        return wet * normal, wet * tangential

    def resistance(self, pair: PairMaterial, radius_eff: float) -> tuple[float, float]:
        """Largest ratios of viscous force to velocity [N s/m]; 0 for a pair without liquid."""
        if pair.properties["liquid_volume"] == 0.0:
            return 0.0, 0.0
        return self.lubrication.resistance(radius_eff)

    def reference_viscous_force(self, contact: ContactState) -> tuple[float, np.ndarray]:
        """Reference implementation of `viscous_force`."""
        normal, tangential = self.lubrication.reference(contact)
        wet = contact.history.bonded if contact.constants.distance > 0.0 else 0.0
        return wet * normal, wet * tangential

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
    return rupture_factor(pair.properties["contact_angle"]) * float(
        pair.properties["liquid_volume"] ** (1.0 / 3.0)
    )


class LiquidBridges(Wetting):
    """Properties of pairs of the model."""

    liquid_volume: Annotated[
        float,
        Number("volume", noun="a volume", at_least=0),
        Remedy("give it in m3, or 0 for a pair without liquid"),
    ] = Field(description="volume of each liquid bridge [m3]", examples=["10 nl"])


MODEL = ContactModel(
    Capillary,
    "liquid bridges of constant volume from first contact to rupture (Willett et al. 2000)",
    options=ViscousOptions,
    pair_properties=LiquidBridges,
)
