"""The time loop: advances to the next event, handles it, and repeats."""

import logging
import time as clock
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from granflow.engine.backend import Arch, Precision, start
from granflow.engine.checkpoint import EngineCheckpoint
from granflow.engine.engine import Engine
from granflow.engine.limits import Diagnosis, abort_message
from granflow.errors import OutputError, RunError
from granflow.geometry.catalog import triangles
from granflow.io.atomic_files import remove_parts
from granflow.io.checkpoint import Checkpoint, remove_after
from granflow.io.lock import locked
from granflow.io.log import run_log, write_scene_as_run
from granflow.load import Scene
from granflow.observers.base import Checkpointable, Observer
from granflow.observers.build import observers_for, progress_for, time_series_for
from granflow.observers.timeseries import TimeSeries
from granflow.particles.generate import initial_particles
from granflow.plan.build import plan_for
from granflow.plan.memory_check import refuse_too_many, refuse_without_memory
from granflow.plan.plan import Plan
from granflow.plan.run_time import refuse_run_time
from granflow.plan.scene_parts import PlannedStage
from granflow.plan.walls import wall_change_times, wall_motions
from granflow.runs.checkpoint_observers import check_observers, check_streams
from granflow.runs.initial_from_run import particles_from_run
from granflow.runs.input_copies import copy_inputs
from granflow.runs.insertion import ParticleInsertion
from granflow.runs.previous import refuse_inputs_inside, replaced_run
from granflow.runs.result import Result, write_result
from granflow.runs.resume import Change, CheckpointWriter, accepted_change, plan_fingerprint
from granflow.runs.stage_progress import REST_CHECKS, StageProgress
from granflow.runs.timings import Readings, WallClock, collect_result, log_plan
from granflow.snapshot import Snapshot

CHUNK_SECONDS = 0.2
"""Wall-clock time of one batch of steps [s]; between batches, signals are handled and checkpoints written."""

ALL_QUANTITIES = frozenset({"particles", "walls", "totals"})
"""Quantities of a complete snapshot without contacts."""
TOTALS = frozenset({"totals"})
"""Quantities of a snapshot that contains totals only."""


class Simulation:
    """One run of one scene.

    scene:          scene of `load_scene` or `Scene.from_dict`
    arch:           architecture, "cpu" by default
    precision:      overrides that of the scene
    threads:        CPU threads; None: all available
    out:            directory for the files of the scene's output block; without it no files are written
    observers:      additional observers, such as `granflow.observers.interval.every(interval, function)`
    progress:       display the progress
    resume:         checkpoint from which to continue
    allow_changes:  resume even if the scene has changes that are not permitted
    allow_long:     accept a run with an estimated duration of more than a year
    Raises:         SceneError for an invalid scene, GranflowError if `arch` is not available or the run cannot be
                    resumed

    `run` raises RunError on an abort and OutputError if files cannot be written. All simulations in one process must
    have the same architecture, precision and threads.
    """

    def __init__(
        self,
        scene: Scene,
        arch: Arch = "cpu",
        precision: Precision | None = None,
        threads: int | None = None,
        out: Path | str | None = None,
        observers: Sequence[Observer] = (),
        progress: bool = False,
        resume: Checkpoint | None = None,
        allow_changes: bool = False,
        allow_long: bool = False,
    ) -> None:
        if precision is not None:
            scene = scene.with_precision(precision)
        self.scene = scene
        self.out = None if out is None else Path(out)
        self._wall_clock = WallClock()
        backend = start(arch, scene.run.precision, threads)
        if self.out is not None and resume is None:
            refuse_inputs_inside(scene, self.out, only_results=True)
        self.plan: Plan = plan_for(scene, on_gpu=not backend.on_cpu)
        refuse_too_many(self.plan)
        refuse_run_time(self.plan, allow_long)
        if backend.on_cpu:
            refuse_without_memory(self.plan)
        change = accepted_change(resume, scene, self.plan, allow_changes) if resume is not None else None
        earlier = particles_from_run(scene) if resume is None else resume.saved["earlier"]
        self._earlier = list(earlier)
        particles = initial_particles(scene, earlier) if resume is None else None
        self._insertion = ParticleInsertion(scene, earlier)
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)
        self.engine = Engine(self.plan, backend)
        self._engine_checkpoint = EngineCheckpoint(self.engine)
        self._stage_progress = StageProgress.of(self.plan)
        self._observers = [*self._default_observers(progress), *observers]
        self._chunk_steps = 1
        self._stop_requested: BaseException | None = None
        self._writer = None if self.out is None else CheckpointWriter(self.out, scene.output.checkpoint)
        self._resumed = resume
        self._delete_previous: Callable[[], None] = lambda: None
        if particles is not None:
            self.engine.insert(particles)
        if resume is not None and change is not None:
            self._load_state_dict(resume, change)
        self._wall_clock.set_up(self.engine.timing.compile)

    @property
    def stage(self) -> str:
        """Name of the current stage."""
        return self._stage_progress.stage

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.engine.time

    def snapshot(self, contacts: bool = False) -> Snapshot:
        """Return the current state as read-only arrays, particles ordered by id.

        `contacts`: also evaluate the contacts.
        """
        return self.engine.snapshot(self.stage, ALL_QUANTITIES | ({"contacts"} if contacts else frozenset()))

    def run(self, until: float | None = None) -> Result:
        """Run all stages, or to the simulated time `until` [s]; return the numbers of the run.

        Returns:  numbers of the run; expectations of the scene are evaluated if it has reached its end
        Raises:   RunError on an abort; OutputError if files cannot be written, after a checkpoint if possible
        """
        try:
            with ExitStack() as stack:
                if self.out is not None:
                    stack.enter_context(locked(self.out))
                    if self._resumed is None:
                        self._delete_previous = stack.enter_context(replaced_run(self.out))
                    self._clean_output(self.out)
                    stack.enter_context(run_log(self.out, append=self._resumed is not None))
                stack.callback(self._finish_observers)
                if self.out is not None:
                    log_plan(self.plan, self.engine, self._resumed)
                return self._run(until)
        except OSError as error:
            raise self._output_error(error) from error

    def _run(self, until: float | None) -> Result:
        """Run the stages that have not ended, then write checkpoint and result."""
        self._wall_clock.start()
        if self._writer is not None:
            self._writer.start(self.time)
        end = inf if until is None else until
        for stage in self.plan.stages:
            if self.time < end and not self._stage_progress.has_ended(stage.name):
                self._run_stage(stage, end)
        self._save()
        last = self._notify(self._observers, TOTALS)
        readings = {**self._readings(), "insertion": self._insertion.results()}
        result = collect_result(self.engine, self._wall_clock, last.totals, readings)
        if self.time < end or until is None:
            result = result.with_expectations(self.plan.expectations)
        self._log_end()
        if self.out is not None:
            write_result(self.out, result)
        return result

    def _log_end(self) -> None:
        """Log size classes, particles that were not inserted, and the end of the run."""
        log = logging.getLogger("granflow")
        for sentence in self._insertion.class_shares():
            log.info("%s", sentence)
        for sentence in self._insertion.shortfalls():
            log.warning("%s", sentence)
        log.info("done at %.6g s after %d steps", self.time, self.engine.step_count)

    def request_stop(self, error: BaseException) -> None:
        """Make `run` complete the current steps, write a checkpoint and raise `error`; for signal handlers."""
        self._stop_requested = error
        self.engine.stepper.interrupted = True

    @property
    def checkpoint_time(self) -> float | None:
        """Simulated time of the last checkpoint [s], initially that of the resumed one; None without a checkpoint."""
        written = self._writer.last_time if self._writer is not None else None
        return self._resumed.time if written is None and self._resumed is not None else written

    @property
    def rows_intact(self) -> bool:
        """Whether the time series still has all rows of the resumed run."""
        return all(observer.rows_intact for observer in self._observers if isinstance(observer, TimeSeries))

    def _clean_output(self, out: Path) -> None:
        """Remove temporary files, newer checkpoints and results after the resumed state; write the input files."""
        remove_parts(out)
        remove_after(out, self._resumed.path if self._resumed else None)
        copy_inputs(out, self.scene)
        write_scene_as_run(out, self.scene)
        if self._resumed is not None:
            (out / "result.json").unlink(missing_ok=True)
            for observer in self._observers:
                if isinstance(observer, Checkpointable):
                    observer.truncate()

    def _readings(self) -> Mapping[str, Readings]:
        """Return the numbers of the flow meters, wall forces and metrics."""
        series = [observer for observer in self._observers if isinstance(observer, TimeSeries)]
        return series[0].results_by_kind() if series else {}

    def _default_observers(self, progress: bool) -> list[Observer]:
        """Return the observers of the scene's output block, and the progress display."""
        found: list[Observer] = []
        if self.out is not None:
            center = 0.5 * (self.plan.domain_low + self.plan.domain_high)
            extent = 0.5 * float(np.max(self.plan.domain_high - self.plan.domain_low))
            surfaces = {wall.name: triangles(wall.shape, center, extent) for wall in self.plan.walls}
            found += observers_for(self.plan, self.out, surfaces)
        elif self.plan.output.flow_meters or self.plan.output.metrics or self.plan.measured_walls:
            found.append(time_series_for(self.plan, None))
        if progress:
            found.append(progress_for(self.plan))
        return found

    def _run_stage(self, stage: PlannedStage, end: float) -> None:
        """Run a stage to its end, or to `end` [s].

        The stage ends after its longest duration, or, with `kinetic_energy_below`, at the first check at which the
        particles are at rest; REST_CHECKS checks are distributed evenly. A resumed stage continues at its target.
        """
        progress = self._stage_progress
        if stage.name not in progress.stage_times:
            self._begin_stage(stage, stage.longest / REST_CHECKS)
        stop = progress.stage_times[stage.name][0] + stage.longest
        while progress.target is not None or not self._reached(min(stop, end)):
            next_check = progress.next_check if stage.kinetic_energy_below is not None else inf
            self._advance_to(min(stop, end, next_check, self._next_event()))
            if self._reached(next_check):
                progress.next_check += stage.longest / REST_CHECKS
                if self._at_rest(stage):
                    break
        else:
            if not self._reached(stop):
                return
        progress.end(self.time)

    def _at_rest(self, stage: PlannedStage) -> bool:
        """Whether the mean kinetic energy per particle is below the limit of the stage, and no insertion is pending."""
        limit = stage.kinetic_energy_below
        return limit is not None and self.engine.mean_kinetic_energy() < limit and self._insertion.is_done

    def _begin_stage(self, stage: PlannedStage, check_interval: float) -> None:
        """Begin a stage: place its walls, insert due particles, compute the forces.

        At the first stage, notify all observers and delete the results of the previous run in the directory.
        """
        first = not self._stage_progress.stage_times
        logging.getLogger("granflow").info("stage %s begins at %.6g s", stage.name, self.time)
        self._stage_progress.begin(stage.name, self.time, check_interval)
        self._stage_progress.set_walls(self.engine)
        self._insertion.insert_due(self.engine)
        self.engine.refresh()
        if self.engine.diagnosis is not None:
            self._abort(self.engine.diagnosis)
        if first:
            self._notify(self._observers)
            self._delete_previous()

    def _reached(self, time: float) -> bool:
        """Whether the current step is the nearest to this time [s], or later."""
        return self.engine.reached(time)

    def _next_event(self) -> float:
        """Return the simulated time [s] of the next observation, insertion or wall change."""
        due = [observer.next_time() for observer in self._observers] + [self._insertion.next_time()]
        due += [time for time in self._stage_progress.changes if not self._reached(time)]
        return min(due, default=inf)

    def _advance_to(self, time: float) -> None:
        """Advance to `time` [s], handle insertion and wall changes there, and notify the observers that are due.

        The target is at least one step ahead, so that the run always advances. A resumed run continues to its saved
        target.
        """
        progress = self._stage_progress
        if progress.target is None:
            progress.set_target(max(time, self.time + self.engine.time_step))
        assert progress.target is not None
        self._advance(progress.target)
        diagnosis = self.engine.diagnosis
        if diagnosis is not None:
            self._abort(diagnosis)
        if not progress.arrived:
            self._insert_and_update_walls()
            progress.arrived = True
        due = [observer for observer in self._observers if self._reached(observer.next_time())]
        if due:
            self._notify(due)
        progress.target = None

    def _advance(self, target: float) -> None:
        """Advance to `target` [s] in batches, between which signals are handled and checkpoints written.

        The number of steps of a batch follows the measured rate, so that a batch takes about CHUNK_SECONDS; it at most
        doubles from one batch to the next.
        """
        while self.engine.steps_to(target) > 0 and not self.engine.aborted:
            began, before = clock.perf_counter(), self.engine.step_count
            checkpoint = self._writer.next_time() if self._writer is not None else inf
            steps_to_checkpoint = (
                max(self.engine.steps_to(checkpoint), 1) if isfinite(checkpoint) else self._chunk_steps
            )
            self.engine.advance(min(self._chunk_steps, self.engine.steps_to(target), steps_to_checkpoint))
            step_rate = (self.engine.step_count - before) / max(clock.perf_counter() - began, 1e-9)
            self._chunk_steps = max(min(int(step_rate * CHUNK_SECONDS), 2 * self._chunk_steps), 1)
            if not self.engine.aborted:
                self._handle_requests()

    def _handle_requests(self) -> None:
        """Stop if requested, after a checkpoint; write a checkpoint if due, and log a write error."""
        if self._stop_requested is not None:
            self._save()
            raise self._stop_requested
        if self._writer is not None and self._writer.due(self.time):
            try:
                self._save()
            except OSError as error:
                if self.out is None or not self.out.is_dir():
                    raise
                logging.getLogger("granflow.checkpoint").warning("No checkpoint at %.6g s: %s", self.time, error)

    def _insert_and_update_walls(self) -> None:
        """Insert particles that are due, and update the presence of walls."""
        inserted = self._insertion.insert_due(self.engine)
        if self._stage_progress.remove_past_changes(self.engine) or inserted:
            self._stage_progress.set_walls(self.engine)
            self.engine.refresh()

    def _notify(
        self, observers: Sequence[Observer], quantities: frozenset[str] = frozenset(), aborted: bool = False
    ) -> Snapshot:
        """Pass a snapshot to observers; that of an aborted run only if all its numbers are finite.

        quantities:  quantities of the snapshot in addition to those that the observers request
        Returns:     the snapshot
        """
        quantities = quantities.union(*(observer.wants for observer in observers))
        with self._wall_clock.measuring_output():
            snapshot = self.engine.snapshot(self.stage, quantities)
            for observer in observers if not aborted or snapshot.is_finite else ():
                observer.observe(snapshot)
        return snapshot

    def _finish_observers(self) -> None:
        """Close the files of all observers."""
        for observer in self._observers:
            observer.finish()

    def _abort(self, diagnosis: Diagnosis) -> None:
        """Abort: write the state if all its numbers are finite, and raise RunError with the diagnosis."""
        message = abort_message(diagnosis, self.plan, self.time)
        written = self._notify(self._observers, TOTALS, aborted=True).is_finite
        if self.out is not None and written:
            message += f" The state is written to {self.out}."
        elif self.out is not None:
            message += f" The state is not finite and is not written; {self.out} contains the earlier frames."
        raise RunError(message)

    def _save(self) -> None:
        """Write a checkpoint; nothing without an output directory."""
        if self._writer is not None:
            began = clock.perf_counter()
            with self._wall_clock.measuring_output():
                self._writer.write(self.scene, self.time, self.engine.step_count, self._state_dict())
            seconds = clock.perf_counter() - began
            logging.getLogger("granflow").info("checkpoint at %.6g s, written in %.3g s", self.time, seconds)

    def _state_dict(self) -> dict[str, Any]:
        """Return the complete state of the run, except for the scene.

        Nested dictionaries of numbers, texts and numpy arrays.
        """
        return {
            "stage_progress": self._stage_progress.state_dict(),
            "wall_clock": self._wall_clock.state_dict(self.engine),
            "plan": plan_fingerprint(self.plan),
            "earlier": self._earlier,
            "insertion": self._insertion.state_dict(),
            "observers": {name: observer.state_dict() for name, observer in self._checkpointed()},
            "engine": self._engine_checkpoint.state_dict(),
        }

    def _load_state_dict(self, checkpoint: Checkpoint, change: Change) -> None:
        """Restore the state of the checkpoint and apply the changes of the scene.

        change:  accepted differences between the scenes of the checkpoint and of this run
        Raises:  GranflowError if observers, particle groups or arrays do not match the checkpoint
        """
        saved = checkpoint.saved
        check_observers(checkpoint, {name: observer.state_dict() for name, observer in self._checkpointed()})
        counts = {group.name: group.count for group in self.plan.groups}
        check_streams(checkpoint, self._insertion.state_dict(), counts)
        reopened = change.moves_stage_end(len(saved["stage_progress"]["stage_times"]) - 1)
        self._stage_progress.load_state_dict(saved["stage_progress"], reopened, same_scene=not change.differences)
        self._engine_checkpoint.load_state_dict(
            saved["engine"], wall_motions([wall.motions for wall in self.plan.walls], self._stage_progress.stage_times)
        )
        self._insertion.load_state_dict(saved["insertion"], self.engine)
        for name, observer in self._checkpointed():
            if name in saved["observers"]:
                observer.load_state_dict(saved["observers"][name])
        self._wall_clock.load_state_dict(saved["wall_clock"])
        if change.affects_contacts:
            self._stage_progress.changes = tuple(
                time for time in wall_change_times(self.plan.walls) if not self._reached(time)
            )
            self._stage_progress.set_walls(self.engine)
            self.engine.refresh()

    def _checkpointed(self) -> list[tuple[str, Checkpointable]]:
        """Return the observers whose state is part of checkpoints, with unique names."""
        found: dict[str, Checkpointable] = {}
        for observer in self._observers:
            if isinstance(observer, Checkpointable):
                kind = type(observer).__name__
                found[f"{kind} {sum(name.startswith(kind) for name in found)}"] = observer
        return list(found.items())

    def _output_error(self, error: OSError) -> OutputError:
        """Return the error for files that cannot be written, after a checkpoint if possible.

        The message contains the file, the reason, the simulated time [s] and the command that resumes the run.
        """
        where = f"{error.filename}: " if error.filename else f"{self.out}: "
        try:
            if self.out is not None and self._stage_progress.target is not None:
                self.out.mkdir(parents=True, exist_ok=True)
                self._save()
        except OSError:
            logging.getLogger("granflow").debug("no checkpoint can be written either")
        last = self._writer.last_time if self._writer is not None else None
        remedy = f"Correct this; granflow resume {self.out} continues from {last:.6g} s." if last is not None else ""
        return OutputError(f"{where}{error.strerror}. Stopped at {self.time:.6g} s. {remedy}".rstrip())

    def free(self) -> None:
        """Release the device memory; the simulation cannot continue afterwards."""
        self.engine.free()
