"""Hertz elastic loading, nonlinear plastic unloading (Zhou 2011): the primary contact model of granflow.

This file defines the whole model: pair constants, history, device functions and reference implementation. Reloading
follows the unloading curve up to the previous maximum overlap, then the Hertz curve, so that the force is continuous:
F = min(k d^1.5, unloading curve for dmax).
"""

from typing import Literal

import numpy as np
import taichi as ti

from granflow.contact import theory
from granflow.contact.material import PairMaterial, VelocityRestitution
from granflow.contact.model import ContactState, ModelRequest, NormalLaw, ReferenceForce
from granflow.contact.substep_corrections import (
    build_step_mean,
    mean_above,
    reference_mean_above,
    reference_step_mean,
    reference_turning_point,
    turning_point,
)
from granflow.contact.tangential.mindlin import mindlin_stiffness

RestitutionAt = Literal["impact", "max_overlap", "constant"]

CONSTANTS = ("modulus_eff", "shear_modulus_eff", "restitution", "sigma", "psi", "limit_velocity")
"""Pair constants: effective moduli E, G [Pa], constant restitution, sigma, psi and vlim [m/s] of Eq. 12."""
HISTORY = ("overlap_max", "restitution", "recovery")
"""History of a contact: dmax [m], restitution e of the contact, recovery y while it unloads (0: loading)."""
LEAST_RESOLVED = 0.1
"""Smallest restitution whose unloading the time step resolves; below it the bound on the unloading tangent applies."""
DAMPING_POWER = 0.25
"""Exponent of the overlap in the viscous force."""
NEWTON_STEPS = 5
"""Newton iterations from y = (4/5) e^2: five reach float64 precision for every e, four leave 25 ulps at e = 1."""


def pair_constants(pair: PairMaterial) -> tuple[float, ...]:
    """Values of CONSTANTS for one pair of materials; unused ones are 0 (psi: 1).

    Raises ValueError if the pair has no restitution.
    """
    shared = (pair.modulus_eff, pair.shear_modulus_eff)
    if isinstance(pair.restitution, VelocityRestitution):
        law = pair.restitution
        return (*shared, 0.0, law.sigma, law.psi, law.limit_velocity)
    return (*shared, pair.restitution_at(0.0), 0.0, 1.0, 0.0)


@ti.func
def restitution_at(constants, velocity):
    """Restitution coefficient at an approach velocity [m/s] (Zhou 2011, Eq. 12).

        e(v) = exp(-sigma (v / (vlim - v))^psi)      v < vlim, else 0

    A pair with a constant restitution has the limit velocity 0.
    """
    sigma, psi, limit = constants[3], constants[4], constants[5]
    e = constants[2]
    if limit > 0.0:
        e = 0.0
        if velocity <= 0.0:
            e = 1.0
        elif velocity < limit:
            e = ti.exp(-sigma * ti.pow(velocity / (limit - velocity), psi))
    return e


@ti.func
def recovery_of(e):
    """Recovered fraction y of the maximum overlap (Zhou 2011, Eq. 8), by NEWTON_STEPS Newton iterations.

    y = (4/5) e^2 + (1/5) e^3 y^2.5
    """
    first = 0.8 * e * e
    share = 0.2 * e * e * e
    y = first
    for _ in ti.static(range(NEWTON_STEPS)):
        root = y * ti.sqrt(y)
        y -= (y - first - share * y * root) / (1.0 - 2.5 * share * root)
    return y


@ti.func
def least_restitution(k, mass, overlap_max, time_step, angle):
    """Smallest restitution at this time step: unloading tangent <= angle^2 M / dt^2; not from the paper.

    Device form of `theory.least_restitution`.
    """
    return ti.sqrt(1.25 * k * ti.sqrt(overlap_max) / mass) * time_step / angle


@ti.func
def unloading_force(stiffness, radius, overlap_max, e, y, overlap, rate, time_step):
    """Force on the unloading branch [N], zero below the residual overlap.

        F = lam (d - ds) + e^3 k (d - ds)^1.5        d > ds        (Zhou 2011, Eq. 4)

    with k = stiffness sqrt(radius), stiffness = (4/3) E, and d - ds averaged over the step, in which the particles may
    separate. Up to 1/e^2 steeper than loading; limited by the time step as e -> 0.
    """
    above = mean_above(overlap - overlap_max * (1.0 - y), rate, time_step)
    cube = e * e * e
    slope = ti.sqrt(radius * overlap_max) * (1.0 - cube * y * ti.sqrt(y)) / y
    return stiffness * above * (slope + cube * ti.sqrt(radius * above))


@ti.func
def unloading_energy(k, overlap_max, e, y, overlap):
    """Energy recovered by unloading from an overlap [J]: lam u^2/2 + (2/5) e^3 k u^2.5, u = d - ds."""
    energy = 0.0 * k
    above = overlap - overlap_max * (1.0 - y)
    if above > 0.0:
        cube = e * e * e
        slope = ti.sqrt(overlap_max) * (1.0 - cube * y * ti.sqrt(y)) / y
        energy = k * above * above * (0.5 * slope + 0.4 * cube * ti.sqrt(above))
    return energy


def build(restitution_at_choice: RestitutionAt, unloading_angle: float, damping_ratio: float = 0.0) -> NormalLaw:
    """Build Zhou's model with the restitution at impact, from the maximum overlap, or constant.

    restitution_at_choice:  velocity at which e is evaluated
    unloading_angle:        bound theta on sqrt(K/M) dt, where K is the unloading tangent
    damping_ratio:          zeta of a viscous force 2 zeta sqrt(K M) times the overlap rate on the elastic branch, where
                            K is the Hertz tangent; 0: no viscous force
    """
    from_max_overlap, damped = restitution_at_choice == "max_overlap", damping_ratio > 0.0
    step_mean = build_step_mean(DAMPING_POWER)

    @ti.func
    def unloading_parameters(constants, radius_eff, mass_eff, time_step, history):
        """Restitution and recovery for unloading from the present maximum overlap."""
        k = 4.0 / 3.0 * constants[0] * ti.sqrt(radius_eff)
        e = history[1]
        y = history[2]
        if y == 0.0:
            if ti.static(from_max_overlap):
                e = restitution_at(constants, ti.sqrt(0.8 * k * history[0] ** 2 * ti.sqrt(history[0]) / mass_eff))
            e = ti.max(e, ti.min(least_restitution(k, mass_eff, history[0], time_step, unloading_angle), 1.0))
            y = recovery_of(e)
        return e, y

    @ti.func
    def prepare(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        """Set the restitution at first touch; set maximum overlap, restitution and recovery when unloading begins."""
        history_new = history
        if ti.static(not from_max_overlap):
            if history_new[0] == 0.0:
                history_new[1] = restitution_at(constants, overlap_rate)
        if overlap < history_new[0] and history_new[2] == 0.0:
            largest_force = 4.0 / 3.0 * constants[0] * ti.sqrt(radius_eff * history_new[0]) * history_new[0]
            overlap_rate_half = overlap_rate
            if ti.static(damped):  # `overlap_rate` is at the time level, not half a step later
                overlap_rate_half += 0.5 * time_step * largest_force / mass_eff
            history_new[0] = turning_point(history_new[0], largest_force, mass_eff, time_step, overlap_rate_half)
            e, y = unloading_parameters(constants, radius_eff, mass_eff, time_step, history_new)
            history_new[1] = e
            history_new[2] = y
        return history_new

    @ti.func
    def force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        """Force of the present branch [N] (Zhou 2011, Eq. 4); the viscous part is limited so that the total is >= 0."""
        stiffness = 4.0 / 3.0 * constants[0]
        contact_radius = ti.sqrt(radius_eff * overlap)
        overlap_max, e, recovery = history[0], history[1], history[2]
        loading = overlap >= overlap_max
        unloading = unloading_force(
            stiffness, radius_eff, overlap_max, e, ti.select(loading, 1.0, recovery), overlap, overlap_rate, time_step
        )
        normal_force = ti.select(loading, stiffness * contact_radius * overlap, unloading)
        viscous = 0.0 * stiffness
        if ti.static(damped):
            overlap_at, weight = step_mean(overlap, overlap_rate, time_step)
            tangent = 1.5 * stiffness * ti.sqrt(radius_eff * overlap_at)
            viscous = 2.0 * damping_ratio * weight * ti.sqrt(tangent * mass_eff) * overlap_rate
            viscous = ti.select(normal_force > 0.0, ti.max(viscous, -normal_force), 0.0)
        history_new = ti.Vector([ti.max(overlap, overlap_max), e, ti.select(loading, 0.0, recovery)])
        return normal_force + viscous, viscous, history_new

    @ti.func
    def stored_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        """Energy recovered by unloading from the present overlap [J]."""
        k = 4.0 / 3.0 * constants[0] * ti.sqrt(radius_eff)
        e, y = unloading_parameters(constants, radius_eff, mass_eff, time_step, history)
        return unloading_energy(k, history[0], e, y, overlap)

    @ti.func
    def lost_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        """Work of loading to the maximum overlap, (2/5) k dmax^2.5, minus the energy recovered by unloading [J]."""
        k = 4.0 / 3.0 * constants[0] * ti.sqrt(radius_eff)
        e, y = unloading_parameters(constants, radius_eff, mass_eff, time_step, history)
        loading_work = 0.4 * k * history[0] * history[0] * ti.sqrt(history[0])
        return loading_work - unloading_energy(k, history[0], e, y, history[0])

    def least_restitution_reached(
        pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float, time_step: float
    ) -> float:
        k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
        largest = theory.overlap_max(k, mass_eff, velocity)
        return float(min(theory.least_restitution(k, mass_eff, largest, time_step, unloading_angle), 1.0))

    def damping(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Viscous force over overlap rate [N s/m], 2 zeta sqrt(K M) with the Hertz tangent K at the maximum overlap."""
        tangent = theory.hertz_tangent(pair, radius_eff, mass_eff, velocity)
        return 2.0 * damping_ratio * float(np.sqrt(tangent * mass_eff))

    return NormalLaw(
        name="zhou",
        source="Zhou 2011, doi 10.1063/2.1104106, Eqs. 4-12",
        limits="for e -> 0 unloading becomes discontinuous and is limited by the time step: e_eff > 0; sigma and psi "
        "must be measured",
        constant_names=CONSTANTS,
        history_names=HISTORY,
        rate_dependent=damped,
        tangential_stiffness_grows=True,
        branch_free=True,
        pair_constants=pair_constants,
        force=force,
        prepare=prepare,
        stored_energy=stored_energy,
        lost_energy=lost_energy,
        tangential_stiffness=mindlin_stiffness,
        reference=_reference(restitution_at_choice, unloading_angle, damping_ratio),
        phase_durations=phase_durations,
        unloading_stiffness=unloading_stiffness,
        stable_stiffness=theory.hertz_tangent,
        damping=damping,
        unloading_angle=unloading_angle,
        unresolved_unloading=theory.unloading_duration(LEAST_RESOLVED) / theory.LOADING_DURATION,
        least_restitution=least_restitution_reached,
    )


def phase_durations(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> tuple[float, float]:
    """Loading and unloading durations [s] (Zhou 2011, Eqs. 13-15): eta1 Ts and eta2(e(v)) Ts."""
    k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
    scale = float(theory.time_scale(k, mass_eff, velocity))
    e = pair.restitution_at(velocity)
    return theory.LOADING_DURATION * scale, theory.unloading_duration(e) * scale


def unloading_stiffness(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
    """Tangent stiffness at the start of unloading [N/m]; infinite at e = 0 (Zhou 2011, Eqs. 4, 7)."""
    k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
    largest = float(theory.overlap_max(k, mass_eff, velocity))
    return k * np.sqrt(largest) * float(theory.unloading_tangent(pair.restitution_at(velocity)))


def law_for(request: ModelRequest) -> NormalLaw:
    """Contact model that a scene requests; constant restitution if that of every pair is a number."""
    fitted = any(isinstance(pair.restitution, VelocityRestitution) for pair in request.pairs)
    source: RestitutionAt = request.settings["restitution_at"] if fitted else "constant"
    return build(source, request.unloading_angle, request.settings["damping_ratio"])


def _reference(restitution_at_choice: RestitutionAt, unloading_angle: float, damping_ratio: float) -> ReferenceForce:
    """Reference implementation of the model for one contact, in float64."""

    def restitution(constants: np.ndarray, velocity: float) -> float:
        if constants[5] == 0.0:
            return float(constants[2])
        return float(VelocityRestitution(*constants[3:6])(max(velocity, 0.0)))

    def reference(contact: ContactState) -> tuple[float, np.ndarray]:
        overlap, mass = contact.overlap, contact.mass_eff
        k = theory.hertz_stiffness(contact.constants[0], contact.radius_eff)
        largest, e, y = contact.history
        if restitution_at_choice != "max_overlap" and largest == 0.0:
            e = restitution(contact.constants, contact.overlap_rate)
        if overlap >= largest:
            elastic, history_new = k * overlap**1.5, np.array([overlap, e, 0.0])
        else:
            if y == 0.0:
                force = k * largest**1.5
                overlap_rate_half = contact.overlap_rate + (
                    0.5 * contact.time_step * force / mass if damping_ratio > 0.0 else 0.0
                )
                largest = reference_turning_point(largest, force, mass, contact.time_step, overlap_rate_half)
                if restitution_at_choice == "max_overlap":
                    e = restitution(contact.constants, np.sqrt(0.8 * k * largest**2.5 / mass))
                e_min = theory.least_restitution(k, mass, largest, contact.time_step, unloading_angle)
                e = min(max(e, e_min), 1.0)
                y = float(theory.recovery(e))
            above = reference_mean_above(overlap - largest * (1.0 - y), contact.overlap_rate, contact.time_step)
            lam = k * np.sqrt(largest) * float(theory.unloading_slope(e))
            elastic, history_new = lam * above + e**3 * k * above**1.5, np.array([largest, e, y])
        if elastic > 0.0 and damping_ratio > 0.0:
            root = reference_step_mean(DAMPING_POWER, overlap, contact.overlap_rate, contact.time_step)
            elastic = max(elastic + 2.0 * damping_ratio * np.sqrt(1.5 * k * mass) * root * contact.overlap_rate, 0.0)
        return float(elastic), history_new

    return reference
