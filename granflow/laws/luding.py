"""Bilinear law with a plasticity that grows with the overlap up to a limit, and a tension (Luding 2008).

Contacts load with k1 and unload with a slope k2 between k1 and kp that grows with the largest overlap. From a
limiting overlap on, the contact is elastic along the kp line: the limit branch. Tension, if any, is -kc d.
"""

import math
from dataclasses import dataclass

import numpy as np
import taichi as ti

from granflow.laws.law import Asked, NormalLaw, Touch, Twin
from granflow.laws.material import PairMaterial
from granflow.laws.spring import Spring, lateral_spring, quarter_period, spring_for

CONSTANTS = ("modulus_eff", "shear_modulus_eff", "growth", "limit")


def law_for(asked: Asked) -> NormalLaw:
    """The law that a scene asks for."""
    depth, tension = (asked.settings[key] for key in ("plasticity_depth", "tension"))
    return build(spring_for(asked, place=2 if tension > 0.0 else 1), depth, tension)


def build(spring: Spring, plasticity_depth: float, tension: float) -> NormalLaw:
    """Luding's law with this loading spring k1 and the largest residual overlap over 2 R; tension is kc / k1.

    Each pair's restitution is that of the limit: kp = k1 / e^2.
    """
    pulls = tension > 0.0

    def pair_constants(pair: PairMaterial) -> tuple[float, ...]:
        """Growth and limit: k2 = k1 (1 + growth dmax / R) for dmax up to limit R."""
        if not isinstance(pair.restitution, float) or not 0.0 < pair.restitution <= 1.0:
            raise ValueError("the luding law takes one number above 0 as restitution coefficient")
        share = pair.restitution**2
        growth = (1.0 - share) ** 2 / (2.0 * plasticity_depth * share)
        limit = 2.0 * plasticity_depth / (1.0 - share) if share < 1.0 else math.inf
        return pair.modulus_eff, pair.shear_modulus_eff, growth, limit

    @ti.func
    def virgin_loss(growth, stiffness, largest):
        """Energy that first loading to an overlap loses [J]: k1 dmax^2 (1 - k1/k2) / 2."""
        steeper = growth * largest
        return 0.5 * stiffness * largest * largest * steeper / (1.0 + steeper)

    @ti.func
    def pulled_loss(growth, stiffness, largest, overlap):
        """Energy lost along -kc d from where the unloading line of `largest` meets it down to an overlap [J]."""
        lost = 0.0 * stiffness
        if ti.static(pulls):
            begin = growth * largest * largest / (1.0 + growth * largest + tension)
            held = tension * tension * (begin * begin / (1.0 + growth * largest))
            held -= tension * tension * overlap * overlap / (1.0 + growth * pulled_largest(growth, overlap))
            heat = 0.5 * stiffness * (tension * (begin * begin - overlap * overlap) + held)
            lost = ti.select(overlap < begin, heat, lost)
        return lost

    @ti.func
    def pulled_largest(growth, overlap):
        """The largest overlap whose unloading line meets -kc d at this overlap."""
        return 0.5 * (overlap + ti.sqrt(overlap * overlap + 4.0 * (1.0 + tension) * overlap / growth))

    @ti.func
    def force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        """F = max(k1 dmax - k2 (dmax - d), -kc d); dmax grows with the overlap up to the limit."""
        memory = history
        stiffness, growth = spring.held(memory), constants[2] / radius_eff
        largest = ti.max(memory[0], ti.min(overlap, constants[3] * radius_eff))
        normal_force = stiffness * (largest + (1.0 + growth * largest) * (overlap - largest))
        least = -tension * stiffness * overlap
        if ti.static(pulls):
            pulled = normal_force < least
            lost = ti.select(pulled, pulled_loss(growth, stiffness, largest, overlap), 0.0)
            memory[1] += virgin_loss(growth, stiffness, largest) - virgin_loss(growth, stiffness, memory[0]) + lost
            largest = ti.select(pulled, pulled_largest(growth, overlap), largest)
        memory[0] = largest
        normal_force = ti.max(normal_force, least)
        return normal_force, 0.0 * normal_force, memory

    @ti.func
    def stored_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        stiffness, steeper = spring.held(history), 1.0 + constants[2] / radius_eff * history[0]
        held = history[0] + steeper * (overlap - history[0])
        held = ti.max(held, -tension * overlap)
        return 0.5 * stiffness * held * held / steeper

    @ti.func
    def lost_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        stiffness, growth = spring.held(history), constants[2] / radius_eff
        lost = pulled_loss(growth, stiffness, history[0], overlap)
        if ti.static(pulls):
            lost += history[1]
        else:
            lost += virgin_loss(growth, stiffness, history[0])
        return lost

    @ti.func
    def lateral_stiffness(constants, radius_eff, overlap, history):
        return lateral_spring(constants, spring.held(history))

    @ti.func
    def attraction(constants, radius_eff, overlap, history):
        """Tension that does not count for friction: its cap is mu (F + kc d) (Luding 2008)."""
        return tension * spring.held(history) * overlap

    def collision(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> Collision:
        _, _, growth, limit = pair_constants(pair)
        stiffness = spring.of(pair, radius_eff, mass_eff, velocity)
        return Collision(stiffness, growth / radius_eff, limit * radius_eff, tension, mass_eff, velocity)

    return NormalLaw(
        name="luding",
        source="Luding 2008, Granular Matter 10:235, doi 10.1007/s10035-008-0099-x; spring: Zhou 2011, Eq. 19",
        limits="e falls with velocity only up to the limit overlap and rises again above it; stiffness and plasticity "
        "depth are fitted, no constants of the material",
        constant_names=CONSTANTS,
        history_names=("overlap_max", *(("plastic_work",) if pulls else ()), *spring.history_names),
        rate_dependent=False,
        lateral_grows=False,
        branch_free=True,
        pair_constants=pair_constants,
        force=force,
        prepare=spring.prepare,
        stored_energy=stored_energy,
        lost_energy=lost_energy,
        lateral_stiffness=lateral_stiffness,
        twin=_twin(spring, tension),
        phase_durations=lambda *bodies: collision(*bodies).durations(),
        unloading_stiffness=lambda *bodies: collision(*bodies).unloading_stiffness,
        stable_stiffness=lambda *bodies: collision(*bodies).unloading_stiffness,
        lateral_tangent=spring.of,
        restitution=lambda *bodies: collision(*bodies).restitution,
        attraction=attraction if pulls else None,
    )


@dataclass(frozen=True)
class Collision:
    """A binary collision in closed form; `growth` [1/m], `limit` overlap [m], `tension` kc / k1."""

    stiffness: float
    growth: float
    limit: float
    tension: float
    mass_eff: float
    velocity: float

    @property
    def overlap_max(self) -> float:
        """Largest overlap that counts as plastic [m]."""
        return min(self.velocity * math.sqrt(self.mass_eff / self.stiffness), self.limit)

    @property
    def unloading_stiffness(self) -> float:
        """Slope k2 [N/m]."""
        return self.stiffness * (1.0 + self.growth * self.overlap_max)

    @property
    def pulled(self) -> float:
        """Overlap [m] at which unloading meets the tension line: (k2 - k1) dmax / (k2 + kc)."""
        steep = self.unloading_stiffness
        return (steep - self.stiffness) * self.overlap_max / (steep + self.tension * self.stiffness)

    @property
    def elastic_energy(self) -> float:
        """Energy [J] that unloading gives back before it pulls."""
        largest = self.overlap_max
        lost = 0.5 * self.stiffness * largest**2 * (1.0 - self.stiffness / self.unloading_stiffness)
        return 0.5 * self.mass_eff * self.velocity**2 - lost

    @property
    def restitution(self) -> float:
        """Restitution coefficient; 0 where the tension holds the spheres."""
        pull = self.tension * self.stiffness * self.pulled
        work = 0.5 * pull * self.pulled + 0.5 * pull**2 / self.unloading_stiffness
        return math.sqrt(max(2.0 * (self.elastic_energy - work) / self.mass_eff, 0.0)) / self.velocity

    def durations(self) -> tuple[float, float]:
        """Loading and unloading duration [s]; unloading of spheres that stay together up to where they would pull."""
        quarter = quarter_period(self.unloading_stiffness, self.mass_eff)
        return self._loading(), quarter + (self._pulling() if self.restitution > 0.0 else 0.0)

    def _loading(self) -> float:
        omega = math.sqrt(self.stiffness / self.mass_eff)
        if self.velocity <= omega * self.limit:
            return 0.5 * math.pi / omega
        stiffer = math.sqrt(self.unloading_stiffness / self.mass_eff)
        left = math.sqrt(self.velocity**2 - (omega * self.limit) ** 2)
        elastic = self.limit * self.stiffness / self.unloading_stiffness
        return math.asin(omega * self.limit / self.velocity) / omega + math.atan2(left, stiffer * elastic) / stiffer

    def _pulling(self) -> float:
        """Time under tension [s]: first on the unloading line, then along -kc d."""
        if self.tension == 0.0 or self.pulled == 0.0:
            return 0.0
        omega = math.sqrt(self.unloading_stiffness / self.mass_eff)
        stretch = self.tension * self.stiffness * self.pulled / self.unloading_stiffness
        parting = math.sqrt(2.0 * self.elastic_energy / self.mass_eff)
        slowed = math.sqrt(parting**2 - (omega * stretch) ** 2)
        growing = math.sqrt(self.tension * self.stiffness / self.mass_eff)
        return math.asin(omega * stretch / parting) / omega + math.atanh(growing * self.pulled / slowed) / growing


def _twin(spring: Spring, tension: float) -> Twin:
    """Numpy twin of `force`, branch by branch with d0 = (1 - k1/k2) dmax as in the paper."""

    def steep(k1: float, growth: float, largest: float) -> float:
        return k1 * (1.0 + growth * largest)

    def loss(k1: float, growth: float, largest: float) -> float:
        residual = growth * largest**2 / (1.0 + growth * largest)
        return 0.5 * k1 * largest * residual

    def twin(touch: Touch) -> tuple[float, np.ndarray]:
        (k1, kept), growth = spring.touched(touch), touch.constants[2] / touch.radius_eff
        before, kc = touch.history[0], tension * k1
        largest = max(before, min(touch.overlap, touch.constants[3] * touch.radius_eff))
        work = (touch.history[1] if tension else 0.0) + loss(k1, growth, largest) - loss(k1, growth, before)
        k2 = steep(k1, growth, largest)
        force = k2 * (touch.overlap - (1.0 - k1 / k2) * largest)
        if force < -kc * touch.overlap:
            force = -kc * touch.overlap
            if tension:
                begin, end = (k2 - k1) * largest / (k2 + kc), touch.overlap
                # g dmax^2 - g d dmax - (1 + kc/k1) d = 0: the line through (d, -kc d)
                largest = max(np.roots([growth, -growth * end, -(1.0 + tension) * end]))
                held = (kc * end) ** 2 / (2.0 * steep(k1, growth, largest)) - (kc * begin) ** 2 / (2.0 * k2)
                work += 0.5 * kc * (begin**2 - end**2) - held
        return float(force), np.array([largest, *([work] if tension else []), *kept])

    return twin
