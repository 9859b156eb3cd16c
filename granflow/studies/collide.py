"""A single head-on collision with the many-particle kernels, compared with closed forms."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow.contact import theory
from granflow.contact.law import NormalLaw
from granflow.contact.material import PairMaterial
from granflow.contact.registry import models
from granflow.engine.backend import start
from granflow.engine.engine import Engine
from granflow.errors import GranflowError, SceneError
from granflow.particles.generate import initial_particles
from granflow.plan.pair_cases import build_laws, pair_material
from granflow.plan.plan import Plan, plan_for
from granflow.scene.reader import scene_in
from granflow.scene.schema.presets import PRESETS
from granflow.scene.schema.scene import LARGEST_OVERLAP, Scene
from granflow.scene.suggest import suggestion_or_list
from granflow.scene.writer import to_yaml
from granflow.scene.yaml12 import parse

WALL = "wall"
"""Name of the wall in the scene."""

HALVINGS = 60
"""Number of bisection steps; sufficient for float64 precision of the overlap."""
SHORT = 1e-3
"""Time step of the reference integration relative to the duration; sub-step corrections are then negligible."""
LONGEST = 20.0
"""Maximum length of a collision in units of its expected duration."""


@dataclass(frozen=True)
class CollisionInput:
    """Input of a collision: material pair, effective radius [m], effective mass [kg], approach velocity [m/s]."""

    pair: PairMaterial
    radius_eff: float
    mass_eff: float
    velocity: float


def collide(
    law: str,
    material: str,
    diameter: float,
    velocity: float,
    diameter2: float | None = None,
    material2: str | None = None,
    wall: bool = False,
    restitution: float | None = None,
    steps_per_contact: float | None = None,
    precision: str | None = None,
    arch: str = "cpu",
    settings: Sequence[str] = (),
) -> dict[str, float]:
    """Collide two spheres, or a sphere and a wall, head on. All values are in SI units.

    `law`: contact model; `material`, `material2`: presets; `diameter`, `diameter2` [m]; `velocity` [m/s]: approach
    velocity. `settings` are those of the contact model as "key=value", such as "yield_ratio=2.8"; the example of the
    catalog supplies the others. `steps_per_contact`: expected duration over time step; automatic time step without it.

    Returns the simulated `restitution`, `duration` [s], `overlap_max` and `overlap_residual` [m] and `force_max` [N];
    the expected values under the same names with `_theory`, and the requested restitution with `_asked`; `velocity`
    [m/s], `spring_equation19` [N/m] (Zhou 2011, Eq. 19) and `time_step` [s].

    Raises GranflowError for an unknown preset or contact model, values that are not positive, a restitution that is
    neither given nor known, an overlap of more than a radius, or an unstable time step.
    """
    sizes = (diameter, diameter2 or diameter)
    materials = (material, material2 or material)
    _refuse_unknown(law, materials)
    _refuse_unphysical(sizes, velocity, steps_per_contact)
    _refuse_restitution(law, materials, restitution)
    backend = start(arch, precision or "f64")  # type: ignore[arg-type]
    described = _scene_of(law, materials, sizes, velocity, wall, restitution)
    scene = _read(described, settings)
    impact = _impact(scene, sizes, velocity, wall)
    expected = _expected(build_laws(scene, velocity).normal, impact)
    _refuse_deep(sizes, velocity, expected["overlap_max_theory"])
    if steps_per_contact is not None:
        described["run"]["time_step"] = expected["duration_theory"] / steps_per_contact
    described["run"]["precision"] = backend.precision
    try:
        plan = plan_for(_read(described, settings), on_gpu=not backend.on_cpu)
    except SceneError:
        raise GranflowError(f"{steps_per_contact:g} steps per contact are not stable; use more.") from None
    for warning in plan.step.warnings:
        logging.getLogger("granflow").warning("warning: %s", warning)
    return expected | _integrate_collision(Engine(plan, backend), plan, impact) | {"time_step": plan.time_step}


def _refuse_unknown(law: str, materials: tuple[str, str]) -> None:
    """Raise GranflowError for an unknown contact model or preset, with a suggestion."""
    if law not in models("normal"):
        raise GranflowError(
            f"Unknown contact model {law}. {_sentence(suggestion_or_list(law, models('normal'), 'contact models'))}"
        )
    for name in materials:
        if name not in PRESETS:
            raise GranflowError(f"Unknown preset {name}. {_sentence(suggestion_or_list(name, PRESETS, 'presets'))}")


def _sentence(remedy: str) -> str:
    return remedy if remedy.endswith("?") else f"{remedy}."


def _refuse_unphysical(sizes: tuple[float, float], velocity: float, steps_per_contact: float | None) -> None:
    """Raise GranflowError for a diameter [m], velocity [m/s] or number of steps that is not above 0."""
    for name, value in (("diameter", min(sizes)), ("velocity", velocity), ("steps_per_contact", steps_per_contact)):
        if value is not None and not value > 0.0:
            raise GranflowError(f"{name} is {value:g}, but must be above 0.")


def _refuse_deep(sizes: tuple[float, float], velocity: float, overlap_max: float) -> None:
    """Raise GranflowError if the maximum overlap [m] exceeds a radius: the spheres would pass through each other."""
    radius = 0.5 * min(sizes)
    if not overlap_max < radius:
        reached = f"the overlap would reach {overlap_max:.3g} m, more than the radius of {radius:.3g} m"
        raise GranflowError(f"velocity is {velocity:g} m/s, but {reached}; reduce the velocity.")


def _refuse_restitution(law: str, materials: tuple[str, str], restitution: float | None) -> None:
    """Raise GranflowError for a restitution that the contact model does not support or that is missing.

    Depending on the model, a restitution is required, must be above 0, or must not be given.
    """
    kind = models("normal")[law]
    if restitution is not None and not 0.0 <= restitution <= 1.0:
        raise GranflowError(f"restitution is {restitution:g}, but must be in [0, 1].")
    if kind.restitution == "nothing":
        if restitution is not None:
            raise GranflowError(
                f"The contact model {law} derives the restitution from the materials; remove --restitution."
            )
        if all(PRESETS[name].yield_strength is None for name in materials):
            raise GranflowError(
                f"The contact model {law} requires a yield strength, which {' and '.join(set(materials))} lacks."
            )
    if kind.restitution == "positive number" and restitution is None:
        raise GranflowError(f"The contact model {law} requires a restitution coefficient; give it with --restitution.")
    if kind.restitution == "positive number" and restitution == 0.0:
        raise GranflowError(f"The contact model {law} requires a restitution above 0, such as --restitution 0.1.")


def _read(described: dict[str, Any], settings: Sequence[str]) -> Scene:
    """Scene from its description and the settings of its contact model.

    Raises SceneError as for a scene file; positions refer to the source "collide".
    """
    return scene_in(parse(to_yaml(described), "collide"), [f"contact.normal.{each}" for each in settings])


def _scene_of(
    law: str,
    materials: tuple[str, str],
    sizes: tuple[float, float],
    velocity: float,
    wall: bool,
    restitution: float | None,
) -> dict[str, Any]:
    """Scene of the collision, as a mapping in the structure of a scene file.

    `sizes` [m]; `velocity` [m/s]: approach velocity, half of it for each sphere, or all of it toward a wall. The
    spheres touch at the start. Raises GranflowError if the restitution is unknown.
    """
    first, second = ("first", "second")
    pair = {"friction": 0} | _restitution_given(law, materials, restitution)
    share = 1.0 if wall else 0.5
    sphere = {
        "material": first,
        "diameter": sizes[0],
        "velocity": [share * velocity, 0, 0],
        "insert": {"kind": "positions", "positions": [[-0.5 * sizes[0], 0, 0]]},
    }
    contact_distance = 10.0 * max(sizes)
    scene: dict[str, Any] = {
        "title": "Head-on collision",
        "gravity": [0, 0, 0],
        "materials": {first: {"preset": materials[0]}, second: {"preset": materials[1]}},
        "pairs": {"first-first": pair, "first-second": pair, "second-second": pair},
        "contact": {"normal": {"law": law, **models("normal")[law].example}, "tangential": "none", "rolling": "none"},
        "particles": {"sphere": sphere},
        "domain": {"min": [-contact_distance] * 3, "max": [contact_distance] * 3, "on_exit": "error"},
        "run": {"duration": 1.0, "velocity_max": velocity},
        "numerics": {"max_overlap": LARGEST_OVERLAP},
        "output": {"interval": 1.0},
    }
    if wall:
        scene["walls"] = {WALL: {"shape": "plane", "point": [0, 0, 0], "normal": [-1, 0, 0], "material": second}}
    else:
        other = {"kind": "positions", "positions": [[0.5 * sizes[1], 0, 0]]}
        velocity_back = [-0.5 * velocity, 0, 0]
        scene["particles"]["other"] = {
            "material": second, "diameter": sizes[1], "velocity": velocity_back, "insert": other
        }  # fmt: skip
    return scene


def _restitution_given(law: str, materials: tuple[str, str], restitution: float | None) -> dict[str, Any]:
    """Restitution of the pair as a scene entry; empty if the contact model derives it from the materials.

    Raises GranflowError if it is neither given nor known for the preset.
    """
    if models("normal")[law].restitution == "nothing":
        return {}
    if restitution is not None:
        return {"restitution": restitution}
    if materials[0] == materials[1] and PRESETS[materials[0]].restitution_fit is not None:
        return {"restitution": {"preset": materials[0]}}
    raise GranflowError(
        f"The restitution of the pair {materials[0]}-{materials[1]} is unknown; give it with --restitution."
    )


def _impact(scene: Scene, sizes: tuple[float, float], velocity: float, wall: bool) -> CollisionInput:
    """Effective radius [m] and mass [kg] of the collision; a wall has infinite radius and mass."""
    pair = pair_material(scene, "first", "second")
    radii = 0.5 * np.array(sizes)
    densities = np.array([scene.materials[name].density for name in ("first", "second")])
    masses = 4.0 / 3.0 * np.pi * radii**3 * densities
    if wall:
        return CollisionInput(pair, float(radii[0]), float(masses[0]), velocity)
    return CollisionInput(pair, float(radii.prod() / radii.sum()), float(masses.prod() / masses.sum()), velocity)


def _expected(law: NormalLaw, impact: CollisionInput) -> dict[str, float]:
    """Closed forms of the contact model; for a dashpot without closed form, results of a fine integration."""
    k = float(theory.hertz_stiffness(impact.pair.modulus_eff, impact.radius_eff))
    mass, velocity = impact.mass_eff, impact.velocity
    requested = law.restitution(impact.pair, impact.radius_eff, mass, velocity)
    spring = float(theory.equivalent_spring(k, mass, velocity))
    shared = {"velocity": velocity, "restitution_asked": requested, "spring_equation19": spring}
    return shared | (_integrated(law, impact) if law.rate_dependent else _closed(law, impact))


def _closed(law: NormalLaw, impact: CollisionInput, steps: int = 4000) -> dict[str, float]:
    """Duration from the contact model; maximum overlap and force where the loading work equals the kinetic energy.

        int_0^dmax F dd = M v^2 / 2

    The integral is a sum of trapezoids, `steps` of them in the loading time at the approach velocity; the last one is
    interpolated.
    """
    bodies = (impact.radius_eff, impact.mass_eff)
    loading, unloading = law.phase_durations(impact.pair, *bodies, impact.velocity)
    constants, history = np.array(law.pair_constants(impact.pair)), np.zeros(max(law.history_count, 1))
    moment = loading / steps
    step = impact.velocity * moment
    overlap, force, force_before, energy = 0.0, 0.0, 0.0, 0.5 * impact.mass_eff * impact.velocity**2
    while energy > 0.0:
        force_before, overlap = force, overlap + step
        force, history = law.reference_force(constants, *bodies, moment, overlap, impact.velocity, history)
        energy -= 0.5 * (force_before + force) * step
    # -energy is the excess work of the last step
    overlap_max, force_max = overlap + energy / force, force + (force - force_before) * energy / force / step
    return {
        "duration_theory": loading + unloading,
        "overlap_max_theory": overlap_max,
        "overlap_residual_theory": _end_overlap(law, impact, moment, overlap_max, history),
        "force_max_theory": force_max,
    }


def _end_overlap(
    law: NormalLaw, impact: CollisionInput, time_step: float, overlap: float, history: np.ndarray
) -> float:
    """Overlap [m] at which the elastic force of a contact with this history vanishes, by bisection; 0 if attractive.

    `overlap` [m]: upper end of the search, with a repulsive force; `history`: fields of the contact model.
    """
    constants, low, high = np.array(law.pair_constants(impact.pair)), 0.0, overlap
    for _ in range(HALVINGS if not law.attracts else 0):
        middle = 0.5 * (low + high)
        bodies = (impact.radius_eff, impact.mass_eff)
        force, _memory = law.reference_force(constants, *bodies, time_step, middle, 0.0, history)
        low, high = (low, middle) if force > 0.0 else (middle, high)
    return low


def _integrated(law: NormalLaw, impact: CollisionInput, steps: int = 4000) -> dict[str, float]:
    """Duration [s], maximum overlap [m] and force [N] of M d'' = -F(d, d').

    Classical Runge-Kutta method (fourth order) in numpy with `steps` steps of the expected duration.
    """
    constants = np.array(law.pair_constants(impact.pair))
    step = sum(law.phase_durations(impact.pair, impact.radius_eff, impact.mass_eff, impact.velocity)) / steps
    history = np.zeros(max(law.history_count, 1))
    _, history = law.reference_force(constants, impact.radius_eff, impact.mass_eff, step, 0.0, impact.velocity, history)

    def force(overlap: float, rate: float) -> float:
        if overlap <= 0.0:
            return 0.0
        moment = SHORT * step
        return law.reference_force(constants, impact.radius_eff, impact.mass_eff, moment, overlap, rate, history)[0]

    def slope(state: np.ndarray) -> np.ndarray:
        return np.array([state[1], -force(*state) / impact.mass_eff])

    state, time, overlap_max, force_max = np.array([0.0, impact.velocity]), 0.0, 0.0, 0.0
    while time == 0.0 or force(*state) > 0.0:
        k1 = slope(state)
        k2 = slope(state + 0.5 * step * k1)
        k3 = slope(state + 0.5 * step * k2)
        state = state + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + slope(state + step * k3))
        time += step
        _, history = law.reference_force(
            constants, impact.radius_eff, impact.mass_eff, step, state[0], state[1], history
        )
        overlap_max, force_max = max(overlap_max, state[0]), max(force_max, force(*state))
    return {"duration_theory": time, "overlap_max_theory": overlap_max, "force_max_theory": force_max}


def _integrate_collision(engine: Engine, plan: Plan, impact: CollisionInput) -> dict[str, float]:
    """Run the collision and record the maximum overlap and force, the rebound velocity and the duration.

    Raises GranflowError if the contact does not end within LONGEST times its expected duration.
    """
    engine.insert(initial_particles(plan.scene))
    engine.set_walls([True] * len(plan.walls), [()] * len(plan.walls))
    engine.refresh()
    limit = int(LONGEST * sum(plan.law.phase_durations(
        impact.pair, impact.radius_eff, impact.mass_eff, impact.velocity)) / plan.time_step) + 10  # fmt: skip
    previous = last = _sample(engine, plan)
    overlap_max, force_max, duration, residual = 0.0, 0.0, 0.0, 0.0
    for _ in range(limit):
        engine.advance(1)
        current = _sample(engine, plan)
        overlap_max, force_max = max(overlap_max, current.overlap), max(force_max, current.force)
        if current.force == 0.0 and last.force > 0.0:
            residual = _end_overlap(plan.law, impact, plan.time_step, last.overlap, last.history)
            duration = engine.time - plan.time_step + _remaining(previous, last, residual, plan)
            break
        previous, last = last, current
    engine.free()
    if duration == 0.0 and plan.laws.attracts:
        raise GranflowError("The collision did not end: the attraction prevents separation.")
    if duration == 0.0:
        raise GranflowError("The collision did not end; increase --steps-per-contact.")
    return {
        "restitution": float(-current.rate / impact.velocity),
        "duration": duration,
        "overlap_max": overlap_max,
        "overlap_residual": residual,
        "force_max": force_max,
    }


def _remaining(previous: "_ContactSample", last: "_ContactSample", residual: float, plan: Plan) -> float:
    """Time [s] from the last step with a force to the time at which the force vanishes.

    A viscous force vanishes while the spheres still overlap; the time follows from the line through the last two
    forces. Otherwise the surfaces separate at a constant rate.
    """
    if plan.features.rate_dependent and previous.force > last.force:
        return min(plan.time_step * last.force / (previous.force - last.force), plan.time_step)
    return (last.overlap - residual) / -last.rate


@dataclass(frozen=True)
class _ContactSample:
    """Overlap [m], overlap rate [m/s], force [N] and history of the contact at one step.

    `history` (fields,): of the contact model; the overlap is negative before and after the contact.
    """

    overlap: float
    rate: float
    force: float
    history: np.ndarray


def _sample(engine: Engine, plan: Plan) -> _ContactSample:
    """State of the contact at the present step; positions and velocities are synchronized."""
    arrays = engine.synchronized(("position", "velocity", "force", "mass", "radius"))
    history_field = engine.state.neighbors.history.get("normal")
    history = np.zeros(3) if history_field is None else history_field.to_numpy()[0]
    position, velocity, force = (arrays[name][:, 0].astype(float) for name in ("position", "velocity", "force"))
    contact_distance = float(arrays["radius"].sum(dtype=float))
    if len(position) == 1:
        return _ContactSample(contact_distance + position[0], float(velocity[0]), float(abs(force[0])), history)
    left, right = np.argsort(position)
    overlap = float(contact_distance - (position[right] - position[left]))
    return _ContactSample(overlap, float(velocity[left] - velocity[right]), float(abs(force[0])), history)
