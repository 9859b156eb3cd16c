"""Closed forms against the values of the paper, root finding, and the equation of motion."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from granflow.contact import theory
from granflow.contact.material import (
    VelocityRestitution,
    limit_velocity,
    modulus_eff,
    shear_modulus_eff,
)
from granflow.contact.normal.kuwabara_kono import dissipation_for
from granflow.scene.blocks.materials import Material

FIGURES = {
    0.2: (0.968000, 31.2483, 0.2513, 1.7230, 20.8),
    0.5: (0.799550, 4.93282, 0.6293, 2.1010, 3.34),
    0.7: (0.601106, 2.29030, 0.8906, 2.3623, 1.74),
    0.9: (0.290089, 0.79440, 1.2067, 2.6783, 1.14),
    1.0: (0.0, 0.0, 1.4716, 2.9433, 1.0),
}
"""e: x, Lambda, eta2, T/Ts, ratio of unloading to Hertz tangent; computed from Zhou 2011, Eqs. 7, 8,
13-15."""
RESTITUTIONS = (0.05, 0.2, 0.5, 0.7, 0.9, 0.99, 1.0)

STAINLESS = Material(young_modulus=193e9, poisson_ratio=0.35, density=8030.0, yield_strength=0.310e9)
CHROME = Material(young_modulus=203e9, poisson_ratio=0.28, density=7830.0, yield_strength=2.03e9)
"""Stainless steel 316 and chrome steel 52100 of Figs. 3-4 of the paper."""


@pytest.mark.parametrize("e", FIGURES)
def test_closed_forms_equal_the_tabulated_values(e):
    found = (
        1.0 - theory.recovery(e),
        theory.unloading_slope(e),
        theory.unloading_duration(e),
        theory.LOADING_DURATION + theory.unloading_duration(e),
        theory.unloading_tangent(e) / 1.5,
    )
    digits = (5e-7, 5e-5 if e == 0.2 else 5e-6, 5e-5, 5e-5, 5e-2 if e == 0.2 else 5e-3)
    for value, given, half in zip(found, FIGURES[e], digits, strict=True):
        assert value == pytest.approx(given, abs=1.001 * half)


def test_recovery_is_the_root_of_equation_8():
    for e in np.linspace(0.01, 1.0, 34):
        root = brentq(
            lambda y, e: y - 0.8 * e**2 - 0.2 * e**3 * y**2.5, 0.0, 1.0 + 1e-9, (e,), xtol=1e-15, rtol=1e-14
        )
        assert theory.recovery(e) == pytest.approx(root, rel=1e-13, abs=3e-15)


@pytest.mark.parametrize(
    ("function", "e", "message"),
    [
        (theory.recovery, -0.01, r"must be in \[0, 1\]"),
        (theory.recovery, 1.01, r"must be in \[0, 1\]"),
        (theory.damping_ratio_for, 0.0, "any restitution in"),
        (theory.damping_ratio_for, 1.1, "any restitution in"),
        *((dissipation_for, e, "restitution") for e in (0.0, -0.5, 1.2, 1e-4)),
    ],
)
def test_unreachable_restitutions_are_rejected(function, e, message):
    with pytest.raises(ValueError, match=message):
        function(e)


def test_closed_form_of_the_residual_has_the_published_accuracy():
    """Within 1 % up to e = 0.99; at e = 1 both approach 0 as 1 - e, with slopes that differ by 1.15 %.

    Slopes dx/d(1 - e) at e = 1: of Eq. 8, y' (1 - 1/2) = 8/5 + 3/5, so 22/5; of Eq. 9, 8/5 + (8 + (1-c)/c)/5
    + 1.
    """
    c = 0.8**2.5
    limit = 1.0 - (1.6 + 0.2 * (8.0 + (1.0 - c) / c) + 1.0) / 4.4
    e = np.linspace(1e-3, 1.0 - 1e-7, 200001)
    exact = 1.0 - theory.recovery(e)
    approximation = theory.residual_closed_form(e)
    error = np.abs(approximation / exact - 1.0)
    assert error[e <= 0.99].max() < 0.01
    assert error[-1] == error.max() == pytest.approx(limit, rel=1e-4)
    assert np.max(np.abs((approximation - exact) / (1.0 - exact))) == pytest.approx(0.0046, abs=5e-5)
    np.testing.assert_allclose(theory.residual_closed_form(np.array([0.0, 1.0])), [1.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("e", RESTITUTIONS)
def test_duration_and_rebound_agree_with_the_equation_of_motion(e):
    """Of the force of Eqs. 4 and 8, whose ratio of unloading to loading work is e^2."""
    k, mass, velocity = 5.3e6, 0.012, 1.7
    overlap_max = float(theory.overlap_max(k, mass, velocity))
    scale = float(theory.time_scale(k, mass, velocity))
    lam = k * np.sqrt(overlap_max) * float(theory.unloading_slope(e))
    residual = overlap_max * (1.0 - float(theory.recovery(e)))

    def loading(t, s):
        return [s[1], -k * max(s[0], 0.0) ** 1.5 / mass]

    def unloading(t, s):
        above = max(s[0] - residual, 0.0)
        return [s[1], -(lam * above + e**3 * k * above**1.5) / mass]

    exact = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-16}
    down = solve_ivp(loading, (0.0, 5 * scale), [0.0, velocity], events=terminal(lambda t, s: s[1]), **exact)
    at_rest = down.y_events[0][0]
    turn = down.t_events[0][0]
    up = solve_ivp(
        unloading,
        (0.0, 5 * scale),
        [at_rest[0], 0.0],
        events=terminal(lambda t, s: s[0] - residual - 1e-13),
        **exact,
    )
    assert at_rest[0] == pytest.approx(overlap_max, rel=1e-9)
    assert -up.y_events[0][0][1] / velocity == pytest.approx(e, rel=1e-6)
    assert turn + up.t_events[0][0] == pytest.approx(theory.duration(e, k, mass, velocity), rel=1e-6)


def terminal(event):
    """The event ends the integration when it crosses zero from above."""
    event.terminal = True
    event.direction = -1.0
    return event


def test_equivalent_spring_stores_the_energy_of_the_hertz_contact():
    k = 2.2e7
    mass = 0.03
    velocity = 0.8
    overlap_max = theory.overlap_max(k, mass, velocity)
    spring = theory.equivalent_spring(k, mass, velocity)
    assert 0.5 * spring * overlap_max**2 == pytest.approx(0.5 * mass * velocity**2, rel=1e-12)
    assert spring == pytest.approx(0.8 * (1.25 * k**4 * mass * velocity**2) ** 0.2, rel=1e-12), "Eq. 19"


@pytest.mark.parametrize("e", [0.05, 0.135, 0.3, 0.6, 0.9, 0.99])
@pytest.mark.parametrize("power", [1.0, 1.5], ids=["linear", "hertz"])
def test_damping_ratio_gives_the_restitution_in_the_equation_of_motion(e, power):
    """x'' + 2 zeta x' + x = 0, and x'' + sqrt(5) zeta x^(1/4) x' + x^1.5 = 0, until the force is zero."""
    zeta = theory.damping_ratio_for(e)

    def force(s):
        overlap = max(s[0], 0.0)
        viscous = 2.0 * zeta * s[1] if power == 1.0 else np.sqrt(5.0) * zeta * overlap**0.25 * s[1]
        return overlap**power + viscous

    release = terminal(lambda t, s: force(s) + (t < 0.1))
    done = solve_ivp(
        lambda t, s: [s[1], -force(s)], (0.0, 300.0), [1e-14, 1.0],
        events=release, method="DOP853", rtol=1e-11, atol=1e-15, max_step=0.05,
    )  # fmt: skip
    assert -done.y_events[0][0][1] == pytest.approx(e, rel=2e-6)


@pytest.mark.parametrize("e", [1e-12, 1e-30, 1e-300])
def test_damping_ratio_of_a_tiny_restitution_follows_the_overdamped_limit(e):
    """x(t) decays with the rates 2 zeta and 1 / (2 zeta): the force is zero when x' = -v / (4 zeta^2)."""
    assert theory.damping_ratio_for(e) == pytest.approx(0.5 / np.sqrt(e), rel=1e-4)


def test_yield_velocities_of_two_steels_equal_the_published_values():
    """Eq. 11 with the yield strengths of the two steels; the paper gives their ratio as 6.5."""
    assert limit_velocity(STAINLESS, STAINLESS) == pytest.approx(np.sqrt(3 * 0.310e9 / 8030.0), rel=1e-14)
    assert limit_velocity(STAINLESS, CHROME) == limit_velocity(CHROME, STAINLESS)
    assert limit_velocity(STAINLESS, CHROME) == limit_velocity(STAINLESS, STAINLESS), (
        "the lower yield strength determines the velocity"
    )
    stiff, hard = (modulus_eff(steel, steel) / steel.yield_strength for steel in (STAINLESS, CHROME))
    assert stiff / hard == pytest.approx(6.5, abs=0.05), "value of the paper"


def test_restitution_decreases_with_velocity_to_zero_at_the_limit():
    law = VelocityRestitution(3.0432, 0.540, 340.0)
    velocity = np.array([0.0, 1e-6, 0.01, 1.0, 100.0, 339.0, 340.0, 1e4])
    e = law(velocity)
    assert e[0] == 1.0
    assert np.all(np.diff(e) <= 0.0)
    assert np.all(e[-2:] == 0.0)
    assert e[3] == pytest.approx(np.exp(-3.0432 * (1.0 / 339.0) ** 0.540), rel=1e-14)


def test_effective_moduli_are_symmetric_and_half_for_equal_materials():
    assert modulus_eff(STAINLESS, CHROME) == modulus_eff(CHROME, STAINLESS)
    assert shear_modulus_eff(STAINLESS, CHROME) == shear_modulus_eff(CHROME, STAINLESS)
    assert modulus_eff(CHROME, CHROME) == pytest.approx(0.5 * 203e9 / (1.0 - 0.28**2), rel=1e-14)
    shear = 203e9 / (2.0 * 1.28)
    assert shear_modulus_eff(CHROME, CHROME) == pytest.approx(shear / (2.0 * (2.0 - 0.28)), rel=1e-14)
