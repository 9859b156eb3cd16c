"""Maximum impact velocity of the plan, on which the time step depends: given in the scene, or estimated.

The estimate is from free fall through the domain, initial velocities, and the motions of walls and periodic
images.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from granflow.load import Scene
from granflow.particles.group import largest_speed
from granflow.plan.walls import surface_speed
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.particles import FileInsertion, Group

DEFAULT_SPEED = 1.0
"""Impact velocity [m/s] of a scene without motion and gravity: contacts still require a time step."""


@dataclass(frozen=True)
class ImpactVelocity:
    """Maximum expected impact velocity [m/s] and its origin."""

    value: float
    source: str


def max_impact_velocity(scene: Scene) -> ImpactVelocity:
    """Read it from the scene, or estimate it from free fall through the domain, initial velocities and moving
    walls.

        v = max(v_fall, v_initial) + max(v_wall, v_image)

    If particles start faster than they fall and faster than walls and images move, two of them approach at
    2 v_initial. Without any motion and gravity, DEFAULT_SPEED. The result is finite and above 0.
    """
    given = scene.run.velocity_max
    if given is not None:
        return ImpactVelocity(given, f"run.velocity_max ({scene.where('run', 'velocity_max')})")
    fall = free_fall(scene)
    initial = max(initial_speeds(scene.particles).values(), default=0.0)
    images = image_speed(scene.domain)
    surface = max(surface_speed(scene), images)
    if not max(fall, initial, surface) > 0.0:
        return ImpactVelocity(DEFAULT_SPEED, "assumed: no initial motion and no gravity")
    speed = fall
    source = f"free fall through the domain ({fall:.3g} m/s)"
    opposing = surface
    opposing_name = "the image across the sheared boundary" if images else "the fastest wall"
    opposing_source = f"{opposing_name} ({surface:.3g} m/s)"
    if initial > fall:
        speed = initial
        source = f"the fastest particle at the start ({initial:.3g} m/s)"
        if initial > surface:
            opposing = initial
            opposing_source = "another one of the same speed"
    parts = []
    if speed > 0.0:
        parts.append(source)
    if opposing > 0.0:
        parts.append(opposing_source)
    return ImpactVelocity(speed + opposing, f"estimated from {' against '.join(parts)}")


def free_fall(scene: Scene) -> float:
    """Velocity [m/s] after free fall from one corner of the domain to the opposite one.

    v = sqrt(2 (|gx| Lx + |gy| Ly + |gz| Lz))
    """
    size = np.subtract(scene.domain.max, scene.domain.min)
    return float(np.sqrt(2.0 * np.abs(scene.gravity) @ size))


def image_speed(domain: Domain) -> float:
    """Velocity [m/s] of the images across a sheared boundary: shear rate times box width.

    0 without Lees-Edwards shear.
    """
    image_motion = domain.periodic_box().image_motion
    return 0.0 if image_motion is None else abs(image_motion.speed)


def initial_speeds(particles: Mapping[str, Group]) -> dict[str, float]:
    """Largest initial speed [m/s] of each group, by name, from the scene or from the file with its particles.

    Random velocities count with `group.largest_speed`.
    """
    return {
        name: max(_largest_norm(group.velocity) + _random_speed(group), _in_file(group, "speed_max"))
        for name, group in particles.items()
    }


def initial_rotation_rates(particles: Mapping[str, Group]) -> dict[str, float]:
    """Largest initial angular velocity [rad/s] of each group, by name, from the scene or from its particle
    file."""
    return {
        name: max(_largest_norm(group.angular_velocity), _in_file(group, "angular_velocity_max"))
        for name, group in particles.items()
    }


def _random_speed(group: Group) -> float:
    """Largest expected random velocity [m/s] of a group; 0 without."""
    return 0.0 if group.thermal is None else largest_speed(group.thermal, group.count)


def _in_file(group: Group, name: str) -> float:
    """The quantity `name` of the summary of the particle file of a group, in SI units; 0 without a file."""
    found = group.insert.found if isinstance(group.insert, FileInsertion) else None
    return getattr(found, name, 0.0)


def _largest_norm(vectors: ArrayLike) -> float:
    """Largest norm of one vector (3,) or of many, (n, 3)."""
    return float(np.linalg.norm(np.atleast_2d(vectors), axis=1).max())
