"""One head-on collision with the kernels of a scene, beside the theory of its contact model.

`collide` refuses input without a meaning, computes what the contact model should give, runs the collision on
the bench of `granflow.studies.bench`, and measures it. The theory is a closed form where there is one, and
otherwise an integration with the reference implementation of the contact model. Nothing is written.
"""

import logging
from collections.abc import Sequence
from typing import Any

import numpy as np

from granflow import GranflowError, Plan, SceneError
from granflow.contact import theory
from granflow.contact.registry import models
from granflow.scene.blocks.materials import PRESETS
from granflow.schema.messages import suggestion_sentence
from granflow.studies.bench import LONGEST, Collision, CollisionBench, Impact, run_duration


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

    `law`: contact model; `material`, `material2`: presets; `diameter`, `diameter2` [m]; `velocity` [m/s]:
    approach velocity. `settings` are those of the contact model and its properties of a pair as "key=value",
    such as "yield_ratio=2.8"; the example of the catalog supplies the others. `steps_per_contact`: expected
    duration over time step; automatic time step without it.

    Returns the simulated `restitution`, `duration` [s], `overlap_max` and `overlap_residual` [m] and
    `force_max` [N]; the expected values under the same names with `_theory`, and the requested restitution
    with `_asked`; `velocity` [m/s], `spring_equation19` [N/m] (Zhou 2011, Eq. 19) and `time_step` [s].

    Raises GranflowError for an unknown preset or contact model, values that are not positive, a restitution
    that is neither given nor known, an overlap of more than a radius, or an unstable time step.
    """
    sizes = (diameter, diameter2 or diameter)
    materials = (material, material2 or material)
    _refuse_unknown(law, materials)
    _refuse_unphysical(sizes, velocity, steps_per_contact)
    _refuse_restitution(law, materials, restitution)
    model = models("normal")[law]
    given = _settings(settings)
    of_pair = {key: given.pop(key, value) for key, value in model.pair_example.items()}
    pair = {"friction": 0} | of_pair | _restitution_given(law, materials, restitution)
    normal = {"law": law, **model.example} | given
    radius = 0.5 * diameter
    other = None if wall else 0.5 * sizes[1]

    def bench(**run: Any) -> CollisionBench:
        return CollisionBench(
            materials={"first": {"preset": materials[0]}, "second": {"preset": materials[1]}},
            pairs={"first-first": pair, "first-second": pair, "second-second": pair},
            contact={"normal": normal},
            collisions=[Collision("first", "second", radius, other, velocity, 1.0 if wall else 0.5)],
            run={
                "duration": run_duration(diameter, velocity),
                "velocity_max": velocity,
                "precision": precision or "f64",
                **run,
            },
            arch=arch,
        )

    automatic = bench()
    impact = automatic.impact_of(automatic.collisions[0])
    expected = _expected(automatic.plan, impact)
    _refuse_deep(sizes, velocity, expected["overlap_max_theory"])
    if steps_per_contact is None:
        chosen = automatic
    else:
        chosen = bench(time_step=expected["duration_theory"] / steps_per_contact)
    plan = _stable_plan(chosen, steps_per_contact)
    with chosen:
        found = _measured(chosen, impact)
    return expected | found | {"time_step": plan.time_step}


def _stable_plan(bench: CollisionBench, steps_per_contact: float | None) -> Plan:
    """The plan, whose warnings are logged. Raises GranflowError if `steps_per_contact` are not stable."""
    try:
        plan = bench.plan
    except SceneError:
        raise GranflowError(f"{steps_per_contact:g} steps per contact are not stable; use more.") from None
    for warning in plan.step.warnings:
        logging.getLogger("granflow").warning("warning: %s", warning)
    return plan


# ---------------------------------------------------------------- input


def _settings(given: Sequence[str]) -> dict[str, Any]:
    """Settings of the contact model from "key=value"; values are YAML.

    Raises GranflowError for a setting of another form.
    """
    from ruamel.yaml import YAML, YAMLError

    found: dict[str, Any] = {}
    for setting in given:
        path, equals, text = setting.partition("=")
        *parents, last = path.strip().split(".")
        try:
            if not (equals and last and text.strip() and all(parents)):
                raise ValueError
            block = found
            for key in parents:
                block = block.setdefault(key, {})
            block[last] = YAML(typ="safe", pure=True).load(text)
        except (YAMLError, ValueError, AttributeError, TypeError):
            form = "key=value, such as yield_ratio=2.8"
            raise GranflowError(
                f"--set {setting}: a setting of the contact model has the form {form}."
            ) from None
    return found


def _refuse_unknown(law: str, materials: tuple[str, str]) -> None:
    """Raise GranflowError for an unknown contact model or preset, with a suggestion."""
    if law not in models("normal"):
        remedy = suggestion_sentence(law, models("normal"), "contact models")
        raise GranflowError(f"Unknown contact model {law}. {remedy}")
    for name in materials:
        if name not in PRESETS:
            raise GranflowError(f"there is no preset {name}. {suggestion_sentence(name, PRESETS, 'presets')}")


def _refuse_unphysical(sizes: tuple[float, float], velocity: float, steps_per_contact: float | None) -> None:
    """Raise GranflowError for a diameter [m], velocity [m/s] or number of steps that is not above 0."""
    for name, value in (
        ("diameter", min(sizes)),
        ("velocity", velocity),
        ("steps_per_contact", steps_per_contact),
    ):
        if value is not None and not value > 0.0:
            raise GranflowError(f"{name} is {value:g}, but must be above 0.")


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
                f"The contact model {law} requires a yield strength, which {' and '.join(set(materials))} "
                "lacks."
            )
    if kind.restitution == "positive number" and restitution is None:
        raise GranflowError(
            f"The contact model {law} requires a restitution coefficient; give it with --restitution."
        )
    if kind.restitution == "positive number" and restitution == 0.0:
        raise GranflowError(
            f"The contact model {law} requires a restitution above 0, such as --restitution 0.1."
        )


def _refuse_deep(sizes: tuple[float, float], velocity: float, overlap_max: float) -> None:
    """Raise GranflowError if the maximum overlap [m] exceeds a radius: the spheres would pass through each
    other."""
    radius = 0.5 * min(sizes)
    if not overlap_max < radius:
        reached = f"the overlap would reach {overlap_max:.3g} m, more than the radius of {radius:.3g} m"
        raise GranflowError(f"velocity is {velocity:g} m/s, but {reached}; reduce the velocity.")


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


# ---------------------------------------------------------------- the simulated collision

FORCE_RESOLUTION = 1e-6
"""Forces below this share of the largest one are rounding: a GPU contracts products and sums, so that in
float32 the elastic force and a dashpot that cancels it do not add up to exactly 0."""


def _measured(bench: CollisionBench, impact: Impact) -> dict[str, float]:
    """Run the collision, and measure it in the terms of `collide`.

    The contact ends where its elastic force vanishes. This residual overlap follows from the contact history,
    so that it is found within a step.

    Raises GranflowError if the contact does not end.
    """
    overlap, rate, force = bench.run()[:, :, 0].T
    force = np.abs(force)
    plan = bench.plan
    time_step = plan.time_step
    attracts = plan.laws.normal.attracts  # a tension, however weak, acts until the surfaces separate
    resolution = 0.0 if attracts else FORCE_RESOLUTION
    last = int(np.flatnonzero(force > resolution * force.max())[-1])
    if last + 1 == len(force):
        raise GranflowError(
            "The collision did not end: the attraction prevents separation."
            if attracts
            else "The collision did not end; increase --steps-per-contact."
        )
    history = history_along(plan, impact, overlap, rate, force)
    residual = end_overlap(plan, impact, time_step, overlap[last], history)
    # A viscous force vanishes while the spheres still overlap: the line through the last two forces.
    # Otherwise the surfaces separate at a constant rate.
    remaining = (overlap[last] - residual) / -rate[last]
    if plan.features.rate_dependent and not attracts and force[last - 1] > force[last]:
        remaining = min(time_step * force[last] / (force[last - 1] - force[last]), time_step)
    return {
        "restitution": float(-rate[last + 1] / impact[3]),
        "duration": float(last * time_step + remaining),
        "overlap_max": float(overlap.max()),
        "overlap_residual": residual,
        "force_max": float(force.max()),
    }


def history_along(
    plan: Plan, impact: Impact, overlap: np.ndarray, rate: np.ndarray, force: np.ndarray
) -> np.ndarray:
    """Contact history at the last force, by the reference implementation along the recorded path.

    `overlap` [m], `rate` [m/s], `force` [N] (steps,). A model without viscosity reads the rate half a step
    back.
    """
    pair, radius_eff, mass_eff, _ = impact
    law = plan.laws.normal
    time_step = plan.time_step
    constants = np.array(law.pair_constants(pair))
    history = np.zeros(max(law.history_count, 1))
    rate_seen = rate if law.rate_dependent else rate + 0.5 * time_step * force / mass_eff
    for index in np.flatnonzero(force):
        point = (overlap[index], rate_seen[index])
        _, history = law.reference_force(constants, radius_eff, mass_eff, time_step, *point, history)
    return history


def end_overlap(plan: Plan, impact: Impact, time_step: float, overlap: float, history: np.ndarray) -> float:
    """Overlap [m] at which the elastic force of a contact with this history vanishes; 0 if attractive.

    `overlap` [m]: upper end of the search; `history`: fields of the contact model.
    """
    from scipy.optimize import brentq

    constants = np.array(plan.laws.normal.pair_constants(impact[0]))

    def is_repulsive(at: float) -> float:
        force, _ = plan.laws.normal.reference_force(constants, *impact[1:3], time_step, at, 0.0, history)
        return 1.0 if force > 0.0 else -1.0

    smallest = 1e-15 * overlap
    if plan.laws.normal.attracts or is_repulsive(smallest) > 0.0:
        return 0.0
    if is_repulsive(overlap) < 0.0:
        return overlap
    return float(brentq(is_repulsive, smallest, overlap, xtol=smallest, rtol=1e-15))


# ---------------------------------------------------------------- theory

SHORT = 1e-6
"""Time step of the reference integration relative to the duration; sub-step corrections are then
negligible."""
FORCE_SAMPLES = 2001
"""Points of each phase of the reference integration at which the force is evaluated."""
LOADING_STEPS = 4000
"""Trapezoids of the loading work."""


def _expected(plan: Plan, impact: Impact) -> dict[str, float]:
    """Closed forms of the contact model; for a dashpot without closed form, results of a fine integration."""
    pair, radius_eff, mass, velocity = impact
    k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
    spring = float(theory.equivalent_spring(k, mass, velocity))
    requested = plan.laws.normal.restitution(*impact)
    shared = {"velocity": velocity, "restitution_asked": requested, "spring_equation19": spring}
    return shared | (
        damped_path(plan, impact) if plan.laws.normal.rate_dependent else loading_path(plan, impact)
    )


def loading_path(plan: Plan, impact: Impact) -> dict[str, float]:
    """Duration from the contact model; maximum overlap and force where the loading work equals the kinetic
    energy.

        int_0^dmax F dd = M v^2 / 2

    The integral is a sum of trapezoids, LOADING_STEPS of them in the loading time at the approach velocity;
    the last one is interpolated.
    """
    pair, radius_eff, mass_eff, velocity = impact
    law = plan.laws.normal
    loading, unloading = law.phase_durations(*impact)
    constants = np.array(law.pair_constants(pair))
    history = np.zeros(max(law.history_count, 1))
    moment = loading / LOADING_STEPS
    step = velocity * moment
    overlap = 0.0
    force = 0.0
    force_before = 0.0
    energy = 0.5 * mass_eff * velocity**2
    while energy > 0.0:
        force_before = force
        overlap = overlap + step
        force, history = law.reference_force(
            constants, radius_eff, mass_eff, moment, overlap, velocity, history
        )
        energy -= 0.5 * (force_before + force) * step
    # -energy is the excess work of the last step
    overlap_max = overlap + energy / force
    force_max = force + (force - force_before) * energy / force / step
    return {
        "duration_theory": loading + unloading,
        "overlap_max_theory": overlap_max,
        "overlap_residual_theory": end_overlap(plan, impact, moment, overlap_max, history),
        "force_max_theory": force_max,
    }


def damped_path(plan: Plan, impact: Impact) -> dict[str, float]:
    """Duration [s], maximum overlap [m] and force [N] of M d'' = -F(d, d'), by the method DOP853 of scipy."""
    from scipy.integrate import solve_ivp

    pair, radius_eff, mass_eff, velocity = impact
    law = plan.laws.normal
    constants = np.array(plan.laws.normal.pair_constants(pair))
    longest = sum(law.phase_durations(*impact))

    def contact(overlap: float, rate: float, history: np.ndarray) -> tuple[float, np.ndarray]:
        return law.reference_force(constants, radius_eff, mass_eff, SHORT * longest, overlap, rate, history)

    _, history = contact(0.0, velocity, np.zeros(max(law.history_count, 1)))

    def force(overlap: float, rate: float) -> float:
        return contact(overlap, rate, history)[0] if overlap > 0.0 else 0.0

    def slope(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -force(*state) / mass_eff]

    def stopped(_: float, state: np.ndarray) -> float:
        return float(state[1])

    def released(_: float, state: np.ndarray) -> float:
        if law.attracts:
            return float(state[0])
        return 1.0 if force(*state) > 0.0 else -1.0

    stopped.terminal = released.terminal = True  # type: ignore[attr-defined]
    released.direction = -1.0  # type: ignore[attr-defined]
    state = np.array([0.0, velocity])
    time = 0.0
    force_max = 0.0
    overlap_max = 0.0
    for event in (stopped, released):
        tolerance = {"rtol": 1e-11, "atol": 1e-14 * np.array([velocity * longest, velocity])}
        course = solve_ivp(
            slope, (time, LONGEST * longest), state, "DOP853", events=event, dense_output=True, **tolerance
        )
        path = course.sol(np.linspace(time, course.t[-1], FORCE_SAMPLES))
        force_max = max(force_max, *(force(*point) for point in path.T))
        state = course.y[:, -1]
        time = float(course.t[-1])
        overlap_max = max(overlap_max, float(course.y[0, -1]))
        if event is stopped:
            _, history = contact(float(state[0]), float(state[1]), history)
    return {"duration_theory": time, "overlap_max_theory": overlap_max, "force_max_theory": force_max}
