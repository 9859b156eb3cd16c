"""One head-on collision with the many-particle kernels, beside its closed forms."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow.device.backend import start
from granflow.device.engine import Engine
from granflow.errors import GranflowError, SceneError
from granflow.laws import theory
from granflow.laws.catalogue import NORMAL_LAWS
from granflow.laws.law import NormalLaw
from granflow.laws.material import PairMaterial
from granflow.plan import Plan, plan_for
from granflow.plan.plan import build_law, pair_material
from granflow.scene import Scene
from granflow.scene.generate import initial_grains
from granflow.scene.presets import PRESETS
from granflow.scene.reader import scene_in
from granflow.scene.schema import LARGEST_OVERLAP
from granflow.scene.suggest import known_or_meant
from granflow.scene.writer import to_yaml
from granflow.scene.yaml12 import parse

WALL = "wall"
HALVINGS = 60
"""As many leave an overlap exact in float64."""
SHORT = 1e-3
"""Over so small a share of a step a law averages nothing that would be seen."""
LONGEST = 20.0
"""A collision not over after this many durations is given up."""


@dataclass(frozen=True)
class Impact:
    """What collides: the pair, effective radius [m] and mass [kg], approach velocity [m/s]."""

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
    """Collide two spheres, or a sphere and a wall, head on; all in SI.

    `settings` are those of the law as "key=value", such as "yield_ratio=2.8"; what is left out is as the catalogue's
    example has it.

    Returns `restitution`, `duration` [s], `overlap_max` and `overlap_residual` [m], `force_max` [N] as reached, the
    same with `_asked` or `_theory`, `spring_equation19` [N/m] and `time_step` [s]. Raises GranflowError where the
    restitution is not given and not known, or the step is not stable.
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
    expected = _expected(build_law(scene, velocity), impact)
    _refuse_deep(sizes, velocity, expected["overlap_max_theory"])
    if steps_per_contact is not None:
        described["run"]["time_step"] = expected["duration_theory"] / steps_per_contact
    described["run"]["precision"] = backend.precision
    try:
        plan = plan_for(_read(described, settings), on_gpu=not backend.on_cpu)
    except SceneError:
        raise GranflowError(f"A contact of {steps_per_contact:g} steps is not stable: give it more steps.") from None
    for warning in plan.step.warnings:
        logging.getLogger("granflow").warning("warning: %s", warning)
    return expected | _watch(Engine(plan, backend), plan, impact) | {"time_step": plan.time_step}


def _refuse_unknown(law: str, materials: tuple[str, str]) -> None:
    if law not in NORMAL_LAWS:
        raise GranflowError(f"There is no law {law}. {_sentence(known_or_meant(law, NORMAL_LAWS, 'laws'))}")
    for name in materials:
        if name not in PRESETS:
            raise GranflowError(f"There is no preset {name}. {_sentence(known_or_meant(name, PRESETS, 'presets'))}")


def _sentence(remedy: str) -> str:
    return remedy if remedy.endswith("?") else f"{remedy}."


def _refuse_unphysical(sizes: tuple[float, float], velocity: float, steps_per_contact: float | None) -> None:
    for name, value in (("diameter", min(sizes)), ("velocity", velocity), ("steps_per_contact", steps_per_contact)):
        if value is not None and not value > 0.0:
            raise GranflowError(f"{name} is {value:g}, but must be above 0.")


def _refuse_deep(sizes: tuple[float, float], velocity: float, overlap_max: float) -> None:
    """Refuse an impact whose overlap [m] exceeds a radius: the spheres would pass through each other."""
    radius = 0.5 * min(sizes)
    if not overlap_max < radius:
        reached = f"the overlap would reach {overlap_max:.3g} m, more than the radius of {radius:.3g} m"
        raise GranflowError(f"velocity is {velocity:g} m/s, but {reached}: lower the velocity.")


def _refuse_restitution(law: str, materials: tuple[str, str], restitution: float | None) -> None:
    """A restitution that the law cannot give, or none where it needs one."""
    kind = NORMAL_LAWS[law]
    if restitution is not None and not 0.0 <= restitution <= 1.0:
        raise GranflowError(f"restitution is {restitution:g}, but lies in [0, 1].")
    if kind.restitution == "nothing":
        if restitution is not None:
            raise GranflowError(f"The {law} law has the restitution from the materials: leave --restitution out.")
        if all(PRESETS[name].yield_strength is None for name in materials):
            raise GranflowError(f"The {law} law needs a yield strength, which {' and '.join(set(materials))} has not.")
    if kind.restitution == "positive number" and restitution is None:
        raise GranflowError(f"The {law} law needs a number as restitution. Give it with --restitution.")
    if kind.restitution == "positive number" and restitution == 0.0:
        raise GranflowError(f"The {law} law reaches any restitution above 0, but not 0 itself.")


def _read(described: dict[str, Any], settings: Sequence[str]) -> Scene:
    """The described scene with settings of its law; they are refused in the words of a scene file."""
    return scene_in(parse(to_yaml(described), "collide"), [f"contact.normal.{each}" for each in settings])


def _scene_of(
    law: str,
    materials: tuple[str, str],
    sizes: tuple[float, float],
    velocity: float,
    wall: bool,
    restitution: float | None,
) -> dict[str, Any]:
    """The scene of the collision, as a file would say it."""
    first, second = ("first", "second")
    pair = {"friction": 0} | _asked(law, materials, restitution)
    share = 1.0 if wall else 0.5
    ball = {
        "material": first,
        "diameter": sizes[0],
        "velocity": [share * velocity, 0, 0],
        "place": {"kind": "list", "positions": [[-0.5 * sizes[0], 0, 0]]},
    }
    reach = 10.0 * max(sizes)
    scene: dict[str, Any] = {
        "title": "Head-on collision",
        "gravity": [0, 0, 0],
        "materials": {first: {"preset": materials[0]}, second: {"preset": materials[1]}},
        "pairs": {"first-first": pair, "first-second": pair, "second-second": pair},
        "contact": {"normal": {"law": law, **NORMAL_LAWS[law].example}, "tangential": "none", "rolling": "none"},
        "particles": {"ball": ball},
        "domain": {"min": [-reach] * 3, "max": [reach] * 3, "leaving": "error"},
        "run": {"duration": 1.0, "velocity_max": velocity},
        "numerics": {"overlap_limit": LARGEST_OVERLAP},
        "output": {"interval": 1.0},
    }
    if wall:
        scene["walls"] = {WALL: {"shape": "plane", "point": [0, 0, 0], "normal": [-1, 0, 0], "material": second}}
    else:
        other = {"kind": "list", "positions": [[0.5 * sizes[1], 0, 0]]}
        velocity_back = [-0.5 * velocity, 0, 0]
        scene["particles"]["other"] = {
            "material": second, "diameter": sizes[1], "velocity": velocity_back, "place": other
        }  # fmt: skip
    return scene


def _asked(law: str, materials: tuple[str, str], restitution: float | None) -> dict[str, Any]:
    """The restitution of the pair, as a scene says it; nothing where the law has it from the materials."""
    if NORMAL_LAWS[law].restitution == "nothing":
        return {}
    if restitution is not None:
        return {"restitution": restitution}
    if materials[0] == materials[1] and PRESETS[materials[0]].restitution_fit is not None:
        return {"restitution": {"preset": materials[0]}}
    raise GranflowError(
        f"The restitution of {materials[0]} on {materials[1]} is not known. Give it with --restitution."
    )


def _impact(scene: Scene, sizes: tuple[float, float], velocity: float, wall: bool) -> Impact:
    pair = pair_material(scene, "first", "second")
    radii = 0.5 * np.array(sizes)
    densities = np.array([scene.materials[name].density for name in ("first", "second")])
    masses = 4.0 / 3.0 * np.pi * radii**3 * densities
    if wall:
        return Impact(pair, float(radii[0]), float(masses[0]), velocity)
    return Impact(pair, float(radii.prod() / radii.sum()), float(masses.prod() / masses.sum()), velocity)


def _expected(law: NormalLaw, impact: Impact) -> dict[str, float]:
    """Closed forms of the law; what a dashpot has none for by integrating one equation finely."""
    k = float(theory.hertz_stiffness(impact.pair.modulus_eff, impact.radius_eff))
    mass, velocity = impact.mass_eff, impact.velocity
    promised = law.restitution(impact.pair, impact.radius_eff, mass, velocity)
    spring = float(theory.equivalent_spring(k, mass, velocity))
    shared = {"velocity": velocity, "restitution_asked": promised, "spring_equation19": spring}
    return shared | (_integrated(law, impact) if law.rate_dependent else _closed(law, impact))


def _closed(law: NormalLaw, impact: Impact, steps: int = 4000) -> dict[str, float]:
    """The law's own duration; largest overlap and force where the work of loading has used up the energy."""
    bodies = (impact.radius_eff, impact.mass_eff)
    loading, unloading = law.phase_durations(impact.pair, *bodies, impact.velocity)
    constants, memory = np.array(law.pair_constants(impact.pair)), np.zeros(max(law.history_count, 1))
    moment = loading / steps
    step = impact.velocity * moment
    overlap, force, before, energy = 0.0, 0.0, 0.0, 0.5 * impact.mass_eff * impact.velocity**2
    while energy > 0.0:
        before, overlap = force, overlap + step
        force, memory = law.reference_force(constants, *bodies, moment, overlap, impact.velocity, memory)
        energy -= 0.5 * (before + force) * step
    # the work of the last step was too much by -energy
    largest, strongest = overlap + energy / force, force + (force - before) * energy / force / step
    return {
        "duration_theory": loading + unloading,
        "overlap_max_theory": largest,
        "overlap_residual_theory": _freed_at(law, impact, moment, largest, memory),
        "force_max_theory": strongest,
    }


def _freed_at(law: NormalLaw, impact: Impact, time_step: float, overlap: float, memory: np.ndarray) -> float:
    """Overlap [m] at which the elastic force of a contact with this history has gone, by halving; 0 if it pulls."""
    constants, low, high = np.array(law.pair_constants(impact.pair)), 0.0, overlap
    for _ in range(HALVINGS if not law.attracts else 0):
        middle = 0.5 * (low + high)
        bodies = (impact.radius_eff, impact.mass_eff)
        force, _memory = law.reference_force(constants, *bodies, time_step, middle, 0.0, memory)
        low, high = (low, middle) if force > 0.0 else (middle, high)
    return low


def _integrated(law: NormalLaw, impact: Impact, steps: int = 4000) -> dict[str, float]:
    """Duration, largest overlap and force of M d'' = -F(d, d') by the classical Runge-Kutta method on the twin."""
    constants = np.array(law.pair_constants(impact.pair))
    step = sum(law.phase_durations(impact.pair, impact.radius_eff, impact.mass_eff, impact.velocity)) / steps
    memory = np.zeros(max(law.history_count, 1))
    _, memory = law.reference_force(constants, impact.radius_eff, impact.mass_eff, step, 0.0, impact.velocity, memory)

    def force(overlap: float, rate: float) -> float:
        if overlap <= 0.0:
            return 0.0
        moment = SHORT * step
        return law.reference_force(constants, impact.radius_eff, impact.mass_eff, moment, overlap, rate, memory)[0]

    def slope(state: np.ndarray) -> np.ndarray:
        return np.array([state[1], -force(*state) / impact.mass_eff])

    state, time, largest, strongest = np.array([0.0, impact.velocity]), 0.0, 0.0, 0.0
    while time == 0.0 or force(*state) > 0.0:
        k1 = slope(state)
        k2 = slope(state + 0.5 * step * k1)
        k3 = slope(state + 0.5 * step * k2)
        state = state + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + slope(state + step * k3))
        time += step
        _, memory = law.reference_force(constants, impact.radius_eff, impact.mass_eff, step, state[0], state[1], memory)
        largest, strongest = max(largest, state[0]), max(strongest, force(*state))
    return {"duration_theory": time, "overlap_max_theory": largest, "force_max_theory": strongest}


def _watch(engine: Engine, plan: Plan, impact: Impact) -> dict[str, float]:
    """Step through the collision and note what it reaches."""
    engine.insert(initial_grains(plan.scene))
    engine.set_walls([True] * len(plan.walls), [()] * len(plan.walls))
    engine.refresh()
    limit = int(LONGEST * sum(plan.law.phase_durations(
        impact.pair, impact.radius_eff, impact.mass_eff, impact.velocity)) / plan.time_step) + 10  # fmt: skip
    before = last = _look(engine, plan)
    largest, strongest, duration, residual = 0.0, 0.0, 0.0, 0.0
    for _ in range(limit):
        engine.advance(1)
        now = _look(engine, plan)
        largest, strongest = max(largest, now.overlap), max(strongest, now.force)
        if now.force == 0.0 and last.force > 0.0:
            residual = _freed_at(plan.law, impact, plan.time_step, last.overlap, last.memory)
            duration = engine.time - plan.time_step + _remaining(before, last, residual, plan)
            break
        before, last = last, now
    engine.free()
    if duration == 0.0 and plan.law.attracts:
        raise GranflowError("The collision did not end: the attraction holds the spheres together.")
    if duration == 0.0:
        raise GranflowError("The collision did not end: give more --steps-per-contact.")
    return {
        "restitution": float(-now.rate / impact.velocity),
        "duration": duration,
        "overlap_max": largest,
        "overlap_residual": residual,
        "force_max": strongest,
    }


def _remaining(before: "_Look", last: "_Look", residual: float, plan: Plan) -> float:
    """Time [s] from the last step with a force to the moment it vanishes.

    A viscous force vanishes while the spheres still overlap: on the line through the last two forces. Otherwise the
    surfaces part at a constant rate from then on.
    """
    if plan.features.rate_dependent and before.force > last.force:
        return min(plan.time_step * last.force / (before.force - last.force), plan.time_step)
    return (last.overlap - residual) / -last.rate


@dataclass(frozen=True)
class _Look:
    """Overlap [m], rate of overlap [m/s], force [N] and history of the contact at one step."""

    overlap: float
    rate: float
    force: float
    memory: np.ndarray


def _look(engine: Engine, plan: Plan) -> _Look:
    arrays = engine.synchronized(("position", "velocity", "force", "mass", "radius"))
    history = engine.state.contacts.history.get("normal")
    memory = np.zeros(3) if history is None else history.to_numpy()[0]
    position, velocity, force = (arrays[name][:, 0].astype(float) for name in ("position", "velocity", "force"))
    reach = float(arrays["radius"].sum(dtype=float))
    if len(position) == 1:
        return _Look(reach + position[0], float(velocity[0]), float(abs(force[0])), memory)
    left, right = np.argsort(position)
    overlap = float(reach - (position[right] - position[left]))
    return _Look(overlap, float(velocity[left] - velocity[right]), float(abs(force[0])), memory)
