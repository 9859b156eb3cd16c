"""The time loop of a run: takes steps to the next event, handles it, and repeats.

`TimeLoop._next_steps` is the only place that decides how many steps come next. `Engine.advance` takes at most
these steps (fewer after an abort, for example), and `engine.stepper` splits them into launches where the
device requires it. The rest of the file is the begin and the end of a run, stop requests, checkpoints and
aborts, and the warning on particles that left the domain.
"""

import logging
import time as clock
from contextlib import suppress
from dataclasses import replace
from math import isfinite

import numpy as np

from granflow.engine.abort import (
    LIMIT_RATIO,
    Diagnosis,
    abort_message,
    next_limit,
    overlap_warning,
    permitted_change,
)
from granflow.engine.engine import Engine
from granflow.engine.totals import EXIT_FACES
from granflow.errors import FunctionError, RunError, StopRun
from granflow.plan.plan import Plan
from granflow.plan.time_step import STEPS_BETWEEN_UPDATES
from granflow.runs.interrupts import stop_of
from granflow.runs.result import Result
from granflow.runs.run_directory import RunDirectory
from granflow.runs.run_state import LastGoodState, RunState
from granflow.runs.stages import warn_without_rest
from granflow.runs.timings import collect_result
from granflow.scene.blocks.gravity import motions_of, vectors_of
from granflow.scene.blocks.run import Stage
from granflow.snapshot import TOTALS, Snapshot

ADVANCE_SECONDS = 0.05
"""Wall-clock time [s] for which the engine takes steps at once. They cannot be interrupted: stop requests are
handled, and checkpoints written, before the next ones."""
FIRST_PARTICLE_STEPS = 50_000.0
"""Particle-steps that the engine takes at first, before its rate is known."""


class TimeLoop:
    """Advances a run through its stages and, on request, beyond the last one.

    The walls and observers of the last stage remain.

    `state`: of the run; `files`: its output directory. `stop_requested`: exception that ends the run after
    the present steps, or None.
    """

    def __init__(self, state: RunState, files: RunDirectory) -> None:
        self.state = state
        self.files = files
        self.stop_requested: BaseException | None = None
        self.last_good = LastGoodState(state)
        self._particle_steps = FIRST_PARTICLE_STEPS

    @property
    def engine(self) -> Engine:
        """The present engine; changes of the compiled features replace it."""
        return self.state.engine

    @property
    def stages_ended(self) -> bool:
        """Whether the last stage has ended."""
        return self.state.progress.has_ended(self.engine.plan.stages[-1].name)

    @property
    def _stage(self) -> Stage:
        """The present stage."""
        name = self.state.progress.stage
        return next(stage for stage in self.engine.plan.stages if stage.name == name)

    def run(self, end: float, within_stages: bool = False) -> None:
        """Run the stages that have not ended, to their ends or to `end` [s].

        The first one begins in any case.

        A finite `end` after that of the last stage is reached too, unless `within_stages`.

        Raises StopRun if an observer ends the run, RunError on an abort.
        """
        progress = self.state.progress
        self._begin_run()
        for stage in self.engine.plan.stages:
            if progress.has_ended(stage.name):
                continue
            if not self.engine.reached(end):
                self._run_stage(stage, end)
            if not progress.has_ended(stage.name):
                break  # at `end`, from which the time may differ by half a step
        if self.stages_ended and isfinite(end) and not within_stages:
            while progress.target is not None or not self.engine.reached(end):
                self._advance_to_event(end)
        self._stop_if_requested()

    def _run_stage(self, stage: Stage, end: float) -> None:
        """Run a stage to its end, or to `end` [s].

        The stage ends after its longest duration, at the first row of the time series that satisfies one of
        its conditions, or, with `kinetic_energy_below`, at the first check at which the particles are at
        rest. A resumed stage continues at its target.
        """
        progress = self.state.progress
        if stage.name not in progress.stage_times:
            self._begin_stage(stage)
        at_rest = False
        while not at_rest and progress.conditions.met is None:
            if progress.target is None and self.engine.reached(min(progress.end_of(stage), end)):
                break
            self._advance_to_event(end)
            progress.controls.sample_if_due(self.engine, stage.longest)
            at_rest = progress.ends_at_rest(stage, self.engine, self.state.insertion.is_done)
        if not at_rest:
            if progress.conditions.met is None and not self.engine.reached(progress.end_of(stage)):
                return
            progress.conditions.log_end(self.engine.plan.scene, stage, self.engine.time)
            warn_without_rest(stage, self.engine, self.state.insertion.is_done)
        progress.controls.warn_at_end(self.engine, stage.name)
        progress.end(self.engine.time)

    def _advance_to_event(self, end: float) -> None:
        """Advance to the next event, at the latest to `end` [s], and handle it.

        Between two calls of the engine, stop requests are handled and checkpoints written. Raises RunError if
        the run exceeds a limit.
        """
        self.prepare()
        self._stop_if_requested()  # by an observer at the last event
        while (steps := self._next_steps(end)) > 0:
            began = clock.perf_counter()
            before = self.engine.step_count
            self.engine.advance(steps)
            rate = (self.engine.step_count - before) / max(clock.perf_counter() - began, 1e-9)
            self._particle_steps = rate * ADVANCE_SECONDS * max(self.engine.particle_count, 1)
            self._abort_if_diagnosed()
            self._handle_requests()
        self._handle_event()

    def _next_steps(self, end: float) -> int:
        """Number of steps until the host has something to do; 0 if an event is reached.

        1. The target is the time of the next event: an observation, an insertion or a wall change; in a stage
           that has not ended also its end, a check for rest, and a sample of its controls; at the latest
           `end` [s]. It is at least one step ahead, so that the run always advances. It remains until its
           event is handled, and checkpoints contain it: a resumed run takes the same steps.
        2. A scheduled checkpoint, or the next update of an adaptive time step, can precede the target.
        3. The steps take about ADVANCE_SECONDS, at the rate of the previous ones.
        """
        progress = self.state.progress
        engine = self.engine
        if progress.target is None:
            times = [end, self.state.observers.next_time(), self.state.insertion.next_time()]
            times += [time for time in progress.changes if not engine.reached(time)]
            if not progress.has_ended(progress.stage):
                times += [progress.end_of(self._stage), progress.controls.next_sample]
                if self._stage.kinetic_energy_below is not None:
                    times.append(progress.next_check)
            progress.set_target(max(min(times), engine.time + engine.time_step))
        assert progress.target is not None
        steps = engine.steps_to(progress.target)
        if isfinite(self.files.next_checkpoint):
            steps = min(steps, max(engine.steps_to(self.files.next_checkpoint), 1))
        if engine.plan.adaptive_time_step is not None:
            steps = min(steps, STEPS_BETWEEN_UPDATES - engine.steps_since_update)
        return min(steps, max(int(self._particle_steps / max(engine.particle_count, 1)), 1))

    def _handle_event(self) -> None:
        """At the target, insert particles and change walls, and notify the observers that are due."""
        progress = self.state.progress
        if not progress.arrived:
            inserted = self.state.insertion.insert_due(self.engine)
            if progress.remove_past_changes(self.engine) or inserted:
                progress.set_walls(self.engine)
                self.engine.refresh()
            progress.arrived = True
        try:
            with self.state.wall_clock.measuring_output():
                self.state.observers.notify_due(self.engine.reached, self._observe)
        except StopRun:
            self._complete_target()
            raise
        self._complete_target()

    def _complete_target(self) -> None:
        """Forget the target; evaluate the conditions of the stage, if the time series has a new row."""
        progress = self.state.progress
        progress.target = None
        if not progress.conditions.since or progress.has_ended(progress.stage):
            return
        if (row := self.state.observers.row_at(self.engine.time)) is not None:
            began = progress.stage_times[progress.stage][0]
            progress.conditions.add_row(
                self.engine.plan.scene, self._stage, began, row, self.engine.time_step
            )

    def notify_all(self, quantities: frozenset[str]) -> None:
        """Pass a snapshot with these quantities to all observers. Raises StopRun, FunctionError."""
        with self.state.wall_clock.measuring_output():
            self.state.observers.notify_all(self._observe, quantities)

    def _observe(self, quantities: frozenset[str]) -> Snapshot:
        """Snapshot for observers, with these quantities."""
        return self.engine.observe(self.state.progress.stage, quantities)

    # The begin of a run and of its stages, and changes from Python.

    def _begin_run(self) -> None:
        """Begin the first stage and notify all observers, unless this is done: the run has then begun."""
        if self.state.progress.stage_times and not self.state.is_unobserved:
            return
        if self.state.is_unobserved:  # begun by a snapshot; Python may have changed the state since
            self.prepare()
        self._begin_stage(self.engine.plan.stages[0])
        self.state.is_unobserved = False
        try:
            self.notify_all(frozenset())
        except StopRun:
            self.files.began()
            raise
        self.files.began()
        self._keep_state()

    def _begin_stage(self, stage: Stage) -> None:
        """Begin a stage, unless it has begun. Raises RunError if its state exceeds a limit."""
        logging.getLogger("granflow").info("stage %s begins at %.6g s", stage.name, self.engine.time)
        if stage.name not in self.state.progress.stage_times:
            self.state.begin_stage(stage)
        self._abort_if_diagnosed()

    def prepare(self) -> None:
        """Apply the changes from Python: compile new features, rebuild neighbor lists, compute forces.

        Raises RunError if the changed state exceeds a limit.
        """
        self.state.prepare()
        if self.engine.is_changed and self.state.progress.stage_times:
            self.engine.refresh()
            self._abort_if_diagnosed()

    # Stop requests, checkpoints and aborts.

    def _handle_requests(self) -> None:
        """Stop if requested; write a checkpoint if due, and keep the state for one after an abort."""
        self._stop_if_requested()
        with self.state.wall_clock.measuring_output():
            self.files.save_if_due(self.engine.time, self.engine.step_count, self.state.state_dict)
        self._keep_state()

    def _stop_if_requested(self) -> None:
        """Raise the requested exception after a checkpoint; the request is then done.

        A stop signal of an MPI rank other than the root is a request, too.
        """
        if self.stop_requested is None and (number := self.engine.stepper.stop_signal):
            self.stop_requested = stop_of(number)
        if self.stop_requested is not None:
            error = self.stop_requested
            self.stop_requested = None
            self.save()
            raise error

    def _keep_state(self) -> None:
        """Keep the present state if that is due: a checkpoint after an abort or in lost files contains it."""
        if self.files.path is not None:
            with self.state.wall_clock.measuring_output():
                self.last_good.keep_if_due()

    def save(self) -> None:
        """Write a checkpoint with the changes from Python, after the begin of the run.

        Without a directory it does nothing.

        After an abort, it contains the last good state.
        """
        if self.engine.aborted:
            self.save_last_good()
            return
        with suppress(StopRun):
            self._begin_run()
        self.prepare()
        with self.state.wall_clock.measuring_output():
            self.files.save(self.engine.time, self.engine.step_count, self.state.state_dict)

    def save_last_good(self) -> None:
        """Write the state that was kept last as a checkpoint, unless a checkpoint is newer.

        Raises OSError.
        """
        self.state.observers.sync()
        self.save_kept(self.files.checkpoint_time)

    def save_kept(self, after: float | None) -> None:
        """Write the state that was kept last as a checkpoint, if it is later than a time [s].

        Raises OSError.
        """
        kept = self.last_good.kept
        if kept is not None and (after is None or kept.time > after):
            self.files.save(kept.time, kept.step, kept.state_dict)

    def _report_overlap(self, diagnosis: Diagnosis, limit: float) -> None:
        """Go on after an overlap, up to the next limit; the first one is a warning."""
        engine = self.engine
        log = logging.getLogger("granflow")
        is_first = engine.overlap_limit < 1.1 * engine.plan.scene.numerics.intended_overlap
        if is_first:  # the limit may be rounded to single precision
            log.warning("%s", overlap_warning(diagnosis, engine.plan, engine.time))
        assert diagnosis.pair is not None
        log.info("overlap %.3g of the radius at %.6g s", diagnosis.pair.overlap, engine.time)
        engine.permit_overlap(limit)

    def _abort_if_diagnosed(self) -> None:
        """After an abort, write the present state if it is finite, and the last good one as a checkpoint.

        After an overlap with which the run goes on, report it instead.

        Raises RunError with the diagnosis and the command that continues.
        """
        diagnosis = self.engine.diagnosis
        if diagnosis is None:
            return
        limit = next_limit(diagnosis, self.engine.plan)
        if limit is not None:
            self._report_overlap(diagnosis, limit)
            return
        message = abort_message(diagnosis, self.engine.plan, self.engine.time)
        with self.state.wall_clock.measuring_output():
            try:
                written = self.state.observers.notify_all(
                    self._observe, frozenset({TOTALS}), only_finite=True
                ).is_finite
            except (StopRun, FunctionError):
                written = True  # a function from Python receives the snapshot after the files
            with suppress(OSError):
                self.save_last_good()
        raise RunError(
            message + self.files.note_on_state(written, permitted_change(diagnosis, self.engine.plan))
        )

    def last_result(self) -> Result:
        """Numbers of the run at its end, which is logged."""
        engine = self.engine
        log = logging.getLogger("granflow")
        result = self.result()
        self.state.insertion.log_end()
        meters = sum(each.get("flow_count", 0.0) for each in result.flow_meters.values())
        warning = exit_warning(engine.plan, engine.accounting.exits, engine.accounting.inserted_count, meters)
        if warning is not None:
            log.warning("%s", warning)
        overlap = engine.overlap_limit
        intended = engine.plan.scene.numerics.intended_overlap
        if overlap > LIMIT_RATIO * LIMIT_RATIO * intended:
            log.warning(
                "The largest overlap of a contact is between %.2g and %.2g of the smaller radius; an earlier "
                "warning describes the first one above %g.",
                overlap / LIMIT_RATIO,
                overlap,
                intended,
            )
        self.state.observers.log_end()
        log.info("done at %.6g s after %d steps", engine.time, engine.step_count)
        return self._evaluated(result)

    def result(self) -> Result:
        """Numbers of the run so far, with expectations if all stages have ended.

        The run continues as without it.
        """
        state = self.state
        totals = self.engine.snapshot(state.progress.stage, frozenset({TOTALS})).totals
        readings = {**state.observers.readings(), "insertion": state.insertion.results()}
        return self._evaluated(collect_result(self.engine, state.wall_clock, totals, readings))

    def _evaluated(self, result: Result) -> Result:
        """The result with the number of warnings so far, and with expectations if all stages have ended."""
        warning_count = float(len(self.files.warnings))
        result = replace(result, run={**result.run, "warning_count": warning_count})
        if not self.stages_ended:
            return replace(result, is_complete=False)
        return result.with_expectations(self.state.plan.scene.expect)


# Particles that left the domain where none is expected to leave it.

LARGE_SHARE = 0.05
"""Fraction of the inserted particles that can leave a domain without outlets, except downward and through
meters."""


def exit_warning(plan: Plan, exits: dict[str, int], inserted: int, through_meters: float) -> str | None:
    """Sentence on the particles that left the domain, and through which face most did; else None.

    With outlets, no other exit is expected. Without, particles can leave downward, as from a hopper, and as
    many as pass flow meters can leave anywhere.

    exits:           number of particles by face of the domain, outside the outlets
    inserted:        number of inserted particles
    through_meters:  number of particles that passed flow meters
    """
    total = sum(exits.values())
    sideward = total - sum(exits[face] for face in _lower_faces(plan))
    expected = 0 if plan.scene.outlets else max(LARGE_SHARE * inserted, through_meters)
    if (total if plan.scene.outlets else sideward) <= expected:
        return None
    most = max(exits, key=lambda face: exits[face])
    axis, end = most.split("_")
    bound = getattr(plan.scene.domain, end)["xyz".index(axis)]
    outside = " outside the outlets" if plan.scene.outlets else ""
    return (
        f"{total} of {inserted} particles left the domain{outside}, {exits[most]} of them through its face "
        f"at {axis} = {bound:.4g} m: they are deleted. If this is not intended, check the walls and "
        f"domain.{end}; otherwise give this region an outlet."
    )


def _lower_faces(plan: Plan) -> set[str]:
    """Faces of the domain toward which gravity points at any time; all faces if it turns."""
    found = set()
    for gravity in plan.scene.gravities:
        for vector in vectors_of(gravity):
            signs = np.concatenate([-np.array(vector), np.array(vector)])
            turns = any(each.rotates for each in motions_of(gravity))
            found |= {face for face, sign in zip(EXIT_FACES, signs, strict=True) if sign > 0.0 or turns}
    return found
