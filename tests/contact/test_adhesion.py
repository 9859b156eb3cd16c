"""Cohesion models with a closed form: pull-off force, work of adhesion, range, and impacts that stick or
rebound."""

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from contact.surface_paths import NUMBERS, VECTORS, evaluate_surface
from scene_builders import (
    SOFT,
    build_scene,
    column,
    few_spheres,
    particle_group,
    plane,
    run_and_sample,
    run_to_end,
    times,
)
from scipy.integrate import quad

from granflow.contact.law import ContactState, ModelRequest
from granflow.contact.material import PairMaterial, modulus_eff
from granflow.contact.registry import models
from granflow.plan.build import plan_for
from granflow.scene.blocks.materials import Material
from granflow.simulation import Simulation

RADIUS, MODULUS = 1e-4, 1e7
"""Effective radius [m] and modulus [Pa] of a soft particle, to which JKR applies."""
MASS_EFF = 100.0
"""Effective mass [kg] of paths with a time step of 1 s: the attraction changes the overlap by some 1e-7 m in one."""
OPTIONS = {
    "work_of_adhesion": 0.05, "surface_tension": 0.072, "contact_angle": 0.3, "liquid_volume": 1e-16,
    "cohesion_energy_density": 1e4, "hamaker_constant": 1e-19, "separation": 1e-8,
}  # fmt: skip
WORK = OPTIONS["work_of_adhesion"]
LENGTH = (2.0 * math.pi * WORK * RADIUS**2 / MODULUS) ** (2.0 / 3.0) / RADIUS
"""The unit of overlaps of JKR [m], a_s^2 / R."""


def pair_with(**options):
    """An elastic pair with the values of OPTIONS, or others."""
    return PairMaterial(MODULUS, 0.3 * MODULUS, 1.0, properties=OPTIONS | options)


def law_of(name, pair):
    """The cohesion model of this name for a pair, with its example options and the energy budget."""
    model = models("cohesion")[name]
    given = {"max_bridge_volume": 1e-15} if name == "capillary_transfer" else {}
    return model.law.from_scene(
        ModelRequest(model.options(**given), (pair,), 1.0, 0.5, energy_budget=True, radius_eff_max=RADIUS)
    )


@dataclass(frozen=True)
class BondResult:
    """Attraction [N], stored and lost energy [J] (contacts, steps), and history (contacts, steps,
    numbers)."""

    attraction: np.ndarray
    stored: np.ndarray
    lost: np.ndarray
    history: np.ndarray


def evaluate_bonds(law, pair, overlap, first=0.0, rate=0.0):
    """Attraction along overlaps (contacts, steps) [m], which may be negative; `first`: first history field
    before; `rate`: overlap rates [m/s]."""
    numbers = dict.fromkeys(NUMBERS, 0.0) | {"radius_eff": RADIUS, "mass_eff": MASS_EFF, "overlap": overlap}
    numbers["overlap_rate"] = rate
    vectors = dict.fromkeys(VECTORS, np.zeros((*overlap.shape, 3)))
    found = evaluate_surface(law, pair, numbers | {"time_step": 1.0}, vectors, first)
    return BondResult(found.force[..., 0], found.stored, found.loss, found.history)


def evaluate_reference_bonds(law, pair, overlap, rate=0.0, **first):
    """Attraction [N] along overlaps by the reference implementation; `first`: history before."""
    rate = np.broadcast_to(rate, overlap.shape)
    constants = SimpleNamespace(**dict(zip(law.constant_names, law.pair_constants(pair), strict=True)))
    attraction = np.zeros(overlap.shape)
    for i, path in enumerate(overlap):
        history = first
        for s, d in enumerate(path):
            state = ContactState(
                constants, RADIUS, MASS_EFF, 1.0, float(d), rate[i, s], SimpleNamespace(**history)
            )
            attraction[i, s], history = law.reference(state)
    return attraction


def hertz(overlap):
    """Hertz force [N]."""
    return 4.0 / 3.0 * MODULUS * np.sqrt(RADIUS) * np.maximum(overlap, 0.0) ** 1.5


def pulled(law, steps=20000):
    """A contact that is pressed together and then pulled apart beyond the range, in small steps [m]."""
    largest = max(3.0 * LENGTH, 0.2 * law.range)
    return np.concatenate(
        [np.linspace(0.0, largest, steps)[1:], np.linspace(largest, -1.1 * law.range, 4 * steps)[1:]]
    )[None, :]


def test_jkr_pull_off_force_distance_and_work(taichi_f64):
    """Smallest force -3/2 pi w R; snap-off at a = a_s / 4^(2/3), which is the distance 3/4 4^(-1/3) d_s (JKR
    1971). One contact loses 7.09 (w^5 R^4 / E^2)^(1/3) (Thornton & Ning 1998), the integral of the force."""
    law = law_of("jkr", pair_with())
    pair = pair_with()
    overlap = pulled(law)
    found = evaluate_bonds(law, pair, overlap)
    force = hertz(overlap) - found.attraction
    assert -force.min() == pytest.approx(1.5 * math.pi * WORK * RADIUS, rel=1e-3)
    assert law.pull_off_force(pair, RADIUS) == pytest.approx(1.5 * math.pi * WORK * RADIUS, rel=1e-12)
    bonded = found.history[0, :, 0] == 1.0
    assert -overlap[0, bonded].min() == pytest.approx(0.75 * 4.0 ** (-1.0 / 3.0) * LENGTH, rel=1e-3)
    at_snap = force[0, np.flatnonzero(bonded)[-1]]
    assert at_snap == pytest.approx(-5.0 / 6.0 * math.pi * WORK * RADIUS, rel=0.02), (
        "5/9 of the pull-off force"
    )
    assert not found.attraction[0, ~bonded].any()
    expected = 7.09 * (WORK**5 * RADIUS**4 / MODULUS**2) ** (1.0 / 3.0)
    assert found.lost[0, -1] == pytest.approx(expected, rel=1e-3)
    work = np.sum(0.5 * (force[0, 1:] + force[0, :-1]) * np.diff(overlap[0]))
    assert work == pytest.approx(expected, rel=1e-3)


def test_capillary_work_and_force(taichi_f64):
    """Force and work against the formulas of the papers, integrated by quadrature; equal spheres of radius 2
    R."""
    law = law_of("capillary", pair_with())
    pair = pair_with()
    overlap = pulled(law)
    found = evaluate_bonds(law, pair, overlap)
    volume = OPTIONS["liquid_volume"]
    sphere = 2.0 * RADIUS
    touching = 2.0 * math.pi * sphere * OPTIONS["surface_tension"] * math.cos(OPTIONS["contact_angle"])

    def force(distance):
        u = 0.5 * distance * math.sqrt(sphere / volume)
        return touching / (1.0 + 2.1 * u + 10.0 * u * u)

    rupture = (1.0 + 0.5 * OPTIONS["contact_angle"]) * volume ** (1.0 / 3.0)
    assert rupture <= law.range < 1.01 * rupture
    bonded = found.history[0, :, 0] == 1.0
    assert -overlap[0, bonded].min() == pytest.approx(rupture, rel=1e-3)
    assert found.attraction.max() == pytest.approx(touching, rel=1e-12)
    assert law.pull_off_force(pair, RADIUS) == pytest.approx(touching, rel=1e-12)
    open_bonds = np.flatnonzero(bonded & (overlap[0] < 0.0))[::500]
    np.testing.assert_allclose(
        found.attraction[0, open_bonds], [force(-d) for d in overlap[0, open_bonds]], rtol=1e-12
    )
    work = quad(force, 0.0, rupture, epsrel=1e-10)[0]
    assert found.lost[0, -1] == pytest.approx(work, rel=1e-9)


def test_bridge_of_a_given_volume_is_that_of_the_model_with_constant_volume(taichi_f64):
    """Force, stored energy and rupture of `capillary_transfer` once the bridge exists, and its reference; with steps
    of any length."""
    pair = pair_with()
    volume = OPTIONS["liquid_volume"]
    constant = law_of("capillary", pair)
    transfer = law_of("capillary_transfer", pair)
    overlap = np.linspace(0.2 * constant.range, -1.1 * constant.range, 5000)[None, :]
    rate = random_distances(constant, *overlap.shape)
    expected = evaluate_bonds(constant, pair, overlap, rate=rate)
    found = evaluate_bonds(transfer, pair, overlap, volume, rate)
    assert np.isclose(expected.attraction[0], expected.attraction[0].max(), rtol=1e-12).sum() < 1000
    ruptured = found.history[0, :, 0] == 0.0
    np.testing.assert_array_equal(ruptured, expected.history[0, :, 0] == 0.0)
    assert 0 < ruptured.sum() < 1000 and set(found.history[0, :, 0]) == {0.0, volume}
    np.testing.assert_allclose(found.attraction, expected.attraction, rtol=1e-13)
    np.testing.assert_allclose(
        found.stored, expected.stored, rtol=0.0, atol=1e-13 * np.abs(expected.stored).max()
    )
    reference = evaluate_reference_bonds(transfer, pair, overlap, rate, bridge_volume=volume)
    np.testing.assert_allclose(found.attraction, reference, rtol=1e-13)


def random_distances(law, contacts=100, steps=60, seed=7):
    """Overlaps [m] with touches, separations within the range and ruptures."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.3, 1.0, (contacts, steps)) * max(law.range, 0.3 * LENGTH)


@pytest.mark.parametrize("name", ["dmt", "jkr", "capillary", "van_der_waals"])
def test_device_equals_its_reference(taichi_f64, name):
    """The reference of JKR finds the contact radius as a root of a polynomial: sensitive at snap-off, a
    double root."""
    law, pair = law_of(name, pair_with()), pair_with()
    overlap = random_distances(law)
    rate = random_distances(law, seed=1)
    if name == "dmt":
        overlap = np.abs(overlap)
    found = evaluate_bonds(law, pair, overlap, rate=rate).attraction
    expected = evaluate_reference_bonds(law, pair, overlap, rate)
    assert np.array_equal(found == 0.0, expected == 0.0) and (found > 0.0).sum() > 1000
    assert np.all(found[overlap < -law.range] == 0.0)
    atol = (1e-7 if name == "jkr" else 1e-13) * expected.max()
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=atol)
    near = overlap > -0.4 * LENGTH
    np.testing.assert_allclose(found[near], expected[near], rtol=0.0, atol=1e-12 * expected.max())


@pytest.mark.parametrize("name", ["jkr", "capillary", "van_der_waals", "dmt", "sjkr"])
def test_force_is_the_derivative_of_the_energy_and_losses_only_grow(taichi_f64, name):
    law, pair = law_of(name, pair_with()), pair_with()
    overlap = pulled(law)
    found = evaluate_bonds(law, pair, overlap)
    assert np.diff(found.lost[0]).min() >= 0.0
    acts = found.attraction[0] > 0.0
    both = acts[1:] & acts[:-1]
    mean_force = 0.5 * (found.attraction[0, 1:] + found.attraction[0, :-1])
    change = np.diff(found.stored[0]) + mean_force * np.diff(overlap[0])
    assert np.abs(change[both]).sum() <= 1e-3 * np.abs(found.stored).max()
    assert found.stored[0, -1] == 0.0


def test_a_pair_without_adhesion_has_no_force(taichi_f64):
    """Also a bridge without liquid: films give it its volume when it forms."""
    zero = {"jkr": {"work_of_adhesion": 0.0}, "capillary": {"liquid_volume": 0.0}, "capillary_transfer": {}}
    for name, without in zero.items():
        law = law_of(name, pair_with())
        found = evaluate_bonds(law, pair_with(**without), random_distances(law))
        assert not found.attraction.any() and np.abs(found.lost).max() == 0.0
        assert np.isfinite(found.history).all()


DENSITY, DIAMETER = 2500.0, 2.0 * RADIUS
SOLID = {"young_modulus": 2e7, "poisson_ratio": 0.3, "density": DENSITY}


def lost_energy(radius_eff):
    """Energy [J] that one contact of JKR loses (Thornton & Ning 1998)."""
    solid = Material(**SOLID)
    return 7.09 * (WORK**5 * radius_eff**4 / modulus_eff(solid, solid) ** 2) ** (1.0 / 3.0)


def test_impacts_stick_below_the_sticking_velocity_and_lose_the_work_of_adhesion(taichi_f64):
    """Rebound velocity sqrt(v^2 - v_s^2), v_s = sqrt(2 W / M) (Thornton & Ning 1998), at walls and particles.

    With every elastic normal model; that of a spring of the stiffness at the onset stores it, and bonds rupture
    after the overlap has ended. In batches, with half of the neighbor list; impacts of capillary bridges are those
    of tests/physics/test_liquid_transfer.py.
    """
    mass = DENSITY * math.pi / 6.0 * DIAMETER**3
    floor = math.sqrt(2.0 * lost_energy(RADIUS) / mass)
    pair = math.sqrt(2.0 * lost_energy(0.5 * RADIUS) / (0.5 * mass))
    shares = np.array([0.99, 1.01, 1.5, 3.0])  # impact velocities over the sticking velocity
    gap = 0.01 * RADIUS
    falling = np.array([[10.0 * RADIUS * k, 0.0, RADIUS + gap] for k in range(4)])
    targets = falling + [0.0, 0.0, 30.0 * RADIUS]
    positions = np.concatenate([falling, targets, targets + [0.0, 0.0, DIAMETER + gap]])
    velocity = np.concatenate([-floor * shares, 0.0 * shares, -pair * shares])[:, None] * [0.0, 0.0, 1.0]
    spring = {"law": "walton_braun", "stiffness": "onset", "unloading": "constant"}
    scene = build_scene(
        {"balls": particle_group(positions, DIAMETER, velocity=velocity)},
        {"floor": plane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])}, pair={"restitution": 1.0, "work_of_adhesion": WORK},
        contact={"normal": spring, "tangential": "mindlin", "rolling": "none", "cohesion": "jkr"},
        materials={"glass": SOLID}, domain={"min": [-0.01] * 3, "max": [0.05] * 3, "on_exit": "error"},
        run={"duration": 20000 * 2e-8, "time_step": 2e-8, "velocity_max": 5.0 * max(floor, pair)},
        numerics={"chunk_size": 12}, output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip
    last, _ = run_to_end(scene)
    order = np.argsort(last.particles["id"])
    velocity, height = (last.particles[name][order, 2].reshape(3, 4) for name in ("velocity", "position"))
    rebound = np.sqrt(np.maximum(shares**2 - 1.0, 0.0))
    for found in (velocity[0] / floor, (velocity[2] - velocity[1]) / pair):
        np.testing.assert_allclose(found[1:], rebound[1:], rtol=0.02, atol=0.02)
    gaps = np.array([height[0] - RADIUS, height[2] - height[1] - DIAMETER])
    within = plan_for(scene).laws.range
    assert np.all(gaps[:, 0] < within) and np.all(gaps[:, 1:] > within), "the slowest impact sticks"
    ends = 3 * (lost_energy(RADIUS) + lost_energy(0.5 * RADIUS))
    start = 0.5 * mass * np.sum((floor**2 + pair**2) * shares**2)
    assert ends * 0.999 <= last.totals["plastic_dissipation"] < start
    assert abs(last.totals["energy_error"]) < 2e-3


@pytest.mark.parametrize(
    ("name", "fraction", "median", "rms"), [("dmt", 0.05, 1e-3, 4e-3), ("jkr", 0.0125, 4e-4, 6e-4)]
)
def test_rebounds_are_those_of_the_potential_at_any_time_within_a_step(
    taichi_f64, name, fraction, median, rms
):
    """Impacts on a floor at 16 times within a step; forces that jump would add errors at random if they acted for
    whole steps: of 0.7 % rms with dmt, of 0.17 % with jkr.

    The potential k d^(5/2) 2/5 - f d of dmt returns the speed of the impact; f is 0.3 of the largest Hertz force. jkr
    at 1.5 sticking velocities loses 1 / 1.5^2 of the energy. A separation at a time level can add half a step of the
    force.
    """
    count = 16
    solid = Material(**SOLID)
    stiffness = 4.0 / 3.0 * modulus_eff(solid, solid) * math.sqrt(RADIUS)
    mass = DENSITY * math.pi / 6.0 * DIAMETER**3
    if name == "dmt":
        speed = expected = 0.1
        work = 0.3 * stiffness * (1.25 * mass * speed**2 / stiffness) ** 0.6 / (2.0 * math.pi * RADIUS)
    else:
        work = WORK
        speed = 1.5 * math.sqrt(2.0 * lost_energy(RADIUS) / mass)
        expected = speed * math.sqrt(1.0 - 1.0 / 1.5**2)
    pair = {"restitution": 1.0, "work_of_adhesion": work}
    cohesion = {"normal": "hertz", "tangential": "mindlin", "rolling": "none", "cohesion": name}
    floor = {"floor": plane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])}

    def falling(time_step):
        gaps = 0.01 * RADIUS + speed * time_step / count * np.arange(count)
        positions = np.stack([10.0 * RADIUS * np.arange(count), np.zeros(count), RADIUS + gaps], axis=1)
        return few_spheres(
            {"balls": particle_group(positions, DIAMETER, velocity=[0.0, 0.0, -speed])}, floor, pair=pair,
            pairs={"fixed-fixed": pair | {"friction": 0.5, "work_of_adhesion": 0.0}}, contact=cohesion,
            materials={"glass": SOLID}, run={"duration": 1e-4 / speed, "velocity_max": speed},
            numerics={"time_step_fraction": fraction},
        )  # fmt: skip

    last, _ = run_to_end(falling(plan_for(falling(0.0)).time_step))
    rebound = last.particles["velocity"][last.particles["id"] < count, 2]
    error = np.abs(rebound / expected - 1.0)
    assert np.median(error) < median and np.sqrt(np.mean(error**2)) < rms


def test_van_der_waals_attraction_is_conservative_on_a_contact_without_history(taichi_f64):
    """Speed at contact from U = A R / 6 (1/s_0 - 1/s_c), s_c = 31 s_0, and at the cut-off again that of the
    approach.

    An elastic Hertz contact without friction has no history, so that no list entry is marked as a contact.
    """
    radius = 1e-5
    speed = 5e-3
    hamaker = 2e-18
    separation = 1e-7
    mass = DENSITY * 4.0 / 3.0 * math.pi * radius**3
    cutoff = 31.0 * separation
    ball = particle_group([[0.0, 0.0, radius + cutoff]], 2.0 * radius, velocity=[0.0, 0.0, -speed])
    scene = build_scene(
        {"ball": ball}, {"floor": plane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])},
        pair={"restitution": 1.0, "hamaker_constant": hamaker, "separation": separation},
        contact={"normal": "hertz", "tangential": "mindlin", "rolling": "none", "cohesion": "van_der_waals"},
        materials={"glass": SOLID}, domain={"min": [-1e-3] * 3, "max": [1e-3] * 3, "on_exit": "error"},
        run={"duration": 2e-3, "velocity_max": 2.0 * speed},
    )  # fmt: skip
    simulation = Simulation(scene)
    fastest = 0.0
    while simulation.time < scene.run.duration:
        simulation.step(20)
        height, velocity = (simulation.snapshot().particles[name][0, 2] for name in ("position", "velocity"))
        fastest = max(fastest, -velocity)
    assert height > radius + cutoff
    energy = hamaker * radius / 6.0 * (1.0 / separation - 1.0 / cutoff)
    assert fastest == pytest.approx(math.sqrt(speed**2 + 2.0 * energy / mass), rel=2e-3)
    assert velocity == pytest.approx(speed, rel=1e-3)


def test_cohesion_increases_the_friction_limit(taichi_f64):
    """A particle slides on a wall with cohesion as the only normal load: friction is mu times the repulsion.

    At k d^1.5 = 2 pi w R d repulsion and attraction balance; a limit of mu times the total force would be 0.
    """
    radius, friction, cohesion, speed = 0.005, 0.3, 1e6, 0.5
    modulus = SOFT["young_modulus"] / (2.0 * (1.0 - SOFT["poisson_ratio"] ** 2))
    attraction = 2.0 * np.pi * cohesion * radius
    overlap = (attraction / (4.0 / 3.0 * modulus * np.sqrt(radius))) ** 2
    sphere = particle_group([0.0, 0.0, radius - overlap], 2.0 * radius, velocity=[[speed, 0.0, 0.0]])
    pair = {"restitution": 1.0, "friction": friction, "cohesion_energy_density": cohesion}
    scene = few_spheres(
        {"sphere": sphere}, {"floor": plane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])}, pair=pair, pairs={"fixed-fixed": pair},
        contact={"normal": "hertz", "tangential": "mindlin", "rolling": "none", "cohesion": "sjkr"},
        run={"duration": 3e-4, "time_step": 1e-6, "velocity_max": speed},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 1e-5)
    velocity = column(snapshots, "velocity")[:, 0]
    time = times(snapshots)
    mass = 4.0 / 3.0 * np.pi * radius**3 * SOFT["density"]
    late = time > 1e-4
    deceleration = -np.polyfit(time[late], velocity[late, 0], 1)[0]
    assert deceleration == pytest.approx(friction * attraction * overlap / mass, rel=2e-3)
    assert np.abs(velocity[:, 2]).max() < 1e-3 * speed
