"""The time step compared with theory computed here, and its rejections and warnings."""

import itertools
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
MODULUS = YOUNG / (2 * (1 - POISSON**2))
LOADING, UNLOADING = 1.471637592, 0.8906
"""eta1, and eta2 at e = 0.7, from the table of the model (Zhou 2011, Eqs. 14 and 15)."""


def hertz(radius_eff):
    return 4 / 3 * MODULUS * math.sqrt(radius_eff)


def largest_overlap(radius_eff, mass_eff):
    return (5 * mass_eff * VELOCITY**2 / (4 * hertz(radius_eff))) ** 0.4


CONTACTS = {"beads-beads": (RADIUS / 2, MASS / 2), "beads-glass wall": (RADIUS, MASS)}
"""Effective radius and mass of the two kinds of contact."""


@pytest.fixture
def step(tmp_path):
    return plan_for(scene_of(tmp_path, "numerics.time_step_fraction=0.02")).step


def test_step_is_a_fraction_of_the_shortest_loading_or_unloading_time(step):
    shortest = min(UNLOADING * largest_overlap(*contact) / VELOCITY for contact in CONTACTS.values())
    assert step.value == pytest.approx(0.02 * shortest, rel=1e-4)
    assert step.limited_by == "0.02 of the shortest loading or unloading time, beads-beads at 1 m/s"


def test_stable_step_holds_for_the_densest_packing(step):
    """The fastest mode without friction has w^2 = 8 K/m = 4 K/M (X point of a face-centered cubic
    crystal)."""

    def bound(radius_eff, mass_eff):
        tangent = 1.5 * hertz(radius_eff) * math.sqrt(largest_overlap(radius_eff, mass_eff))
        return 2.0 / math.sqrt(4.0 * tangent / mass_eff)

    assert step.stable_below == pytest.approx(0.99 * min(bound(*contact) for contact in CONTACTS.values()))
    assert step.stable_limit == "beads-beads"


def fastest_mode(directions, ratio):
    """Largest w^2 over K/M of equal particles on a lattice with contacts in these directions, Kt = ratio K.

    The plane wave has displacements u and rotations t, in units of the radius; mass 1 and moment of inertia
    2/5. At the contact with a neighbor along n, a particle moves by u + t x n and the neighbor by u - t x n,
    times the phase of the wave.
    """
    unit = np.array(directions, float) / np.linalg.norm(directions[0])
    root = np.diag([1.0] * 3 + [math.sqrt(2.5)] * 3)
    best = 0.0
    grid = np.linspace(0.0, math.sqrt(2.0) * math.pi, 5)
    for wave in itertools.product(grid, repeat=3):
        total = np.zeros((6, 6), complex)
        for n in unit:
            cross = np.cross(np.eye(3), n).T
            own = np.hstack([np.eye(3), cross])
            partner = np.hstack([np.eye(3), -cross])
            relative_motion = own - np.exp(1j * np.dot(wave, n)) * partner
            spring = np.outer(n, n) + ratio * (np.eye(3) - np.outer(n, n))
            total += 0.5 * relative_motion.conj().T @ spring @ relative_motion
        best = max(best, np.linalg.eigvalsh(root @ total @ root)[-1])
    return best / 2.0  # M is half of the mass 1


def diagonals():
    return [p for p in itertools.product((-1, 0, 1), repeat=3) if sum(map(abs, p)) == 2]


@pytest.mark.parametrize("poisson", [0.0, 0.23, 0.5])
def test_friction_reduces_the_stable_step_by_the_rotational_modes(tmp_path, poisson):
    friction = [f"pairs.glass-{name}.friction=0.3" for name in ("glass", "steel")]
    step = plan_for(scene_of(tmp_path, f"materials.glass.poisson_ratio={poisson}", *friction)).step
    ratio = 2.0 * (1.0 - poisson) / (2.0 - poisson)  # Mindlin: Kt / K
    modes = fastest_mode(diagonals(), ratio)
    assert modes == pytest.approx(20.0 * ratio)
    young = YOUNG / (2 * (1 - poisson**2))
    k = 4 / 3 * young * math.sqrt(RADIUS / 2)
    tangent = 1.5 * k * math.sqrt((5 * MASS / 2 * VELOCITY**2 / (4 * k)) ** 0.4)
    assert step.stable_below == pytest.approx(0.99 * 2.0 / math.sqrt(modes * tangent / (MASS / 2)))


@pytest.mark.parametrize(("contacts", "modes"), [(1, 1.0), (2, 2.0), (12, 4.0), (500, 4.0)])
@pytest.mark.parametrize("restitution", [0.9, 0.3, 0.01])
def test_stable_step_of_a_damped_spring_is_the_leapfrog_stability_limit(contacts, modes, restitution):
    """Eigenvalues of one step: the velocity lags by half a step; the viscous force uses it and the last
    kick."""
    zeta = damping_ratio_for(restitution)
    stiffness = 1e4
    law = Linear(Spring(stiffness, None, 0.0))
    pair = PairMaterial(1e9, 1e9, restitution)
    solid = Material(young_modulus=1e9, poisson_ratio=0.25, density=2500.0)
    case = PairCase("pair", ("a", "a"), pair, 1e-3, MASS, 1e-3, 1e-3, solid, contacts)
    allowed = case.stable_step(law, VELOCITY) / 0.99

    def growth(step):
        spring = modes * stiffness * step**2 / MASS
        viscous = modes * 2.0 * zeta * math.sqrt(stiffness / MASS) * step
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
    stiffness = 1e6
    pair = PairMaterial(1e9, 1e9, 1.0, has_tangential_force=True, tangential_stiffness=stiffness)
    solid = Material(young_modulus=1e9, poisson_ratio=0.25, density=2500.0)
    case = PairCase("pair", ("a", "a"), pair, 1e-3, MASS, 1e-3, 1e-3, solid, 1)
    expected = 0.99 * 2.0 / math.sqrt(3.5 * stiffness / MASS)
    assert case.stable_step(Linear(Spring(1e4, None, 0.0)), VELOCITY) == pytest.approx(expected)


def test_rayleigh_fraction_limits_the_step(tmp_path):
    step = plan_for(scene_of(tmp_path, "numerics.rayleigh_fraction=0.001")).step
    shear = YOUNG / (2 * (1 + POISSON))
    rayleigh = math.pi * RADIUS * math.sqrt(DENSITY / shear) / (0.1631 * POISSON + 0.8766)
    assert step.value == pytest.approx(0.001 * rayleigh)
    assert step.limited_by.startswith("0.001 of the Rayleigh time, beads-")


def test_least_restitution_follows_from_the_unloading_stiffness_bound(step):
    def least(radius_eff, mass_eff):
        tangent = hertz(radius_eff) * math.sqrt(largest_overlap(radius_eff, mass_eff)) / 0.8
        return math.sqrt(tangent * step.value**2 / (0.5**2 * mass_eff))

    assert step.least_restitution == pytest.approx(max(least(*contact) for contact in CONTACTS.values()))
    assert step.warnings == ()


def test_given_step_above_the_stable_step_is_rejected_with_its_line_and_a_valid_step(tmp_path):
    allowed = plan_for(scene_of(tmp_path)).step
    text = TEXT.replace("duration: 50 ms", "duration: 50 ms\n  time_step: 1e-3")
    with pytest.raises(SceneError) as rejection:
        plan_for(scene_of(tmp_path, text=text))
    (problem,) = rejection.value.problems
    assert problem.endswith(
        f"beads.yaml:{line_of('duration') + 1}:14: run.time_step is 0.001 s, above the stability limit "
        f"{allowed.stable_below:.3g} s (beads-beads at 1 m/s). Lower it to {allowed.value:.2g} s or remove it."
    )


def test_stable_step_that_does_not_reach_the_restitution_causes_a_warning(tmp_path):
    step = plan_for(scene_of(tmp_path, "run.time_step=4.5e-5")).step
    assert (step.value, step.limited_by) == (4.5e-5, "given in the scene")
    warning = step.warnings[0]
    assert warning.startswith(
        "glass-glass: the restitution at 1 m/s is 0.7, but a time step of 4.5e-05 s reproduces no "
        "restitution below"
    )
    remedy = float(warning.split("Use run.time_step: ")[1].split()[0])
    assert not plan_for(scene_of(tmp_path, f"run.time_step={0.98 * remedy}")).step.warnings


PAIRS = ("glass-glass", "glass-steel")
INSERTION = TEXT.split("insert: ")[1].split("\n")[0]
ROUGH = f"particles.rough={{material: steel, count: 5, diameter: 4 mm, fixed: true, insert: {INSERTION}}}"
UNRESOLVED = [f"pairs.{pair}.restitution=0.001" for pair in PAIRS]


def groups_like_the_beads(count):
    group = TEXT.split("  beads:\n")[1].split("domain:")[0]
    return TEXT.replace(group, group + "".join(f"  group_{number}:\n{group}" for number in range(1, count)))


def test_small_restitution_causes_one_warning_per_material_pair(tmp_path):
    """Ten groups and a wall have 65 kinds of contact: 55 between groups and 10 with the wall."""
    text = groups_like_the_beads(10)
    (warning,) = plan_for(scene_of(tmp_path, *UNRESOLVED, text=text)).step.warnings
    assert warning.startswith("glass-glass: ")
    both = plan_for(scene_of(tmp_path, *UNRESOLVED, "walls.floor.material=steel", text=text)).step.warnings
    assert [each.split(":")[0] for each in both] == list(PAIRS)


def test_velocity_dependent_restitution_0_causes_a_warning(tmp_path):
    """At the limit velocity e(v) is 0; the contact rebounds with the smallest restitution of the time
    step."""
    fit = "{sigma: 1.2, psi: 0.54, limit_velocity: 0.5 m/s}"
    step = plan_for(scene_of(tmp_path, *(f"pairs.{pair}.restitution={fit}" for pair in PAIRS))).step
    (warning,) = step.warnings
    assert warning.startswith("glass-glass: the restitution at 1 m/s is 0, and no time step reproduces 0 ")
    assert f": the smallest is {step.least_restitution:.3g} at a time step of " in warning
    assert warning.endswith("A constant restitution of 0 is exact.")


def test_restitution_0_requires_neither_a_warning_nor_a_shorter_step(tmp_path):
    """The contact stops in one step; unloading, which takes longer than loading at restitution 1, is not
    resolved."""
    steps = [
        plan_for(scene_of(tmp_path, *(f"pairs.{pair}.restitution={e}" for pair in PAIRS))).step
        for e in (0, 1)
    ]
    assert not steps[0].warnings
    assert steps[0].least_restitution == 0.0
    assert steps[0].value == pytest.approx(steps[1].value, rel=1e-6)


@pytest.mark.parametrize(
    ("overrides", "pairs"),
    [
        (("particles.beads.count=1",), ["glass-glass"]),  # with the floor
        (("particles.beads.count=1", "walls.floor.material=steel"), ["glass-steel"]),
        (("particles.beads.count=1", "walls={}"), []),
        ((ROUGH, "pairs.steel-steel={restitution: 0.001, friction: 0, rolling_friction: 0}"), list(PAIRS)),
        ((ROUGH, "particles.beads.fixed=true"), []),
    ],
)
def test_contacts_that_cannot_occur_cause_no_warning(tmp_path, overrides, pairs):
    found = plan_for(scene_of(tmp_path, *UNRESOLVED, *overrides)).step.warnings
    assert [warning.split(":")[0] for warning in found] == pairs


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


TANGENTIAL = "contact.tangential={law: linear_history, stiffness: %s}"


def test_stiffness_of_a_linear_tangential_spring_bounds_the_step(tmp_path):
    """All rotate and slip: w^2 = 20 kt / M, dt < 0.99 * 2 / w, for a spring that is stiffer than the normal
    contact."""
    stiffness = 1e6
    friction = ["pairs.glass-glass.friction=0.5"]
    step = plan_for(scene_of(tmp_path, TANGENTIAL % f"{stiffness:g} N/m", *friction)).step
    assert step.stable_below == pytest.approx(0.99 * 2.0 / math.sqrt(20.0 * stiffness / (MASS / 2)), rel=1e-3)
    soft = plan_for(scene_of(tmp_path, TANGENTIAL % "1 N/m", *friction)).step
    assert soft.stable_below == pytest.approx(plan_for(scene_of(tmp_path)).step.stable_below, rel=1e-2)


def test_tangential_dashpot_requires_that_of_the_normal_model(tmp_path):
    given = ["contact.tangential={law: mindlin, damping: 0.5}", "pairs.glass-glass.friction=0.5"]
    with pytest.raises(
        SceneError,
        match=r"contact.tangential.damping is 0.5, .* zhou has no such dashpot; write 0, or choose hertz",
    ):
        plan_for(scene_of(tmp_path, *given))
    assert plan_for(scene_of(tmp_path, "contact.normal=hertz", *given)).laws.damped_slots == ("tangential",)


VIBRATION = "{{kind: vibration, direction: [0, 0, 1], amplitude: 1 nm, frequency: {} Hz}}"
ROTATION = "{{kind: rotation, point: [0, 0, 0], axis: [0, 0, 1], angular_velocity: {}}}"


@pytest.mark.parametrize("motion", [
    VIBRATION.format(9_999), ROTATION.format(2 * math.pi * 9_999),
    VIBRATION.format(10_001), ROTATION.format(-2 * math.pi * 10_001),
])  # fmt: skip
def test_a_period_of_a_motion_has_at_least_ten_steps(tmp_path, motion):
    """A step of 1e-5 s, so a period of 1e-4 s: 10 kHz or 62 832 rad/s."""
    text = TEXT.replace("material: glass}\nparticles", f"material: glass, motion: {motion}}}\nparticles")
    scene = scene_of(tmp_path, "run.time_step=1e-5", "run.velocity_max=1 m/s", text=text)
    if "9999" in motion or str(2 * math.pi * 9_999) in motion:
        assert plan_for(scene).step.value == 1e-5
    else:
        message = r"walls.floor.motion.0 has a period of 0.0001 s, .* to 1e-05 s or less"
        with pytest.raises(SceneError, match=message):
            plan_for(scene)


def test_a_period_of_gravity_has_at_least_ten_steps(tmp_path):
    rocking = "gravity={vector: [0, 0, -9.81], motion: {kind: oscillation, axis: [1, 0, 0], amplitude: 1 deg, frequency: 10001}}"
    with pytest.raises(SceneError, match=r"gravity.motion.0 has a period of 0.0001 s, .* to 1e-05 s or less"):
        plan_for(scene_of(tmp_path, rocking, "run.time_step=1e-5", "run.velocity_max=1 m/s"))
