"""Conduction through the gas between particles and at walls, compared with a quadrature of its integral."""

from types import SimpleNamespace

import numpy as np
import pytest
from scene_builders import build_scene, particle_group
from scipy.integrate import quad

from granflow import Simulation
from granflow.contact.heat.conduction import Conduction
from granflow.contact.heat.gas import Gas
from granflow.contact.material import PairMaterial, modulus_eff
from granflow.plan.build import plan_for
from granflow.plan.forecast import gap_findings

GAS, GAP, FILM = 0.3, 2e-5, 0.6
SOLID, OTHER = 1.0, 3.0
YOUNG, TRUE_YOUNG, POISSON, DENSITY = 1e7, 8e7, 0.25, 1e12
"""The spheres are so heavy that they stay where they are."""
CAPACITY = 500.0 / DENSITY
TIME_STEP, STEPS = 1e-5, 100
HOT, COLD = 400.0, 300.0
SPHERES = [
    # radii [m], overlap [m] or minus the gap
    (5e-3, 5e-3, 5e-4), (5e-3, 5e-3, 1e-5), (5e-3, 5e-3, -1e-6), (5e-3, 5e-3, -1e-4), (5e-3, 5e-3, -1.4e-3),
    (5e-3, 2e-3, 1e-5), (2e-3, 5e-3, -1e-5), (5e-3, 1.2e-3, 1e-6), (5e-3, 1.2e-3, -1.4e-3),
    (5e-3, 5e-3, -3.1e-3),
]  # fmt: skip
"""The last pair is farther apart than the film; the film of the large sphere covers half of the smallest one."""
WALLS = [(5e-3, 1e-4), (5e-3, -1e-5), (2e-3, -5e-4), (5e-3, -3.1e-3)]
"""Radius and overlap of spheres at a plate; the last one is farther from it than its film."""


def mass(radius):
    return DENSITY * 4.0 / 3.0 * np.pi * radius**3


def gas_scene(fixed=False):
    """Pairs of spheres, the second one of another material, and spheres at plates with temperatures.

    Only the first material has a true modulus.
    """
    groups, walls = {}, {}

    def add(name, of, radius, x, y, temperature):
        group = particle_group([[x, y, 0.0]], 2.0 * radius, of, temperature=temperature)
        groups[name] = group | {"fixed": fixed}

    for k, (radius, other, overlap) in enumerate(SPHERES):
        add(f"first_{k}", "sphere", radius, 0.0, 0.03 * k, COLD)
        add(f"second_{k}", "other", other, radius + other - overlap, 0.03 * k, HOT)
    for k, (radius, overlap) in enumerate(WALLS):
        add(f"at_wall_{k}", "sphere", radius, 0.1 + radius - overlap, 0.03 * k, COLD)
        walls[f"plate_{k}"] = {
            "shape": "rectangle", "corner": [0.1, 0.03 * k - 0.01, -0.01], "sides": [[0, 0.02, 0], [0, 0, 0.02]],
            "material": "other", "temperature": HOT,
        }  # fmt: skip
    solid = {"young_modulus": YOUNG, "poisson_ratio": POISSON, "density": DENSITY, "heat_capacity": CAPACITY}
    gas = {"conductivity": GAS, "min_gap": GAP, "film": FILM}
    return build_scene(
        groups, walls, {"restitution": 1.0},
        materials={
            "sphere": solid | {"thermal_conductivity": SOLID, "true_young_modulus": TRUE_YOUNG},
            "other": solid | {"thermal_conductivity": OTHER},
        },
        contact={
            "normal": "hertz", "tangential": "none", "rolling": "none", "heat": {"law": "conduction", "gas": gas},
        },
        domain={"min": [-0.1] * 3, "max": [0.5] * 3, "on_exit": "error"}, numerics={"max_overlap": 0.3},
        run={"duration": 1.0, "time_step": TIME_STEP, "velocity_max": 0.1},
    )  # fmt: skip


def lens_integral(radii, distance, inner, outer, ratio):
    """k_g int 2 pi r dr / (l + p (D - l)), l = max(D - w(r), s), from the inner to the outer radius.

    w(r) is the sum of the half chords of the spheres with these radii.
    """
    if outer <= inner:
        return 0.0

    def per_radius(r):
        gap = max(distance - sum(half_chord(radius, r) for radius in radii), GAP)
        return 2.0 * np.pi * r / (gap + ratio * (distance - gap))

    points = inner + (outer - inner) * 10.0 ** -np.arange(1.0, 7.0)
    return GAS * quad(per_radius, inner, outer, points=points, limit=500, epsabs=0, epsrel=1e-10)[0]


def half_chord(radius, r):
    return np.sqrt(max(radius**2 - r**2, 0.0))


def crossing(radius, other, distance):
    """Distance from the axis at which two spheres intersect; 0 if they do not."""
    along = (distance**2 + radius**2 - other**2) / (2.0 * distance)
    return half_chord(radius, along)


def conductances():
    """Conductance [W/K] of each pair of spheres, and of each sphere with its plate: contact area and gas.

    The contacts of the true modulus E* have a force F = 4/3 E sqrt(R) d^1.5 = 4/3 E* sqrt(R) d*^1.5.
    """
    compliance = (1.0 - POISSON**2) / YOUNG
    softness = ((1.0 - POISSON**2) / TRUE_YOUNG + compliance) / (2.0 * compliance)
    solid = 2.0 * SOLID * OTHER / (SOLID + OTHER)
    ratio, wall_ratio = GAS / solid, GAS / SOLID
    spheres, walls = [], []
    for first, second, overlap in SPHERES:
        true = softness ** (2.0 / 3.0) * overlap if overlap > 0.0 else overlap
        distance = first + second - true
        large, small = max(first, second), min(first, second)
        film = (1.0 + FILM) * large
        outer = small if distance**2 + small**2 < film**2 else crossing(film, small, distance)
        inner = crossing(first, second, distance) if true > 0.0 else 0.0
        gas = lens_integral((large, small), distance, inner, outer, ratio)
        radius = np.sqrt(first * second / (first + second) * max(true, 0.0))
        spheres.append(2.0 * solid * radius + gas)
    for first, overlap in WALLS:
        true = softness ** (2.0 / 3.0) * overlap if overlap > 0.0 else overlap
        distance = first - true
        outer, inner = half_chord((1.0 + FILM) * first, distance), half_chord(first, distance)
        gas = lens_integral((first,), distance, inner, min(outer, first), wall_ratio)
        walls.append(2.0 * solid * np.sqrt(first * max(true, 0.0)) + gas)
    return np.array(spheres), np.array(walls)


def test_the_conductance_of_gas_is_its_integral():
    """Pairs at a distance and in contact approach each other's temperature with the rate h (1/C_i + 1/C_j)."""
    spheres, walls = conductances()
    assert np.count_nonzero(spheres) == len(SPHERES) - 1 and np.count_nonzero(walls) == len(WALLS) - 1
    with Simulation(gas_scene(), threads=2) as simulation:
        start = simulation.snapshot()
        simulation.step(STEPS)
        end = simulation.snapshot()
    flows = start.particles["heat_flow"]
    count = len(SPHERES)
    np.testing.assert_allclose(flows[: 2 * count : 2], (HOT - COLD) * spheres, rtol=1e-8)
    assert flows[1 : 2 * count : 2].tolist() == (-flows[: 2 * count : 2]).tolist()
    np.testing.assert_allclose(flows[2 * count :], (HOT - COLD) * walls, rtol=1e-8)
    capacities = np.array([[mass(first), mass(second)] for first, second, _ in SPHERES]) * CAPACITY
    found = end.particles["temperature"]
    differences = found[1 : 2 * count : 2] - found[: 2 * count : 2]
    rates = spheres * (1.0 / capacities).sum(axis=1)
    explicit = (HOT - COLD) * (1.0 - rates * TIME_STEP) ** STEPS
    np.testing.assert_allclose(differences, explicit, rtol=1e-8)
    assert differences.min() < 0.9 * (HOT - COLD)
    gained = end.totals["heat_content"] - start.totals["heat_content"]
    given = sum(end.totals[f"wall_heat.plate_{k}"] for k in range(len(WALLS)))
    assert given > 0.0 and gained == pytest.approx(given, rel=1e-9)


def test_without_the_resistance_of_the_solid_the_gas_alone_limits_the_flow():
    """The ratios of the resistance in the solid, the only constants that differ, are 0."""
    solid = SimpleNamespace(
        young_modulus=1e7, poisson_ratio=0.3, thermal_conductivity=2.0, true_young_modulus=None
    )
    pair = PairMaterial(modulus_eff(solid, solid), 1.0, 0.5, materials=(solid, solid))
    both, gas_only = (
        Conduction(gas=Gas(GAS, GAP, FILM, resists, 1e-3)).pair_constants(pair) for resists in (True, False)
    )
    assert both == pytest.approx((4.0, 1.0, 0.5 * GAS, 0.5 * GAS))
    assert gas_only == pytest.approx((4.0, 1.0, 0.0, 0.0))


def test_fixed_particles_and_a_smallest_gap_beyond_the_film_are_warnings():
    """The film of the largest sphere has 0.6 of 5 mm."""
    warned = ["all particles are fixed" in " ".join(plan_for(gas_scene(f)).warnings) for f in (True, False)]
    assert warned == [True, False]
    for gap, is_beyond in ((3.1e-3, True), (2.9e-3, False)):
        laws = SimpleNamespace(by_slot={"heat": Conduction(gas=Gas(GAS, gap, FILM, True, 5e-3 * FILM))})
        found = list(gap_findings(SimpleNamespace(laws=laws)))
        assert [path[-1] for path, _ in found] == ["min_gap"] * is_beyond
