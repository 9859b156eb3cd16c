"""The time loop: advances to the next event, handles it, and repeats."""

import logging
import time as clock
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from math import inf, isfinite

import numpy as np

from granflow.engine.abort import abort_message, permitted_change
from granflow.engine.engine import Engine, RestState
from granflow.engine.totals import EXIT_FACES
from granflow.errors import FunctionError, GranflowError, RunError, StopRun
from granflow.observers.observer import TOTALS
from granflow.plan.plan import Plan
from granflow.plan.stages import PlannedStage
from granflow.runs.interrupts import stop_of
from granflow.runs.result import Result
from granflow.runs.run_directory import RunDirectory
from granflow.runs.run_state import REST_CHECKS, LastGoodState, RunState
from granflow.runs.timings import collect_result
from granflow.units import seconds_of

# Warning at the end of a run about particles that left the domain where none is expected to leave it.

LARGE_SHARE = 0.05
"""Fraction of the inserted particles that can leave a domain without outlets, except downward and through
meters."""


def log_exits(engine: Engine, result: Result) -> None:
    """Log a warning about particles that left the domain outside the outlets; `result`: numbers of the
    run."""
    meters = sum(each.get("flow_count", 0.0) for each in result.flow_meters.values())
    sentence = exit_warning(engine.plan, engine.accounting.exits, engine.accounting.inserted_count, meters)
    if sentence is not None:
        logging.getLogger("granflow").warning("%s", sentence)


def exit_warning(plan: Plan, exits: dict[str, int], inserted: int, through_meters: float) -> str | None:
    """Sentence on the particles that left the domain, with the face through which most of them did; None if
    expected.

    With outlets, no other exit is expected. Without, particles can leave downward, as from a hopper, and as
    many as pass flow meters can leave anywhere.

    exits:           number of particles by face of the domain, outside the outlets
    inserted:        number of inserted particles
    through_meters:  number of particles that passed flow meters
    """
    total = sum(exits.values())
    sideward = total - sum(exits[face] for face in _lower_faces(plan))
    expected = 0 if plan.outlets else max(LARGE_SHARE * inserted, through_meters)
    if (total if plan.outlets else sideward) <= expected:
        return None
    most = max(exits, key=lambda face: exits[face])
    axis, end = most.split("_")
    bound = getattr(plan.domain, end)["xyz".index(axis)]
    outside = " outside the outlets" if plan.outlets else ""
    return (
        f"{total} of {inserted} particles left the domain{outside}, {exits[most]} of them through its face "
        f"at {axis} = {bound:.4g} m: they are deleted. If this is not intended, check the walls and "
        f"domain.{end}; otherwise give this region an outlet."
    )


def _lower_faces(plan: Plan) -> set[str]:
    """Faces of the domain toward which gravity points."""
    signs = np.concatenate([-np.array(plan.gravity), np.array(plan.gravity)])
    return {face for face, sign in zip(EXIT_FACES, signs, strict=True) if sign > 0.0}


# Ends of stages at rest: low kinetic energy of particles whose weight is supported.

LARGEST_UNBALANCED = 0.2
"""Largest net force on all particles over their weight at rest. It is 1 in free fall, also at the start from
rest and at the top of a bounce, and 1 - cundall with damping. Internal forces cancel, so that vibrations of
stiff contacts, with accelerations of single particles above gravity, do not delay the end."""


def ends_at_rest(stage: PlannedStage, stage_times: Mapping[str, tuple[float, float]], engine: Engine) -> bool:
    """Whether a stage ends because its particles are at rest after its shortest duration; the end is logged.

    stage_times:  start and end [s] of the stages
    """
    if stage.kinetic_energy_below is None or not engine.reached(stage_times[stage.name][0] + stage.shortest):
        return False
    state = engine.rest_state()
    if not _is_rest(stage, state):
        return False
    logging.getLogger("granflow").info(
        "stage %s ends at %.6g s: %s", stage.name, engine.time, _statement(stage, state)
    )
    return True


def warn_without_rest(stage: PlannedStage, engine: Engine, insertion_is_done: bool) -> None:
    """Warn that the particles are not at rest at the end of the longest duration of a stage that requires
    it."""
    if stage.kinetic_energy_below is None:
        return
    state = engine.rest_state()
    pending = "" if insertion_is_done else "insertion continues; "
    if pending or not _is_rest(stage, state):
        logging.getLogger("granflow").warning(
            "stage %s (%s): its longest duration of %.6g s is over, but %s%s.",
            stage.name,
            stage.source,
            stage.longest,
            pending,
            _statement(stage, state),
        )


def _is_rest(stage: PlannedStage, state: RestState) -> bool:
    """Whether the kinetic energy is below the limit, and the walls carry the weight."""
    limit = stage.kinetic_energy_below
    return limit is not None and state.kinetic_energy < limit and state.unbalanced < LARGEST_UNBALANCED


def _statement(stage: PlannedStage, state: RestState) -> str:
    limit = stage.kinetic_energy_below
    assert limit is not None
    below = "below" if state.kinetic_energy < limit else "not below"
    return (
        f"the mean kinetic energy is {state.kinetic_energy:.3g} J, {below} {limit:.3g} J, and the net force "
        f"on the particles is {state.unbalanced:.2g} of their weight (at most {LARGEST_UNBALANCED:g})"
    )


# Times of `Simulation.run`: text with units, durations, and their limits.


def end_of_run(
    until: float | str | None, duration: float | str | None, now: float, time_step: float
) -> float:
    """End [s] of a run until a time or for a duration, numbers in s or text with units; infinite without
    both.

    now:        present time [s]
    time_step:  present time step [s]
    Raises:     GranflowError
    """
    until, duration = (
        None if time is None else seconds_of(name, time)
        for name, time in (("until", until), ("duration", duration))
    )
    if until is not None and duration is not None:
        raise GranflowError("run takes until or duration, not both.")
    if until is not None and until < now - time_step:
        raise GranflowError(f"until is {until:g} s, but the simulation is at {now:g} s.")
    for name, time in (("until", until), ("duration", duration)):
        if time is not None and not isfinite(now + time):
            raise GranflowError(f"{name} is {time} s, but must be finite.")
    if duration is not None and duration < 0.0:
        raise GranflowError(f"duration is {duration:g} s, but must not be negative.")
    return now + duration if duration is not None else inf if until is None else until


# Batches of steps: between batches, signals are handled and checkpoints are written.

CHUNK_SECONDS = 0.2
"""Wall-clock time of one batch [s]."""


class StepBatches:
    """Takes steps in batches of about CHUNK_SECONDS: their length follows the measured rate, and at most
    doubles."""

    def __init__(self) -> None:
        self._steps = 1

    def advance(self, engine: Engine, most: int) -> None:
        """Take one batch of at most `most` steps."""
        began = clock.perf_counter()
        before = engine.step_count
        engine.advance(min(self._steps, most))
        step_rate = (engine.step_count - before) / max(clock.perf_counter() - began, 1e-9)
        self._steps = max(min(int(step_rate * CHUNK_SECONDS), 2 * self._steps), 1)


class TimeLoop:
    """Advances a run through its stages and, on request, beyond the last one, whose walls and observers
    remain.

    `state`: of the run; `files`: its output directory. `stop_requested`: exception that ends the run after
    the present batch of steps, or None.
    """

    def __init__(self, state: RunState, files: RunDirectory) -> None:
        self.state = state
        self.files = files
        self.stop_requested: BaseException | None = None
        self._batches = StepBatches()
        self.last_good = LastGoodState(state)

    @property
    def engine(self) -> Engine:
        """The present engine; changes of the compiled features replace it."""
        return self.state.engine

    @property
    def stages_ended(self) -> bool:
        """Whether the last stage has ended."""
        return self.state.progress.has_ended(self.engine.plan.stages[-1].name)

    def run(self, end: float, within_stages: bool = False) -> None:
        """Run the stages that have not ended, to their ends or to `end` [s]; the first one begins in any
        case.

        A finite `end` after that of the last stage is reached too, unless `within_stages`.

        Raises StopRun if an observer ends the run, RunError on an abort.
        """
        self._begin_run()
        for stage in self.engine.plan.stages:
            if self.state.progress.has_ended(stage.name):
                continue
            if self.engine.time < end:
                self._run_stage(stage, end)
            if not self.state.progress.has_ended(stage.name):
                break  # at `end`, from which the time may differ by half a step
        if self.stages_ended and isfinite(end) and not within_stages:
            while self.state.progress.target is not None or not self.engine.reached(end):
                self._advance_to(min(end, self._next_event()))
        self._stop_if_requested()

    def _run_stage(self, stage: PlannedStage, end: float) -> None:
        """Run a stage to its end, or to `end` [s].

        The stage ends after its longest duration, at the first row of the time series that satisfies one of
        its conditions, or, with `kinetic_energy_below`, at the first check at which the particles are at
        rest; REST_CHECKS checks are distributed evenly (see `granflow.runs.time_loop`). A resumed stage
        continues at its target.
        """
        progress = self.state.progress
        if stage.name not in progress.stage_times:
            self._begin_stage(stage)
        stop = progress.stage_times[stage.name][0] + stage.longest
        while progress.conditions.met is None and (
            progress.target is not None or not self.engine.reached(min(stop, end))
        ):
            next_check = progress.next_check if stage.kinetic_energy_below is not None else inf
            self._advance_to(min(stop, end, next_check, progress.servos.next_sample, self._next_event()))
            progress.servos.sample_if_due(self.engine, stage.longest)
            if self.engine.reached(next_check):
                progress.next_check += stage.longest / REST_CHECKS
                if self.state.insertion.is_done and ends_at_rest(stage, progress.stage_times, self.engine):
                    break
        else:
            if progress.conditions.met is None and not self.engine.reached(stop):
                return
            progress.conditions.log_end(stage, self.engine.time)
            warn_without_rest(stage, self.engine, self.state.insertion.is_done)
        progress.servos.warn_at_end(self.engine, stage.name)
        progress.end(self.engine.time)

    def _begin_run(self) -> None:
        """Begin the first stage and notify all observers, unless this is done: the run has then begun."""
        if self.state.progress.stage_times and not self.state.is_unobserved:
            return
        if self.state.is_unobserved:  # begun by a snapshot; Python may have changed the state since
            self.prepare()
        self._begin_stage(self.engine.plan.stages[0])
        self.state.is_unobserved = False
        try:
            self._notify(self.state.observers.notify_all)
        except StopRun:
            self.files.began()
            raise
        self.files.began()
        self._keep_state()

    def _begin_stage(self, stage: PlannedStage) -> None:
        """Begin a stage, unless it has begun. Raises RunError if its state exceeds a limit."""
        logging.getLogger("granflow").info("stage %s begins at %.6g s", stage.name, self.engine.time)
        if stage.name not in self.state.progress.stage_times:
            self.state.begin_stage(stage)
        self._abort_if_diagnosed()

    def _notify(self, notify: Callable[..., object], *arguments: object) -> None:
        """Call a method of the observer list with a function that takes the snapshot; its time counts as
        output."""
        with self.state.wall_clock.measuring_output():
            notify(*arguments, partial(self.engine.observe, self.state.progress.stage))

    def _next_event(self) -> float:
        """Return the simulated time [s] of the next observation, insertion or wall change."""
        changes = [time for time in self.state.progress.changes if not self.engine.reached(time)]
        return min([self.state.observers.next_time(), self.state.insertion.next_time(), *changes])

    def _advance_to(self, time: float) -> None:
        """Advance to `time` [s], handle insertion and wall changes there, and notify the observers that are
        due.

        The target is at least one step ahead, so that the run always advances. A resumed run continues to its
        saved target.
        """
        progress = self.state.progress
        if progress.target is None:
            progress.set_target(max(time, self.engine.time + self.engine.time_step))
        assert progress.target is not None
        self._advance(progress.target)
        if not progress.arrived:
            inserted = self.state.insertion.insert_due(self.engine)
            if progress.remove_past_changes(self.engine) or inserted:
                progress.set_walls(self.engine)
                self.engine.refresh()
            progress.arrived = True
        try:
            self._notify(self.state.observers.notify_due, self.engine.reached)
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
            stage = next(each for each in self.engine.plan.stages if each.name == progress.stage)
            progress.conditions.add_row(stage, progress.stage_times[stage.name][0], row)

    def _advance(self, target: float) -> None:
        """Advance to `target` [s] in batches, between which signals are handled and checkpoints written.

        Raises RunError if the run exceeds a limit.
        """
        self.prepare()
        while (steps := self.engine.steps_to(target)) > 0:
            if isfinite(self.files.next_checkpoint):
                steps = min(steps, max(self.engine.steps_to(self.files.next_checkpoint), 1))
            self._batches.advance(self.engine, steps)
            self._abort_if_diagnosed()
            self._handle_requests()

    def prepare(self) -> None:
        """Apply the changes from Python: compile new features, rebuild neighbor lists, compute forces.

        Raises RunError if the changed state exceeds a limit.
        """
        self.state.prepare()
        if self.engine.is_changed and self.state.progress.stage_times:
            self.engine.refresh()
            self._abort_if_diagnosed()

    def _stop_if_requested(self) -> None:
        """Raise the requested exception after a checkpoint; the request is then done.

        A stop signal of an MPI rank other than the root is a request, too.
        """
        if self.stop_requested is None and (number := self.engine.stepper.stop_signal):
            self.stop_requested = stop_of(number)
        if self.stop_requested is not None:
            error = self.stop_requested
            self.stop_requested = None
            self.engine.stepper.interrupted = False
            self.save()
            raise error

    def _handle_requests(self) -> None:
        """Stop if requested; write a checkpoint if due, and keep the state for one after an abort."""
        self._stop_if_requested()
        with self.state.wall_clock.measuring_output():
            self.files.save_if_due(self.engine.time, self.engine.step_count, self.state.state_dict)
        self._keep_state()

    def _keep_state(self) -> None:
        """Keep the present state if that is due: a checkpoint after an abort or in lost files contains it."""
        if self.files.path is not None:
            with self.state.wall_clock.measuring_output():
                self.last_good.keep_if_due()

    def save(self) -> None:
        """Write a checkpoint with the changes from Python, after the begin of the run; nothing without a
        directory.

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
        """Write the state that was kept last as a checkpoint, unless a checkpoint is newer. Raises
        OSError."""
        self.state.observers.sync()
        self.save_kept(self.files.checkpoint_time)

    def save_kept(self, after: float | None) -> None:
        """Write the state that was kept last as a checkpoint, if it is later than a time [s]. Raises
        OSError."""
        kept = self.last_good.kept
        if kept is not None and (after is None or kept.time > after):
            self.files.save(kept.time, kept.step, kept.state_dict)

    def _abort_if_diagnosed(self) -> None:
        """After an abort, write the present state if all its numbers are finite, and the last good one as a
        checkpoint.

        Raises RunError with the diagnosis and the command that continues.
        """
        diagnosis = self.engine.diagnosis
        if diagnosis is None:
            return
        message = abort_message(diagnosis, self.engine.plan, self.engine.time)
        take = partial(self.engine.observe, self.state.progress.stage)
        with self.state.wall_clock.measuring_output():
            try:
                written = self.state.observers.notify_all(
                    take, frozenset({TOTALS}), only_finite=True
                ).is_finite
            except (StopRun, FunctionError):
                written = True  # a function from Python receives the snapshot after the files
            with suppress(OSError):
                self.save_last_good()
        raise RunError(message + self.files.note_on_state(written, permitted_change(diagnosis)))

    def notify_all(self, quantities: frozenset[str]) -> None:
        """Pass a snapshot with these quantities to all observers. Raises StopRun, FunctionError."""
        with self.state.wall_clock.measuring_output():
            self.state.observers.notify_all(
                partial(self.engine.observe, self.state.progress.stage), quantities
            )

    def log_end(self) -> None:
        """Log the simulated time and the number of steps."""
        engine = self.engine
        logging.getLogger("granflow").info("done at %.6g s after %d steps", engine.time, engine.step_count)

    def last_result(self) -> Result:
        """Numbers of the run at its end, which is logged."""
        result = self.result()
        self.state.insertion.log_end()
        log_exits(self.engine, result)
        self.state.observers.log_end()
        self.log_end()
        return result

    def result(self) -> Result:
        """Numbers of the run so far, with expectations if all stages have ended; the run continues as without
        it."""
        state = self.state
        totals = self.engine.snapshot(state.progress.stage, frozenset({TOTALS})).totals
        readings = {**state.observers.readings(), "insertion": state.insertion.results()}
        result = collect_result(self.engine, state.wall_clock, totals, readings)
        if not self.stages_ended:
            return replace(result, is_complete=False)
        return result.with_expectations(state.plan.expectations)
