"""Arrays of snapshots."""

import numpy as np

from granflow.engine.accounting import BY_ID, Accounting
from granflow.engine.state import State
from granflow.engine.wall_dynamics import controlled_displacements
from granflow.geometry.motion import pose
from granflow.snapshot import WallPose


def ordered_particles(arrays: dict[str, np.ndarray], accounting: Accounting) -> dict[str, np.ndarray]:
    """Arrays of Snapshot.particles, ordered by id, from arrays (n,) or (n, 3) in device order.

    Without rotation, angular velocity and torque are zero.
    """
    order = np.argsort(arrays["id"], kind="stable")
    found = {name: values[order] for name, values in arrays.items()}
    found["id"] = found["id"].astype(np.int64)
    for name in BY_ID:
        found[name] = accounting.by_id(name, found["id"])
    for name in ("angular_velocity", "torque"):
        found.setdefault(name, np.zeros_like(found["velocity"]))
    return found


def wall_poses(state: State) -> dict[str, WallPose]:
    """Present pose of every wall by name."""
    found, displacements = {}, controlled_displacements(state)
    for index, wall in enumerate(state.plan.walls):
        poses = pose(state.wall_motions[index], np.array([state.clock.time]))
        present = bool(state.walls.present[index])
        found[wall.name] = WallPose(
            present,
            poses.offset[0] + displacements[index],
            poses.rotation[0],
            poses.pivot,
            poses.surface_velocity[0],
        )
    return found
