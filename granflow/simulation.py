"""The time loop: advances to the next event, handles it, and repeats."""

import logging
from collections.abc import Sequence
from functools import partial
from math import inf, isfinite
from pathlib import Path

from granflow.engine.backend import Arch, Precision, start
from granflow.engine.engine import Engine
from granflow.engine.limits import abort_message
from granflow.errors import RunError
from granflow.io.checkpoint import Checkpoint
from granflow.load import Scene
from granflow.observers.base import CONTACTS, PARTICLES, TOTALS, WALLS, Observer
from granflow.observers.build import observers_for
from granflow.particles.particle_data import ParticleData
from granflow.plan.build import plan_for
from granflow.plan.memory_check import refuse_too_many, refuse_without_device_memory, refuse_without_memory
from granflow.plan.plan import Plan
from granflow.plan.run_time import refuse_run_time
from granflow.plan.scene_parts import PlannedStage
from granflow.runs.initial_particles import initial_state, warnings_before
from granflow.runs.insertion import ParticleInsertion
from granflow.runs.observer_list import ObserverList
from granflow.runs.result import Result
from granflow.runs.resume import accepted_change
from granflow.runs.run_directory import RunDirectory
from granflow.runs.run_state import RunState
from granflow.runs.stage_progress import REST_CHECKS
from granflow.runs.step_batches import StepBatches
from granflow.runs.timings import WallClock, collect_result, log_plan
from granflow.snapshot import Snapshot
from granflow.visible_text import visible_line


class Simulation:
    """One run of one scene.

    scene:          scene of `load_scene` or `Scene.from_dict`
    arch:           architecture, "cpu" by default
    precision:      overrides that of the scene
    threads:        CPU threads; None: all available
    out:            directory for the files of the scene's output block; without it no files are written
    observers:      additional observers, such as `granflow.on_interval(interval, function)`
    progress:       display the progress
    particles:      particles at the start, instead of those of the scene; groups of these particles are not inserted
    resume:         checkpoint from which to continue
    allow_changes:  resume even if the scene has changes that are not permitted
    allow_long:     accept a run with an estimated duration of more than a year
    plan:           replaces the plan of the scene
    Raises:         SceneError for an invalid scene, GranflowError if `arch` is not available, the run cannot be
                    resumed, or `particles` does not match the groups of the scene

    `warnings`: sentences on the scene before the run, which `run` logs with those during the run.

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
        particles: ParticleData | None = None,
        resume: Checkpoint | None = None,
        allow_changes: bool = False,
        allow_long: bool = False,
        plan: Plan | None = None,
    ) -> None:
        wall_clock = WallClock()
        if precision is not None:
            scene = scene.with_precision(precision)
        backend = start(arch, scene.run.precision, threads)
        self.files = RunDirectory(None if out is None else Path(out), scene, resume)
        self.plan = plan or plan_for(scene, on_gpu=not backend.on_cpu)
        refuse_too_many(self.plan)
        refuse_run_time(self.plan, allow_long)
        if backend.on_cpu:
            refuse_without_memory(self.plan)
        else:
            refuse_without_device_memory(self.plan, backend.arch)
        change = None if resume is None else accepted_change(resume, scene, self.plan, allow_changes)
        initial, earlier = initial_state(scene, self.plan, particles, resume)
        self.warnings = warnings_before(scene, self.plan, initial)
        self._insertion = ParticleInsertion(scene, earlier)
        self.files.create()
        own_observers = observers_for(self.plan, self.files.path, progress, self.files.writer)
        self.observers = ObserverList([*own_observers, *observers])
        self.engine = Engine(self.plan, backend)
        self._state = RunState(self.engine, self._insertion, self.observers, wall_clock, earlier)
        self._progress, self._wall_clock = self._state.progress, wall_clock
        self._resumed, self._batches = resume, StepBatches()
        self._stop_requested: BaseException | None = None
        if initial is not None:
            self.engine.insert(initial)
        if resume is not None and change is not None:
            self._state.load_state_dict(resume, change)
        wall_clock.set_up(self.engine.timing.compile)

    @property
    def stage(self) -> str:
        """Name of the current stage."""
        return self._progress.stage

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.engine.time

    @property
    def time_step(self) -> float:
        """Present time step [s]."""
        return self.engine.time_step

    def snapshot(self, contacts: bool = False) -> Snapshot:
        """Return the current state as read-only arrays, particles ordered by id.

        `contacts`: also evaluate the contacts.
        """
        quantities = {PARTICLES, WALLS, TOTALS, *([CONTACTS] if contacts else [])}
        return self.engine.snapshot(self.stage, frozenset(quantities))

    def run(self, until: float | None = None) -> Result:
        """Run all stages, or to the simulated time `until` [s]; return the numbers of the run.

        Returns:  numbers of the run; expectations of the scene are evaluated if it has reached its end
        Raises:   RunError on an abort; OutputError if files cannot be written, after a checkpoint if possible
        """
        try:
            with self.files.open(self.observers.checkpointed().values()), self.observers.finishing():
                if self.files.path is not None:
                    log_plan(self.plan, self.engine, self._resumed, self.warnings)
                return self._run(until)
        except OSError as error:
            save = self._save if self._progress.target is not None else None
            raise self.files.output_error(error, self.time, save) from error

    def step(self, count: int = 1) -> None:
        """Take `count` steps with all events on the way; after the end of the last stage, steps without events.

        For simulations without `out`: no file is written. Raises ValueError with `out`, and RunError on an abort.
        """
        if self.files.path is not None:
            raise ValueError("A simulation with an output directory cannot take single steps; use run(until).")
        wanted = self.engine.step_count + count
        while (remaining := wanted - self.engine.step_count) > 0:
            target = self.time + (remaining if self.plan.adaptive_time_step is None else 1) * self.time_step
            self._run_stages(target)
            self._advance(target)

    def restart(self, particles: ParticleData, time_step: float | None = None) -> None:
        """Replace all particles, with initial forces and without contact history; no kernel is compiled.

        particles:  at the present time
        time_step:  of all further steps [s]; default: the present one
        """
        self.engine.restart(particles, time_step)

    def _run(self, until: float | None) -> Result:
        """Run the stages that have not ended, then write checkpoint and result."""
        self._wall_clock.start()
        self.files.start_schedule(self.time)
        end = inf if until is None else until
        self._run_stages(end)
        self._save()
        with self._wall_clock.measuring_output():
            last = self.observers.notify_all(partial(self.engine.observe, self.stage), frozenset({TOTALS}))
            self.files.writer.wait()
        readings = {**self.observers.readings(), "insertion": self._insertion.results()}
        result = collect_result(self.engine, self._wall_clock, last.totals, readings)
        if self.time < end or until is None:
            result = result.with_expectations(self.plan.expectations)
        self._insertion.log_end()
        logging.getLogger("granflow").info("done at %.6g s after %d steps", self.time, self.engine.step_count)
        return self.files.write(result)

    def request_stop(self, error: BaseException) -> None:
        """Make `run` complete the current steps, write a checkpoint and raise `error`; for signal handlers."""
        self._stop_requested = error
        self.engine.stepper.interrupted = True

    def _run_stages(self, end: float) -> None:
        """Run the stages that have not ended, to their ends or to `end` [s]."""
        for stage in self.plan.stages:
            if self.time < end and not self._progress.has_ended(stage.name):
                self._run_stage(stage, end)

    def _run_stage(self, stage: PlannedStage, end: float) -> None:
        """Run a stage to its end, or to `end` [s].

        The stage ends after its longest duration, or, with `kinetic_energy_below`, at the first check at which the
        particles are at rest; REST_CHECKS checks are distributed evenly. A resumed stage continues at its target.
        """
        progress = self._progress
        if stage.name not in progress.stage_times:
            self._begin_stage(stage, stage.longest / REST_CHECKS)
        stop = progress.stage_times[stage.name][0] + stage.longest
        while progress.target is not None or not self.engine.reached(min(stop, end)):
            next_check = progress.next_check if stage.kinetic_energy_below is not None else inf
            self._advance_to(min(stop, end, next_check, self._next_event()))
            if self.engine.reached(next_check):
                progress.next_check += stage.longest / REST_CHECKS
                if self._at_rest(stage):
                    break
        else:
            if not self.engine.reached(stop):
                return
        progress.end(self.time)

    def _at_rest(self, stage: PlannedStage) -> bool:
        """Whether the mean kinetic energy per particle is below the limit of the stage, and no insertion is pending."""
        limit = stage.kinetic_energy_below
        return limit is not None and self.engine.mean_kinetic_energy() < limit and self._insertion.is_done

    def _begin_stage(self, stage: PlannedStage, check_interval: float) -> None:
        """Begin a stage: place its walls, insert due particles, compute the forces.

        At the first stage, notify all observers; the run has then begun.
        """
        first = not self._progress.stage_times
        logging.getLogger("granflow").info("stage %s begins at %.6g s", stage.name, self.time)
        self._progress.begin(stage.name, self.time, check_interval)
        self._progress.set_walls(self.engine)
        self._insertion.insert_due(self.engine)
        self.engine.refresh()
        self._abort_if_diagnosed()
        if first:
            with self._wall_clock.measuring_output():
                self.observers.notify_all(partial(self.engine.observe, self.stage))
            self.files.began()

    def _next_event(self) -> float:
        """Return the simulated time [s] of the next observation, insertion or wall change."""
        changes = [time for time in self._progress.changes if not self.engine.reached(time)]
        return min([self.observers.next_time(), self._insertion.next_time(), *changes])

    def _advance_to(self, time: float) -> None:
        """Advance to `time` [s], handle insertion and wall changes there, and notify the observers that are due.

        The target is at least one step ahead, so that the run always advances. A resumed run continues to its saved
        target.
        """
        progress = self._progress
        if progress.target is None:
            progress.set_target(max(time, self.time + self.engine.time_step))
        assert progress.target is not None
        self._advance(progress.target)
        if not progress.arrived:
            inserted = self._insertion.insert_due(self.engine)
            if progress.remove_past_changes(self.engine) or inserted:
                progress.set_walls(self.engine)
                self.engine.refresh()
            progress.arrived = True
        with self._wall_clock.measuring_output():
            self.observers.notify_due(self.engine.reached, partial(self.engine.observe, self.stage))
        progress.target = None

    def _advance(self, target: float) -> None:
        """Advance to `target` [s] in batches, between which signals are handled and checkpoints written.

        Raises RunError if the run exceeds a limit.
        """
        while (steps := self.engine.steps_to(target)) > 0:
            if isfinite(self.files.next_checkpoint):
                steps = min(steps, max(self.engine.steps_to(self.files.next_checkpoint), 1))
            self._batches.advance(self.engine, steps)
            self._abort_if_diagnosed()
            self._handle_requests()

    def _handle_requests(self) -> None:
        """Stop if requested, after a checkpoint; write a checkpoint if due."""
        if self._stop_requested is not None:
            self._save()
            raise self._stop_requested
        with self._wall_clock.measuring_output():
            self.files.save_if_due(self.time, self.engine.step_count, self._state.state_dict)

    def _save(self) -> None:
        """Write a checkpoint; nothing without an output directory."""
        with self._wall_clock.measuring_output():
            self.files.save(self.time, self.engine.step_count, self._state.state_dict)

    def _abort_if_diagnosed(self) -> None:
        """After an abort, write the state if all its numbers are finite, and raise RunError with the diagnosis."""
        diagnosis = self.engine.diagnosis
        if diagnosis is None:
            return
        message = abort_message(diagnosis, self.plan, self.time)
        with self._wall_clock.measuring_output():
            written = self.observers.notify_all(
                partial(self.engine.observe, self.stage), frozenset({TOTALS}), only_finite=True
            ).is_finite
        raise RunError(message + self.files.note_on_state(written))

    def free(self) -> None:
        """Release the device memory; the simulation cannot continue afterwards."""
        self.engine.free()

    def __repr__(self) -> str:
        """One line: title, simulated time [s], steps, stage."""
        stage = f", stage {self.stage}" if self.stage else ""
        state = f"{self.time:.4g} s, step {self.engine.step_count}{stage}"
        return f'<Simulation "{visible_line(self.plan.title)}": {state}>'
