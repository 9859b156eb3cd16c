"""Upper bounds of the speed of moving walls."""

from collections.abc import Sequence

import numpy as np

from granflow.geometry.motion import Motion, Rotation, Translation, VelocityMotion, Vibration
from granflow.geometry.motion_table import TableRotation, TableTranslation


def speed_bound(motions: Sequence[Motion], reach: float) -> float:
    """Upper bound [m/s] of the speed of any point of the wall, as if all motions were active simultaneously.

    The sum of |velocity| of translations, A w of vibrations and |angular velocity| `reach` of the rotation, with the
    largest distance [m] from its axis of geometry that moves (`catalog.reach_about`). Force-controlled motions and
    surface velocities are ignored.
    """
    bound = 0.0
    for motion in motions:
        if isinstance(motion, Translation):
            bound += top_speed(motion)
        elif isinstance(motion, Vibration):
            bound += abs(motion.amplitude * motion.angular_frequency)
        elif isinstance(motion, Rotation):
            bound += max(abs(motion.angular_velocity), abs(motion.initial_angular_velocity)) * reach
        elif isinstance(motion, TableTranslation | TableRotation):
            bound += motion.table.largest_rate * (1.0 if isinstance(motion, TableTranslation) else reach)
    return bound


def top_speed(motion: VelocityMotion) -> float:
    """Largest speed [m/s] of the motion, at the start or at the end of its ramp."""
    ends = np.linalg.norm([motion.velocity, motion.initial_velocity], axis=1)
    return float(ends.max()) if motion.ramp_duration else float(ends[0])
