"""Poses of the walls, and offsets of the images of a sheared box, on the device for WALL_BATCH steps in advance."""

from granflow.engine.periodic_box import upload_offsets
from granflow.engine.state import State
from granflow.engine.walls import upload_poses
from granflow.plan.capacities import WALL_BATCH


class WallPoses:
    """The poses on the device.

    `next`: index of the poses of the next step; WALL_BATCH if they must be uploaded, 0 without poses.
    """

    def __init__(self, state: State) -> None:
        self._state = state
        self.discard()

    def discard(self) -> None:
        """Upload the poses again before their next use, because motions or the time step have changed."""
        self.next = WALL_BATCH if self._state.plan.has_poses else 0
        self._first_step: int | None = None

    def index_at(self, step: int) -> int:
        """Index of the poses after step number `step`; uploads them unless they are on the device."""
        if not self._state.plan.has_poses:
            return 0
        first = self._first_step
        if first is None or not 0 <= step - first < WALL_BATCH:
            self._upload(step)
            self.next, first = 1, step
        return step - first

    def prepare(self, step: int, steps_since_rebuild: int) -> int:
        """Upload the poses of the steps after number `step` if necessary; returns the number of steps that they allow.

        If a wall may move too far in the next step, requests a rebuild: walls are not in the displacement check of the
        particles. The rebuild follows the integration of the next step, as all others: forces are not computed again
        for it.
        """
        if not self._state.plan.has_poses:
            return WALL_BATCH
        allowed = self._steps_to_displacement_limit(steps_since_rebuild)
        if allowed < 1:
            self._state.control.rebuild_requested[0] = 1
        if self.next == WALL_BATCH:
            self._upload(step + 1)
            self.next = 0
        return min(WALL_BATCH - self.next, max(allowed, 1))

    def advance(self, steps: int) -> None:
        """Continue after a number of completed steps."""
        if self._state.plan.has_poses:
            self.next += steps

    def _upload(self, step: int) -> None:
        """Upload the poses of walls and images from step number `step`."""
        self._first_step = step
        if self._state.plan.features.moving_walls:
            upload_poses(self._state, step)
        if self._state.plan.features.lees_edwards:
            upload_offsets(self._state, step)

    def _steps_to_displacement_limit(self, steps_since_rebuild: int) -> int:
        """Steps until the fastest wall may reach its displacement limit between rebuilds, or an image the skin.

        Force-controlled walls request their rebuilds on the device. WALL_BATCH if nothing moves.
        """
        plan = self._state.plan
        displacement_limit, speed = (
            (plan.wall_displacement_limit, plan.wall_speed)
            if not plan.features.lees_edwards
            else (plan.skin, plan.image_speed)
        )
        if speed == 0.0:
            return WALL_BATCH
        return int(displacement_limit / (speed * plan.longest_time_step)) - steps_since_rebuild
