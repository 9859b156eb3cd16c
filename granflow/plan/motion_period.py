"""Wall motions: the time step must resolve their period, or the rows of their table."""

import math
from collections.abc import Sequence

from granflow.errors import SceneError
from granflow.geometry.motion import Motion
from granflow.geometry.motion_table import TableRotation, TableTranslation
from granflow.load import Scene
from granflow.plan.walls import PlannedWall
from granflow.scene.schema.motions import Rotation, Vibration
from granflow.scene.schema.quantities import Vector3

STEPS_PER_PERIOD = 10
"""Minimum number of time steps per period. With fewer, the wall velocities do not represent the motion (aliasing)."""


def refuse_fast_motion(scene: Scene, walls: Sequence[PlannedWall], time_step: float) -> None:
    """Raise SceneError for each vibration or rotation whose period is shorter than ten time steps [s].

    Rows of a table must be at least one time step apart. One SceneError names all such motions, each with the largest
    permitted time step. `walls`: those of the scene in numeric form.
    """
    problems = []
    planned = {wall.name: wall.motions for wall in walls}
    for name, wall in scene.walls.items():
        for index, motion in enumerate(wall.motion):
            shortest = _shortest_row(planned[name][index].given)
            if time_step > shortest * (1.0 + 1e-9):
                problems.append(
                    f"{scene.locate('walls', name, 'motion', index)}: walls.{name}.motion.{index} has rows that are "
                    f"{shortest:.3g} s apart, less than the time step of {time_step:.3g} s. Give fewer rows, or set "
                    f"run.time_step to {shortest:.2g} s or less."
                )
            period = _period(motion, scene.gravity) if isinstance(motion, Vibration | Rotation) else math.inf
            if STEPS_PER_PERIOD * time_step > period * (1.0 + 1e-9):
                key = f"walls.{name}.motion.{index}"
                problems.append(
                    f"{scene.locate('walls', name, 'motion')}: {key} has a period of {period:.3g} s, shorter than "
                    f"{STEPS_PER_PERIOD} time steps of {time_step:.3g} s. Slow the motion down, or set run.time_step "
                    f"to {period / STEPS_PER_PERIOD:.2g} s or less."
                )
    if problems:
        raise SceneError(problems)


def _shortest_row(motion: Motion) -> float:
    """Shortest time [s] between two rows of a table; infinite for other motions."""
    return motion.table.shortest_step if isinstance(motion, TableTranslation | TableRotation) else math.inf


def _period(motion: Vibration | Rotation, gravity: Vector3) -> float:
    """Period 2 pi / w [s] of a vibration or rotation; infinite without motion (w = 0 or amplitude 0)."""
    if isinstance(motion, Rotation):
        rate = max(abs(motion.angular_velocity), abs(motion.initial_angular_velocity or 0.0))
    else:
        amplitude, rate = motion.amplitude_and_angular_frequency(gravity)
        rate = rate if amplitude else 0.0
    return 2.0 * math.pi / rate if rate else math.inf
