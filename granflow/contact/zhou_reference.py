"""Reference implementation of the Zhou model in numpy; `normal.zhou` contains its device form."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Literal

import numpy as np

from granflow.contact import theory
from granflow.contact.law import ContactState
from granflow.contact.material import VelocityRestitution
from granflow.contact.substep_corrections import reference_mean_above, reference_step_mean, reference_turning_point
from granflow.contact.zhou_inelastic import reference_inelastic
from granflow.contact.zhou_unloading import REST_SPEED

RestitutionAt = Literal["impact", "max_overlap", "constant"]

DAMPING_POWER = 0.25
"""Exponent of the overlap in the viscous force."""


def reference_contact(
    contact: ContactState, restitution_at: RestitutionAt, angle: float, damping_ratio: float, reloading_ratio: float
) -> tuple[float, Mapping[str, float]]:
    """Normal force [N] and changed history fields of one contact, in float64.

    `angle`, `damping_ratio`, `reloading_ratio`: as in `normal.zhou.Zhou`
    """
    overlap, rate, constants, history = contact.overlap, contact.overlap_rate, contact.constants, contact.history
    k = float(theory.hertz_stiffness(constants.modulus_eff, contact.radius_eff))
    largest, e, y = history.overlap_max, history.restitution, history.recovery
    if constants.restitution == constants.limit_velocity == 0.0:
        if damping_ratio > 0.0:
            rate += 0.5 * contact.time_step * history.force_before / contact.mass_eff
        return reference_inelastic(contact, k, rate)
    if restitution_at != "max_overlap" and largest == 0.0:
        e = _restitution(constants, rate)
    viscous = 0.0
    if overlap >= largest:
        elastic, largest, y = k * overlap**1.5, overlap, 0.0
    else:
        if y == 0.0:
            largest, e, y = _unloading_start(contact, k, restitution_at, angle, damping_ratio > 0.0)
        above = reference_mean_above(overlap - largest * (1.0 - y), rate, contact.time_step)
        lam = k * np.sqrt(largest) * float(theory.unloading_slope(e))
        elastic = lam * above + e**3 * k * above**1.5
        if elastic > 0.0 and constants.restitution < 1.0:
            tangent = lam + 1.5 * e**3 * k * np.sqrt(above)
            share = max(1.0 - tangent * contact.time_step**2 / contact.mass_eff, 0.0)
            share /= 1.0 + max(rate, 0.0) ** 2 * contact.mass_eff / (0.8 * k * largest**2.5 * REST_SPEED**2)
            viscous = 2.0 * reloading_ratio * share * np.sqrt(tangent * contact.mass_eff) * max(rate, 0.0)
    if elastic > 0.0 and damping_ratio > 0.0:
        root = reference_step_mean(DAMPING_POWER, overlap, rate, contact.time_step)
        viscous += 2.0 * damping_ratio * np.sqrt(1.5 * k * contact.mass_eff) * root * rate
    total = float(max(elastic + viscous, 0.0))
    return total, {"overlap_max": largest, "restitution": e, "recovery": y}


def _unloading_start(
    contact: ContactState, k: float, restitution_at: RestitutionAt, angle: float, is_damped: bool
) -> tuple[float, float, float]:
    """Maximum overlap [m], restitution and recovery at the start of unloading."""
    largest, mass, time_step = contact.history.overlap_max, contact.mass_eff, contact.time_step
    force, rate, e = k * largest**1.5, contact.overlap_rate, contact.history.restitution
    if is_damped:
        rate += 0.5 * time_step * force / mass
    largest = reference_turning_point(largest, force, mass, time_step, rate)
    if restitution_at == "max_overlap":
        e = _restitution(contact.constants, np.sqrt(0.8 * k * largest**2.5 / mass))
    least = float(theory.least_restitution(k, mass, largest, time_step, angle))
    e = min(max(e, least), 1.0)
    return largest, e, float(theory.recovery(e))


def _restitution(constants: SimpleNamespace, velocity: float) -> float:
    """Restitution at an approach velocity [m/s]."""
    if constants.limit_velocity == 0.0:
        return float(constants.restitution)
    fit = VelocityRestitution(constants.sigma, constants.psi, constants.limit_velocity)
    return float(fit(max(velocity, 0.0)))
