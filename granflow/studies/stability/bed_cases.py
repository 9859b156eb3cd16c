"""Many-particle cases: static loads, falling, compressed, impacted and vibrated beds, and their measurements."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from granflow import Plan, Scene, Simulation, plan_for
from granflow.geometry.sphere import sphere_volume
from granflow.studies.stability.cases import CaseResult

RADIUS, DENSITY, YOUNG, POISSON, GRAVITY = 1e-3, 2500.0, 5e7, 0.25, 9.81
"""Radius [m], density [kg/m3], Young's modulus [Pa], Poisson ratio, gravity [m/s2]."""

DIAMETER = 2.0 * RADIUS
"""Diameter of the particles [m]."""

LAWS: Mapping[str, Any] = {"zhou": "zhou", "hertz": "hertz", "linear": {"law": "linear", "stiffness": "onset"}}
"""Settings of `contact.normal` by name; every pair has restitution 0.5."""
ROW = 4
"""Particles along each edge of a bed."""
SIDE = ROW * DIAMETER
"""Edge of a bed [m]."""

REST_STEPS = 20_000
"""Number of steps of a static case."""


def scene_with(law: str, particles: Mapping[str, Any], duration: float, **changes: Any) -> Scene:
    """Scene with particles of the materials `light` and `heavy`, and walls of `light`.

    `law`: key of LAWS; `particles`: groups by name; `duration` [s]. `changes` replace defaults: friction, gravity
    [m/s2], walls, numerics, run, young_modulus [Pa], density of `heavy` [kg/m3], reach [m].
    """
    solid = {"young_modulus": changes.get("young_modulus", YOUNG), "poisson_ratio": POISSON}
    pair = {"restitution": 0.5, "friction": changes.get("friction", 0.3)}
    reach = changes.get("reach", 10.0 * SIDE)
    return Scene.from_dict({
        "title": "Many particles in an extreme case",
        "gravity": [0, 0, -changes.get("gravity", GRAVITY)],
        "materials": {
            "light": {**solid, "density": DENSITY}, "heavy": {**solid, "density": changes.get("density", DENSITY)}
        },
        "pairs": {"light-light": pair, "light-heavy": pair, "heavy-heavy": pair},
        "contact": {"normal": LAWS[law], "tangential": "mindlin", "rolling": "none"},
        "walls": changes.get("walls", {"floor": _plane([0, 0, 0], [0, 0, 1])}),
        "particles": particles,
        "domain": {"min": [-reach, -reach, -0.1 * reach], "max": [reach] * 3, "on_exit": "error"},
        "run": {"duration": duration, **changes.get("run", {})},
        "numerics": changes.get("numerics", {}),
        "output": {"interval": 1e9, "energy_budget": True},
    })  # fmt: skip


def _plane(point: list[float], normal: list[float], motion: Any = ()) -> dict[str, Any]:
    """Plane wall through a point [m] with a normal."""
    return {"shape": "plane", "point": point, "normal": normal, "material": "light", "motion": list(motion)}


def box_walls(motion: Any = (), spread: float = 0.0) -> dict[str, Any]:
    """A floor, optionally moving, and four walls around a bed with this relative spacing."""
    low, high = -0.5 * SIDE * (1.0 + spread), 0.5 * SIDE * (1.0 + spread)
    return {
        "floor": _plane([0, 0, 0], [0, 0, 1], motion),
        "west": _plane([low, 0, 0], [1, 0, 0]), "east": _plane([high, 0, 0], [-1, 0, 0]),
        "south": _plane([0, low, 0], [0, 1, 0]), "north": _plane([0, high, 0], [0, -1, 0]),
    }  # fmt: skip


def particles_at(positions: Any, velocity: Any = (0.0, 0.0, 0.0), material: str = "light") -> dict[str, Any]:
    """A group of particles at positions (n, 3) [m]."""
    return {
        "material": material, "diameter": DIAMETER, "velocity": np.asarray(velocity, float).tolist(),
        "insert": {"kind": "positions", "positions": np.asarray(positions, float).tolist()},
    }  # fmt: skip


def bed_positions(height: float = 0.0, spread: float = 0.0) -> np.ndarray:
    """Positions (n, 3) [m] of a cube of touching particles, `height` [m] above the floor.

    `spread` increases the spacing by this fraction and adds random shifts, the same in each call.
    """
    points = np.stack(np.meshgrid(*[np.arange(ROW)] * 3, indexing="ij"), axis=-1).reshape(-1, 3).astype(float)
    points = (points + 0.5) * DIAMETER - np.array([0.5 * SIDE, 0.5 * SIDE, 0.0])
    points *= 1.0 + spread
    shift = np.random.default_rng(1).uniform(-1.0, 1.0, points.shape) * 0.25 * spread * RADIUS
    return points + shift + np.array([0.0, 0.0, height])


def energy_budget_result(scene: Scene) -> CaseResult:
    """Run the scene; the error is the magnitude of `energy_error` at the end of the run.

    Raises RunError after an abort.
    """
    simulation = Simulation(scene)
    try:
        result = simulation.run()
    finally:
        simulation.free()
    error = float(result.totals["energy_error"])
    step = simulation.plan.step
    return CaseResult("energy error", 0.0, error, abs(error), step.value, step.warnings)


def energy_budget_result_of(
    law: str, particles: Mapping[str, Any], duration: float, changes: Mapping[str, Any]
) -> CaseResult:
    """`energy_budget_result` of `scene_with`."""
    return energy_budget_result(scene_with(law, particles, duration, **changes))


def column_at_rest(law: str, densities: tuple[float, ...], young_modulus: float) -> CaseResult:
    """Column of particles at rest, lowest first: the floor force must remain equal to the weight.

    `densities` [kg/m3] from bottom to top; `young_modulus` [Pa]. The initial overlaps are those of the equilibrium; the
    error is that of the force on the floor after REST_STEPS steps, relative to the weight.
    """
    weights = GRAVITY * sphere_volume(RADIUS) * np.array(densities)
    heavy = max(densities)
    names = ["heavy" if density == heavy and heavy != DENSITY else "light" for density in densities]

    def scene(heights: np.ndarray) -> Scene:
        centers = np.stack([0.0 * heights, 0.0 * heights, heights], axis=1)
        groups = {
            name: particles_at(centers[[each == name for each in names]], material=name)
            for name in dict.fromkeys(names)
        }
        reach = max(10.0 * SIDE, 2.5 * RADIUS * len(densities))
        return scene_with(law, groups, 1.0, density=heavy, young_modulus=young_modulus, reach=reach)

    touching = RADIUS * (1.0 + 2.0 * np.arange(len(densities)))
    plan = plan_for(scene(touching))
    supported_weights = np.cumsum(weights[::-1])[::-1]
    masses = np.append(np.inf, weights / GRAVITY)
    overlaps = [_overlap_for_load(plan, index, supported_weights[index], masses) for index in range(len(densities))]
    simulation = Simulation(scene(touching - np.cumsum(overlaps)))
    simulation.run(until=REST_STEPS * simulation.plan.time_step)
    contacts = simulation.snapshot(contacts=True).contacts
    assert contacts is not None
    floor = float(contacts["normal_force"][contacts["wall"] >= 0].sum())
    step = simulation.plan.step
    simulation.free()
    weight = float(weights.sum())
    return CaseResult("force on the floor [N]", weight, floor, abs(floor / weight - 1.0), step.value, step.warnings)


def _overlap_for_load(plan: Plan, index: int, load: float, masses: np.ndarray) -> float:
    """Overlap [m] at which contact `index` of a column carries a load [N]; contact 0 is at the floor.

    `masses` (n + 1,) [kg]: floor (infinite) and particles. The force is that of the reference implementation.
    """
    from scipy.optimize import brentq

    radius_eff = RADIUS if index == 0 else 0.5 * RADIUS
    lower, upper = masses[index], masses[index + 1]
    mass_eff = upper if index == 0 else lower * upper / (lower + upper)
    constants = plan.pair_constants[0]
    history = np.zeros(plan.law.history_count)

    def excess(overlap: float) -> float:
        arguments = (constants, radius_eff, mass_eff, plan.time_step, overlap, 0.0, history)
        return plan.law.reference_force(*arguments)[0] - load

    least = 1e-15 * RADIUS  # without an overlap the particles are not in contact and have no force
    return float(brentq(excess, least, RADIUS, xtol=least, rtol=1e-15))
