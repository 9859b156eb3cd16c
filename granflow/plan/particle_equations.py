"""The limit of the time step of particle equations, such as that of the temperature."""

from collections.abc import Iterator

from granflow.contact.law import FlowCase
from granflow.contact.particle_equation import ParticleEquation
from granflow.errors import SceneError
from granflow.plan.plan import Plan

CONTACTS = 12
"""Contacts of the smallest particle that limit the time step: equal spheres around it."""


def longest_step(plan: Plan, equation: ParticleEquation) -> float:
    """Time step [s] up to which the explicit step of an equation is stable: that of the smallest particles,
    with contacts at the overlap limit."""
    return min(_longest_steps(plan, equation))


def refuse_long_step(plan: Plan) -> None:
    """Raise SceneError if the time step exceeds the limit of a particle equation."""
    scene = plan.scene
    for equation in scene.equations:
        longest = longest_step(plan, equation)
        if plan.longest_time_step > longest:
            raise SceneError(
                f"{scene.locate('run', 'time_step')}: the time step {plan.longest_time_step:.3g} s is longer "
                f"than {longest:.3g} s, up to which the equation of the {equation.name} is stable; give a "
                "smaller run.time_step."
            )


def _longest_steps(plan: Plan, equation: ParticleEquation) -> Iterator[float]:
    """Limit of the time step [s] of the smallest particle of each group; each sphere of a clump has its own
    contacts."""
    for group in plan.scene.particles.values():
        density = plan.scene.materials[group.material].density
        smallest = 0.5 * group.diameters[0]
        body = group.shape.body
        radii = [smallest] if body is None else body.radius.tolist()
        slopes = {
            radius: max(_slopes(plan, equation, group.material, radius), default=0.0) for radius in set(radii)
        }
        mass = group.shape.mass_of_sphere(smallest, density)
        constants = plan.material_constants(equation, group.material)
        slope = CONTACTS * sum(slopes[radius] for radius in radii)
        yield equation.longest_time_step(constants, max(radii), mass, slope)


def _slopes(plan: Plan, equation: ParticleEquation, material: str, radius: float) -> Iterator[float]:
    """Largest derivative by the property of a flow through a contact of a particle."""
    overlap = plan.scene.numerics.intended_overlap * radius
    for (first, _), pair in plan.pair_materials.items():
        case = FlowCase(pair, radius, overlap, plan.value_ranges, plan.wall_value_ranges)
        for law in plan.laws.laws if first == material else ():
            yield from (law.flow_bounds(name, case)[1] for name in law.flows if name in equation.flows)
