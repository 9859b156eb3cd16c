"""Edinburgh elasto-plastic adhesion (EEPA): plastic loading, stiffer unloading, tension that grows with the
plastic overlap (Thakur et al. 2014, Morrissey 2013).

    F = min(k1 d^n, k2 (d^n - dp^n)) - f0        loading | unloading and reloading
    F = -kadh d^chi - f0                         adhesion branch, from the smallest force to separation
    k2 = k1 / (1 - lam),   dp^n = lam dmax^n     so that both branches meet at dmax
    kadh dmin^chi = fmin = min(3/2 pi w a, k2 dp^n / 2),   a^2 = 2 R dp,   k2 (dp^n - dmin^n) = fmin

n is 1.5 with k1 = (4/3) E sqrt(R), or 1 with a given stiffness; w is the work of adhesion, a the radius of
the plastic contact. On the adhesion branch the plastic overlap decreases, dp^n = d^n + kadh/k2 d^chi, and the
contact reloads along the line of slope k2 through the point that it has left. The branch itself remains until
the contact is loaded beyond this line: fmin then follows the plastic overlap at that point.

A contact remembers dmax, the overlap of the last loading on the first branch, and the smallest overlap x
since then. With g = fmin/k2 and r = min(x^n / dmin^n, 1), the plastic overlap of every state is

    dp^n = r dmin^n + g r^(chi/n)

The numbers are those of one contact; `Eepa` has them as device functions, `EepaCollision` in closed form.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from granflow.contact import theory
from granflow.contact.law import (
    ContactModel,
    ContactState,
    HistoryField,
    ModelRequest,
    NormalLaw,
    Options,
    WorkOfAdhesion,
)
from granflow.contact.material import PairMaterial
from granflow.contact.normal.linear import SpringValue
from granflow.contact.step_corrections import (
    build_step_mean,
    reference_share_in_contact,
    reference_step_mean,
    share_in_contact,
)
from granflow.device_functions import power, ti
from granflow.schema.model import choose_by_first_key
from granflow.schema.quantities import Number

HERTZ, LINEAR = 1.5, 1.0
"""Exponents n of the overlap."""
ADHESION = 1.5 * math.pi
"""Pull-off force over work of adhesion and radius (Johnson, Kendall & Roberts 1971)."""
LARGEST_SHARE = 0.5
"""Largest minimum of the force over that of the unloading line at zero overlap."""
DAMPING_POWER = 0.25
"""Exponent of the overlap in the viscous force for n = 1.5."""

_hertz_mean = build_step_mean(DAMPING_POWER)
_linear_mean = build_step_mean(0.0)


# Closed forms of a binary collision


@dataclass(frozen=True)
class EepaCollision:
    """A binary collision without dashpot.

    exponent:           n
    stiffness:          k1 [N/m^n]
    plasticity:         lam
    adhesion_exponent:  chi
    work_of_adhesion:   w [J/m2]
    pull_off_force:     f0 [N]
    radius_eff, mass_eff, velocity:  R [m], M [kg], approach velocity [m/s]
    """

    exponent: float
    stiffness: float
    plasticity: float
    adhesion_exponent: float
    work_of_adhesion: float
    pull_off_force: float
    radius_eff: float
    mass_eff: float
    velocity: float

    @property
    def unloading_stiffness(self) -> float:
        """k2 [N/m^n]."""
        return self.stiffness / (1.0 - self.plasticity)

    @cached_property
    def overlap_max(self) -> float:
        """Maximum overlap [m]: M v^2 / 2 = k1 dmax^(n + 1) / (n + 1) - f0 dmax, by Newton's method."""
        order = self.exponent + 1.0
        energy = 0.5 * self.mass_eff * self.velocity**2
        # above the root, so that the iteration descends on a convex function
        largest = (order * energy / self.stiffness) ** (1.0 / order)
        largest += (order * self.pull_off_force / self.stiffness) ** (1.0 / self.exponent)
        for _ in range(60):
            excess = self.stiffness * largest**order / order - self.pull_off_force * largest - energy
            slope = self.stiffness * largest**self.exponent - self.pull_off_force
            largest -= excess / slope
        return largest

    @cached_property
    def minimum(self) -> tuple[float, float]:
        """Overlap dmin [m] at the end of the unloading line, and the force fmin [N] there."""
        plastic = self.plasticity ** (1.0 / self.exponent) * self.overlap_max
        radius = math.sqrt(2.0 * self.radius_eff * plastic)
        at_zero = self.unloading_stiffness * plastic**self.exponent
        force = min(ADHESION * self.work_of_adhesion * radius, LARGEST_SHARE * at_zero)
        power_of_overlap = plastic**self.exponent - force / self.unloading_stiffness
        return max(power_of_overlap, 0.0) ** (1.0 / self.exponent), force

    def _released(self, overlap: np.ndarray) -> np.ndarray:
        """Kinetic energy [J] at overlaps [m] of the unloading line."""
        order = self.exponent + 1.0
        largest = self.overlap_max
        plastic = self.plasticity * largest**self.exponent
        line = (largest**order - overlap**order) / order - plastic * (largest - overlap)
        return np.asarray(self.unloading_stiffness * line - self.pull_off_force * (largest - overlap))

    def _left(self, overlap: np.ndarray) -> np.ndarray:
        """Kinetic energy [J] at overlaps [m] of the adhesion branch."""
        end, force = self.minimum
        order = self.adhesion_exponent + 1.0
        relative = overlap / end if end > 0.0 else overlap
        work = force * end * (1.0 - relative**order) / order
        return np.asarray(self._released(np.array(end)) - work - self.pull_off_force * (end - overlap))

    @property
    def restitution(self) -> float:
        """Restitution coefficient; 0 if the attraction prevents separation."""
        kept = min(float(self._left(np.array(0.0))), float(self._released(np.array(self.minimum[0]))))
        return math.sqrt(2.0 * max(kept, 0.0) / self.mass_eff) / self.velocity

    @property
    def steepest_tangent(self) -> float:
        """Largest slope [N/m] of all branches: n k2 dmax^(n - 1), or chi fmin / dmin."""
        end, force = self.minimum
        unloading = self.exponent * self.unloading_stiffness * self.overlap_max ** (self.exponent - 1.0)
        return max(unloading, self.adhesion_exponent * force / end if end > 0.0 else 0.0)

    def durations(self) -> tuple[float, float]:
        """Loading and unloading durations [s]; without attraction or separation, unloading ends at zero
        force."""
        largest = self.overlap_max
        order = self.exponent + 1.0

        def loading(overlap: np.ndarray) -> np.ndarray:
            work = self.stiffness * (largest**order - overlap**order) / order
            return np.asarray(work - self.pull_off_force * (largest - overlap))

        end = self.minimum[0]
        if self.restitution > 0.0:
            unloading = self._time(self._released, largest, end, at_rest=True)
            if self.minimum[1] > 0.0 or self.pull_off_force > 0.0:
                unloading += self._time(self._left, end, 0.0, at_rest=False)
        else:
            balance = self.plasticity * largest**self.exponent
            balance += self.pull_off_force / self.unloading_stiffness
            unloading = self._time(self._released, largest, balance ** (1.0 / self.exponent), at_rest=True)
        return self._time(loading, largest, 0.0, at_rest=True), unloading

    def _time(
        self, energy: Callable[[np.ndarray], np.ndarray], first: float, last: float, at_rest: bool
    ) -> float:
        """Time [s] between two overlaps [m] from the kinetic energy: int dd / sqrt(2 T / M).

        At rest at the first overlap, d = last + (first - last) cos(t) removes the singularity there.
        """
        nodes, weights = theory.gauss_nodes(80)
        share = 0.5 * (nodes + 1.0)
        if at_rest:
            angle = 0.5 * math.pi * share
            overlap = last + (first - last) * np.cos(angle)
            width = 0.5 * math.pi * np.sin(angle)
        else:
            overlap = first + (last - first) * share
            width = np.ones_like(share)
        speed = np.sqrt(2.0 * energy(overlap) / self.mass_eff)
        return float(0.5 * np.sum(weights * (first - last) * width / speed)) if first > last else 0.0


# The law


@dataclass(frozen=True)
class Eepa(NormalLaw):
    """The model with the options of one scene.

    stiffness:          k1 [N/m] for n = 1; None: that of Hertz, n = 1.5
    adhesion_exponent:  chi
    adhesive:           whether a pair has a work of adhesion
    pulls_off:          whether a pair has a constant pull-off force
    damped:             whether a pair has a restitution below 1
    energy_budget:      whether the plastic work of earlier cycles is saved
    """

    stiffness: float | None
    adhesion_exponent: float
    adhesive: bool
    pulls_off: bool
    damped: bool
    energy_budget: bool

    name = "eepa"
    source = (
        "Thakur et al. 2014, Granular Matter 16:383, doi 10.1007/s10035-014-0506-4; Morrissey 2013, thesis, "
        "University of Edinburgh"
    )
    limits = (
        "plasticity and adhesion are fit parameters of a bulk solid, and e of a plastic contact is below the "
        "restitution of the pair, which is that of the dashpot alone; the pull-off force is discontinuous at "
        "first contact and separation"
    )
    constant_names = (
        "modulus_eff",
        "shear_modulus_eff",
        "plasticity",
        "residual_ratio",
        "work_of_adhesion",
        "pull_off_force",
        "viscosity",
    )
    """Ratio of plastic to maximum overlap; viscosity: sqrt(5) zeta for n = 1.5, 2 zeta for n = 1 [-]."""

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Eepa":
        """The law that a scene requests."""
        given = request.options.stiffness
        stiffness = given.value if isinstance(given, SpringValue) else None
        chi = request.options.adhesion_exponent
        return cls(
            stiffness,
            chi,
            any(pair.properties["work_of_adhesion"] > 0.0 for pair in request.pairs),
            any(pair.properties["pull_off_force"] > 0.0 for pair in request.pairs),
            any(pair.restitution != 1.0 for pair in request.pairs),
            request.energy_budget,
        )

    @property
    def is_hertz(self) -> bool:
        """Whether n is 1.5; kernels cannot compare with None."""
        return self.stiffness is None

    @property
    def exponent(self) -> float:
        """n."""
        return HERTZ if self.is_hertz else LINEAR

    @property
    def rate_dependent(self) -> bool:
        """Whether the contact has damping."""
        return self.damped

    @property
    def attracts(self) -> bool:
        """Whether the force can be attractive."""
        return self.adhesive or self.pulls_off

    @property
    def prepares(self) -> bool:
        """Whether the plastic work of earlier cycles is saved."""
        return self.energy_budget

    @property
    def tangential_stiffness_grows(self) -> bool:
        """Whether the tangential stiffness is that of Hertz contacts."""
        return self.is_hertz

    @property
    def parameters(self) -> Mapping[str, float]:
        """Exponent chi over n, and the stiffness [N/m] if it is a number."""
        given = {} if self.stiffness is None else {"spring_stiffness": self.stiffness}
        return {**given, "adhesion_power": self.adhesion_exponent / self.exponent}

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """Two overlaps, and with the energy budget the plastic work of earlier cycles."""
        work = (HistoryField("plastic_work", "plastic work of earlier cycles", "J"),)
        return (
            HistoryField(
                "overlap_max", "overlap of the last loading beyond the plastic limit", "m", in_output=True
            ),
            HistoryField("overlap_min", "smallest overlap since then", "m"),
            *(work if self.energy_budget else ()),
        )

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`; the damping ratio follows from the restitution.

        Raises ValueError if the restitution is 0 or depends on velocity.
        """
        if not isinstance(pair.restitution, float):
            raise ValueError("the contact model eepa requires one number as restitution coefficient")
        zeta = theory.damping_ratio_for(pair.restitution)
        plasticity = pair.properties["plasticity"]
        return (
            pair.modulus_eff,
            pair.shear_modulus_eff,
            plasticity,
            plasticity ** (1.0 / self.exponent),
            pair.properties["work_of_adhesion"],
            pair.properties["pull_off_force"],
            (math.sqrt(5.0) if self.is_hertz else 2.0) * zeta,
        )

    # Powers of the overlap and the state of a contact

    @ti.func
    def raised(self, overlap):
        """d^n."""
        result = overlap
        if ti.static(self.is_hertz):
            result = overlap * ti.sqrt(overlap)
        return result

    @ti.func
    def lowered(self, raised):
        """d from d^n."""
        result = raised
        if ti.static(self.is_hertz):
            result = power(raised, 2.0 / 3.0)
        return result

    @ti.func
    def loading(self, constants, contact):
        """k1 [N/m^n]."""
        value = 0.0 * contact.overlap
        if ti.static(self.is_hertz):
            value += 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff)
        else:
            value += constants.spring_stiffness
        return value

    @ti.func
    def limit(self, constants, contact, overlap_max):
        """Struct of the unloading line and the adhesion branch after loading to an overlap [m].

        steep:    k2 [N/m^n]
        plastic:  dp^n
        depth:    fmin / k2
        lowest:   dmin^n
        """
        steep = self.loading(constants, contact) / (1.0 - constants.plasticity)
        plastic = constants.plasticity * self.raised(overlap_max)
        depth = 0.0 * plastic
        if ti.static(self.adhesive):
            radius = ti.sqrt(2.0 * contact.radius_eff * constants.residual_ratio * overlap_max)
            depth = ti.min(ADHESION * constants.work_of_adhesion * radius / steep, LARGEST_SHARE * plastic)
        return ti.Struct(steep=steep, plastic=plastic, depth=depth, lowest=plastic - depth)

    @ti.func
    def position(self, limit, overlap):
        """(d / dmin)^n; 0 for a contact without plastic overlap."""
        divisor = ti.select(limit.lowest > 0.0, limit.lowest, 1.0)
        return ti.select(limit.lowest > 0.0, self.raised(overlap) / divisor, 0.0)

    @ti.func
    def tension(self, constants, limit, position):
        """kadh d^chi / k2 at a position on the adhesion branch, or on its continuation."""
        tension = 0.0 * position
        if ti.static(self.adhesive):
            tension = limit.depth * power(position, constants.adhesion_power)
        return tension

    @ti.func
    def pull_off(self, constants, contact):
        """Constant pull-off force [N] over the step, in those of first contact and separation for a part."""
        force = 0.0 * contact.overlap
        if ti.static(self.pulls_off):
            share = share_in_contact(contact.overlap, contact.overlap_rate, contact.time_step)
            force = constants.pull_off_force * share
        return force

    @ti.func
    def force(self, constants, contact, history):
        """Loading branch, or unloading line, or adhesion branch; with dashpot and pull-off force.

        The dashpot never reduces the force that presses the surfaces together below 0.
        """
        history_new = history
        limit = self.limit(constants, contact, history.overlap_max)
        raised = self.raised(contact.overlap)
        loading_force = self.loading(constants, contact) * raised
        smallest = ti.min(history.overlap_min, contact.overlap)
        position = ti.min(self.position(limit, smallest), 1.0)
        tension = self.tension(constants, limit, position)
        line = limit.steep * (raised - (position * limit.lowest + tension))
        on_branch = (contact.overlap <= history.overlap_min) and (position < 1.0)
        unloading_force = ti.select(on_branch, -limit.steep * tension, line)
        is_plastic = loading_force <= line
        elastic = ti.select(is_plastic, loading_force, unloading_force)
        history_new.overlap_max = ti.select(is_plastic, contact.overlap, history.overlap_max)
        history_new.overlap_min = ti.select(is_plastic, contact.overlap, smallest)
        viscous = 0.0 * elastic
        if ti.static(self.damped):
            least = elastic + self.adhesion(constants, contact, history_new)
            viscous = ti.max(self.step_damping(constants, contact) * contact.overlap_rate, -least)
        return elastic + viscous - self.pull_off(constants, contact), viscous, history_new

    @ti.func
    def adhesion(self, constants, contact, history):
        """kadh d^chi [N] at the present overlap, also on the other branches."""
        force = 0.0 * contact.overlap
        if ti.static(self.adhesive):
            limit = self.limit(constants, contact, history.overlap_max)
            force = limit.steep * self.tension(constants, limit, self.position(limit, contact.overlap))
        return force

    @ti.func
    def attraction(self, constants, contact, history):
        """kadh d^chi + f0; the friction limit is mu (F + kadh d^chi + f0) (Thakur et al. 2014)."""
        return self.adhesion(constants, contact, history) + self.pull_off(constants, contact)

    @ti.func
    def step_damping(self, constants, contact):
        """Dashpot [N s/m], its power of the overlap averaged over the step, as `hertz` and `linear`."""
        damping = 0.0 * contact.overlap
        if ti.static(self.is_hertz):
            overlap_at, weight = _hertz_mean(contact.overlap, contact.overlap_rate, contact.time_step)
            secant = 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff * overlap_at)
            damping = constants.viscosity * weight * ti.sqrt(contact.mass_eff * secant)
        else:
            _overlap_at, weight = _linear_mean(contact.overlap, contact.overlap_rate, contact.time_step)
            damping = constants.viscosity * weight * ti.sqrt(constants.spring_stiffness * contact.mass_eff)
        return damping

    @ti.func
    def damping(self, constants, contact, history):
        """sqrt(5) zeta sqrt(M k1) d^(1/4), or 2 zeta sqrt(M k1) [N s/m]."""
        secant = self.loading(constants, contact)
        if ti.static(self.is_hertz):
            secant *= ti.sqrt(contact.overlap)
        return constants.viscosity * ti.sqrt(contact.mass_eff * secant)

    # Energies

    @ti.func
    def prepare(self, constants, contact, history):
        """Save the plastic work of a contact that is loaded again after its plastic overlap has decreased."""
        history_new = history
        if ti.static(self.energy_budget):
            limit = self.limit(constants, contact, history.overlap_max)
            position = self.position(limit, history.overlap_min)
            if position < 1.0 and limit.lowest > 0.0:
                raised = self.raised(contact.overlap)
                plastic = position * limit.lowest + self.tension(constants, limit, position)
                if self.loading(constants, contact) * raised <= limit.steep * (raised - plastic):
                    history_new.plastic_work += (
                        self.loading_loss(constants, limit, limit.plastic)
                        - self.loading_loss(constants, limit, plastic)
                        + self.branch_loss(constants, limit, position)
                    )
        return history_new

    @ti.func
    def loading_loss(self, constants, limit, plastic):
        """Energy [J] lost by loading to the plastic overlap dp: n/(n + 1) k2 dp^n (dmax - dp).

        plastic:  dp^n
        """
        ratio = ti.select(constants.residual_ratio > 0.0, constants.residual_ratio, 1.0)
        excess = (1.0 - constants.residual_ratio) / ratio * self.lowered(plastic)
        return self.exponent / (self.exponent + 1.0) * limit.steep * plastic * excess

    @ti.func
    def line_energy(self, limit, overlap, plastic):
        """Energy [J] of the unloading line of dp at an overlap [m]: int_dp^d k2 (x^n - dp^n) dx.

        plastic:  dp^n
        """
        order = self.exponent + 1.0
        tail = self.exponent / order * plastic * self.lowered(plastic)
        energy = overlap * (self.raised(overlap) / order - plastic) + tail
        return limit.steep * ti.max(energy, 0.0)

    @ti.func
    def branch_content(self, constants, limit, position):
        """Energy [J] of the unloading line at a position of the adhesion branch, and the remaining work."""
        overlap = self.lowered(position * limit.lowest)
        tension = self.tension(constants, limit, position)
        order = constants.adhesion_power * self.exponent + 1.0
        work = limit.steep * tension * overlap / order
        return work + self.line_energy(limit, overlap, position * limit.lowest + tension)

    @ti.func
    def branch_loss(self, constants, limit, position):
        """Energy [J] lost along the adhesion branch down to a position."""
        energy_lost = 0.0 * position
        if ti.static(self.adhesive):
            whole = self.branch_content(constants, limit, 0.0 * position + 1.0)
            energy_lost = ti.max(whole - self.branch_content(constants, limit, position), 0.0)
        return energy_lost

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Energy of the unloading line, and minus the work of the pull-off force [J]."""
        limit = self.limit(constants, contact, history.overlap_max)
        position = ti.min(self.position(limit, history.overlap_min), 1.0)
        plastic = position * limit.lowest + self.tension(constants, limit, position)
        energy = self.line_energy(limit, contact.overlap, plastic)
        if ti.static(self.pulls_off):
            energy -= constants.pull_off_force * contact.overlap
        return energy

    @ti.func
    def lost_energy(self, constants, contact, history):
        """Energy [J] lost by loading, along the adhesion branch and in earlier cycles."""
        limit = self.limit(constants, contact, history.overlap_max)
        smallest = ti.min(history.overlap_min, contact.overlap)
        position = ti.min(self.position(limit, smallest), 1.0)
        energy_lost = self.loading_loss(constants, limit, limit.plastic)
        energy_lost += self.branch_loss(constants, limit, position)
        if ti.static(self.energy_budget):
            energy_lost += history.plastic_work
        return energy_lost

    # Reference implementation

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force`, branch by branch with kadh."""
        n = self.exponent
        chi = self.adhesion_exponent
        constants = contact.constants
        d = contact.overlap
        k1 = self.stiffness or float(theory.hertz_stiffness(constants.modulus_eff, contact.radius_eff))
        k2 = k1 / (1.0 - constants.plasticity)
        largest = contact.history.overlap_max
        residual = constants.plasticity ** (1.0 / n) * largest
        contact_radius = math.sqrt(2.0 * contact.radius_eff * residual)
        tension = min(ADHESION * constants.work_of_adhesion * contact_radius, 0.5 * k2 * residual**n)
        d_min = (residual**n - tension / k2) ** (1.0 / n)
        k_adh = tension / d_min**chi if residual > 0.0 else 0.0
        before = contact.history.overlap_min
        plastic = residual**n if before >= d_min else before**n + k_adh / k2 * before**chi
        work = getattr(contact.history, "plastic_work", 0.0)
        smallest = min(before, d)
        if k1 * d**n <= k2 * (d**n - plastic):
            if before < d_min:
                work += _work_lost(n, chi, k2, constants.plasticity, residual, (d_min, before), k_adh)
            elastic = k1 * d**n
            largest = d
            smallest = d
            residual = constants.plasticity ** (1.0 / n) * d
            contact_radius = math.sqrt(2.0 * contact.radius_eff * residual)
            tension = min(ADHESION * constants.work_of_adhesion * contact_radius, 0.5 * k2 * residual**n)
            k_adh = tension / (residual**n - tension / k2) ** (chi / n) if residual > 0.0 else 0.0
        elif d <= before and d < d_min:
            elastic = -k_adh * d**chi
        else:
            elastic = k2 * (d**n - plastic)
        share = reference_share_in_contact(d, contact.overlap_rate, contact.time_step)
        power_of_overlap = DAMPING_POWER if self.is_hertz else 0.0
        mean = reference_step_mean(power_of_overlap, d, contact.overlap_rate, contact.time_step)
        viscous = constants.viscosity * math.sqrt(contact.mass_eff * k1) * mean * contact.overlap_rate
        if constants.viscosity > 0.0:
            elastic += max(viscous, -elastic - k_adh * d**chi)
        saved = {"plastic_work": work} if self.energy_budget else {}
        changed = {"overlap_max": largest, "overlap_min": smallest, **saved}
        return elastic - share * constants.pull_off_force, changed

    # Closed forms of a binary collision

    def collision(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> EepaCollision:
        """Closed forms of a collision without dashpot."""
        return EepaCollision(
            self.exponent,
            self.stiffness or float(theory.hertz_stiffness(pair.modulus_eff, radius_eff)),
            pair.properties["plasticity"],
            self.adhesion_exponent,
            pair.properties["work_of_adhesion"],
            pair.properties["pull_off_force"],
            radius_eff,
            mass_eff,
            velocity,
        )

    def phase_durations(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> tuple[float, float]:
        """Loading and unloading durations [s] without dashpot."""
        return self.collision(pair, radius_eff, mass_eff, velocity).durations()

    def overlap_max(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Maximum overlap [m] without dashpot."""
        return self.collision(pair, radius_eff, mass_eff, velocity).overlap_max

    def loading_stiffness(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> float:
        """Tangent n k1 dmax^(n - 1) [N/m] of the loading branch."""
        collision = self.collision(pair, radius_eff, mass_eff, velocity)
        return self.exponent * collision.stiffness * collision.overlap_max ** (self.exponent - 1.0)

    def stable_stiffness(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> float:
        """Tangent n k2 dmax^(n - 1) [N/m] of the unloading line; the adhesion branch restores nothing."""
        loading = self.loading_stiffness(pair, radius_eff, mass_eff, velocity)
        return loading / (1.0 - pair.properties["plasticity"])

    def unloading_stiffness(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> float:
        """Largest slope of unloading line and adhesion branch [N/m]."""
        return self.collision(pair, radius_eff, mass_eff, velocity).steepest_tangent

    def viscosity(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Viscous force over overlap rate [N s/m], at the maximum overlap without damping."""
        collision = self.collision(pair, radius_eff, mass_eff, velocity)
        secant = collision.stiffness * collision.overlap_max ** (self.exponent - 1.0)
        return self.pair_constants(pair)[-1] * math.sqrt(mass_eff * secant)

    def restitution(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Restitution of plastic work, adhesion and dashpot; with a dashpot by leapfrog."""
        if pair.restitution == 1.0:
            return self.collision(pair, radius_eff, mass_eff, velocity).restitution
        return self._integrated(pair, radius_eff, mass_eff, velocity)

    def _integrated(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Restitution of a collision in INTEGRATION_STEPS of its undamped duration; 0 without separation."""
        step = sum(self.phase_durations(pair, radius_eff, mass_eff, velocity)) / INTEGRATION_STEPS
        constants = np.array(self.pair_constants(pair))
        history = np.zeros(self.history_count)
        overlap = 0.5 * velocity * step
        rate = velocity
        force = 0.0
        for _ in range(2 * INTEGRATION_STEPS):
            at_level = rate - 0.5 * step * force / mass_eff
            force, history = self.reference_force(
                constants, radius_eff, mass_eff, step, overlap, at_level, history
            )
            rate -= step * force / mass_eff
            overlap += step * rate
            if overlap <= 0.0:
                return -rate / velocity
        return 0.0


INTEGRATION_STEPS = 4000
"""Steps of a collision with dashpot; the error of e is below 1e-6."""


def _work_lost(
    n: float,
    chi: float,
    k2: float,
    plasticity: float,
    residual: float,
    ends: tuple[float, float],
    k_adh: float,
) -> float:
    """Energy [J] lost by unloading from `residual` [m] between two overlaps of the adhesion branch.

    The work against the force, minus the change of the elastic energy; and what the next loading loses again
    on the first branch, up to the overlap that the contact had.
    """

    def elastic(d: float, d_p: float) -> float:
        return k2 * ((d ** (n + 1.0) - d_p ** (n + 1.0)) / (n + 1.0) - d_p**n * (d - d_p))

    def virgin(d_p: float) -> float:
        d_max = d_p / plasticity ** (1.0 / n)
        return (1.0 - plasticity) * k2 * d_max ** (n + 1.0) / (n + 1.0) - elastic(d_max, d_p)

    first, last = ends
    decreased = (last**n + k_adh / k2 * last**chi) ** (1.0 / n)
    work = k_adh * (first ** (chi + 1.0) - last ** (chi + 1.0)) / (chi + 1.0)
    branch = work + elastic(first, residual) - elastic(last, decreased)
    return branch + virgin(residual) - virgin(decreased)


class EepaOptions(Options):
    """Options of the model."""

    stiffness: Annotated[
        Literal["hertz"] | SpringValue,
        choose_by_first_key("it must be hertz or {value: 1e4 N/m}", words=("hertz",)),
    ] = Field(
        description="loading stiffness k1: hertz (n = 1.5, k1 = 4/3 E sqrt(R)) or {value: 1e4 N/m} (n = 1)",
        examples=["hertz"],
    )
    adhesion_exponent: Annotated[float, Number(noun="an exponent", at_least=1, at_most=20)] = Field(
        description="exponent chi of the overlap on the adhesion branch, such as 1.5, or 5 for a force that "
        "falls steeply",
        examples=["1.5"],
    )


class EepaProperties(WorkOfAdhesion):
    """Properties of pairs of the model."""

    plasticity: Annotated[float, Number(noun="a ratio", at_least=0, at_most=0.99)] = Field(
        description="contact plasticity ratio lambda = 1 - k1/k2 of the stiffnesses of loading k1 and "
        "unloading k2; 0 for an elastic contact",
        examples=["0.5"],
    )
    pull_off_force: Annotated[float, Number("force", noun="a force", at_least=0)] = Field(
        description="constant attraction f0 [N] of every contact; 0 for none", examples=["0"]
    )


MODEL = ContactModel(
    Eepa,
    "Edinburgh elasto-plastic adhesion: plastic loading, and tension that grows with the plastic overlap "
    "(Thakur et al. 2014); the restitution of a pair is that of a dashpot.",
    options=EepaOptions,
    pair_properties=EepaProperties,
)
