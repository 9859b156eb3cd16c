"""The complete state of a run, except for its scene: what a checkpoint contains."""

import logging
import time as clock
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from math import inf
from threading import Thread
from typing import Any

from granflow.engine.backend import refuse_other_thread
from granflow.engine.checkpoint import (
    RankFileWriter,
    keep_particles,
    rank_file_entries,
    restore_state,
    saved_particles,
    saved_sums_and_clocks,
    with_plan,
)
from granflow.engine.engine import Engine
from granflow.engine.state import Clock
from granflow.io.checkpoint import Checkpoint
from granflow.plan.plan import Plan
from granflow.plan.walls import wall_change_times, wall_motions
from granflow.runs.insertion import ParticleInsertion
from granflow.runs.observer_list import ObserverList
from granflow.runs.resume import Change, plan_fingerprint, refuse_other_keys, saved_changes
from granflow.runs.stages import StageProgress
from granflow.runs.timings import WallClock
from granflow.scene.blocks.run import Stage


class RunState:
    """Engine, stages, insertion, observers and wall clock of a run.

    `earlier`: names of the groups whose particles do not come from the scene. `original`: plan of the scene.
    `plan`: of the next step; changes from Python replace it, and `prepare` applies it.
    """

    def __init__(
        self,
        engine: Engine,
        insertion: ParticleInsertion,
        observers: ObserverList,
        wall_clock: WallClock,
        earlier: list[str],
        original: Plan,
    ) -> None:
        self._engine = engine
        self.insertion = insertion
        self.observers = observers
        self.wall_clock = wall_clock
        self.progress = StageProgress.of(engine.plan)
        self.plan = engine.plan
        self._original = original
        self._earlier = earlier
        self._walls_changed = False
        self.is_unobserved = False
        engine.set_stage(self.progress.stage)

    @property
    def engine(self) -> Engine:
        """The engine of the run.

        Raises GranflowError in another thread than its own, or in a forked process.
        """
        refuse_other_thread(self.owner)
        return self._engine

    @property
    def owner(self) -> Thread:
        """The thread of the run."""
        return self._engine.state.backend.owner

    @property
    def clock(self) -> Clock:
        """The clock of the run, which every thread may read."""
        return self._engine.state.clock

    def free(self) -> None:
        """Release the device memory; also in another thread, if that of the run has ended."""
        if self.owner.is_alive():
            refuse_other_thread(self.owner)
        self._engine.free()

    def prepare(self) -> None:
        """Continue with an engine for `plan`, which may have changed; compiles new features."""
        engine = self.engine
        if self.plan is not engine.plan:
            self._engine = with_plan(engine, self.plan)
            self._engine.set_stage(self.progress.stage)
        if self._walls_changed and self.progress.stage_times:
            self.progress.set_walls(self.engine)
        self._walls_changed = False

    def begin(self) -> None:
        """Begin the first stage, unless this is done.

        From then on, contacts and forces of the initial state are known.

        The observers receive the initial state when the run begins, until which `is_unobserved` is True.
        """
        if not self.progress.stage_times:
            self.begin_stage(self.engine.plan.stages[0])
            self.is_unobserved = True

    def begin_stage(self, stage: Stage) -> None:
        """Begin a stage: delete particles, place its walls, insert due particles, set their properties.

        The forces are known afterwards.
        """
        self.prepare()
        progress = self.progress
        engine = self.engine
        if stage.delete:
            if engine.is_changed:  # particles that a program has removed are counted already
                engine.refresh()
            _warn_of_no_particles(stage, "delete", engine.delete(stage.name), engine)
        progress.begin(stage, engine.time)
        engine.begin_stage(stage.name, engine.plan.scene.gravity_course(progress.stage_times))
        progress.set_walls(engine)
        self.insertion.begin_stage(stage.name, engine.time)
        self.insertion.insert_due(engine)
        engine.refresh()
        if stage.set_:
            _warn_of_no_particles(stage, "set", engine.apply_settings(stage.name), engine)
            engine.refresh()
        progress.controls.begin(engine, stage.longest)
        progress.conditions.begin(stage, engine.time)

    def change_walls(self, plan: Plan) -> None:
        """Continue with a plan with other walls."""
        self.plan = plan
        self._walls_changed = True

    def state_dict(self, writer: RankFileWriter) -> dict[str, Any]:
        """Return the state for a checkpoint: nested dictionaries of numbers, texts and numpy arrays.

        `writer`: writes the particles of MPI ranks other than the root before. Raises OSError.
        """
        self.observers.sync()
        rank_files = rank_file_entries(self.engine, writer)
        return _with_particles(self._without_particles(), rank_files, saved_particles(self.engine))

    def kept(self) -> "KeptState":
        """Return a copy of the present state in memory; it replaces the copy before it."""
        keep_particles(self.engine)
        return KeptState(
            self.engine, self.engine.time, self.engine.step_count, deepcopy(self._without_particles())
        )

    def _without_particles(self) -> dict[str, Any]:
        """The state for a checkpoint without the particles and their contacts."""
        return {
            "stage_progress": self.progress.state_dict(),
            "wall_clock": self.wall_clock.state_dict(self.engine),
            "plan": plan_fingerprint(self.engine.plan),
            "changes": saved_changes(self.plan, self._original, self.observers),
            "earlier": self._earlier,
            "insertion": self.insertion.state_dict(),
            "observers": {
                name: observer.state_dict() for name, observer in self.observers.checkpointed().items()
            },
            "stability": self.engine.stability_monitor.state_dict(),
            "engine": saved_sums_and_clocks(self.engine),
        }

    def load_state_dict(self, checkpoint: Checkpoint, change: Change) -> None:
        """Restore the state of the checkpoint and apply the changes of the scene.

        change:  accepted differences between the scenes of the checkpoint and of this run
        Raises:  GranflowError if observers, particle groups or arrays do not match the checkpoint
        """
        saved = checkpoint.saved
        engine = self.engine
        progress = self.progress
        observers = self.observers.checkpointed()
        refuse_other_keys(checkpoint, "insertion", self.insertion.state_dict())
        for name, observer in observers.items():
            if name in saved["observers"]:
                refuse_other_keys(checkpoint, f"observers/{name}", observer.state_dict())
        reopened = change.moves_stage_end(len(saved["stage_progress"]["stage_times"]) - 1)
        progress.load_state_dict(saved["stage_progress"], engine.plan.stages, reopened, change.keeps_course)
        motions = wall_motions([wall.motions for wall in engine.plan.walls], progress.stage_times)
        engine.set_gravity(engine.plan.scene.gravity_course(progress.stage_times))
        restore_state(engine, saved["engine"], motions, checkpoint.rank_files)
        engine.set_stage(progress.stage)
        engine.stability_monitor.load_state_dict(saved["stability"])
        self.insertion.load_state_dict(saved["insertion"], engine)
        for name, observer in observers.items():
            if name in saved["observers"]:
                observer.load_state_dict(saved["observers"][name])
        self.wall_clock.load_state_dict(saved["wall_clock"])
        if change.affects_walls:
            times = wall_change_times(engine.plan.walls)
            progress.changes = tuple(time for time in times if not engine.reached(time))
        if change.affects_forces:
            progress.set_walls(engine)
            engine.refresh()


def _warn_of_no_particles(stage: Stage, key: str, counts: Sequence[int], engine: Engine) -> None:
    """Warn of entries of a key of a stage that apply to no particle, with the number of particles of each."""
    scene = engine.plan.scene
    number = [each.name for each in engine.plan.stages].index(stage.name)
    for index, count in enumerate(counts):
        if not count:
            place = scene.locate("stages", number, key, index)
            logging.getLogger("granflow").warning(
                "stage %s (%s): none of the %d particles is in the groups and the region of the %s.",
                stage.name,
                place,
                engine.particle_count,
                {"set": "setting", "delete": "deletion"}[key],
            )


@dataclass(frozen=True)
class KeptState:
    """A state of a run in the memory of each process, from which a checkpoint can be written later.

    `engine`: keeps the particles; `time` [s], `step`: of the state; `saved`: all else.
    """

    engine: Engine
    time: float
    step: int
    saved: dict[str, Any]

    def state_dict(self, writer: RankFileWriter) -> dict[str, Any]:
        """As `RunState.state_dict` at the time of the copy. Raises OSError."""
        rank_files = rank_file_entries(self.engine, writer, kept=True)
        return _with_particles(self.saved, rank_files, saved_particles(self.engine, kept=True))


def _with_particles(
    saved: dict[str, Any], rank_files: list[dict[str, Any]], particles: dict[str, Any]
) -> dict[str, Any]:
    """A complete state: all else, the files of other MPI ranks, and the particles of the root."""
    return saved | {"rank_files": rank_files, "engine": saved["engine"] | particles}


KEPT_SECONDS = 2.0
"""Shortest wall-clock time [s] between two copies of the state."""
KEPT_SHARE = 0.003
"""Largest share of the wall-clock time that copies take."""


class LastGoodState:
    """The state before an abort: the device has overwritten it when a limit is exceeded.

    A copy in memory is taken between two launches every KEPT_SECONDS, and less often if copies take more than
    KEPT_SHARE of the time. The steps after it are deterministic: a run that continues from it reaches the
    step of the abort with the same bits.
    """

    def __init__(self, state: RunState) -> None:
        self._state = state
        self.kept: KeptState | None = None
        self._next = -inf

    def keep_if_due(self) -> None:
        """Copy the present state if that is due. Raises OSError if frames cannot be written."""
        if clock.monotonic() >= self._next:
            began = clock.perf_counter()
            self.kept = None
            self.kept = self._state.kept()
            self._wait(clock.perf_counter() - began)

    def clear(self) -> None:
        """Drop the copy: the particles are replaced."""
        self.kept = None
        self._state.engine.on_each_rank(_clear_particles)
        self._wait(0.0)

    def _wait(self, seconds: float) -> None:
        self._next = clock.monotonic() + max(KEPT_SECONDS, seconds / KEPT_SHARE)


def _clear_particles(engine: Engine, _rank: int) -> None:
    engine.kept_particles = None
