"""Cohesion models with a closed form: pull-off force, work of adhesion, range, and impacts that stick or
rebound."""

import math
import re

import numpy as np
import pytest
from contact.bonds import (
    MODULUS,
    OPTIONS,
    RADIUS,
    evaluate_bonds,
    evaluate_reference_bonds,
    law_of,
    pair_with,
)
from scene_builders import build_scene, particle_group, plane, run_to_end
from scipy.integrate import quad

from granflow.contact.material import modulus_eff
from granflow.plan.build import plan_for
from granflow.plan.explain import explain
from granflow.scene.blocks.materials import Material
from granflow.simulation import Simulation

WORK = OPTIONS["work_of_adhesion"]
LENGTH = (2.0 * math.pi * WORK * RADIUS**2 / MODULUS) ** (2.0 / 3.0) / RADIUS
"""The unit of overlaps of JKR [m], a_s^2 / R."""
BONDS = ("jkr", "capillary")


def hertz(overlap):
    """Hertz force [N]."""
    return 4.0 / 3.0 * MODULUS * np.sqrt(RADIUS) * np.maximum(overlap, 0.0) ** 1.5


def pulled(law, steps=20000):
    """A contact that is pressed together and then pulled apart beyond the range, in small steps [m]."""
    largest = max(3.0 * LENGTH, 0.2 * law.range)
    return np.concatenate(
        [np.linspace(0.0, largest, steps)[1:], np.linspace(largest, -1.1 * law.range, 4 * steps)[1:]]
    )[None, :]


@pytest.mark.parametrize("name", ["capillary", "capillary_transfer"])
def test_the_range_of_a_bridge_covers_all_pairs_of_materials(name):
    """Rupture distance (1 + angle / 2) V^(1/3) (Lian et al. 1993): 0.6 rad instead of 0.1 for one pair."""
    liquid = {"surface_tension": 0.07, "restitution": 0.8, "friction": 0.0}
    volume = {"liquid_volume": 1e-9} if name == "capillary" else {}
    pairs = {
        f"{a}-{b}": liquid | volume | {"contact_angle": 0.6 if a == "glass" else 0.1}
        for a, b in (("glass", "glass"), ("glass", "steel"), ("steel", "steel"))
    }
    model = name if name == "capillary" else {"law": name, "max_bridge_volume": 1e-9}
    scene = build_scene(
        {"balls": particle_group([[0.0, 0.0, 0.0]])}, {"floor": plane([0, 0, -1], [0, 0, 1], "steel")},
        pairs=pairs, contact={"normal": "hertz", "tangential": "none", "rolling": "none", "cohesion": model},
    )  # fmt: skip
    farthest = (1.0 + 0.5 * 0.6) * 1e-9 ** (1.0 / 3.0)
    assert farthest <= plan_for(scene).laws.cohesion.range < 1.01 * farthest


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
    """Force, stored energy and rupture of `capillary_transfer` once the bridge exists, and its reference."""
    pair = pair_with()
    volume = OPTIONS["liquid_volume"]
    constant = law_of("capillary", pair)
    transfer = law_of("capillary_transfer", pair)
    overlap = np.linspace(0.2 * constant.range, -1.1 * constant.range, 5000)[None, :]
    expected = evaluate_bonds(constant, pair, overlap)
    found = evaluate_bonds(transfer, pair, overlap, volume)
    ruptured = found.history[0, :, 0] == 0.0
    np.testing.assert_array_equal(ruptured, expected.history[0, :, 0] == 0.0)
    assert 0 < ruptured.sum() < 1000 and set(found.history[0, :, 0]) == {0.0, volume}
    np.testing.assert_allclose(found.attraction, expected.attraction, rtol=1e-13)
    np.testing.assert_allclose(
        found.stored, expected.stored, rtol=0.0, atol=1e-13 * np.abs(expected.stored).max()
    )
    reference = evaluate_reference_bonds(transfer, pair, overlap, bridge_volume=volume)
    np.testing.assert_allclose(found.attraction, reference, rtol=1e-13)


def random_distances(law, contacts=100, steps=60, seed=7):
    """Overlaps [m] with touches, separations within the range and ruptures."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.3, 1.0, (contacts, steps)) * max(law.range, 0.3 * LENGTH)


@pytest.mark.parametrize("name", ["dmt", "jkr", "capillary", "van_der_waals"])
def test_device_equals_its_reference(taichi_f64, name):
    """The reference of JKR finds the contact radius as a root of a polynomial: sensitive at snap-off, a
    double root."""
    law = law_of(name, pair_with())
    pair = pair_with()
    overlap = random_distances(law)
    if name == "dmt":
        overlap = np.abs(overlap)
    found = evaluate_bonds(law, pair, overlap).attraction
    expected = evaluate_reference_bonds(law, pair, overlap)
    assert np.array_equal(found == 0.0, expected == 0.0) and (found > 0.0).sum() > 1000
    assert np.all(found[overlap < -law.range] == 0.0)
    np.testing.assert_allclose(
        found, expected, rtol=0.0, atol=(1e-7 if name == "jkr" else 1e-13) * expected.max()
    )
    far = overlap > -0.4 * LENGTH
    np.testing.assert_allclose(found[far], expected[far], rtol=0.0, atol=1e-12 * expected.max())


@pytest.mark.parametrize("name", [*BONDS, "van_der_waals", "dmt", "sjkr"])
def test_force_is_the_derivative_of_the_energy_and_losses_only_grow(taichi_f64, name):
    law = law_of(name, pair_with())
    pair = pair_with()
    overlap = pulled(law)
    found = evaluate_bonds(law, pair, overlap)
    assert np.diff(found.lost[0]).min() >= 0.0
    acts = found.attraction[0] > 0.0
    both = acts[1:] & acts[:-1]
    mean_force = 0.5 * (found.attraction[0, 1:] + found.attraction[0, :-1])
    change = np.diff(found.stored[0]) + mean_force * np.diff(overlap[0])
    assert np.abs(change[both]).sum() <= 1e-3 * np.abs(found.stored).max()
    assert found.stored[0, -1] == 0.0


@pytest.mark.parametrize(
    ("name", "without"),
    [("jkr", {"work_of_adhesion": 0.0}), ("capillary", {"liquid_volume": 0.0}), ("capillary_transfer", {})],
)
def test_a_pair_without_adhesion_has_no_force(taichi_f64, name, without):
    """Also a bridge without liquid: films give it its volume when it forms."""
    law = law_of(name, pair_with())
    plain = pair_with(**without)
    found = evaluate_bonds(law, plain, random_distances(law))
    assert not found.attraction.any() and np.abs(found.lost).max() == 0.0
    assert np.isfinite(found.history).all()


DENSITY, DIAMETER = 2500.0, 2.0 * RADIUS
SOLID = {"young_modulus": 2e7, "poisson_ratio": 0.3, "density": DENSITY}
SHARES = (0.99, 1.01, 1.5, 3.0)
"""Impact velocities over the sticking velocity."""


def lost_energy(radius_eff):
    """Energy [J] that one contact of JKR loses (Thornton & Ning 1998)."""
    elasticity = {key: SOLID[key] for key in ("young_modulus", "poisson_ratio")}
    solid = Material(density=DENSITY, **elasticity)
    return 7.09 * (WORK**5 * radius_eff**4 / modulus_eff(solid, solid) ** 2) ** (1.0 / 3.0)


def impacts(gravity=0.0, normal="hertz"):
    """A scene of particles that hit a floor or another particle at rest, and the two sticking velocities."""
    mass = DENSITY * math.pi / 6.0 * DIAMETER**3
    floor = math.sqrt(2.0 * lost_energy(RADIUS) / mass)
    pair = math.sqrt(2.0 * lost_energy(0.5 * RADIUS) / (0.5 * mass))
    gap = 0.01 * RADIUS
    falling = [[10.0 * RADIUS * k, 0.0, RADIUS + gap] for k in range(len(SHARES))]
    targets = [[x, y, 30.0 * RADIUS] for x, y, _ in falling]
    shots = [[x, y, z + DIAMETER + gap] for x, y, z in targets]
    speeds = np.array([*(-floor * np.array(SHARES)), *np.zeros(len(SHARES)), *(-pair * np.array(SHARES))])
    velocity = speeds[:, None] * [0.0, 0.0, 1.0]
    scene = build_scene(
        {"balls": particle_group([*falling, *targets, *shots], DIAMETER, velocity=velocity)},
        {"floor": plane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])}, pair={"restitution": 1.0, "work_of_adhesion": WORK},
        contact={"normal": normal, "tangential": "mindlin", "rolling": "none", "cohesion": "jkr"},
        materials={"glass": SOLID}, domain={"min": [-0.01] * 3, "max": [0.05] * 3, "on_exit": "error"},
        run={"duration": 20000 * 2e-8, "time_step": 2e-8, "velocity_max": 5.0 * max(floor, pair)},
        gravity=[0.0, 0.0, -gravity], numerics={"chunk_size": 12},
        output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip
    return scene, floor, pair, mass


def test_impacts_stick_below_the_sticking_velocity_and_lose_the_work_of_adhesion(taichi_f64):
    """Rebound velocity sqrt(v^2 - v_s^2), v_s = sqrt(2 W / M) (Thornton & Ning 1998), at walls and particles.

    In batches, with half of the neighbor list; impacts of capillary bridges are those of
    tests/physics/test_liquid_transfer.py.
    """
    scene, floor, pair, mass = impacts()
    last, _ = run_to_end(scene)
    velocity = last.particles["velocity"][np.argsort(last.particles["id"]), 2].reshape(3, len(SHARES))
    rebound = np.sqrt(np.maximum(np.array(SHARES) ** 2 - 1.0, 0.0))
    relative = np.array([velocity[0] / floor, (velocity[2] - velocity[1]) / pair])
    for found in relative:
        np.testing.assert_allclose(found[1:], rebound[1:], rtol=0.02, atol=0.02)
    position = last.particles["position"][np.argsort(last.particles["id"]), 2].reshape(3, len(SHARES))
    gaps = np.array([position[0] - RADIUS, position[2] - position[1] - DIAMETER])
    within = plan_for(scene).laws.range
    assert np.all(gaps[:, 0] < within) and np.all(gaps[:, 1:] > within), "the slowest impact sticks"
    ends = 3 * (lost_energy(RADIUS) + lost_energy(0.5 * RADIUS))
    start = 0.5 * mass * np.sum((floor**2 + pair**2) * np.array(SHARES) ** 2)
    assert last.totals["plastic_dissipation"] >= ends * 0.999
    assert abs(last.totals["energy_error"]) < 2e-3, "relative error of the energy budget"
    assert last.totals["plastic_dissipation"] < start


def test_energy_budget_closes_with_models_that_store_the_stiffness_of_a_contact(taichi_f64):
    """Bonds rupture after their overlap has ended, and with it the stiffness in the history of the normal
    model."""
    scene, *_ = impacts(normal={"law": "walton_braun", "stiffness": "onset", "unloading": "constant"})
    last, _ = run_to_end(scene)
    losses = 3 * (lost_energy(RADIUS) + lost_energy(0.5 * RADIUS))
    assert abs(last.totals["energy_error"]) < 2e-3
    assert last.totals["plastic_dissipation"] > 0.8 * losses


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


def test_explain_shows_the_bond_number():
    """Pull-off force over weight: 3/2 pi w R / (m g), with the radius R of the particle at a wall, and half of it
    for two particles."""
    scene, *_ = impacts(gravity=10.0)
    text = " ".join(explain(plan_for(scene)).partition("Bond number")[2].split())
    at_wall, of_two = re.findall(r"(\S+) pull-off force \S+ N over weight, (.*?), diameter 0.0002 m", text)
    number = 1.5 * math.pi * WORK * RADIUS / (DENSITY * math.pi / 6.0 * DIAMETER**3 * 10.0)
    assert at_wall[0] == f"{number:.3g}" and "wall" in at_wall[1]
    assert of_two[0] == f"{number / 2.0:.3g}" and "wall" not in of_two[1]
