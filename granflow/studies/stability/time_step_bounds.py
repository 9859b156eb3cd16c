"""Measured stability limit of the time step: the largest step at which confined particles do not gain energy.

Particles with the overlap that the check assumes get a small perturbation; a bisection finds the time step at
which the perturbation grows. The limit of `check` for the same particles is the reference. `real_bounds`
measures one contact model on all lattices: single particles between anchors, a chain, and a dense block.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from granflow import ParticleData, Plan, RunError, Scene, Simulation
from granflow.geometry.sphere import sphere_mass
from granflow.scene.blocks.run import LARGEST_OVERLAP

# ---------------------------------------------------------------- lattices of touching particles
#
# Particles at the boundary are anchors, too heavy to move; they confine the free particles as in the
# interior of a bed.

CHAIN_LENGTH = 10
"""Number of free particles of the chain."""
HALF_CELLS = 6
"""Edge length of the dense block, in halves of its cubic cell."""


@dataclass(frozen=True)
class TestLattice:
    """Particle centers (n, 3) over the nearest-neighbor distance, and anchor flags (n,) bool."""

    centers: np.ndarray
    is_anchor: np.ndarray

    @property
    def max_contacts(self) -> int:
        """Largest number of simultaneous contacts per particle that `check` can assume."""
        return len(self.centers) - 1

    @property
    def has_free_pairs(self) -> bool:
        """Whether free particles touch each other; otherwise they touch anchors only."""
        return int(np.sum(~self.is_anchor)) > 1


def _confined_particle(directions: np.ndarray) -> TestLattice:
    """One free particle between anchors at unit distance in the given directions (n, 3)."""
    unit = directions / np.linalg.norm(directions, axis=1)[:, None]
    return TestLattice(np.concatenate([np.zeros((1, 3)), unit]), np.arange(len(unit) + 1) > 0)


def _chain() -> TestLattice:
    """Straight chain along z with an anchor at each end."""
    place = np.arange(CHAIN_LENGTH + 2)
    return TestLattice(
        place[:, None] * np.array([[0.0, 0.0, 1.0]]), (place == 0) | (place == CHAIN_LENGTH + 1)
    )


def _block() -> TestLattice:
    """Face-centered cubic packing enclosed by anchors."""
    points = np.array([p for p in product(range(HALF_CELLS + 1), repeat=3) if sum(p) % 2 == 0])
    return TestLattice(points / np.sqrt(2.0), np.any((points == 0) | (points == HALF_CELLS), axis=1))


_AXES = np.concatenate([np.eye(3), -np.eye(3)])
"""Directions (6, 3) of a particle in a simple cubic packing to its neighbors."""
_DIAGONALS = np.array([p for p in product((-1.0, 0.0, 1.0), repeat=3) if sum(map(abs, p)) == 2.0])
"""Directions (12, 3) of a particle in a face-centered cubic packing to its neighbors."""
LATTICES: Mapping[str, TestLattice] = {
    "between 2": _confined_particle(_AXES[[2, 5]]),
    "between 6": _confined_particle(_AXES),
    "between 12": _confined_particle(_DIAGONALS),
    "chain of 10": _chain(),
    "densest packing": _block(),
}
"""Lattices by name: one particle between anchors, a straight chain, and a block with 12 contacts per
particle."""

# ---------------------------------------------------------------- measurement

RADIUS, DENSITY, YOUNG, POISSON, YIELD = 1e-3, 2500.0, 1e8, 0.25, 1e6
"""Radius [m], density [kg/m3], Young's modulus [Pa], Poisson ratio and yield strength [Pa] of the
particles."""
ANCHOR = 1e9
"""Density of an anchor over that of a free particle."""
VELOCITY = 1e-3
"""Approach velocity [m/s] whose maximum overlap the particles get; small enough to avoid buckling of
chains."""
SPRING = 1e3
"""Stiffness [N/m] of the linear springs."""
PERTURBATION = 1e-3
"""Speed of the perturbation over VELOCITY."""
GROWTH_LIMIT = 1e4
"""Kinetic energy over that of the perturbation that counts as growth: a hundredth of the energy of a
collision.

A contact that reverses for the first time within a step releases up to a fiftieth of that, once.
"""
CHECKS, STEPS_PER_CHECK = 30, 10
"""Number of energy checks of a run, and time steps between two of them."""
LOWEST, HIGHEST = 0.25, 4.0
"""Search range of the bisection, over the limit of the check."""
RESOLUTION = 1.02
"""Final ratio of the bisection interval."""
FRICTION = 10.0
"""Friction coefficient that prevents sliding."""
LAWS: Mapping[str, tuple[Any, float | None]] = {
    "zhou": ("zhou", 0.5),
    "zhou, e 0": ("zhou", 0.0),
    "zhou, damped 0.2": ({"law": "zhou", "damping_ratio": 0.2}, 0.5),
    "hertz, e 1": ("hertz", 1.0),
    "hertz, e 0.5": ("hertz", 0.5),
    "hertz, e 0.05": ("hertz", 0.05),
    "linear, e 1": ({"law": "linear", "stiffness": {"value": SPRING}}, 1.0),
    "linear, e 0.5": ({"law": "linear", "stiffness": {"value": SPRING}}, 0.5),
    "linear, e 0.05": ({"law": "linear", "stiffness": {"value": SPRING}}, 0.05),
    "thornton": ({"law": "thornton", "yield_ratio": 1.6}, None),
    "walton_braun": ({"law": "walton_braun", "stiffness": {"value": SPRING}, "unloading": "constant"}, 0.5),
    "luding": ({"law": "luding", "stiffness": {"value": SPRING}, "plasticity_depth": 0.01}, 0.5),
    "kuwabara_kono": ({"law": "kuwabara_kono", "reference_velocity": VELOCITY}, 0.5),
}
"""`contact.normal` and restitution by name."""


@dataclass(frozen=True)
class Bound:
    """Measured limit `bound` [s] and limit of the check `allowed` [s] for a contact model and a lattice.

    Both refer to the same overlaps and numbers of contacts.
    """

    law: str
    friction: bool
    lattice: str
    bound: float
    allowed: float
    scale: float
    """sqrt(M/K) of one contact [s]."""

    @property
    def ratio(self) -> float:
        """Measured limit over the limit of the check."""
        return self.bound / self.allowed


def real_bounds(law: str, friction: bool) -> list[Bound]:
    """Measured stability limits on every lattice with one contact model.

    `law`: key of LAWS; `friction`: with the friction coefficient FRICTION, which prevents sliding. All
    lattices share one engine.
    """
    first = _particles(next(iter(LATTICES.values())), 0.0, friction)
    simulation = Simulation(_scene(law, FRICTION if friction else 0.0), particles=first)
    bounds = []
    plan = simulation.plan
    for name, lattice in LATTICES.items():
        pair_case = _pair_case(plan, lattice)
        impact = (pair_case.pair, pair_case.radius_eff, pair_case.mass_eff, VELOCITY)
        allowed = pair_case.stable_step(plan.laws.normal, VELOCITY)
        scale = np.sqrt(pair_case.mass_eff / plan.laws.normal.stable_stiffness(*impact))
        particles = _particles(lattice, plan.laws.normal.overlap_max(*impact), friction)
        bound = _find_bound(simulation, particles, allowed)
        bounds.append(Bound(law, friction, name, bound, allowed, float(scale)))
    simulation.free()
    return bounds


def _pair_case(plan: Plan, lattice: TestLattice) -> Any:
    """Pair case of a lattice: free particles with each other, or with anchors only."""
    partner = "free" if lattice.has_free_pairs else "anchors"
    pair_case = next(each for each in plan.pair_cases if each.name == f"free-{partner}")
    return replace(pair_case, contact_count=lattice.max_contacts)


def _scene(law: str, friction: float) -> Scene:
    """Scene with free particles and anchors of equal elasticity, without gravity; particles are inserted
    later.

    `law`: key of LAWS; `friction`: coefficient. The groups provide the capacity for the largest lattice.
    """
    normal, restitution = LAWS[law]
    solid = {"young_modulus": YOUNG, "poisson_ratio": POISSON, "yield_strength": YIELD}
    pair = {"friction": friction} | ({} if restitution is None else {"restitution": restitution})
    names = ("light", "heavy")
    side = 100 * RADIUS
    count = max(len(lattice.centers) for lattice in LATTICES.values())
    region = {"box": {"min": [-side] * 3, "max": [side] * 3}}
    group = {"count": count, "diameter": 2 * RADIUS, "insert": {"kind": "lattice", "region": region}}
    return Scene.from_dict(
        {
            "title": "Stability limit of the time step",
            "gravity": [0, 0, 0],
            "materials": {
                "light": {**solid, "density": DENSITY},
                "heavy": {**solid, "density": DENSITY * ANCHOR},
            },
            "pairs": {f"{a}-{b}": pair for a, b in (names[:1] * 2, names, names[1:] * 2)},
            "contact": {"normal": normal, "tangential": "mindlin" if friction else "none", "rolling": "none"},
            "particles": {"free": {"material": "light", **group}, "anchors": {"material": "heavy", **group}},
            "domain": {"min": [-side] * 3, "max": [side] * 3, "on_exit": "delete"},
            "run": {"duration": 1.0, "velocity_max": VELOCITY},
            "numerics": {"max_overlap": LARGEST_OVERLAP, "skin": RADIUS},
            "output": {"interval": 1.0},
        }
    )


def _particles(lattice: TestLattice, overlap: float, with_friction: bool) -> ParticleData:
    """Particles of the lattice with this overlap [m]; random perturbation of the free particles.

    Without friction the perturbation is limited to the directions in which the lattice extends.
    """
    count = len(lattice.centers)
    perturbation = (
        PERTURBATION
        * VELOCITY
        * np.random.default_rng(1).uniform(-1.0, 1.0, (2, count, 3))
        * ~lattice.is_anchor[:, None]
    )
    if not with_friction:
        # Chains are laterally unstable at any time step.
        perturbation *= np.abs(lattice.centers).max(axis=0) > 0.0
    kind = lattice.is_anchor.astype(np.int32)
    return ParticleData(
        position=lattice.centers * (2 * RADIUS - overlap),
        velocity=perturbation[0],
        angular_velocity=perturbation[1] / RADIUS,
        radius=np.full(count, RADIUS),
        material=kind,
        group=kind,
    )


def _find_bound(simulation: Simulation, particles: ParticleData, allowed: float) -> float:
    """Time step [s] above which the perturbation grows, by bisection on a logarithmic scale.

    `allowed` [s]: limit of the check; the search range is LOWEST to HIGHEST times it.
    """
    low, high = LOWEST * allowed, HIGHEST * allowed
    while high > RESOLUTION * low:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if _is_unstable(simulation, particles, middle) else (middle, high)
    return float(np.sqrt(low * high))


def _is_unstable(simulation: Simulation, particles: ParticleData, step: float) -> bool:
    """Whether the perturbation grows at this time step [s], or the run aborts."""
    simulation.restart(particles, step)
    mass = sphere_mass(RADIUS, DENSITY)
    initial_energy = _kinetic(particles.velocity, particles.angular_velocity, mass)
    for _ in range(CHECKS):
        try:
            simulation.step(STEPS_PER_CHECK)
        except RunError:
            return True
        arrays = simulation.snapshot().particles
        free = arrays["material"] == 0
        energy = _kinetic(arrays["velocity"][free], arrays["angular_velocity"][free], mass)
        if not energy < GROWTH_LIMIT * initial_energy:
            return True
    return False


def _kinetic(velocity: np.ndarray, angular_velocity: np.ndarray, mass: float) -> float:
    """Kinetic energy of translation and rotation [J] of spheres with equal mass [kg].

        E = m/2 sum v^2 + (2/5) m R^2 / 2 sum w^2

    `velocity` (n, 3) [m/s], `angular_velocity` (n, 3) [rad/s].
    """
    return 0.5 * mass * float(np.sum(velocity**2) + 0.4 * RADIUS**2 * np.sum(angular_velocity**2))
