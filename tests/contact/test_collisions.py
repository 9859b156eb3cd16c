"""Binary collisions with every normal model: restitution, duration and energy balance."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from contact.cases import (
    CASES,
    COHESION,
    CONTINUOUS,
    MASS,
    PLAIN,
    RADIUS,
    evaluate_path,
    law_parameters,
    single_contact,
)

from granflow.contact.material import VelocityRestitution
from granflow.kernel_language import ti

VELOCITIES = np.array([0.08, 0.2, 0.45, 0.7, 1.0, 1.4])
TABLE = ti.types.ndarray(ti.f64, 1)


@cache
def kernel_for(laws):
    """A kernel that integrates one collision per velocity with the leapfrog scheme of the engine."""
    read_constants, new_history, contact_of, force_of, energies, _ = single_contact(laws)
    law = laws.normal
    since_separation = (
        1.0 if law.name == "zhou" else 0.5
    )  # steps; a force averaged over the step ends half a step later

    @ti.kernel
    def collide(
        pair: TABLE, parameters: TABLE, radius: ti.f64, mass: ti.f64, velocity: TABLE, start: TABLE, dt: TABLE,
        limit: ti.i32, rebound: TABLE, duration: TABLE, lost: TABLE
    ):  # fmt: skip
        for i in range(velocity.shape[0]):
            constants = read_constants(pair, parameters)
            history = new_history()
            overlap = start[i] * dt[i] * velocity[i]
            half = velocity[i]
            force = 0.0
            viscous_work = 0.0
            time = 0.0
            over = 0
            free = 0
            for _ in range(limit):
                if over == 0:
                    rate = half
                    if ti.static(law.rate_dependent):
                        rate = half - 0.5 * dt[i] * force / mass
                    before = force
                    contact = contact_of(radius, mass, dt[i], overlap, rate)
                    force, _load, viscous, history_new = force_of(constants, contact, history)
                    history = history_new
                    viscous_work += viscous * rate * dt[i]
                    if force == 0.0 and before > 0.0:
                        free = 1
                        duration[i] = time - since_separation * dt[i]
                    half -= dt[i] * force / mass
                    if overlap + dt[i] * half <= 0.0:
                        over = 1
                        if free == 0:
                            duration[i] = time + overlap / -half
                    overlap += dt[i] * half
                    time += dt[i]
            rebound[i] = -half
            _stored, lost_in_history = energies(constants, contact_of(radius, mass, dt[i], 0.0, 0.0), history)
            lost[i] = viscous_work + lost_in_history

    return collide


def collisions(case, steps, phases=7, velocities=VELOCITIES):
    """Restitution, duration over that of the model, relative energy error: (velocities, phases).

    The phases are initial overlaps as fractions of the distance per time step.
    """
    law = case.law()
    pair = case.pair()
    velocity = np.repeat(velocities, phases)
    expected = np.repeat([sum(law.phase_durations(pair, RADIUS, MASS, v)) for v in velocities], phases)
    start = np.tile((np.arange(phases) + 0.5) / phases, len(velocities))
    found = [np.zeros(len(velocity)) for _ in range(3)]
    constants = np.array(case.laws().pair_constants(pair)), law_parameters(case.laws())
    step = expected / steps
    kernel_for(case.laws())(*constants, RADIUS, MASS, velocity, start, step, 4 * steps, *found)
    rebound, duration, lost = found
    energy = 0.5 * MASS * velocity**2
    missing = (energy - 0.5 * MASS * rebound**2 - lost) / energy
    shape = (len(velocities), phases)
    duration = (duration + start * step) / expected
    return rebound.reshape(shape) / velocities[:, None], duration.reshape(shape), missing.reshape(shape)


COARSE, FINE = 200, 800
"""Steps per collision."""
WITHOUT_REBOUND = "zhou_without_rebound"
"""Case of the restitution 0."""


def expected_restitution(case, steps):
    """Restitution of the model, or the smallest that it reaches with this number of steps: (velocities,
    1)."""
    law = case.law()
    pair = case.pair()
    found = np.array([law.restitution(pair, RADIUS, MASS, v) for v in VELOCITIES])
    if law.limits_restitution:
        durations = np.array([sum(law.phase_durations(pair, RADIUS, MASS, v)) for v in VELOCITIES])
        least = [
            law.least_restitution(pair, RADIUS, MASS, *each)
            for each in zip(VELOCITIES, durations / steps, strict=True)
        ]
        found = np.maximum(found, least)
    return found[:, None]


UNDAMPED = ("linear", "hertz_damped", "zhou_damped", "eepa_damped", WITHOUT_REBOUND)
"""Beginnings of the names of cases whose closed form is not that of the duration."""


@pytest.mark.parametrize("case", CASES, ids=str)
def test_restitution_duration_and_energy_of_a_collision_converge_in_second_order(taichi_f64, case):
    """Onset, maximum overlap and separation are resolved within a time step, the end within half a step.

    The loss of kinetic energy equals the dissipation of the model: plastic work plus damping. At the largest velocity
    some cohesive contacts do not separate, and their energy is still stored. A contact of the restitution 0
    accumulates its work as the leapfrog scheme does: without error. Models with a dashpot state undamped durations.
    """
    separating = VELOCITIES[:-1] if case.adhesive else VELOCITIES
    steps = (COARSE, FINE)
    restitution, duration, missing = zip(
        *(collisions(case, n, velocities=separating) for n in steps), strict=True
    )
    coarse, fine = (np.abs(each).max() for each in missing)
    assert coarse <= 2e-4
    assert coarse / fine >= 9.0 or max(coarse, fine) <= 1e-13 and case.name == WITHOUT_REBOUND
    if case in PLAIN and case.name not in ("zhou_damped", WITHOUT_REBOUND):
        coarse, fine = (
            np.abs(e - expected_restitution(case, n)).max() for e, n in zip(restitution, steps, strict=True)
        )
        assert coarse <= 1e-4
        assert coarse / fine >= 0.9 * 4.0**2
    if case in PLAIN and not case.name.startswith(UNDAMPED):
        for found, n in zip(duration, steps, strict=True):
            assert np.abs(found - 1.0).max() <= 0.51 / n + 1e-4


BY_NAME = {case.name: case for case in CASES}
SMALL = {"zhou_small": 0.001, "zhou_impact": VelocityRestitution(1.2, 0.54, 0.3), "zhou_constant": 0.1}


def test_restitution_below_the_smallest_one_is_the_smallest_one(taichi_f64):
    """Within 0.6 % from ten steps per collision on, also for e(v) = 0 above the limit velocity, 0.3 m/s.

    A contact of the restitution 0 stops the pair in one step; the rest is rounding.
    """
    for name, restitution in SMALL.items():
        small = replace(BY_NAME[name], restitution=restitution)
        for steps in (10, 50):
            expected = expected_restitution(small, steps)
            assert expected.max() < 1.0
            found = collisions(small, steps)[0]
            np.testing.assert_allclose(found, np.broadcast_to(expected, (6, 7)), rtol=6e-3)
    for steps in (10, COARSE):
        assert np.abs(collisions(BY_NAME[WITHOUT_REBOUND], steps)[0]).max() <= 1e-14


def test_a_strong_linear_dashpot_does_not_reverse_the_motion_in_its_first_step(taichi_f64):
    """The kick of the first step is up to 1.5 times 2 zeta w dt, at 44 steps per collision 1.5 times 1."""
    rebound = collisions(replace(BY_NAME["linear_onset"], restitution=0.005), 44)[0]
    assert 0.0 <= rebound.min() and rebound.max() <= 1.1 * 0.005


@pytest.mark.parametrize("case", [case for case in PLAIN if case in CONTINUOUS], ids=str)
def test_unloading_stiffness_equals_the_steepest_chord(taichi_f64, case):
    """The steepest chord of the elastic force near the maximum overlap of a collision; it determines the time
    step."""
    law = case.law()
    pair = case.pair()
    velocity = 1.0
    steepest = law.unloading_stiffness(pair, RADIUS, MASS, velocity)
    rising = np.linspace(0.0, 1.2e-3, 12001)[1:]
    rate = np.full((1, len(rising)), velocity)
    force = evaluate_path(case, rising[None, :], rate, time_step=0.0).elastic[0]
    turn = int(np.searchsorted(np.cumsum(force) * rising[0], 0.5 * MASS * velocity**2))
    path = np.concatenate([rising[: turn + 1], rising[:turn][::-1]])
    elastic = evaluate_path(
        case, path[None, :], rate[:, :1] * np.ones((1, len(path))), time_step=0.0
    ).elastic[0]
    chord_max = np.abs(np.diff(elastic) / np.diff(path)).max()
    assert chord_max <= 1.002 * steepest
    if np.isfinite(steepest):
        assert chord_max >= 0.98 * steepest


def test_cohesion_lowers_the_restitution_of_a_bilinear_contact(taichi_f64):
    """The attraction is a spring of -kc, which increases the overlap: e^2 = 1 - (1 - e0^2) / (1 - kc /
    k1)."""
    case = BY_NAME["sjkr_walton_braun_number"]
    attraction = 2.0 * np.pi * COHESION * RADIUS
    expected = np.sqrt(1.0 - (1.0 - 0.6**2) / (1.0 - attraction / 2e4))
    np.testing.assert_allclose(collisions(case, FINE)[0], expected, atol=1e-4)
