"""Forecasts of values that are possible, but probably have a wrong unit."""

from collections.abc import Iterator
from math import pi

from granflow.contact import registry
from granflow.fields import unit_of
from granflow.load import Scene
from granflow.plan.forecast.advice import HARDEST, pressure_words
from granflow.plan.walls import surface_speed

LIGHTEST = 20.0
"""Density [kg/m3] of light foams. There is no upper limit: scaled densities are common."""

MOST_FRICTION = 5.0
"""Coefficient of friction above that of all granular materials."""

FASTEST_SURFACE = 10.0
"""Surface speed of a wall [m/s] above that of drums, mixers and conveyors."""


def unit_warnings(scene: Scene) -> Iterator[str]:
    """A sentence for each density, friction, surface speed and expected angle that suggests another unit."""
    for name, material in scene.materials.items():
        if material.density < LIGHTEST:
            where = scene.where("materials", name, "density")
            yield (
                f"materials.{name}.density ({where}) is {material.density:.3g} kg/m3, less than light foams: check "
                "the unit (2.5 g/cm3 is 2500 kg/m3)."
            )
    yield from _too_hard(scene)
    yield from _unused_cohesion(scene)
    for name, pair in scene.pairs.items():
        if pair.friction > MOST_FRICTION:
            yield (
                f"pairs.{name}.friction ({scene.where('pairs', name, 'friction')}) is {pair.friction:.3g}: it is a "
                "coefficient, the tangent of the friction angle, such as 0.5."
            )
    yield from _speed_warnings(scene)
    for index, each in enumerate(scene.expect):
        bounds = [*(each.between or ()), *filter(None, (each.below, each.above, each.equals))]
        if unit_of(each.quantity) == "rad" and max(map(abs, bounds), default=0.0) > pi:
            yield (
                f"expect[{index}] ({scene.where('expect', str(index))}): {each.quantity} is in rad, and the bound is "
                f"{max(map(abs, bounds)):.3g} rad. Write degrees with the unit, such as 25 deg."
            )


def _too_hard(scene: Scene) -> Iterator[str]:
    """A sentence for each material of mobile particles that is harder than diamond.

    Walls and fixed particles of such a material are rigid, which is often intended.
    """
    for name in dict.fromkeys(group.material for group in scene.particles.values() if not group.fixed):
        modulus = scene.materials[name].young_modulus
        if modulus > HARDEST:
            yield (
                f"materials.{name}.young_modulus ({scene.where('materials', name, 'young_modulus')}) is "
                f"{pressure_words(modulus)}, more than that of diamond: check the unit (1 N/mm2 is 1 MPa)."
            )


def _unused_cohesion(scene: Scene) -> Iterator[str]:
    """A sentence on the parameters of a cohesion that is switched off."""
    if scene.contact.name("cohesion") != "none":
        return
    for option in registry.pair_options().values():
        models = registry.models_with(option.key)
        names = [name for name, pair in scene.pairs.items() if getattr(pair, option.key)]
        if list(models) == ["cohesion"] and names:
            yield (
                f"pairs.{names[0]}.{option.key} ({scene.where('pairs', names[0], option.key)}) is not used, because "
                f"contact.cohesion is none; {' or '.join(models['cohesion'])} would use it."
            )


def _speed_warnings(scene: Scene) -> Iterator[str]:
    """A sentence on the fastest wall, if angular velocities are probably not in rad/s."""
    rotating = [
        name for name, wall in scene.walls.items() if any(hasattr(each, "angular_velocity") for each in wall.motion)
    ]
    if rotating and (speed := surface_speed(scene)) > FASTEST_SURFACE:
        name = rotating[0]
        yield (
            f"walls.{name}.motion ({scene.where('walls', name, 'motion')}): walls move at up to {speed:.3g} m/s. "
            "Angular velocities are in rad/s: write 30 rpm or 180 deg/s with the unit."
        )
