"""The walls of a simulation, changed from Python while it runs: `simulation.walls[NAME]` is a `LiveWall`."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NoReturn

from granflow.engine.totals import wall_poses
from granflow.errors import GranflowError
from granflow.plan.wall_changes import wall_named, with_motions, without_wall
from granflow.plan.walls import wall_motions
from granflow.runs.run_state import RunState
from granflow.scene.blocks.motions import ASSIGNABLE, TimedMotion
from granflow.snapshot import WallPose


class LiveWall:
    """One wall of a simulation; changes take effect with the next step."""

    def __init__(self, state: RunState, name: str) -> None:
        self._state = state
        self._name = name

    def __setattr__(self, name: str, value: object) -> None:
        """Assign a motion. Raises AttributeError for another attribute, which would have no effect."""
        if name != "motion" and not name.startswith("_"):
            raise AttributeError(
                f"walls[{self._name!r}].{name} cannot be set: assign a motion, such as "
                f"walls[{self._name!r}].motion = granflow.Translation(velocity=[0, 0, 0.1]), or remove the "
                "wall."
            )
        super().__setattr__(name, value)

    @property
    def name(self) -> str:
        """Name of the wall in the scene."""
        return self._name

    def __repr__(self) -> str:
        return f"<wall {self.name}, {'present' if self.is_present else 'not present'}>"

    @property
    def is_present(self) -> bool:
        """Whether the wall is present in the next step."""
        engine = self._state.engine
        middle = engine.time + 0.5 * engine.time_step
        wall = wall_named(self._state.plan, self.name)
        return wall.spec.is_present(self._state.progress.stage, middle)

    @property
    def pose(self) -> WallPose:
        """Present pose of the wall; `pose.moved(points)` are the present positions of points (n, 3) [m] at
        rest."""
        return wall_poses(self._state.engine.state)[self.name]

    def remove(self) -> None:
        """Remove the wall at the present time. The energy of its contacts counts as removed."""
        self._state.change_walls(without_wall(self._state.plan, self.name, self._state.engine.time))

    @property
    def motion(self) -> tuple[TimedMotion, ...]:
        """Motions of the wall; assign a motion, a list of them, or None to stop the wall.

            simulation.walls["drum"].motion = granflow.Rotation(
                point=[0, 0, 0], axis=[0, 1, 0], angular_velocity="30 rpm"
            )

        A motion begins at the present time, unless it has a later `start`, and from the present pose; points
        and directions are those in space. The first motion of a scene in which no wall moves compiles the
        kernels again. Raises GranflowError for a force-controlled wall, or a motion that is too fast for the
        time step.
        """
        return wall_named(self._state.plan, self.name).motions

    @motion.setter
    def motion(self, given: TimedMotion | Sequence[TimedMotion] | None) -> None:
        state = self._state
        time = state.engine.time
        motions: list[Any]
        if given is None:
            motions = []
        else:
            motions = list(given) if isinstance(given, list | tuple) else [given]
        for each in motions:
            if not isinstance(each, ASSIGNABLE):
                kinds = ", ".join(kind.__name__ for kind in ASSIGNABLE)
                raise GranflowError(
                    f"walls[{self.name!r}].motion is {each!r}, but must be a {kinds}, a list of them, or "
                    "None."
                )
            if each.stages is not None:
                raise GranflowError(f"walls[{self.name!r}].motion has stages: give start and end instead.")
        wall = wall_named(state.plan, self.name)
        if wall.spec.end_time <= time:
            raise GranflowError(
                f"walls[{self.name!r}] was removed at {wall.spec.end_time:.6g} s: it cannot move."
            )
        (present,) = wall_motions([wall.motions], state.progress.stage_times)
        begun = [each.numeric(state.plan.scene.usual_gravity).not_before(time) for each in motions]
        state.change_walls(with_motions(state.plan, self.name, begun, time, present))


class LiveWalls(Mapping[str, LiveWall]):
    """The walls of a simulation by name.

    simulation.walls["gate"].remove()
    """

    def __init__(self, state: RunState) -> None:
        self._state = state

    def __getitem__(self, name: str) -> LiveWall:
        """The wall with this name. Raises GranflowError for an unknown one."""
        return LiveWall(self._state, wall_named(self._state.plan, name).name)

    def __setitem__(self, name: str, value: object) -> NoReturn:
        """Raises GranflowError: walls are those of the scene."""
        raise GranflowError(
            f"walls[{name!r}] cannot be set: walls are those of the scene; assign a motion, such as "
            f"walls[{name!r}].motion = granflow.Translation(velocity=[0, 0, 0.1])."
        )

    def __delitem__(self, name: str) -> NoReturn:
        """Raises GranflowError: `remove` of a wall does it at the present time."""
        raise GranflowError(f"walls[{name!r}] cannot be deleted: call walls[{name!r}].remove().")

    def __setattr__(self, name: str, value: object) -> None:
        """Raises AttributeError: walls have no attributes of their own."""
        if not name.startswith("_"):
            raise AttributeError(f"walls.{name} cannot be set: walls are found by name, walls[{name!r}].")
        super().__setattr__(name, value)

    def __iter__(self) -> Iterator[str]:
        return iter([wall.name for wall in self._state.plan.walls])

    def __len__(self) -> int:
        return len(self._state.plan.walls)

    def __repr__(self) -> str:
        return repr(list(self.values()))
