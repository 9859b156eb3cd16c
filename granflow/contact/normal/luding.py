"""Bilinear model with plasticity that increases with the overlap up to a limit, and with tension (Luding 2008).

The loading slope is k1. The unloading slope k2 lies between k1 and kp and increases with the maximum overlap. Beyond
the limit overlap the contact is elastic along the kp line: the limit branch. The tension, if any, is -kc d.

    F = max(k1 dmax - k2 (dmax - d), -kc d),   k2 = k1 (1 + growth dmax / R),   dmax up to the limit overlap
"""

import math
from dataclasses import dataclass

import numpy as np
import taichi as ti

from granflow.contact.material import PairMaterial
from granflow.contact.model import ContactState, ModelRequest, NormalLaw, ReferenceForce
from granflow.contact.spring import Spring, quarter_period, spring_for, tangential_spring

CONSTANTS = ("modulus_eff", "shear_modulus_eff", "growth", "limit")
"""Pair constants: effective moduli E, G [Pa], growth of k2 / k1 per dmax / R, limit of dmax / R."""


def law_for(request: ModelRequest) -> NormalLaw:
    """Contact model that a scene requests."""
    depth, tension = (request.settings[key] for key in ("plasticity_depth", "tension"))
    return build(spring_for(request, history_index=2 if tension > 0.0 else 1), depth, tension)


def build(spring: Spring, plasticity_depth: float, tension: float) -> NormalLaw:
    """Build Luding's model with the loading spring k1.

    spring:            spring k1; its index in the history follows overlap_max and, with tension, plastic_work
    plasticity_depth:  ratio of the largest residual overlap to 2 R
    tension:           ratio kc / k1; 0: no tension

    The restitution of a pair applies on the limit branch: kp = k1 / e^2.
    """
    has_tension = tension > 0.0

    def pair_constants(pair: PairMaterial) -> tuple[float, ...]:
        """Growth and limit: k2 = k1 (1 + growth dmax / R) for dmax up to limit R.

            growth = (1 - e^2)^2 / (2 depth e^2),   limit = 2 depth / (1 - e^2), infinite for e = 1

        Raises ValueError if the restitution is 0, above 1 or depends on velocity.
        """
        if not isinstance(pair.restitution, float) or not 0.0 < pair.restitution <= 1.0:
            raise ValueError("the contact model luding requires one number above 0 as restitution coefficient")
        share = pair.restitution**2
        growth = (1.0 - share) ** 2 / (2.0 * plasticity_depth * share)
        limit = 2.0 * plasticity_depth / (1.0 - share) if share < 1.0 else math.inf
        return pair.modulus_eff, pair.shear_modulus_eff, growth, limit

    @ti.func
    def loading_loss(growth, stiffness, largest):
        """Energy lost by first loading to an overlap [J]: k1 dmax^2 (1 - k1/k2) / 2."""
        excess = growth * largest
        return 0.5 * stiffness * largest * largest * excess / (1.0 + excess)

    @ti.func
    def tension_loss(growth, stiffness, largest, overlap):
        """Energy lost along -kc d from its intersection with the unloading line of `largest` to an overlap [J]."""
        energy_lost = 0.0 * stiffness
        if ti.static(has_tension):
            begin = growth * largest * largest / (1.0 + growth * largest + tension)
            elastic_change = tension * tension * (begin * begin / (1.0 + growth * largest))
            elastic_change -= (
                tension * tension * overlap * overlap / (1.0 + growth * tension_overlap_max(growth, overlap))
            )
            dissipated = 0.5 * stiffness * (tension * (begin * begin - overlap * overlap) + elastic_change)
            energy_lost = ti.select(overlap < begin, dissipated, energy_lost)
        return energy_lost

    @ti.func
    def tension_overlap_max(growth, overlap):
        """Maximum overlap [m] of the unloading line that intersects -kc d at this overlap."""
        return 0.5 * (overlap + ti.sqrt(overlap * overlap + 4.0 * (1.0 + tension) * overlap / growth))

    @ti.func
    def force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        """F = max(k1 dmax - k2 (dmax - d), -kc d); dmax follows the overlap up to the limit."""
        history_new = history
        stiffness, growth = spring.stiffness_of(history_new), constants[2] / radius_eff
        largest = ti.max(history_new[0], ti.min(overlap, constants[3] * radius_eff))
        normal_force = stiffness * (largest + (1.0 + growth * largest) * (overlap - largest))
        least = -tension * stiffness * overlap
        if ti.static(has_tension):
            in_tension = normal_force < least
            energy_lost = ti.select(in_tension, tension_loss(growth, stiffness, largest, overlap), 0.0)
            history_new[1] += (
                loading_loss(growth, stiffness, largest) - loading_loss(growth, stiffness, history_new[0]) + energy_lost
            )
            largest = ti.select(in_tension, tension_overlap_max(growth, overlap), largest)
        history_new[0] = largest
        normal_force = ti.max(normal_force, least)
        return normal_force, 0.0 * normal_force, history_new

    @ti.func
    def stored_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        """Elastic energy [J], F^2 / (2 k2)."""
        stiffness, stiffness_ratio = spring.stiffness_of(history), 1.0 + constants[2] / radius_eff * history[0]
        scaled_force = history[0] + stiffness_ratio * (overlap - history[0])
        scaled_force = ti.max(scaled_force, -tension * overlap)
        return 0.5 * stiffness * scaled_force * scaled_force / stiffness_ratio

    @ti.func
    def lost_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        stiffness, growth = spring.stiffness_of(history), constants[2] / radius_eff
        energy_lost = tension_loss(growth, stiffness, history[0], overlap)
        if ti.static(has_tension):
            energy_lost += history[1]
        else:
            energy_lost += loading_loss(growth, stiffness, history[0])
        return energy_lost

    @ti.func
    def tangential_stiffness(constants, radius_eff, overlap, history):
        """Mindlin's ratio 4 G / E times k1 [N/m]."""
        return tangential_spring(constants, spring.stiffness_of(history))

    @ti.func
    def attraction(constants, radius_eff, overlap, history):
        """Tension kc d, which the friction limit mu (F + kc d) excludes (Luding 2008)."""
        return tension * spring.stiffness_of(history) * overlap

    def collision(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> LudingCollision:
        _, _, growth, limit = pair_constants(pair)
        stiffness = spring.stiffness(pair, radius_eff, mass_eff, velocity)
        return LudingCollision(stiffness, growth / radius_eff, limit * radius_eff, tension, mass_eff, velocity)

    return NormalLaw(
        name="luding",
        source="Luding 2008, Granular Matter 10:235, doi 10.1007/s10035-008-0099-x; spring: Zhou 2011, Eq. 19",
        limits="e decreases with velocity up to the limit overlap and increases beyond it; stiffness and plasticity "
        "depth are fit parameters, not material constants",
        constant_names=CONSTANTS,
        history_names=("overlap_max", *(("plastic_work",) if has_tension else ()), *spring.history_names),
        rate_dependent=False,
        tangential_stiffness_grows=False,
        branch_free=True,
        pair_constants=pair_constants,
        force=force,
        prepare=spring.prepare,
        stored_energy=stored_energy,
        lost_energy=lost_energy,
        tangential_stiffness=tangential_stiffness,
        reference=_reference(spring, tension),
        phase_durations=lambda *arguments: collision(*arguments).durations(),
        unloading_stiffness=lambda *arguments: collision(*arguments).unloading_stiffness,
        stable_stiffness=lambda *arguments: collision(*arguments).unloading_stiffness,
        loading_tangent=spring.stiffness,
        restitution=lambda *arguments: collision(*arguments).restitution,
        attraction=attraction if has_tension else None,
    )


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
        unloading_stiffness_now = self.unloading_stiffness
        return (
            (unloading_stiffness_now - self.stiffness)
            * self.overlap_max
            / (unloading_stiffness_now + self.tension * self.stiffness)
        )

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
        work = 0.5 * tension_force * self.overlap_in_tension + 0.5 * tension_force**2 / self.unloading_stiffness
        return math.sqrt(max(2.0 * (self.elastic_energy - work) / self.mass_eff, 0.0)) / self.velocity

    def durations(self) -> tuple[float, float]:
        """Loading and unloading durations [s]. If the spheres do not separate, unloading ends at zero force."""
        quarter = quarter_period(self.unloading_stiffness, self.mass_eff)
        return self._loading_duration(), quarter + (self._tension_duration() if self.restitution > 0.0 else 0.0)

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


def _reference(spring: Spring, tension: float) -> ReferenceForce:
    """Reference implementation of `force` in numpy, branch by branch with d0 = (1 - k1/k2) dmax as in the paper."""

    def unloading_stiffness(k1: float, growth: float, largest: float) -> float:
        """Slope k2 [N/m]."""
        return k1 * (1.0 + growth * largest)

    def loss(k1: float, growth: float, largest: float) -> float:
        """Energy [J] lost by first loading to `largest` [m]."""
        residual = growth * largest**2 / (1.0 + growth * largest)
        return 0.5 * k1 * largest * residual

    def reference(contact: ContactState) -> tuple[float, np.ndarray]:
        (k1, spring_history), growth = spring.reference_stiffness(contact), contact.constants[2] / contact.radius_eff
        largest_before, kc = contact.history[0], tension * k1
        largest = max(largest_before, min(contact.overlap, contact.constants[3] * contact.radius_eff))
        work = (contact.history[1] if tension else 0.0) + loss(k1, growth, largest) - loss(k1, growth, largest_before)
        k2 = unloading_stiffness(k1, growth, largest)
        force = k2 * (contact.overlap - (1.0 - k1 / k2) * largest)
        if force < -kc * contact.overlap:
            force = -kc * contact.overlap
            if tension:
                begin, end = (k2 - k1) * largest / (k2 + kc), contact.overlap
                # g dmax^2 - g d dmax - (1 + kc/k1) d = 0: the unloading line through (d, -kc d)
                largest = max(np.roots([growth, -growth * end, -(1.0 + tension) * end]))
                elastic_change = (kc * end) ** 2 / (2.0 * unloading_stiffness(k1, growth, largest)) - (
                    kc * begin
                ) ** 2 / (2.0 * k2)
                work += 0.5 * kc * (begin**2 - end**2) - elastic_change
        return float(force), np.array([largest, *([work] if tension else []), *spring_history])

    return reference
