"""Largest distance per step of particles and walls, so that no center crosses a wall without a detected contact."""

from collections.abc import Mapping

from granflow.errors import SceneError
from granflow.load import Scene
from granflow.scene.schema.run import LARGEST_OVERLAP

STEP_SHARE = 1.0 - LARGEST_OVERLAP
"""Largest distance per step, of a particle and of a wall, over the smallest radius R.

Rectangles, discs and meshes are two-sided: a center that crosses one is pushed out on the wrong side. With the overlap
limit L, the centers of a run that has not stopped are at a distance g >= (1 - L) R from the wall. One step with the
share f for both takes a center at most 2 f R - g behind the wall, where its overlap over R is

    1 - (2 f R - g) / R >= 2 - 2 f - L >= L        for f <= 1 - L

so that the overlap limit stops the run. Two particles pass each other only with more than 2 (2 - L) R in a step.
Stable steps are below the limit: v dt < 2 v/w = 2 d_max <= 0.2 R, for overlaps d_max up to the default L = 0.1.
"""

STEP_MARGIN = 0.9
"""Time step that a message suggests, relative to the limit."""


def refuse_fast_start(scene: Scene, speeds: Mapping[str, float], step: float, radius_min: float) -> None:
    """Raise SceneError if particles of a group have an initial displacement per step above the limit.

    `speeds`: largest initial speed [m/s] of each group; `step` [s].
    """
    limit = STEP_SHARE * radius_min
    for name, speed in speeds.items():
        if speed * step > limit:
            given = scene.is_given("particles", name, "velocity")
            place = scene.locate("particles", name, *(["velocity"] if given else []))
            statement = f"{place}: particles.{name} starts with {speed:.3g} m/s"
            raise SceneError(f"{statement}{_per_step(scene, speed, step, limit, share_of(limit, radius_min))}")


def refuse_fast_rotation(scene: Scene, rates: Mapping[str, float], step: float) -> None:
    """Raise SceneError if the surface of a particle moves by more than the same share of its radius in a step [s].

    `rates`: largest initial angular velocity [rad/s] of each group.
    """
    for name, rate in rates.items():
        if rate * step > STEP_SHARE:
            given = scene.is_given("particles", name, "angular_velocity")
            place = scene.locate("particles", name, *(["angular_velocity"] if given else []))
            raise SceneError(
                f"{place}: particles.{name} starts with {rate:.3g} rad/s, "
                f"which is {rate * step:.3g} rad per step of {step:.3g} s, above the limit of {STEP_SHARE:g} rad. Use "
                f"at most {STEP_MARGIN * STEP_SHARE / step:.2g} rad/s, or lower run.time_step."
            )


def refuse_fast_walls(scene: Scene, speeds: Mapping[str, float], step: float, limit: float, share: str) -> None:
    """Raise SceneError if a prescribed motion moves a wall by more than `limit` [m] in a step [s].

    `share`: the limit relative to the length from which it follows.
    """
    for name, speed in speeds.items():
        if speed * step > limit:
            statement = f"{scene.locate('walls', name, 'motion')}: walls.{name} moves at up to {speed:.3g} m/s"
            raise SceneError(f"{statement}{_per_step(scene, speed, step, limit, share)}")


def refuse_fast_images(scene: Scene, speed: float, step: float, limit: float, share: str) -> None:
    """Raise SceneError if the images of a sheared box move by more than `limit` [m] in a step [s].

    `share`: the limit relative to the length from which it follows.
    """
    if speed * step > limit:
        statement = f"{scene.locate('domain', 'lees_edwards')}: domain.lees_edwards moves the images at {speed:.3g} m/s"
        raise SceneError(f"{statement}{_per_step(scene, speed, step, limit, share)}")


def _per_step(scene: Scene, speed: float, step: float, limit: float, share: str) -> str:
    """End of a sentence on a speed [m/s] too high for a step [s], with the remedy."""
    return (
        f", which is {speed * step:.3g} m per step of {step:.3g} s, above the limit of {limit:.3g} m ({share}): beyond "
        f"it contacts can be missed. {remedy(not isinstance(scene.run.time_step, str), speed, speed, limit)}"
    )


def share_of(limit: float, radius_min: float) -> str:
    """A limit [m] relative to the smallest radius [m]."""
    return f"{limit / radius_min:.2g} of the smallest radius {radius_min:.3g} m"


def remedy(step_is_given: bool, speed: float, planned_speed: float, limit: float) -> str:
    """Remedy for a displacement per step above the limit [m].

    If the scene gives the time step a shorter one, otherwise a higher planned velocity.
    """
    if step_is_given:
        return f"Lower run.time_step to {STEP_MARGIN * limit / speed:.2g} s, or lower the speed."
    return f"Set run.velocity_max to {planned_speed:.3g} m/s, or lower the speed."
