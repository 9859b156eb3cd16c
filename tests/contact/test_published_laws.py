"""Closed forms of the normal models against the numbers of their papers and against the equation of motion."""

import numpy as np
import pytest
from contact.cases import CASES, MASS, RADIUS, SHEAR_MODULUS
from scene_builders import SOFT, few_spheres, particle_group
from scipy.integrate import solve_ivp

from granflow.contact import theory
from granflow.contact.law import ModelRequest
from granflow.contact.material import (
    PairMaterial,
    VelocityRestitution,
    limit_velocity,
    modulus_eff,
    shear_modulus_eff,
)
from granflow.contact.normal.kuwabara_kono import dissipation_for, rebound_of
from granflow.contact.registry import models
from granflow.plan.build import plan_for
from granflow.scene.blocks.materials import Material

STAINLESS = Material(young_modulus=193e9, poisson_ratio=0.35, density=8030.0, yield_strength=0.310e9)
CHROME = Material(young_modulus=203e9, poisson_ratio=0.28, density=7830.0, yield_strength=2.03e9)
"""Stainless steel 316 and chrome steel 52100 of Figs. 3-4 of Zhou (2011)."""
BY_NAME = {case.name: case for case in CASES}


def law_of(name, pair, **settings):
    """The normal model of that name for one pair."""
    model = models("normal")[name]
    return model.law.from_scene(ModelRequest(model.options(**settings), (pair,), 1.0, 0.5))


def motion(force, mass, start, until, duration, max_step=np.inf):
    """Time and state [overlap, rate] at which `until(t, state)` becomes negative, for a force of the state."""
    until.terminal = True
    until.direction = -1.0
    done = solve_ivp(
        lambda t, s: [s[1], -force(s) / mass], (0.0, duration), start,
        events=until, method="DOP853", rtol=1e-11, atol=1e-16, max_step=max_step,
    )  # fmt: skip
    return done.t_events[0][0], done.y_events[0][0]


def rebound(loading, unloading, residual_of, mass, velocity, duration):
    """Largest overlap, durations of loading and unloading, and velocity at the end."""
    turn, (overlap_max, _) = motion(
        lambda s: loading(max(s[0], 0.0)), mass, [0.0, velocity], lambda t, s: s[1], duration, duration / 500
    )
    residual = residual_of(overlap_max)
    end, (_, rate) = motion(
        lambda s: unloading(max(s[0] - residual, 0.0), overlap_max), mass, [overlap_max, 0.0],
        lambda t, s: s[0] - residual - 1e-13, duration, duration / 500,
    )  # fmt: skip
    return overlap_max, (turn, end), -rate


FIGURES = {
    0.2: (0.968000, 31.2483, 0.2513, 1.7230, 20.8),
    0.5: (0.799550, 4.93282, 0.6293, 2.1010, 3.34),
    0.7: (0.601106, 2.29030, 0.8906, 2.3623, 1.74),
    0.9: (0.290089, 0.79440, 1.2067, 2.6783, 1.14),
    1.0: (0.0, 0.0, 1.4716, 2.9433, 1.0),
}
"""e: x, Lambda, eta2, T/Ts, ratio of unloading to Hertz tangent; computed from Zhou 2011, Eqs. 7, 8,
13-15."""


@pytest.mark.parametrize("e", FIGURES)
def test_closed_forms_of_zhou_equal_the_tabulated_values(e):
    """The closed form of the residual overlap, Eq. 9, has an error below 1 %."""
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
    assert theory.residual_closed_form(e) == pytest.approx(FIGURES[e][0], rel=0.01, abs=1e-12)


@pytest.mark.parametrize(
    ("function", "e"),
    [(theory.recovery, 1.01), (theory.recovery, -0.01), (theory.damping_ratio_for, 0.0),
     (theory.damping_ratio_for, 1.1), *((dissipation_for, e) for e in (0.0, 1.2, 1e-4))],
)  # fmt: skip
def test_unreachable_restitutions_are_rejected(function, e):
    with pytest.raises(ValueError, match="restitution"):
        function(e)


@pytest.mark.parametrize("e", [0.05, 0.5, 0.9, 1.0])
def test_zhou_agrees_with_the_equation_of_motion(e):
    """Of the force of Eqs. 4 and 8, whose ratio of unloading to loading work is e^2. A spring with the energy of
    the Hertz contact is Eq. 19."""
    k, mass, velocity = 5.3e6, 0.012, 1.7
    overlap_max = float(theory.overlap_max(k, mass, velocity))
    lam = k * np.sqrt(overlap_max) * float(theory.unloading_slope(e))
    found, durations, end = rebound(
        lambda d: k * d**1.5, lambda s, _: lam * s + e**3 * k * s**1.5,
        lambda d: d * (1.0 - float(theory.recovery(e))), mass, velocity, 5 * float(theory.time_scale(k, mass, velocity)),
    )  # fmt: skip
    assert found == pytest.approx(overlap_max, rel=1e-9)
    assert end / velocity == pytest.approx(e, rel=1e-6)
    assert sum(durations) == pytest.approx(theory.duration(e, k, mass, velocity), rel=1e-6)
    spring = theory.equivalent_spring(k, mass, velocity)
    assert 0.5 * spring * overlap_max**2 == pytest.approx(0.5 * mass * velocity**2, rel=1e-12)
    assert spring == pytest.approx(0.8 * (1.25 * k**4 * mass * velocity**2) ** 0.2, rel=1e-12)


@pytest.mark.parametrize(("e", "power"), [(0.05, 1.5), (0.135, 1.0), (0.6, 1.5), (0.99, 1.0)])
def test_damping_ratio_gives_the_restitution_in_the_equation_of_motion(e, power):
    """x'' + 2 zeta x' + x = 0, and x'' + sqrt(5) zeta x^(1/4) x' + x^1.5 = 0, until the force is zero."""
    zeta = theory.damping_ratio_for(e)

    def force(s):
        overlap = max(s[0], 0.0)
        viscous = 2.0 * zeta * s[1] if power == 1.0 else np.sqrt(5.0) * zeta * overlap**0.25 * s[1]
        return overlap**power + viscous

    _, (_, rate) = motion(force, 1.0, [1e-14, 1.0], lambda t, s: force(s) + (t < 0.1), 300.0, 0.05)
    assert -rate == pytest.approx(e, rel=2e-6)


@pytest.mark.parametrize("e", [1e-12, 1e-300])
def test_damping_ratio_of_a_tiny_restitution_follows_the_overdamped_limit(e):
    """x(t) decays with the rates 2 zeta and 1 / (2 zeta): the force is zero when x' = -v / (4 zeta^2)."""
    assert theory.damping_ratio_for(e) == pytest.approx(0.5 / np.sqrt(e), rel=1e-4)


def test_constants_of_two_materials():
    """Eq. 11 with the lower yield strength; Zhou gives 6.5 as the ratio of E/p of two steels.

    For equal materials Kt / (2 a E*) = 2 (1 - nu) / (2 - nu), times the factor of the tangential stiffness.
    """
    assert limit_velocity(STAINLESS, STAINLESS) == pytest.approx(np.sqrt(3 * 0.310e9 / 8030.0), rel=1e-14)
    assert limit_velocity(STAINLESS, CHROME) == limit_velocity(CHROME, STAINLESS)
    assert limit_velocity(STAINLESS, CHROME) == limit_velocity(STAINLESS, STAINLESS)
    stiff, hard = (modulus_eff(steel, steel) / steel.yield_strength for steel in (STAINLESS, CHROME))
    assert stiff / hard == pytest.approx(6.5, abs=0.05)
    for function in (modulus_eff, shear_modulus_eff):
        assert function(STAINLESS, CHROME) == function(CHROME, STAINLESS)
    assert modulus_eff(CHROME, CHROME) == pytest.approx(0.5 * 203e9 / (1.0 - 0.28**2), rel=1e-14)
    shear = 203e9 / (2.0 * 1.28)
    assert shear_modulus_eff(CHROME, CHROME) == pytest.approx(shear / (2.0 * (2.0 - 0.28)), rel=1e-14)
    tangential = {"law": "mindlin", "stiffness_factor": 1.5}
    scene = few_spheres(
        {"balls": particle_group([0.0, 0.0, 0.0])}, pair={"friction": 0.3},
        contact={"normal": "hertz", "tangential": tangential, "rolling": "none"},
    )  # fmt: skip
    pair = next(case.pair for case in plan_for(scene).pair_cases if case.name == "balls-balls")
    ratio = 2.0 * (1.0 - SOFT["poisson_ratio"]) / (2.0 - SOFT["poisson_ratio"])
    assert 8.0 * pair.shear_modulus_eff / (2.0 * pair.modulus_eff) == pytest.approx(1.5 * ratio, rel=1e-14)


def test_restitution_decreases_with_velocity_to_zero_at_the_limit():
    e = VelocityRestitution(3.0432, 0.540, 340.0)(np.array([0.0, 1e-6, 0.01, 1.0, 339.0, 340.0, 1e4]))
    assert e[0] == 1.0 and np.all(np.diff(e) <= 0.0) and np.all(e[-2:] == 0.0)
    assert e[3] == pytest.approx(np.exp(-3.0432 * (1.0 / 339.0) ** 0.540), rel=1e-14)


def test_thornton_yields_at_the_published_velocity_and_restitution_decreases_with_its_fourth_root():
    """v_y = 1.56 sqrt(p^5 / (E^4 rho)) for a sphere on a wall (Thornton 1997, Eq. 21), and
    e = 1.185 (v_y / v)^(1/4) for v >> v_y."""
    pair = PairMaterial(modulus_eff(STAINLESS, STAINLESS), 1.0, None, yield_strength=STAINLESS.yield_strength)
    mass = 4.0 / 3.0 * np.pi * RADIUS**3 * STAINLESS.density
    law = law_of("thornton", pair, yield_ratio=1.6)
    pressure = 1.6 * STAINLESS.yield_strength
    expected = 1.56 * np.sqrt(pressure**5 / (pair.modulus_eff**4 * STAINLESS.density))
    assert law.restitution(pair, RADIUS, mass, 0.999 * expected) == 1.0
    assert law.restitution(pair, RADIUS, mass, 1.001 * expected) < 1.0
    assert law.restitution(pair, RADIUS, mass, 1e4 * expected) == pytest.approx(0.1185, rel=1e-3)


@pytest.mark.parametrize("velocity", [0.02, 4.0])
def test_thornton_agrees_with_the_equation_of_motion(velocity):
    """The published force of loading and unloading, with the radius R k d^1.5 / F of the flattened contact."""
    law, pair = BY_NAME["thornton"].law(), BY_NAME["thornton"].pair()
    pressure, modulus = pair.yield_strength, pair.modulus_eff
    k = 4.0 / 3.0 * modulus * np.sqrt(RADIUS)
    yielding = RADIUS * (0.5 * np.pi * pressure / modulus) ** 2

    def loading(d):
        return k * d**1.5 if d <= yielding else k * yielding**1.5 + np.pi * pressure * RADIUS * (d - yielding)

    def curvature(overlap_max):
        return RADIUS * k * overlap_max**1.5 / loading(overlap_max)

    def residual(overlap_max):
        return overlap_max - RADIUS * overlap_max / curvature(overlap_max)

    def unloading(s, overlap_max):
        return 4.0 / 3.0 * modulus * np.sqrt(curvature(overlap_max)) * s**1.5

    _, durations, end = rebound(loading, unloading, residual, MASS, velocity, 0.01)
    assert end / velocity == pytest.approx(law.restitution(pair, RADIUS, MASS, velocity), rel=1e-5)
    assert law.phase_durations(pair, RADIUS, MASS, velocity) == pytest.approx(durations, rel=1e-5)


def test_walton_braun_restitution_follows_the_published_slope():
    """e = sqrt(w0 / (S v + w0)), w0 = sqrt(2 k1 / m), for two spheres of mass m and k2 = k1 + S F_max
    (1986)."""
    k1, e, reference = 2e4, 0.6, 0.7
    pair = PairMaterial(4e7, SHEAR_MODULUS, e)
    law = law_of("walton_braun", pair, stiffness={"value": k1}, unloading={"reference_velocity": reference})
    omega = np.sqrt(2.0 * k1 / (2.0 * MASS))
    slope = omega * (1.0 / e**2 - 1.0) / reference
    for velocity in (0.1, 0.7, 5.0):
        expected = np.sqrt(omega / (slope * velocity + omega))
        assert law.restitution(pair, RADIUS, MASS, velocity) == pytest.approx(expected, rel=1e-12)


def test_luding_restitution_is_minimal_at_the_maximum_plastic_overlap():
    """At this overlap k2 = kp = k1 / e^2; at smaller and larger overlaps the restitution is higher.

    There the springs return 0.36 of the energy, and separation with kc = 5 k1 requires 0.73 of it.
    """
    pair = PairMaterial(4e7, SHEAR_MODULUS, 0.6)
    law, tensile = (
        law_of("luding", pair, stiffness={"value": 2e4}, plasticity_depth=0.01, tension=tension)
        for tension in (0.0, 5.0)
    )
    velocity = 2.0 * 0.01 * RADIUS / (1.0 - 0.6**2) * np.sqrt(2e4 / MASS)
    assert law.restitution(pair, RADIUS, MASS, velocity) == pytest.approx(0.6, rel=1e-9)
    for factor in (0.5, 0.9, 1.1, 2.0):
        assert law.restitution(pair, RADIUS, MASS, factor * velocity) > 0.6
    assert tensile.restitution(pair, RADIUS, MASS, velocity) == 0.0
    assert all(np.isfinite(tensile.phase_durations(pair, RADIUS, MASS, velocity)))
    assert tensile.restitution(pair, RADIUS, MASS, 0.1 * velocity) > 0.0
    at_high_speed = [each.restitution(pair, RADIUS, MASS, 5.0) for each in (tensile, law)]
    assert 0.0 < at_high_speed[0] < at_high_speed[1]


@pytest.mark.parametrize("velocity", [0.05, 3.0])
def test_kuwabara_kono_agrees_with_the_equation_of_motion(velocity):
    """F = k d^1.5 + (3/2) A k d^0.5 d', with A from the dissipation at the reference velocity of 0.7 m/s."""
    law, pair = BY_NAME["kuwabara_kono"].law(), BY_NAME["kuwabara_kono"].pair()
    k = 4.0 / 3.0 * pair.modulus_eff * np.sqrt(RADIUS)
    constant = dissipation_for(0.6) / (1.5 * (k / MASS) ** 0.4 * 0.7**0.2)

    def force(s):
        d = max(s[0], 0.0)
        return k * d**1.5 + 1.5 * constant * k * np.sqrt(d) * s[1]

    scale = (MASS**2 / (k**2 * velocity)) ** 0.2
    duration, (_, rate) = motion(
        force, MASS, [0.0, velocity], lambda t, s: force(s) + (t < scale), 10.0 * scale, 0.01 * scale
    )
    assert -rate / velocity == pytest.approx(law.restitution(pair, RADIUS, MASS, velocity), rel=1e-5)
    assert duration == pytest.approx(sum(law.phase_durations(pair, RADIUS, MASS, velocity)), rel=1e-5)
    assert law.restitution(pair, RADIUS, MASS, 0.7) == pytest.approx(0.6, abs=1e-9)


def test_kuwabara_kono_expansion_has_the_published_coefficients():
    """e = 1 - 1.15344 g + 0.79826 g^2 (Ramirez et al. 1999), g = (3/2) A (k/M)^(2/5) v^(1/5).

    Separation at zero force adds a term in g^(5/2) (Schwager & Poeschel 2008), here with a factor below 1/2.
    """
    for g in (1e-3, 1e-2):
        assert 1.0 - rebound_of(g)[0] == pytest.approx(1.15344 * g - 0.79826 * g**2, abs=0.5 * g**2.5)
