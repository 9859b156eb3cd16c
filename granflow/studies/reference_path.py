"""Path of one head-on collision by the reference implementation of its contact model."""

import numpy as np

from granflow import Plan
from granflow.contact.material import PairMaterial
from granflow.studies.collision_bench import LONGEST

SHORT = 1e-6
"""Time step of the reference integration relative to the duration; sub-step corrections are then negligible."""
FORCE_SAMPLES = 2001
"""Points of each phase of the reference integration at which the force is evaluated."""

Impact = tuple[PairMaterial, float, float, float]
"""Arguments of contact models: pair of materials, effective radius [m] and mass [kg], approach velocity [m/s]."""


LOADING_STEPS = 4000
"""Trapezoids of the loading work."""


def loading_path(plan: Plan, impact: Impact) -> dict[str, float]:
    """Duration from the contact model; maximum overlap and force where the loading work equals the kinetic energy.

        int_0^dmax F dd = M v^2 / 2

    The integral is a sum of trapezoids, LOADING_STEPS of them in the loading time at the approach velocity; the last
    one is interpolated.
    """
    (pair, radius_eff, mass_eff, velocity), law = impact, plan.law
    loading, unloading = law.phase_durations(*impact)
    constants, history = np.array(law.pair_constants(pair)), np.zeros(max(law.history_count, 1))
    moment = loading / LOADING_STEPS
    step = velocity * moment
    overlap, force, force_before, energy = 0.0, 0.0, 0.0, 0.5 * mass_eff * velocity**2
    while energy > 0.0:
        force_before, overlap = force, overlap + step
        force, history = law.reference_force(constants, radius_eff, mass_eff, moment, overlap, velocity, history)
        energy -= 0.5 * (force_before + force) * step
    # -energy is the excess work of the last step
    overlap_max, force_max = overlap + energy / force, force + (force - force_before) * energy / force / step
    return {
        "duration_theory": loading + unloading,
        "overlap_max_theory": overlap_max,
        "overlap_residual_theory": end_overlap(plan, impact, moment, overlap_max, history),
        "force_max_theory": force_max,
    }


def end_overlap(plan: Plan, impact: Impact, time_step: float, overlap: float, history: np.ndarray) -> float:
    """Overlap [m] at which the elastic force of a contact with this history vanishes; 0 if attractive.

    `overlap` [m]: upper end of the search; `history`: fields of the contact model.
    """
    from scipy.optimize import brentq

    constants = np.array(plan.law.pair_constants(impact[0]))

    def is_repulsive(at: float) -> float:
        force, _ = plan.law.reference_force(constants, *impact[1:3], time_step, at, 0.0, history)
        return 1.0 if force > 0.0 else -1.0

    smallest = 1e-15 * overlap
    if plan.law.attracts or is_repulsive(smallest) > 0.0:
        return 0.0
    if is_repulsive(overlap) < 0.0:
        return overlap
    return float(brentq(is_repulsive, smallest, overlap, xtol=smallest, rtol=1e-15))


def damped_path(plan: Plan, impact: Impact) -> dict[str, float]:
    """Duration [s], maximum overlap [m] and force [N] of M d'' = -F(d, d'), by the method DOP853 of scipy."""
    from scipy.integrate import solve_ivp

    pair, radius_eff, mass_eff, velocity = impact
    law, constants = plan.law, np.array(plan.law.pair_constants(pair))
    longest = sum(law.phase_durations(*impact))

    def contact(overlap: float, rate: float, history: np.ndarray) -> tuple[float, np.ndarray]:
        return law.reference_force(constants, radius_eff, mass_eff, SHORT * longest, overlap, rate, history)

    _, history = contact(0.0, velocity, np.zeros(max(law.history_count, 1)))

    def force(overlap: float, rate: float) -> float:
        return contact(overlap, rate, history)[0] if overlap > 0.0 else 0.0

    def slope(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -force(*state) / mass_eff]

    def stopped(_: float, state: np.ndarray) -> float:
        return float(state[1])

    def released(_: float, state: np.ndarray) -> float:
        return 1.0 if force(*state) > 0.0 else -1.0

    stopped.terminal = released.terminal = True  # type: ignore[attr-defined]
    released.direction = -1.0  # type: ignore[attr-defined]
    state, time, force_max, overlap_max = np.array([0.0, velocity]), 0.0, 0.0, 0.0
    for event in (stopped, released):
        tolerance = {"rtol": 1e-11, "atol": 1e-14 * np.array([velocity * longest, velocity])}
        course = solve_ivp(
            slope, (time, LONGEST * longest), state, "DOP853", events=event, dense_output=True, **tolerance
        )
        path = course.sol(np.linspace(time, course.t[-1], FORCE_SAMPLES))
        force_max = max(force_max, *(force(*point) for point in path.T))
        state, time, overlap_max = course.y[:, -1], float(course.t[-1]), max(overlap_max, float(course.y[0, -1]))
        _, history = contact(float(state[0]), float(state[1]), history)
    return {"duration_theory": time, "overlap_max_theory": overlap_max, "force_max_theory": force_max}


def history_along(plan: Plan, impact: Impact, overlap: np.ndarray, rate: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Contact history at the last force, by the reference implementation along the recorded path.

    `overlap` [m], `rate` [m/s], `force` [N] (steps,). A model without viscosity reads the rate half a step back.
    """
    pair, radius_eff, mass_eff, _ = impact
    law, time_step = plan.law, plan.time_step
    constants, history = np.array(law.pair_constants(pair)), np.zeros(max(law.history_count, 1))
    rate_seen = rate if law.rate_dependent else rate + 0.5 * time_step * force / mass_eff
    for index in np.flatnonzero(force):
        point = (overlap[index], rate_seen[index])
        _, history = law.reference_force(constants, radius_eff, mass_eff, time_step, *point, history)
    return history
