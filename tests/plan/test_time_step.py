"""The time step compared with theory computed here, and its rejections and warnings."""

import math

import numpy as np
import pytest
from plan.scenes import TEXT, line_of, scene_of

from granflow.contact.material import PairMaterial
from granflow.contact.normal.linear import Linear, Spring
from granflow.contact.theory import damping_ratio_for
from granflow.errors import SceneError
from granflow.plan.build import plan_for
from granflow.plan.pair_case import PairCase
from granflow.scene.blocks.materials import Material

RADIUS, DENSITY, YOUNG, POISSON, VELOCITY = 2e-3, 2500.0, 10e6, 0.23, 1.0
MASS = 4 / 3 * math.pi * RADIUS**3 * DENSITY
UNLOADING = 0.8906
"""eta2 at e = 0.7, from the table of the model (Zhou 2011, Eq. 15); loading takes longer."""
CONTACTS = ((RADIUS / 2, MASS / 2), (RADIUS, MASS))
"""Effective radius and mass of the contacts between beads, and with the wall."""


def hertz(radius_eff):
    return 4 / 3 * YOUNG / (2 * (1 - POISSON**2)) * math.sqrt(radius_eff)


def largest_overlap(radius_eff, mass_eff):
    return (5 * mass_eff * VELOCITY**2 / (4 * hertz(radius_eff))) ** 0.4


def tangent_stiffness(radius_eff, mass_eff):
    return 1.5 * hertz(radius_eff) * math.sqrt(largest_overlap(radius_eff, mass_eff))


def step_of(folder, *overrides, text=TEXT):
    return plan_for(scene_of(folder, *overrides, text=text)).step


FRICTION = [f"pairs.glass-{name}.friction=0.3" for name in ("glass", "steel")]
TANGENTIAL = "contact.tangential={law: linear_history, stiffness: %s N/m}"


def test_step_and_its_limits_equal_theory(tmp_path):
    """The step is a fraction of the shortest loading or unloading time.

    Stable: without friction the fastest mode of a face-centered cubic crystal has w^2 = 8 K/m = 4 K/M (X point), and
    dt < 0.99 * 2 / w. The restitution that unloading reaches follows from the bound of its stiffness.
    """
    step = step_of(tmp_path, "numerics.time_step_fraction=0.02")
    shortest = min(UNLOADING * largest_overlap(*contact) / VELOCITY for contact in CONTACTS)
    assert step.value == pytest.approx(0.02 * shortest, rel=1e-4)
    stable = min(0.99 * 2.0 / math.sqrt(4.0 * tangent_stiffness(*each) / each[1]) for each in CONTACTS)
    assert step.stable_below == pytest.approx(stable) and step.stable_limit == "beads-beads"

    def least(radius_eff, mass_eff):
        tangent = tangent_stiffness(radius_eff, mass_eff) / 1.5 / 0.8
        return math.sqrt(tangent * step.value**2 / (0.5**2 * mass_eff))

    assert step.least_restitution == pytest.approx(max(least(*contact) for contact in CONTACTS))
    assert step.warnings == ()


@pytest.mark.parametrize("poisson", [0.0, 0.5])
def test_friction_reduces_the_stable_step_by_the_rotational_modes(tmp_path, poisson):
    """In the mode of a face-centered cubic crystal in which all particles rotate and slip w^2 = 20 Kt / M, with
    Mindlin's Kt / K = 2 (1 - nu) / (2 - nu)."""
    step = step_of(tmp_path, f"materials.glass.poisson_ratio={poisson}", *FRICTION)
    k = 4 / 3 * YOUNG / (2 * (1 - poisson**2)) * math.sqrt(RADIUS / 2)
    tangent = 1.5 * k * math.sqrt((5 * MASS / 2 * VELOCITY**2 / (4 * k)) ** 0.4)
    modes = 20.0 * 2.0 * (1.0 - poisson) / (2.0 - poisson)
    assert step.stable_below == pytest.approx(0.99 * 2.0 / math.sqrt(modes * tangent / (MASS / 2)))


def test_stiffness_of_a_linear_tangential_spring_bounds_the_step(tmp_path):
    """w^2 = 20 kt / M as above, for a spring that is stiffer than the normal contact."""
    step = step_of(tmp_path, TANGENTIAL % "1e6", *FRICTION)
    assert step.stable_below == pytest.approx(0.99 * 2.0 / math.sqrt(20.0 * 1e6 / (MASS / 2)), rel=1e-3)
    soft = step_of(tmp_path, TANGENTIAL % "1", *FRICTION)
    assert soft.stable_below == pytest.approx(step_of(tmp_path).stable_below, rel=1e-2)


def case_of(contacts, restitution=1.0, **more):
    """A contact of two equal spheres with this number of contacts each."""
    solid = Material(young_modulus=1e9, poisson_ratio=0.25, density=2500.0)
    pair = PairMaterial(1e9, 1e9, restitution, **more)
    return PairCase("pair", ("a", "a"), pair, 1e-3, MASS, 1e-3, 1e-3, solid, contacts)


@pytest.mark.parametrize(("contacts", "modes", "restitution"), [
    (1, 1.0, 0.9), (2, 2.0, 0.3), (12, 4.0, 0.9), (500, 4.0, 0.01)
])  # fmt: skip
def test_stable_step_of_a_damped_spring_is_the_leapfrog_stability_limit(contacts, modes, restitution):
    """Eigenvalues of one step: the velocity lags by half a step; the viscous force uses it and the last
    kick."""
    stiffness = 1e4
    law = Linear(Spring(stiffness, None, 0.0))
    allowed = case_of(contacts, restitution).stable_step(law, VELOCITY) / 0.99

    def growth(step):
        spring = modes * stiffness * step**2 / MASS
        viscous = modes * 2.0 * damping_ratio_for(restitution) * math.sqrt(stiffness / MASS) * step
        # Factors of position, velocity and last kick, in units of steps.
        kick = np.array([-spring, -viscous, -0.5 * viscous])
        velocity = np.array([0.0, 1.0, 0.0]) + kick
        return np.abs(np.linalg.eigvals([np.array([1.0, 0.0, 0.0]) + velocity, velocity, kick])).max()

    assert growth(0.999 * allowed) <= 1.0 + 1e-9
    assert growth(1.001 * allowed) > 1.0 + 1e-6


def test_stable_step_of_a_sliding_pair_contains_its_rotation():
    """A tangential spring Kt much stiffer than the normal one between two equal spheres of mass m = 2 M.

    A force F moves both surfaces against each other by 2 (F/m + R^2 F/I) = (1 + 5/2) F/M.
    """
    case = case_of(1, has_tangential_force=True, tangential_stiffness=1e6)
    expected = 0.99 * 2.0 / math.sqrt(3.5 * 1e6 / MASS)
    assert case.stable_step(Linear(Spring(1e4, None, 0.0)), VELOCITY) == pytest.approx(expected)


def test_rayleigh_fraction_limits_the_step(tmp_path):
    step = step_of(tmp_path, "numerics.rayleigh_fraction=0.001")
    shear = YOUNG / (2 * (1 + POISSON))
    rayleigh = math.pi * RADIUS * math.sqrt(DENSITY / shear) / (0.1631 * POISSON + 0.8766)
    assert step.value == pytest.approx(0.001 * rayleigh)


def test_given_step_above_the_stable_step_is_rejected_with_its_line_and_a_valid_step(tmp_path):
    allowed = step_of(tmp_path)
    with pytest.raises(SceneError) as rejection:
        step_of(tmp_path, text=TEXT.replace("duration: 50 ms", "duration: 50 ms\n  time_step: 1e-3"))
    (problem,) = rejection.value.problems
    assert problem.endswith(
        f"beads.yaml:{line_of('duration') + 1}:14: run.time_step is 0.001 s, above the stability limit "
        f"{allowed.stable_below:.3g} s (beads-beads at 1 m/s). Lower it to {allowed.value:.2g} s or remove it."
    )


def test_stable_step_that_does_not_reach_the_restitution_causes_a_warning(tmp_path):
    step = step_of(tmp_path, "run.time_step=4.5e-5")
    assert (step.value, step.limited_by) == (4.5e-5, "given in the scene")
    assert step.warnings[0].startswith(
        "glass-glass: the restitution at 1 m/s is 0.7, but a time step of 4.5e-05"
    )
    remedy = float(step.warnings[0].split("Use run.time_step: ")[1].split()[0])
    assert not step_of(tmp_path, f"run.time_step={0.98 * remedy}").warnings


INSERTION = TEXT.split("insert: ")[1].split("\n")[0]
ROUGH = f"particles.rough={{material: steel, count: 5, diameter: 4 mm, fixed: true, insert: {INSERTION}}}"
LONE = "particles.beads.count=1"


@pytest.mark.parametrize(("overrides", "pairs"), [
    ((), ["glass-glass"]),
    (("walls.floor.material=steel",), ["glass-glass", "glass-steel"]),
    ((LONE,), ["glass-glass"]),  # with the floor
    ((LONE, "walls.floor.material=steel"), ["glass-steel"]),
    ((LONE, "walls={}"), []),
    ((ROUGH, "pairs.steel-steel={restitution: 0.001, friction: 0, rolling_friction: 0}"),
     ["glass-glass", "glass-steel"]),
    ((ROUGH, "particles.beads.fixed=true"), []),
])  # fmt: skip
def test_small_restitution_causes_one_warning_per_material_pair_that_can_touch(tmp_path, overrides, pairs):
    unresolved = [f"pairs.glass-{name}.restitution=0.001" for name in ("glass", "steel")]
    found = step_of(tmp_path, *unresolved, *overrides).warnings
    assert [warning.split(":")[0] for warning in found] == pairs


def test_only_a_constant_restitution_of_0_requires_neither_a_warning_nor_a_shorter_step(tmp_path):
    """The contact stops in one step, and unloading, which takes longer than loading at restitution 1, is not
    resolved. With a restitution that is 0 from a velocity on it rebounds, as the step permits."""
    fit = "{sigma: 1.2, psi: 0.54, limit_velocity: 0.5 m/s}"
    zero, one, fitted = (
        step_of(tmp_path, *(f"pairs.glass-{name}.restitution={e}" for name in ("glass", "steel")))
        for e in (0, 1, fit)
    )
    assert not zero.warnings and zero.least_restitution == 0.0
    assert zero.value == pytest.approx(one.value, rel=1e-6)
    (warning,) = fitted.warnings
    assert f": the smallest is {fitted.least_restitution:.3g} at a time step of " in warning


AUTO = "run.velocity_max=null"
NO_GRAVITY = "gravity=[0, 0, 0]"
TABLE_OF_GRAVITY = (
    "gravity={times: [0, 1], vectors: [[0, 0, 1], [0, 0, 5]],"
    " motion: {kind: vibration, amplitude: [0, 0, -2], frequency: 5 Hz}}"
)
RISING = "walls.floor.motion={kind: translation, velocity: [0, 0, 2]}"
FAR_AXIS = "walls.floor.motion={kind: rotation, axis: [0, 0, 1], point: [-3, 0, 0], angular_velocity: 8}"


@pytest.mark.parametrize(("overrides", "value", "source"), [
    ((), 1.0, "run.velocity_max, "),
    ((AUTO,), math.sqrt(2 * 9.81 * 0.04), "estimated from a free fall through the domain"),
    ((AUTO, "particles.beads.velocity=[3, 4, 0]"), 10.0, "estimated from the speed of the fastest particle"),
    ((AUTO, NO_GRAVITY), 1.0, "assumed"),
    ((AUTO, NO_GRAVITY, RISING), 2.0, "estimated from the speed of the fastest wall, 2 m/s"),
    ((AUTO, NO_GRAVITY, FAR_AXIS), 8.0 * math.hypot(3.03, 0.03), "estimated from the speed of the fastest wall"),
    ((AUTO, NO_GRAVITY, "stages=[{name: a, duration: 1, gravity: [3, 4, 0]}]", "run.duration=null"),
     math.sqrt(2 * (3 + 4) * 0.04), "estimated from a free fall through the domain"),
    ((AUTO, TABLE_OF_GRAVITY),
     math.sqrt(2 * (5 + 2) * 0.04), "estimated from a free fall through the domain"),
    ((AUTO, "gravity={vector: [0, 0, -5], motion: {kind: rotation, axis: [1, 1, 0], angular_velocity: 1}}"),
     math.sqrt(2 * 5 * math.sqrt(3) * 0.04), "estimated from a free fall through the domain"),
])  # fmt: skip
def test_max_impact_velocity_has_a_value_and_a_source(tmp_path, overrides, value, source):
    """Free fall along the edges, v^2 = 2 (|gx| Lx + |gy| Ly + |gz| Lz), with the largest gravity of the run; along
    the diagonal if gravity turns. The corner of the domain that is farthest from the axis is as fast as a plane can
    be."""
    impact_velocity = plan_for(scene_of(tmp_path, *overrides)).impact_velocity
    assert impact_velocity.value == pytest.approx(value)
    assert impact_velocity.source.startswith(source)


def test_tangential_dashpot_requires_that_of_the_normal_model(tmp_path):
    given = ["contact.tangential={law: mindlin, damping: 0.5}", *FRICTION]
    with pytest.raises(SceneError, match=r"damping is 0.5, .* zhou has no such dashpot; write 0, or choose"):
        plan_for(scene_of(tmp_path, *given))
    assert plan_for(scene_of(tmp_path, "contact.normal=hertz", *given)).laws.damped_slots == ("tangential",)


VIBRATION = "walls.floor.motion={kind: vibration, direction: [0, 0, 1], amplitude: 1 nm, frequency: %g Hz}"
ROTATION = "walls.floor.motion={kind: rotation, point: [0, 0, 0], axis: [0, 0, 1], angular_velocity: %g rpm}"
ROCKING = (
    "gravity={vector: [0, 0, -9.81], "
    "motion: {kind: oscillation, axis: [1, 0, 0], amplitude: 1 deg, frequency: %g}}"
)


@pytest.mark.parametrize(("motion", "factor", "key"), [
    (VIBRATION, 1.0, "walls.floor.motion.0"), (ROTATION, -60.0, "walls.floor.motion.0"),
    (ROCKING, 1.0, "gravity.motion.0")
])  # fmt: skip
def test_a_period_of_a_motion_has_at_least_ten_steps(tmp_path, motion, factor, key):
    """A step of 1e-5 s, so a period of 1e-4 s: 10 kHz, or -600 000 rpm."""
    assert step_of(tmp_path, "run.time_step=1e-5", motion % (factor * 9_999)).value == 1e-5
    with pytest.raises(SceneError, match=f"{key} has a period of 0.0001 s, .* to 1e-05 s or less"):
        step_of(tmp_path, "run.time_step=1e-5", motion % (factor * 10_001))
