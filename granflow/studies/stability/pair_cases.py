"""Head-on collisions of any number of distant pairs in one scene, until all pairs have separated.

The pairs share the time step of the stiffest one. The total momentum of each pair is 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from granflow.contact.material import VelocityRestitution
from granflow.geometry.sphere import sphere_mass
from granflow.studies.collision_bench import Collision, CollisionBench
from granflow.studies.stability.cases import CaseResult

POISSON = 0.25
"""Poisson ratio of all particles."""

GAP = 1e-3
"""Initial gap over the smaller radius."""
MAX_OVERLAP = 0.1
"""Overlap over radius above which a run is aborted, the default of scenes."""
SKIN = 0.3
"""Skin over the smallest radius; equal for all cases, so that the kernels compile once."""


@dataclass(frozen=True)
class ParticlePair:
    """Two particles of equal elasticity that collide head-on, in SI units.

    `radius_ratio`, `density_ratio`: second particle over the first.
    """

    young_modulus: float = 1e8
    restitution: float | tuple[float, float, float] = 0.7
    """A number, or sigma, psi and limit velocity [m/s] of Eq. 12."""
    velocity: float = 1.0
    radius: float = 1e-3
    density: float = 2500.0
    radius_ratio: float = 1.0
    density_ratio: float = 1.0

    @property
    def masses(self) -> np.ndarray:
        """Masses of both particles (2,) [kg]."""
        return sphere_mass(self.radius, self.density) * np.array([1.0, self.radius_ratio**3 * self.density_ratio])

    @property
    def requested(self) -> float:
        """Target restitution."""
        if isinstance(self.restitution, float):
            return self.restitution
        return float(VelocityRestitution(*self.restitution)(self.velocity))


@dataclass(frozen=True)
class Rebound:
    """Results of the pairs (n,): restitution, and momentum error over m v with the smaller mass m.

    `time_step` [s]; `warnings`: of the plan.
    """

    restitution: np.ndarray
    momentum: np.ndarray
    time_step: float
    warnings: tuple[str, ...]


@cache
def rebound(pairs: tuple[ParticlePair, ...], precision: str = "f64", share: float | None = None) -> Rebound:
    """Collide the pairs with Zhou's model, at `share` of the largest permitted time step, or at the default one.

    Cached: cases with the same pairs share one run. Raises SceneError if the time step is refused, RunError if the run
    aborts.
    """
    step = None if share is None else share * _largest_step(pairs)
    bench = _bench(pairs, precision, step)
    bench.rebound()
    velocity, chosen = bench.motions()[0][:, :, 0], bench.plan.step
    bench.free()
    masses, speeds = np.array([pair.masses for pair in pairs]), np.array([pair.velocity for pair in pairs])
    momentum_error = np.abs(np.sum(masses * velocity, axis=1)) / (masses.min(axis=1) * speeds)
    return Rebound((velocity[:, 1] - velocity[:, 0]) / speeds, momentum_error, chosen.value, chosen.warnings)


@cache
def _largest_step(pairs: tuple[ParticlePair, ...]) -> float:
    """Largest permitted time step [s]."""
    return _bench(pairs, "f64").plan.step.stable_below


def _bench(pairs: Sequence[ParticlePair], precision: str, time_step: float | None = None) -> CollisionBench:
    """Bench with all pairs; `time_step` [s]: automatic if None. The materials of pair 0 are a0 and b0, and so on."""
    materials, pairs_of_materials, collisions = {}, {}, []
    for index, pair in enumerate(pairs):
        names, masses = (f"a{index}", f"b{index}"), pair.masses
        for name, ratio in zip(names, (1.0, pair.density_ratio), strict=True):
            density = pair.density * ratio
            materials[name] = {"young_modulus": pair.young_modulus, "poisson_ratio": POISSON, "density": density}
        pairs_of_materials["-".join(names)] = {"restitution": _restitution_setting(pair), "friction": 0}
        gap = GAP * pair.radius * min(pair.radius_ratio, 1.0)
        collisions.append(Collision(
            *names, pair.radius, pair.radius * pair.radius_ratio, pair.velocity, share=masses[1] / masses.sum(),
            first_contact=gap / pair.velocity,
        ))  # fmt: skip
    smallest = min(pair.radius * min(pair.radius_ratio, 1.0) for pair in pairs)
    return CollisionBench(
        materials, pairs_of_materials, {"normal": "zhou"}, collisions,
        run={
            "precision": precision, "velocity_max": max(pair.velocity for pair in pairs),
            "duration": 1.0 + 10.0 * max(each.first_contact for each in collisions), "time_step": time_step or "auto",
        },
        numerics={"skin": SKIN * smallest, "max_overlap": MAX_OVERLAP},
    )  # fmt: skip


def _restitution_setting(pair: ParticlePair) -> Any:
    """`restitution` of the pair in the structure of a scene file."""
    if isinstance(pair.restitution, float):
        return pair.restitution
    sigma, psi, limit = pair.restitution
    return {"sigma": sigma, "psi": psi, "limit_velocity": limit}


def rebound_result(
    pairs: tuple[ParticlePair, ...], index: int, precision: str = "f64", share: float | None = None
) -> CaseResult:
    """Larger error of restitution and momentum of one pair, relative to the approach velocity.

    `index`: of the pair; warnings about other pairs are omitted. Raises the errors of `rebound`.
    """
    found, requested = rebound(pairs, precision, share), pairs[index].requested
    reached, momentum_error = float(found.restitution[index]), float(found.momentum[index])
    others = [f"a{other}-b{other}:" for other in range(len(pairs)) if other != index]
    warnings = tuple(text for text in found.warnings if not text.startswith(tuple(others)))
    if momentum_error > abs(reached - requested):
        return CaseResult("momentum error", 0.0, momentum_error, momentum_error, found.time_step, warnings)
    return CaseResult("restitution", requested, reached, abs(reached - requested), found.time_step, warnings)
