"""Checks of the particle properties that equations integrate: their keys, and the limit of the time step."""

from collections.abc import Iterator

from granflow.contact.law import FlowCase
from granflow.contact.particle_equation import ParticleEquation
from granflow.errors import SceneError
from granflow.geometry.shape import sphere_mass
from granflow.load import Scene
from granflow.plan.plan import Plan

CONTACTS = 12
"""Contacts of the smallest particle that limit the time step: equal spheres around it."""


def refuse_without_values(scene: Scene, equations: tuple[ParticleEquation, ...]) -> None:
    """Raise SceneError for keys that particle equations require and the scene lacks, and for what they do not
    support."""
    problems = [problem for equation in equations for problem in _missing(scene, equation)]
    if problems:
        raise SceneError(problems)


def _missing(scene: Scene, equation: ParticleEquation) -> Iterator[str]:
    """Problems of the keys of one equation."""
    name = equation.name
    for group_name, group in scene.particles.items():
        place = f"{scene.locate('particles', group_name)}: particles.{group_name}"
        if getattr(group, name) is None:
            yield f"{place}.{name} is missing; give the initial value, {equation.meaning} [{equation.unit}]."
        if group.clump is not None:
            yield f"{place}.clump cannot be combined with an equation of the {name}."
    for material in dict.fromkeys(group.material for group in scene.particles.values()):
        for key, (_, description) in equation.material_keys.items():
            if getattr(scene.materials[material], key) is None:
                place = f"{scene.locate('materials', material)}: materials.{material}.{key}"
                yield f"{place} is missing; the equation of the {name} requires it: {description}."
    if scene.start_from is not None:
        yield (
            f"{scene.locate('start_from')}: start_from cannot be combined with an equation of the {name}, "
            "whose values it does not read."
        )


def refuse_long_step(plan: Plan) -> None:
    """Raise SceneError if the time step exceeds the limit of a particle equation."""
    scene = plan.scene
    for equation in plan.equations:
        longest = min(_longest_steps(plan, equation))
        if plan.longest_time_step > longest:
            raise SceneError(
                f"{scene.locate('run', 'time_step')}: the time step {plan.longest_time_step:.3g} s is longer "
                f"than {longest:.3g} s, up to which the equation of the {equation.name} is stable; give a "
                "smaller run.time_step."
            )


def _longest_steps(plan: Plan, equation: ParticleEquation) -> Iterator[float]:
    """Limit of the time step [s] of the smallest particle of each group."""
    for group in plan.scene.particles.values():
        radius = 0.5 * group.diameters[0]
        mass = sphere_mass(radius, plan.scene.materials[group.material].density)
        slope = max(_slopes(plan, equation, group.material, radius), default=0.0)
        constants = plan.material_constants(equation, group.material)
        yield equation.longest_time_step(constants, radius, mass, CONTACTS * slope)


def _slopes(plan: Plan, equation: ParticleEquation, material: str, radius: float) -> Iterator[float]:
    """Largest derivative by the property of a flow through a contact of a particle."""
    overlap = plan.scene.numerics.max_overlap * radius
    for (first, _), pair in plan.pair_materials.items():
        case = FlowCase(pair, radius, overlap, plan.value_ranges)
        for law in plan.laws.laws if first == material else ():
            yield from (law.flow_bounds(name, case)[1] for name in law.adds if name in equation.reads)
