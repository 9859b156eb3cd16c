"""Head-on collisions of any number of distant pairs in one scene, until all pairs have separated.

The pairs share the time step of the stiffest one. The total momentum of each pair is 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from granflow.contact import theory
from granflow.contact.material import VelocityRestitution
from granflow.engine.backend import Precision
from granflow.load import Scene
from granflow.plan.build import plan_for
from granflow.scene.schema.scene import SceneInput
from granflow.simulation import Simulation
from granflow.studies.stability.cases import CaseResult

POISSON = 0.25
"""Poisson ratio of all particles."""

GAP = 1e-3
"""Initial gap over the smaller radius."""
SPACING = 5.0
"""Distance of neighboring pairs over the larger radius."""
RUN_DURATIONS = 3.0
"""Run time after first contact, in durations of the slowest collision."""
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
        sizes = np.array([1.0, self.radius_ratio**3 * self.density_ratio])
        return 4.0 / 3.0 * np.pi * self.radius**3 * self.density * sizes

    @property
    def velocities(self) -> np.ndarray:
        """Velocities of both particles (2,) [m/s] with zero total momentum."""
        return self.velocity * self.masses[::-1] / self.masses.sum() * np.array([1.0, -1.0])

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
def rebound(pairs: tuple[ParticlePair, ...], precision: Precision = "f64", share: float | None = None) -> Rebound:
    """Collide the pairs with Zhou's model, at `share` of the largest permitted time step, or at the default one.

    Cached: cases with the same pairs share one run. Raises SceneError if the time step is refused, RunError if the run
    aborts.
    """
    step = None if share is None else share * _largest_step(pairs)
    simulation = Simulation(scene_of(pairs, precision, step))
    simulation.run()
    velocity = simulation.snapshot().particles["velocity"][:, 0].astype(float).reshape(-1, 2)
    chosen = simulation.plan.step
    simulation.free()
    masses = np.array([pair.masses for pair in pairs])
    speeds = np.array([pair.velocity for pair in pairs])
    momentum_error = np.abs(np.sum(masses * velocity, axis=1)) / (masses.min(axis=1) * speeds)
    return Rebound((velocity[:, 1] - velocity[:, 0]) / speeds, momentum_error, chosen.value, chosen.warnings)


@cache
def _largest_step(pairs: tuple[ParticlePair, ...]) -> float:
    """Largest permitted time step [s]."""
    return plan_for(scene_of(pairs, "f64")).step.stable_below


def scene_of(pairs: Sequence[ParticlePair], precision: Precision, time_step: float | None = None) -> Scene:
    """Scene of all pairs with separate materials, in a square grid normal to the approach direction.

    `time_step` [s]: automatic if None. Materials a0, b0, a1, ...: one pair of materials per collision.
    """
    side = int(np.ceil(np.sqrt(len(pairs))))
    spacing = SPACING * max(pair.radius * max(pair.radius_ratio, 1.0) for pair in pairs)
    materials, pairs_of_materials, particles = {}, {}, {}
    for index, pair in enumerate(pairs):
        row, column = divmod(index, side)
        names = (f"a{index}", f"b{index}")
        for number, name in enumerate(names):
            ratio = pair.density_ratio if number else 1.0
            materials[name] = {
                "young_modulus": pair.young_modulus, "poisson_ratio": POISSON, "density": pair.density * ratio
            }  # fmt: skip
            particles[name] = {"material": name, **_particle(pair, number, spacing * row, spacing * column)}
        pairs_of_materials["-".join(names)] = {"restitution": _restitution_setting(pair), "friction": 0}
    reach = spacing * (side + 1)
    smallest = min(pair.radius * min(pair.radius_ratio, 1.0) for pair in pairs)

    return Scene.of(SceneInput.model_validate({
        "title": "Head-on collisions",
        "gravity": [0, 0, 0],
        "materials": materials,
        "pairs": pairs_of_materials,
        "contact": {"normal": "zhou", "tangential": "none", "rolling": "none"},
        "particles": particles,
        "domain": {"min": [-reach] * 3, "max": [reach] * 3, "on_exit": "error"},
        "run": {
            "precision": precision, "velocity_max": max(pair.velocity for pair in pairs),
            "duration": max(_duration(pair) for pair in pairs), "time_step": time_step or "auto",
        },
        "numerics": {"skin": SKIN * smallest},
        "output": {"interval": 1e9},
    }))  # fmt: skip


def _particle(pair: ParticlePair, number: int, y: float, z: float) -> dict[str, Any]:
    """Diameter, velocity and position of the first or second particle of a pair; first contact is at x = 0."""
    radius = pair.radius * (pair.radius_ratio if number else 1.0)
    gap = 0.5 * GAP * pair.radius * min(pair.radius_ratio, 1.0)
    position = (radius + gap) * (1.0 if number else -1.0)
    return {
        "diameter": [2.0 * radius], "velocity": [[float(pair.velocities[number]), 0.0, 0.0]],
        "insert": {"kind": "positions", "positions": [[position, y, z]]},
    }  # fmt: skip


def _restitution_setting(pair: ParticlePair) -> Any:
    """`restitution` of the pair in the structure of a scene file."""
    if isinstance(pair.restitution, float):
        return pair.restitution
    sigma, psi, limit = pair.restitution
    return {"sigma": sigma, "psi": psi, "limit_velocity": limit}


def _duration(pair: ParticlePair) -> float:
    """Time [s] for approach and separation of a pair, with a safety margin."""
    masses, modulus = pair.masses, 0.5 * pair.young_modulus / (1.0 - POISSON**2)
    radius_eff = pair.radius * pair.radius_ratio / (1.0 + pair.radius_ratio)
    k, mass = theory.hertz_stiffness(modulus, radius_eff), float(masses.prod() / masses.sum())
    gap = GAP * pair.radius * min(pair.radius_ratio, 1.0)
    return gap / pair.velocity + RUN_DURATIONS * float(theory.duration(1.0, k, mass, pair.velocity))


def rebound_result(
    pairs: tuple[ParticlePair, ...], index: int, precision: Precision = "f64", share: float | None = None
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
