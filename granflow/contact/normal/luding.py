"""Bilinear model with tension, whose plasticity increases with the overlap up to a limit (Luding 2008).

The loading slope is k1. The unloading slope k2 lies between k1 and kp and increases with the maximum overlap.
Beyond the limit overlap the contact is elastic along the kp line: the limit branch. The tension, if any, is
-kc d.

    F = max(k1 dmax - k2 (dmax - d), -kc d),   k2 = k1 (1 + growth dmax / R),   dmax up to the limit overlap
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from granflow.contact.law import (
    ClosedFormCollision,
    ContactModel,
    ContactState,
    HistoryField,
    ModelRequest,
)
from granflow.contact.material import PairMaterial
from granflow.contact.normal.linear import Spring, SpringLaw, SpringOptions, quarter_period
from granflow.device_functions import ti
from granflow.schema.quantities import Number

# Closed forms of a binary collision


@dataclass(frozen=True)
class LudingCollision:
    """A binary collision in closed form.

    stiffness:  k1 [N/m]
    growth:     relative increase of k2 with the maximum overlap [1/m]
    limit:      limit overlap [m]
    tension:    kc / k1
    mass_eff:   effective mass [kg]
    velocity:   approach velocity [m/s]
    """

    stiffness: float
    growth: float
    limit: float
    tension: float
    mass_eff: float
    velocity: float

    @property
    def overlap_max(self) -> float:
        """Largest plastic overlap [m]."""
        return min(self.velocity * math.sqrt(self.mass_eff / self.stiffness), self.limit)

    @property
    def unloading_stiffness(self) -> float:
        """Slope k2 [N/m] after loading to `overlap_max`."""
        return self.stiffness * (1.0 + self.growth * self.overlap_max)

    @property
    def overlap_in_tension(self) -> float:
        """Overlap [m] at the intersection of unloading line and tension line: (k2 - k1) dmax / (k2 + kc)."""
        k2 = self.unloading_stiffness
        return (k2 - self.stiffness) * self.overlap_max / (k2 + self.tension * self.stiffness)

    @property
    def elastic_energy(self) -> float:
        """Energy [J] recovered by unloading before the force becomes tensile."""
        largest = self.overlap_max
        energy_lost = 0.5 * self.stiffness * largest**2 * (1.0 - self.stiffness / self.unloading_stiffness)
        return 0.5 * self.mass_eff * self.velocity**2 - energy_lost

    @property
    def restitution(self) -> float:
        """Restitution coefficient; 0 if the tension prevents separation."""
        tension_force = self.tension * self.stiffness * self.overlap_in_tension
        work = (
            0.5 * tension_force * self.overlap_in_tension + 0.5 * tension_force**2 / self.unloading_stiffness
        )
        return math.sqrt(max(2.0 * (self.elastic_energy - work) / self.mass_eff, 0.0)) / self.velocity

    def durations(self) -> tuple[float, float]:
        """Loading and unloading durations [s]; without separation, unloading ends at zero force."""
        quarter = quarter_period(self.unloading_stiffness, self.mass_eff)
        if self.restitution == 0.0:
            return self._loading_duration(), quarter
        return self._loading_duration(), quarter + self._tension_duration()

    def _loading_duration(self) -> float:
        """Loading duration [s]: a quarter period of k1, or the limit overlap with k1 and the rest with kp."""
        omega = math.sqrt(self.stiffness / self.mass_eff)
        if self.velocity <= omega * self.limit:
            return 0.5 * math.pi / omega
        stiffer = math.sqrt(self.unloading_stiffness / self.mass_eff)
        velocity_at_limit = math.sqrt(self.velocity**2 - (omega * self.limit) ** 2)
        elastic = self.limit * self.stiffness / self.unloading_stiffness
        return (
            math.asin(omega * self.limit / self.velocity) / omega
            + math.atan2(velocity_at_limit, stiffer * elastic) / stiffer
        )

    def _tension_duration(self) -> float:
        """Time under tension [s]: first on the unloading line, then along -kc d."""
        if self.tension == 0.0 or self.overlap_in_tension == 0.0:
            return 0.0
        omega = math.sqrt(self.unloading_stiffness / self.mass_eff)
        stretch = self.tension * self.stiffness * self.overlap_in_tension / self.unloading_stiffness
        velocity_at_zero = math.sqrt(2.0 * self.elastic_energy / self.mass_eff)
        velocity_in_tension = math.sqrt(velocity_at_zero**2 - (omega * stretch) ** 2)
        rate = math.sqrt(self.tension * self.stiffness / self.mass_eff)
        return (
            math.asin(omega * stretch / velocity_at_zero) / omega
            + math.atanh(rate * self.overlap_in_tension / velocity_in_tension) / rate
        )


@ti.func
def loading_loss(growth, stiffness, largest):
    """Energy lost by first loading to an overlap [J]: k1 dmax^2 (1 - k1/k2) / 2."""
    excess = growth * largest
    return 0.5 * stiffness * largest * largest * excess / (1.0 + excess)


@ti.func
def tension_overlap_max(growth, tension, overlap):
    """Maximum overlap [m] of the unloading line that intersects -kc d at this overlap."""
    return 0.5 * (overlap + ti.sqrt(overlap * overlap + 4.0 * (1.0 + tension) * overlap / growth))


@dataclass(frozen=True)
class Luding(ClosedFormCollision, SpringLaw):
    """Luding's model with the loading spring k1; the restitution of a pair gives kp = k1 / e^2 at the limit.

    plasticity_depth:  ratio of the largest residual overlap to 2 R
    tension:           ratio kc / k1; 0: no tension
    """

    plasticity_depth: float
    tension: float

    name = "luding"
    source = "Luding 2008, Granular Matter 10:235, doi 10.1007/s10035-008-0099-x; spring: Zhou 2011, Eq. 19"
    limits = (
        "e decreases with velocity up to the limit overlap and increases beyond it; stiffness and plasticity "
        "depth are fit parameters, not material constants"
    )
    constant_names = ("modulus_eff", "shear_modulus_eff", "growth", "limit")
    """Growth of k2 / k1 per dmax / R, limit of dmax / R."""

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Luding":
        """The law that a scene requests."""
        return cls(Spring.from_scene(request), request.options.plasticity_depth, request.options.tension)

    @property
    def attracts(self) -> bool:
        """Whether the model has tension."""
        return self.tension > 0.0

    @property
    def parameters(self) -> Mapping[str, float]:
        """Those of the spring, and the tension."""
        return {**self.spring.parameters, "tension": self.tension}

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """Maximum overlap, plastic work with tension, and the stiffness unless it is a number."""
        work = (HistoryField("plastic_work", "plastic work", "J"),) if self.attracts else ()
        return (
            HistoryField("overlap_max", "maximum overlap", "m", in_output=True),
            *work,
            *self.spring_history,
        )

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Growth and limit: k2 = k1 (1 + growth dmax / R) for dmax up to limit R.

            growth = (1 - e^2)^2 / (2 depth e^2),   limit = 2 depth / (1 - e^2), infinite for e = 1

        Raises ValueError if the restitution is 0, above 1 or depends on velocity.
        """
        if not isinstance(pair.restitution, float) or not 0.0 < pair.restitution <= 1.0:
            raise ValueError(
                "the contact model luding requires one number above 0 as restitution coefficient"
            )
        share = pair.restitution**2
        growth = (1.0 - share) ** 2 / (2.0 * self.plasticity_depth * share)
        limit = 2.0 * self.plasticity_depth / (1.0 - share) if share < 1.0 else math.inf
        return pair.modulus_eff, pair.shear_modulus_eff, growth, limit

    @ti.func
    def tension_loss(self, constants, growth, stiffness, largest, overlap):
        """Energy lost along -kc d, from the unloading line of `largest` to an overlap [J]."""
        energy_lost = 0.0 * stiffness
        if ti.static(self.attracts):
            tension = constants.tension
            begin = growth * largest * largest / (1.0 + growth * largest + tension)
            elastic_change = tension * tension * (begin * begin / (1.0 + growth * largest))
            elastic_change -= (
                tension
                * tension
                * overlap
                * overlap
                / (1.0 + growth * tension_overlap_max(growth, tension, overlap))
            )
            dissipated = 0.5 * stiffness * (tension * (begin * begin - overlap * overlap) + elastic_change)
            energy_lost = ti.select(overlap < begin, dissipated, energy_lost)
        return energy_lost

    @ti.func
    def force(self, constants, contact, history):
        """F = max(k1 dmax - k2 (dmax - d), -kc d); dmax follows the overlap up to the limit."""
        history_new = history
        overlap = contact.overlap
        stiffness = self.stiffness_of(constants, contact, history)
        growth = constants.growth / contact.radius_eff
        largest = ti.max(history.overlap_max, ti.min(overlap, constants.limit * contact.radius_eff))
        normal_force = stiffness * (largest + (1.0 + growth * largest) * (overlap - largest))
        least = -constants.tension * stiffness * overlap
        if ti.static(self.attracts):
            in_tension = normal_force < least
            energy_lost = ti.select(
                in_tension, self.tension_loss(constants, growth, stiffness, largest, overlap), 0.0
            )
            history_new.plastic_work += (
                loading_loss(growth, stiffness, largest)
                - loading_loss(growth, stiffness, history.overlap_max)
                + energy_lost
            )
            largest = ti.select(in_tension, tension_overlap_max(growth, constants.tension, overlap), largest)
        history_new.overlap_max = largest
        normal_force = ti.max(normal_force, least)
        return normal_force, 0.0 * normal_force, history_new

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Elastic energy [J], F^2 / (2 k2)."""
        stiffness = self.stiffness_of(constants, contact, history)
        largest = history.overlap_max
        stiffness_ratio = 1.0 + constants.growth / contact.radius_eff * largest
        scaled_force = largest + stiffness_ratio * (contact.overlap - largest)
        scaled_force = ti.max(scaled_force, -constants.tension * contact.overlap)
        return 0.5 * stiffness * scaled_force * scaled_force / stiffness_ratio

    @ti.func
    def lost_energy(self, constants, contact, history):
        """Energy lost by loading and along the tension line [J]."""
        stiffness = self.stiffness_of(constants, contact, history)
        growth = constants.growth / contact.radius_eff
        energy_lost = self.tension_loss(constants, growth, stiffness, history.overlap_max, contact.overlap)
        if ti.static(self.attracts):
            energy_lost += history.plastic_work
        else:
            energy_lost += loading_loss(growth, stiffness, history.overlap_max)
        return energy_lost

    @ti.func
    def attraction(self, constants, contact, history):
        """Tension kc d, which the friction limit mu (F + kc d) excludes (Luding 2008)."""
        return constants.tension * self.stiffness_of(constants, contact, history) * contact.overlap

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force`, branch by branch with d0 = (1 - k1/k2) dmax."""
        k1, spring = self.reference_stiffness(contact)
        growth = contact.constants.growth / contact.radius_eff
        largest_before = contact.history.overlap_max
        kc = self.tension * k1
        end = contact.overlap
        largest = max(largest_before, min(end, contact.constants.limit * contact.radius_eff))
        work = _reference_loss(k1, growth, largest) - _reference_loss(k1, growth, largest_before)
        k2 = k1 * (1.0 + growth * largest)
        force = k2 * (end - (1.0 - k1 / k2) * largest)
        if force < -kc * end:
            force = -kc * end
            if self.attracts:
                begin = (k2 - k1) * largest / (k2 + kc)
                # g dmax^2 - g d dmax - (1 + kc/k1) d = 0: the unloading line through (d, -kc d)
                largest = max(np.roots([growth, -growth * end, -(1.0 + self.tension) * end]))
                elastic_before = (kc * begin) ** 2 / (2.0 * k2)
                elastic = (kc * end) ** 2
                work += 0.5 * kc * (begin**2 - end**2) - (
                    elastic / (2.0 * k1 * (1.0 + growth * largest)) - elastic_before
                )
        plastic = {"plastic_work": contact.history.plastic_work + work} if self.attracts else {}
        return float(force), {"overlap_max": largest, **plastic, **spring}

    def collision(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> LudingCollision:
        """Closed forms of a collision."""
        _, _, growth, limit = self.pair_constants(pair)
        stiffness = self.loading_stiffness(pair, radius_eff, mass_eff, velocity)
        return LudingCollision(
            stiffness, growth / radius_eff, limit * radius_eff, self.tension, mass_eff, velocity
        )


def _reference_loss(k1: float, growth: float, largest: float) -> float:
    """Energy [J] lost by first loading to `largest` [m]."""
    residual = growth * largest**2 / (1.0 + growth * largest)
    return 0.5 * k1 * largest * residual


class LudingOptions(SpringOptions):
    """Options of the model."""

    plasticity_depth: Annotated[float, Number(noun="a ratio", above=0, at_most=1)] = Field(
        description="ratio of the largest residual overlap to 2 R (R: effective radius), such as 0.05",
        examples=["0.05"],
    )
    tension: Annotated[float, Number(noun="a ratio", at_least=0)] = Field(
        0.0,
        description="ratio of the stiffness kc of the tension line -kc d to the loading stiffness; 0: no "
        "tension",
        examples=["0.2"],
    )


MODEL = ContactModel(
    Luding,
    "Bilinear, with plasticity that increases up to a limit overlap, elastic beyond it (Luding 2008); the "
    "restitution of a pair applies at the limit.",
    options=LudingOptions,
)
