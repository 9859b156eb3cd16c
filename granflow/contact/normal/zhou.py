"""Hertz elastic loading, nonlinear plastic unloading (Zhou 2011): the primary contact model of granflow.

This file defines the model: pair constants, history, device functions and reference implementation. Reloading follows
the unloading curve up to the previous maximum overlap, then the Hertz curve, so that the force is continuous:
F = min(k d^1.5, unloading curve for dmax).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from granflow.contact import theory
from granflow.contact.law import ContactState, HistoryField, ModelRequest
from granflow.contact.material import PairMaterial, VelocityRestitution
from granflow.contact.model import ContactModel
from granflow.contact.normal_law import NormalLaw
from granflow.contact.options import Amount, Choice
from granflow.contact.substep_corrections import build_step_mean, turning_point
from granflow.contact.zhou_inelastic import HISTORY, SUPPORT_MODES, inelastic_force, inelastic_pair, is_inelastic
from granflow.contact.zhou_reference import DAMPING_POWER, RestitutionAt, reference_contact
from granflow.contact.zhou_unloading import (
    least_restitution,
    recovery_of,
    reloading_force,
    restitution_at,
    unloading_energy,
    unloading_force,
)
from granflow.device_functions import ti

REST_DAMPING = 0.1
"""Default of the option `rest_damping`."""

LEAST_RESOLVED = 0.1
"""Smallest restitution whose unloading the time step resolves; below it the bound on the unloading tangent applies."""

_step_mean = build_step_mean(DAMPING_POWER)


@dataclass(frozen=True)
class Zhou(NormalLaw):
    """Zhou's model.

    restitution_at:   velocity at which e is evaluated
    angle:            bound theta on sqrt(K/M) dt, where K is the unloading tangent
    damping_ratio:    zeta of a viscous force 2 zeta sqrt(K M) times the overlap rate on the elastic branch, where K is
                      the Hertz tangent; 0: no viscous force
    rest_damping:     the same of contacts that reload, where K is the unloading tangent; 0: none
    has_inelastic:    whether a pair has the restitution 0, see `zhou_inelastic`
    """

    restitution_at: RestitutionAt
    angle: float
    damping_ratio: float = 0.0
    rest_damping: float = 0.0
    has_inelastic: bool = False

    name = "zhou"
    source = "Zhou 2011, doi 10.1063/2.1104106, Eqs. 4-12"
    limits = (
        "for e -> 0 unloading becomes discontinuous and is limited by the time step: e_eff > 0; sigma and psi must be "
        "measured"
    )
    constant_names = ("modulus_eff", "shear_modulus_eff", "restitution", "sigma", "psi", "limit_velocity")
    """Constant restitution; sigma, psi and vlim [m/s] of Eq. 12."""
    limits_restitution = True

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Zhou":
        """The law that a scene requests; constant restitution if that of every pair is a number."""
        fitted = any(isinstance(pair.restitution, VelocityRestitution) for pair in request.pairs)
        restitution_at: RestitutionAt = request.options["restitution_at"] if fitted else "constant"
        elastic = all(pair.restitution == 1.0 for pair in request.pairs)
        return cls(
            restitution_at,
            request.unloading_angle,
            request.options["damping_ratio"],
            0.0 if elastic else request.options["rest_damping"],
            any(is_inelastic(pair) for pair in request.pairs),
        )

    @property
    def parameters(self) -> Mapping[str, float]:
        """Bound on the unloading tangent, and the damping ratios of the viscous forces that are not disabled."""
        ratios = {"damping_ratio": self.damping_ratio, "rest_damping": self.rest_damping}
        return {"unloading_angle": self.angle} | {name: ratio for name, ratio in ratios.items() if ratio > 0.0}

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """Maximum overlap, restitution of the contact, and recovery y while it unloads (0: loading)."""
        return (
            HistoryField("overlap_max", "maximum overlap", "m", in_output=True),
            HistoryField("restitution", "restitution coefficient", in_output=True),
            HistoryField("recovery", "recovered fraction of the maximum overlap"),
            *(HISTORY if self.has_inelastic else ()),
        )

    @property
    def rate_dependent(self) -> bool:
        """Whether the contact has damping."""
        return self.damping_ratio > 0.0

    @property
    def prepares(self) -> bool:
        """The restitution and the start of unloading need branches."""
        return True

    @property
    def unloading_angle(self) -> float:
        """Bound on the unloading tangent, see `least_restitution`."""
        return self.angle

    @property
    def reloading_damping(self) -> float:
        """Damping ratio of contacts that reload."""
        return self.rest_damping

    def unresolved_unloading(self, pair: PairMaterial) -> float:
        """Ratio of the durations at the restitution LEAST_RESOLVED; 1 for an inelastic pair, which does not unload."""
        return 1.0 if is_inelastic(pair) else theory.unloading_duration(LEAST_RESOLVED) / theory.LOADING_DURATION

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`; unused ones are 0 (psi: 1). Raises ValueError if the pair has no restitution."""
        moduli = (pair.modulus_eff, pair.shear_modulus_eff)
        if isinstance(pair.restitution, VelocityRestitution):
            fit = pair.restitution
            return (*moduli, 0.0, fit.sigma, fit.psi, fit.limit_velocity)
        return (*moduli, pair.restitution_at(0.0), 0.0, 1.0, 0.0)

    @ti.func
    def unloading_parameters(self, constants, contact, history):
        """Restitution and recovery for unloading from the present maximum overlap."""
        k = 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff)
        e, y, largest, mass = history.restitution, history.recovery, history.overlap_max, contact.mass_eff
        if y == 0.0:
            if ti.static(self.restitution_at == "max_overlap"):
                e = restitution_at(constants, ti.sqrt(0.8 * k * largest**2 * ti.sqrt(largest) / mass))
            least = least_restitution(k, mass, largest, contact.time_step, constants.unloading_angle)
            e = ti.max(e, ti.min(least, 1.0))
            y = recovery_of(e)
        return e, y

    @ti.func
    def prepare(self, constants, contact, history):
        """Set the restitution at first contact; set maximum overlap, restitution and recovery when unloading begins."""
        history_new = history
        if ti.static(self.restitution_at != "max_overlap"):
            if history_new.overlap_max == 0.0:
                history_new.restitution = restitution_at(constants, contact.overlap_rate)
        unloads = contact.overlap < history_new.overlap_max and history_new.recovery == 0.0
        if ti.static(self.has_inelastic):
            unloads = unloads and not inelastic_pair(constants)
        if unloads:
            largest, mass = history_new.overlap_max, contact.mass_eff
            largest_force = 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff * largest) * largest
            overlap_rate_half = contact.overlap_rate
            if ti.static(self.rate_dependent):  # `overlap_rate` is at the time level, not half a step later
                overlap_rate_half += 0.5 * contact.time_step * largest_force / mass
            history_new.overlap_max = turning_point(largest, largest_force, mass, contact.time_step, overlap_rate_half)
            e, y = self.unloading_parameters(constants, contact, history_new)
            history_new.restitution = e
            history_new.recovery = y
        return history_new

    @ti.func
    def force(self, constants, contact, history):
        """Force of the present branch [N] (Zhou 2011, Eq. 4); the viscous part is limited so that the total is >= 0."""
        overlap, radius, rate = contact.overlap, contact.radius_eff, contact.overlap_rate
        stiffness = 4.0 / 3.0 * constants.modulus_eff
        overlap_max, recovery = history.overlap_max, history.recovery
        loading = overlap >= overlap_max
        y = ti.select(loading, 1.0, recovery)
        unloading, tangent = unloading_force(
            stiffness, radius, overlap_max, history.restitution, y, overlap, rate, contact.time_step
        )
        loading_force = stiffness * ti.sqrt(radius * overlap) * overlap
        normal_force = ti.select(loading, loading_force, unloading)
        viscous, excess = 0.0 * stiffness, 0.0 * stiffness
        if ti.static(self.rest_damping > 0.0):
            reloads = (overlap < overlap_max) & (rate > 0.0) & (unloading > 0.0) & (constants.restitution < 1.0)
            damping_force, damping_excess = reloading_force(constants, contact, overlap_max, tangent)
            viscous = ti.select(reloads, damping_force, 0.0)
            excess = ti.select(reloads, damping_excess, 0.0)
        if ti.static(self.rate_dependent):
            viscous += self.viscous_force(constants, contact)
            viscous = ti.select(normal_force > 0.0, ti.max(viscous, -normal_force), 0.0)
        total = normal_force + viscous
        viscous -= excess
        history_new = history
        history_new.overlap_max = ti.max(overlap, overlap_max)
        history_new.recovery = ti.select(loading, 0.0, recovery)
        if ti.static(self.has_inelastic):
            inelastic, rate_half = inelastic_pair(constants), rate
            if ti.static(self.rate_dependent):  # `overlap_rate` is at the time level, half a step later
                rate_half += 0.5 * contact.time_step * history.force_before / contact.mass_eff
            force, history_inelastic = inelastic_force(contact, stiffness * ti.sqrt(radius), rate_half, history)
            total, viscous = ti.select(inelastic, force, total), ti.select(inelastic, 0.0, viscous)
            largest, state = history_new.overlap_max, history_new.recovery
            history_new = history_inelastic  # the fields of HISTORY of other pairs are not read
            history_new.overlap_max = ti.select(inelastic, history_inelastic.overlap_max, largest)
            history_new.recovery = ti.select(inelastic, history_inelastic.recovery, state)
        return total, viscous, history_new

    @ti.func
    def viscous_force(self, constants, contact):
        """Viscous force of the option `damping_ratio` [N], mean over the step."""
        overlap_at, weight = _step_mean(contact.overlap, contact.overlap_rate, contact.time_step)
        tangent = 2.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff * overlap_at)
        return 2.0 * constants.damping_ratio * weight * ti.sqrt(tangent * contact.mass_eff) * contact.overlap_rate

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Energy recovered by unloading from the present overlap [J]; an inelastic pair stores none."""
        k = 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff)
        e, y = self.unloading_parameters(constants, contact, history)
        energy = unloading_energy(k, history.overlap_max, e, y, contact.overlap)
        if ti.static(self.has_inelastic):
            if inelastic_pair(constants):
                energy = 0.0
        return energy

    @ti.func
    def lost_energy(self, constants, contact, history):
        """Work of loading to the maximum overlap, (2/5) k dmax^2.5, minus the energy recovered by unloading [J].

        All work on an inelastic pair.
        """
        k, largest = 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff), history.overlap_max
        e, y = self.unloading_parameters(constants, contact, history)
        energy_lost = 0.4 * k * largest * largest * ti.sqrt(largest) - unloading_energy(k, largest, e, y, largest)
        if ti.static(self.has_inelastic):
            if inelastic_pair(constants):
                energy_lost = history.work
        return energy_lost

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of the model for one contact, in float64."""
        return reference_contact(contact, self.restitution_at, self.angle, self.damping_ratio, self.rest_damping)

    def phase_durations(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> tuple[float, float]:
        """Loading and unloading durations [s] (Zhou 2011, Eqs. 13-15): eta1 Ts and eta2(e(v)) Ts."""
        k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
        scale, e = float(theory.time_scale(k, mass_eff, velocity)), pair.restitution_at(velocity)
        return theory.LOADING_DURATION * scale, theory.unloading_duration(e) * scale

    def unloading_stiffness(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Tangent stiffness at the start of unloading [N/m]; infinite at e = 0 (Zhou 2011, Eqs. 4, 7)."""
        k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
        largest = float(theory.overlap_max(k, mass_eff, velocity))
        return k * np.sqrt(largest) * float(theory.unloading_tangent(pair.restitution_at(velocity)))

    def stable_stiffness(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Hertz tangent [N/m]; the unloading tangent is bounded by the time step."""
        return theory.hertz_tangent(pair, radius_eff, mass_eff, velocity)

    def viscosity(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Viscous force over overlap rate [N s/m], 2 zeta sqrt(K M) with the Hertz tangent K at the maximum overlap."""
        tangent = theory.hertz_tangent(pair, radius_eff, mass_eff, velocity)
        return 2.0 * self.damping_ratio * float(np.sqrt(tangent * mass_eff))

    def unloading_number(self, pair: PairMaterial) -> float:
        """theta^2; that of the support and its damping for an inelastic pair, see `zhou_inelastic`."""
        return SUPPORT_MODES if is_inelastic(pair) else self.angle**2

    def least_restitution(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float, time_step: float
    ) -> float:
        """Smallest restitution that the bound on the unloading tangent permits; 0 for an inelastic pair."""
        if is_inelastic(pair):
            return 0.0
        k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
        largest = theory.overlap_max(k, mass_eff, velocity)
        return float(min(theory.least_restitution(k, mass_eff, largest, time_step, self.angle), 1.0))


MODEL = ContactModel(
    Zhou,
    "Hertz loading, nonlinear plastic unloading (Zhou 2011).",
    options={
        "restitution_at": Choice(
            "velocity at which e is evaluated: impact (at first contact), max_overlap (from the maximum overlap, "
            "Zhou 2011, Eq. 5) or constant (e does not depend on velocity; always used if the restitution of "
            "every pair is a number)",
            words=("impact", "max_overlap", "constant"),
            default="impact",
            with_numbers="constant",
        ),
        "damping_ratio": Amount(
            "damping ratio of the viscous force on the elastic branch; 0: no viscous force, 1: critical damping",
            *("0.1", "number", "a damping ratio"),
            at_least=0,
            at_most=1,
            default=0.0,
        ),
        "rest_damping": Amount(
            "damping ratio of a viscous force on contacts that are compressed again without having separated, as in a "
            "bed at rest; binary collisions are not affected; 0: no such force",
            *("0.1", "number", "a damping ratio"),
            at_least=0,
            at_most=0.5,
            default=REST_DAMPING,
        ),
    },
    restitution="number or fit",
)
