"""The fastest approach that a plan reckons with: as the scene says, or estimated from what can move and fall."""

from dataclasses import dataclass

import numpy as np

from granflow.plan.walls import surface_speed
from granflow.scene import Scene
from granflow.scene.periodic_box import PeriodicBox
from granflow.scene.schema import FileInsertion, Group

DEFAULT_SPEED = 1.0
"""Fastest approach [m/s] where nothing moves or falls: contacts still need a time step."""


@dataclass(frozen=True)
class ImpactVelocity:
    """Fastest approach expected [m/s], and where it comes from."""

    value: float
    source: str


def max_impact_velocity(scene: Scene) -> ImpactVelocity:
    """Take it from the scene, or estimate it: free fall through the domain or initial speeds, and moving walls."""
    if scene.run.velocity_max is not None:
        return ImpactVelocity(scene.run.velocity_max, f"run.velocity_max ({scene.where('run', 'velocity_max')})")
    fall, initial, surface = free_fall(scene), initial_speed(scene), max(surface_speed(scene), image_speed(scene))
    if not max(fall, initial, surface) > 0.0:
        return ImpactVelocity(DEFAULT_SPEED, "assumed: nothing moves or falls at first")
    speed, source = fall, f"free fall through the domain ({fall:.3g} m/s)"
    opposing_name = "the fastest wall" if not image_speed(scene) else "the image across the sheared border"
    opposing, opposing_source = surface, f"{opposing_name} ({surface:.3g} m/s)"
    if initial > fall:
        speed, source = initial, f"the fastest particle at the start ({initial:.3g} m/s)"
        if initial > surface:
            opposing, opposing_source = initial, "another as fast"
    parts = ([source] if speed > 0.0 else []) + ([opposing_source] if opposing > 0.0 else [])
    return ImpactVelocity(speed + opposing, f"estimated from {' meeting '.join(parts)}")


def free_fall(scene: Scene) -> float:
    """Speed [m/s] after a fall from one corner of the domain to the opposite one."""
    size = np.subtract(scene.domain.max, scene.domain.min)
    return float(np.sqrt(2.0 * np.abs(scene.gravity) @ size))


def image_speed(scene: Scene) -> float:
    """Speed [m/s] of the images across a sheared border."""
    image_motion = PeriodicBox.of(scene.domain).image_motion
    return 0.0 if image_motion is None else abs(image_motion.speed)


def initial_speed(scene: Scene) -> float:
    """Largest speed [m/s] at which any particle starts."""
    return max(initial_speeds(scene).values(), default=0.0)


def initial_speeds(scene: Scene) -> dict[str, float]:
    """Largest speed [m/s] of every group at the start."""
    return {name: _initial_speed(group) for name, group in scene.particles.items()}


def _initial_speed(group: Group) -> float:
    """Largest speed [m/s] at which a particle of the group starts, as given or as read from a file."""
    file_speeds = (
        group.insert.found.speed_max if isinstance(group.insert, FileInsertion) and group.insert.found else 0.0
    )
    velocity = np.atleast_2d(np.array(group.velocity))
    return max(file_speeds, float(np.linalg.norm(velocity, axis=1).max()))
