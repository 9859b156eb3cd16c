"""Elastic, perfectly plastic spheres (Thornton 1997): limited contact pressure, Hertz unloading.

Restitution follows from the material and is not an input. A flattened contact unloads, and reloads up to its
previous maximum overlap, as an elastic sphere of a larger radius.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from granflow.contact import theory
from granflow.contact.law import (
    ClosedFormCollision,
    ContactModel,
    ContactState,
    HistoryField,
    ModelRequest,
    NormalLaw,
    Options,
)
from granflow.contact.material import PairMaterial
from granflow.device_functions import ti
from granflow.schema.quantities import Number


@ti.func
def yield_point(constants, radius_eff):
    """Overlap [m] and force [N] at first yield: d_y = R (pi p / (2 E))^2, F_y = k d_y^1.5 (Thornton 1997)."""
    slope = 0.5 * math.pi * constants.yield_pressure / constants.modulus_eff
    overlap = radius_eff * slope * slope
    return overlap, 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(radius_eff * overlap) * overlap


@ti.func
def loading_force(constants, radius_eff, overlap):
    """Force on the loading branch [N]: k d^1.5 up to first yield, then F_y + pi p R (d - d_y)."""
    elastic = 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(radius_eff * overlap) * overlap
    overlap_yield, force_yield = yield_point(constants, radius_eff)
    plastic = force_yield + math.pi * constants.yield_pressure * radius_eff * (overlap - overlap_yield)
    return ti.select(overlap > overlap_yield, plastic, elastic)


@ti.func
def unloading_contact(constants, radius_eff, overlap_max):
    """Unloading stiffness [N/m^1.5] and residual overlap [m] of the flattened contact (Thornton 1997).

    R_p F* = R F_e*,   F_e* = k d*^1.5,   d_p = d* - d* F* / F_e*        * at the maximum overlap, R_p
    flattened radius
    """
    hertz = 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(radius_eff * overlap_max) * overlap_max
    ratio = hertz / loading_force(constants, radius_eff, overlap_max)
    return 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(radius_eff * ratio), overlap_max - overlap_max / ratio


@dataclass(frozen=True)
class ThorntonCollision:
    """A binary collision of elastic, perfectly plastic spheres in closed form.

    hertz:          Hertz stiffness k [N/m^1.5]
    radius_eff:     effective radius R [m]
    mass_eff:       effective mass M [kg]
    velocity:       approach velocity v [m/s]
    pressure:       limiting contact pressure p [Pa]
    overlap_yield:  overlap at first yield [m]
    """

    hertz: float
    radius_eff: float
    mass_eff: float
    velocity: float
    pressure: float
    overlap_yield: float

    @property
    def force_yield(self) -> float:
        """Force at first yield [N]."""
        return self.hertz * self.overlap_yield**1.5

    @property
    def yield_velocity(self) -> float:
        """Smallest approach velocity with yield [m/s]: M v_y^2 / 2 = (2/5) F_y d_y."""
        return math.sqrt(0.8 * self.force_yield * self.overlap_yield / self.mass_eff)

    @property
    def plastic_slope(self) -> float:
        """Tangent stiffness of plastic loading [N/m], pi p R."""
        return math.pi * self.pressure * self.radius_eff

    @property
    def overlap_max(self) -> float:
        """Maximum overlap [m], from energy conservation; without yield Zhou 2011, Eq. 5.

        d_y + (sqrt(F_y^2 + s M (v^2 - v_y^2)) - F_y) / s,   s = pi p R        v > v_y
        """
        if self.velocity <= self.yield_velocity:
            return float(theory.overlap_max(self.hertz, self.mass_eff, self.velocity))
        energy = self.mass_eff * (self.velocity**2 - self.yield_velocity**2)
        root = math.sqrt(self.force_yield**2 + self.plastic_slope * energy)
        return self.overlap_yield + (root - self.force_yield) / self.plastic_slope

    @property
    def flattening(self) -> float:
        """Ratio of the radius of the flattened contact to that of the sphere, R_p / R."""
        largest = self.overlap_max
        if largest <= self.overlap_yield:
            return 1.0
        force = self.force_yield + self.plastic_slope * (largest - self.overlap_yield)
        return self.hertz * largest**1.5 / force

    @property
    def restitution(self) -> float:
        """Restitution coefficient (Thornton 1997).

        e^2 = (6 sqrt(3) / 5) (1 - w^2 / 6) (w / (w + 2 sqrt((6 - w^2) / 5)))^(1/2),   w = v_y / v <= 1
        """
        w = self.yield_velocity / self.velocity
        if w >= 1.0:
            return 1.0
        share = w / (w + 2.0 * math.sqrt((6.0 - w * w) / 5.0))
        return math.sqrt(6.0 * math.sqrt(3.0) / 5.0 * (1.0 - w * w / 6.0)) * share**0.25

    @property
    def unloading_stiffness(self) -> float:
        """Tangent stiffness at the start of unloading [N/m]."""
        return 1.5 * self.hertz * math.sqrt(self.overlap_max)

    def durations(self) -> tuple[float, float]:
        """Loading and unloading durations [s]."""
        scale = float(theory.time_scale(self.hertz, self.mass_eff, self.velocity))
        rebound = self.overlap_max / self.flattening
        unloading = theory.LOADING_DURATION * rebound / (self.restitution * self.velocity)
        if self.velocity <= self.yield_velocity:
            return theory.LOADING_DURATION * scale, unloading
        elastic = scale * _hertz_time(self.overlap_yield * self.velocity**-1 / scale)
        velocity_at_yield = math.sqrt(self.velocity**2 - self.yield_velocity**2)
        omega = math.sqrt(self.plastic_slope / self.mass_eff)
        plastic = math.atan2(velocity_at_yield * omega * self.mass_eff, self.force_yield) / omega
        return elastic + plastic, unloading


def _hertz_time(share: float) -> float:
    """Time over T_s of Hertz loading to a share of dmax: int_0^share du / sqrt(1 - u^2.5)."""
    nodes, weights = theory.gauss_nodes(60)
    end = math.asin(share)
    angle = 0.5 * end * (nodes + 1.0)
    integrand = np.cos(angle) / np.sqrt(1.0 - np.sin(angle) ** 2.5)
    return float(0.5 * end * np.sum(weights * integrand))


@dataclass(frozen=True)
class Thornton(ClosedFormCollision, NormalLaw):
    """Thornton's model; the contact pressure is limited to `yield_ratio` times the lower yield strength."""

    yield_ratio: float

    name = "thornton"
    source = "Thornton 1997, J. Appl. Mech. 64:383, doi 10.1115/1.2787319"
    limits = (
        "neither hardening nor rate dependence: e is 1 below the yield velocity and decreases as v^(-1/4) "
        "far above it, for every material; the contact pressure at yield is uncertain by a factor of 2"
    )
    constant_names = ("modulus_eff", "shear_modulus_eff", "yield_pressure")

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Thornton":
        """The law that a scene requests."""
        return cls(request.options.yield_ratio)

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """Maximum overlap."""
        return (HistoryField("overlap_max", "maximum overlap", "m", in_output=True),)

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`. Raises ValueError if neither material has a yield strength."""
        if pair.yield_strength is None:
            raise ValueError(
                "the contact model thornton requires a yield strength of at least one of the two materials"
            )
        return pair.modulus_eff, pair.shear_modulus_eff, self.yield_ratio * pair.yield_strength

    @ti.func
    def force(self, constants, contact, history):
        """Loading branch beyond the previous maximum overlap [N], flattened Hertz contact below it."""
        history_new = history
        history_new.overlap_max = ti.max(contact.overlap, history.overlap_max)
        stiffness, residual = unloading_contact(constants, contact.radius_eff, history_new.overlap_max)
        above = ti.max(contact.overlap - residual, 0.0)
        loading = loading_force(constants, contact.radius_eff, contact.overlap)
        normal_force = ti.select(
            contact.overlap >= history.overlap_max, loading, stiffness * above * ti.sqrt(above)
        )
        return normal_force, 0.0 * normal_force, history_new

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Energy recovered by unloading [J]: 2/5 of the force times the overlap above the residual one."""
        stiffness, residual = unloading_contact(constants, contact.radius_eff, history.overlap_max)
        above = ti.max(contact.overlap - residual, 0.0)
        return 0.4 * stiffness * above * above * ti.sqrt(above)

    @ti.func
    def lost_energy(self, constants, contact, history):
        """Work of loading to the maximum overlap minus the energy recovered by unloading [J]."""
        largest = history.overlap_max
        overlap_yield, force_yield = yield_point(constants, contact.radius_eff)
        energy_lost = 0.0 * largest
        if largest > overlap_yield:
            beyond = largest - overlap_yield
            work = 0.4 * force_yield * overlap_yield
            work += beyond * (
                force_yield + 0.5 * math.pi * constants.yield_pressure * contact.radius_eff * beyond
            )
            stiffness, residual = unloading_contact(constants, contact.radius_eff, largest)
            above = largest - residual
            energy_lost = work - 0.4 * stiffness * above * above * ti.sqrt(above)
        return energy_lost

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force`, by contact radii: a^2 = R d and a^2 = R_p (d - d_p)."""
        modulus = contact.constants.modulus_eff
        pressure = contact.constants.yield_pressure
        radius = contact.radius_eff
        before = contact.history.overlap_max
        largest = max(contact.overlap, before)
        yield_radius = math.pi * pressure * radius / (2.0 * modulus)

        def loaded(overlap: float) -> float:
            contact_radius = math.sqrt(radius * overlap)
            elastic = 4.0 * modulus * min(contact_radius, yield_radius) ** 3 / (3.0 * radius)
            return elastic + math.pi * pressure * max(contact_radius**2 - yield_radius**2, 0.0)

        if contact.overlap >= before:
            return loaded(contact.overlap), {"overlap_max": largest}
        equivalent = 4.0 * modulus * (radius * largest) ** 1.5 / (3.0 * radius)
        flat_radius = radius * equivalent / loaded(largest)
        above = max(contact.overlap - (largest - radius * largest / flat_radius), 0.0)
        return 4.0 / 3.0 * modulus * math.sqrt(flat_radius) * above**1.5, {"overlap_max": largest}

    def collision(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> ThorntonCollision:
        """Closed forms of a collision."""
        modulus, _, pressure = self.pair_constants(pair)
        hertz = float(theory.hertz_stiffness(modulus, radius_eff))
        overlap_yield = radius_eff * (0.5 * math.pi * pressure / modulus) ** 2
        return ThorntonCollision(hertz, radius_eff, mass_eff, velocity, pressure, overlap_yield)

    def overlap_max(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Maximum overlap [m], with yield."""
        return self.collision(pair, radius_eff, mass_eff, velocity).overlap_max


class ThorntonOptions(Options):
    """Options of the model."""

    yield_ratio: Annotated[float, Number(noun="a ratio", above=0)] = Field(
        description="ratio of the maximum contact pressure to the yield strength: 1.6 at the onset of yield "
        "below the surface (Thornton 1997), 2.8 for a fully plastic contact (Johnson 1985)",
        examples=["1.6"],
    )


MODEL = ContactModel(
    Thornton,
    "Elastic, perfectly plastic spheres: restitution follows from the yield strength (Thornton 1997).",
    options=ThorntonOptions,
    restitution="nothing",
)
