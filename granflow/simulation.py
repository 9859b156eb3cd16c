"""The simulation of a scene: runs, steps, snapshots, and live access to particles, walls and forces."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import inf, isfinite
from numbers import Real
from pathlib import Path
from threading import Lock
from types import NoneType, TracebackType
from typing import TYPE_CHECKING, NoReturn

from granflow.arguments import items_of, path_of, refuse_other, shown, whole_number
from granflow.engine.backend import Arch, Backend, Precision, free_device_memory, refuse_other_thread
from granflow.engine.engine import Engine
from granflow.engine.state_cache import start
from granflow.errors import GranflowError, StopRun
from granflow.io.checkpoint import Checkpoint, checkpoint_at
from granflow.live.forces import Forces, ParticleForce, plan_with_forces
from granflow.live.particles import LiveParticles
from granflow.live.walls import LiveWalls
from granflow.load import Scene, refuse_other_object
from granflow.observers.build import observers_for
from granflow.observers.observer import Observer
from granflow.parallel.refusals import refuse_on_ranks
from granflow.particles.group import ParticleData
from granflow.plan.build import plan_for, rank_plan, with_workers
from granflow.plan.cost import (
    refuse_run_time,
    refuse_too_many,
    refuse_without_device_memory,
    refuse_without_memory,
)
from granflow.plan.plan import Plan
from granflow.plan.restitution import restitution_warnings
from granflow.runs.initial_particles import initial_state, refuse_other_particles
from granflow.runs.insertion import ParticleInsertion
from granflow.runs.interrupts import stopping_on_interrupt
from granflow.runs.observer_list import ObserverList, name_of
from granflow.runs.result import Result
from granflow.runs.resume import (
    Change,
    accepted_change,
    changed_plan,
    engine_difference,
    refuse_other_functions,
    saved_parameters,
)
from granflow.runs.run_directory import RunDirectory
from granflow.runs.run_state import RunState
from granflow.runs.session import RunSession
from granflow.runs.time_loop import TimeLoop
from granflow.runs.timings import WallClock
from granflow.snapshot import CONTACTS, PARTICLES, TOTALS, WALLS, Snapshot
from granflow.units import seconds_of
from granflow.visible_text import html_table, readable, visible_line

if TYPE_CHECKING:
    from granflow.parallel.communicator import Communicator

REMEDIES = {
    "forces": "use simulation.forces.append and remove",
    "observers": "use simulation.observers.append and remove",
    "walls": "use the methods of a wall, such as simulation.walls[NAME].motion = ...",
    "particles": "assign to an array, such as simulation.particles.velocity = ..., or use add and remove",
}
"""How to change what an assignment to an attribute of a simulation does not."""
_CREATION = Lock()
"""Held between the start of Taichi and the allocation of fields: another thread must not restart it there."""


class Simulation:
    """One run of one scene; a context manager that finishes the files and releases the memory at its end.

        with Simulation(scene, out="out/hopper") as simulation:
            simulation.step(1000)
            simulation.run(until=0.2)
            simulation.run(duration=0.1)

    scene:          scene of `load_scene` or `Scene.from_dict`
    arch:           architecture, "cpu" by default
    precision:      overrides that of the scene
    threads:        CPU threads; None: all available
    out:            directory for the files of the scene's output block; without it no files are written
    observers:      additional observers, such as `granflow.on_interval(interval, function)`
    progress:       display the progress
    particles:      particles at the start, instead of those of the scene; groups of these particles are not
                    inserted. `simulation.particles.add` takes arrays with fewer arguments
    resume:         checkpoint, its file, or directory of the run whose newest checkpoint is used, from which
                    to continue; forces and observers from Python must be given again, with the same names
    allow_changes:  resume even if the scene has changes that are not permitted
    allow_long:     accept a run with an estimated duration of more than a year
    plan:           replaces the plan of the scene
    forces:         forces on particles from device functions
    overwrite:      replace an earlier run in `out` after the first frame of the new one
    communicator:   distributes the particles over MPI ranks; this process is the root
    Raises:         SceneError for an invalid scene, GranflowError if `arch` is not available, the run cannot
                    be resumed, `out` contains an earlier run, or `particles` does not match the groups of the
                    scene

    `warnings`: sentences on the scene before the run, which `run` logs with those during the run.
    `is_stopped`: whether an observer has ended the last `run` or `step` with StopRun.
    `particles`: `LiveParticles`; `walls`: `LiveWalls` by name; `forces`, `observers`: lists with `append` and
    `remove`.

    Simulations in use at the same time in one process must have the same architecture, precision and threads;
    `free` ends the use. A simulation belongs to the thread that creates it; other threads may call
    `request_stop` and read `time`, `step_count` and `stage`. Processes start with
    multiprocessing.get_context("spawn"), not by a fork.
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
        resume: Checkpoint | Path | str | None = None,
        allow_changes: bool = False,
        allow_long: bool = False,
        plan: Plan | None = None,
        forces: Sequence[ParticleForce] = (),
        communicator: "Communicator | None" = None,
        overwrite: bool = False,
    ) -> None:
        wall_clock = WallClock()
        refuse_other_types(scene, particles, plan, resume)
        out = None if out is None else path_of("out", out)
        observers = items_of(
            "observers", observers, "observers, such as granflow.on_interval(interval, function)"
        )
        forces = items_of("forces", forces, "granflow.ParticleForce")
        if communicator is not None:
            refuse_on_ranks(arch, forces, scene)
        checkpoint = checkpoint_given(resume, on_ranks=communicator is not None)
        scene = scene.with_precision(precision)
        with _CREATION:
            backend = start(arch, scene.run.precision, threads)
            self.files = RunDirectory(out, scene, checkpoint, overwrite)
            begin = run_start(
                scene,
                backend,
                checkpoint,
                given_particles=particles,
                given_plan=plan,
                forces=forces,
                observers=observers,
                communicator=communicator,
                allow_changes=allow_changes,
                allow_long=allow_long,
                writes_files=out is not None,
            )
            self.files.create()
            engine = engine_for(begin.plan, backend, communicator)
        self.warnings = begin.warnings
        from_scene = observers_for(
            begin.plan, self.files.path, progress, self.files.writer, None if communicator is None else engine
        )
        self.observers = ObserverList(from_scene, observers)
        self._state = RunState(
            engine, begin.insertion, self.observers, wall_clock, begin.earlier, begin.original
        )
        self._loop = TimeLoop(self._state, self.files)
        self._session = RunSession(self._loop, self.files, checkpoint, lambda: self.warnings)
        self._in_block = False
        self._is_running = False
        self.is_stopped = False
        if begin.initial is not None:
            engine.insert(begin.initial)
        if checkpoint is not None and begin.change is not None:
            self._restore(checkpoint, begin.change, forces)
        self.particles = LiveParticles(self._state)
        self.walls = LiveWalls(self._state)
        self.forces = Forces(self._state, forces)
        wall_clock.set_up(engine.timing.compile)
        self._is_created = True

    def _restore(self, checkpoint: Checkpoint, change: Change, forces: Sequence[ParticleForce]) -> None:
        """Continue from a checkpoint, with the saved observers and parameters of forces."""
        self.observers.remove_named(checkpoint.saved["changes"]["removed_observers"])
        for force in forces:
            force.parameters.update(saved_parameters(checkpoint, force.planned))
        self._state.load_state_dict(checkpoint, change)

    def __setattr__(self, name: str, value: object) -> None:
        """Set an attribute of the simulation itself.

        Raises AttributeError for others, which would have no effect.
        """
        if not (name.startswith("_") or name == "is_stopped" or "_is_created" not in vars(self)):
            remedy = REMEDIES.get(
                name,
                "values of the scene are fixed in a run. Change the scene before it (Scene.from_dict), or "
                "add a force: simulation.forces.append(...)",
            )
            raise AttributeError(f"Simulation.{name} cannot be set: {remedy}.")
        object.__setattr__(self, name, value)

    def __reduce__(self) -> NoReturn:
        """Raises GranflowError: device memory and files belong to this process."""
        raise GranflowError(
            "A simulation can neither be pickled nor copied: pickle its scene, or continue from a checkpoint "
            "(save)."
        )

    @property
    def engine(self) -> Engine:
        """The device data and kernels of the run; a change of the compiled features replaces them."""
        return self._state.engine

    @property
    def plan(self) -> Plan:
        """The plan, with the changes from Python."""
        return self._state.plan

    @property
    def stage(self) -> str:
        """Name of the current stage."""
        return self._state.progress.stage

    @property
    def is_complete(self) -> bool:
        """Whether the last stage has ended."""
        return self._loop.stages_ended

    @property
    def time(self) -> float:
        """Simulated time [s]; may be read in any thread."""
        return self._state.clock.time

    @property
    def step_count(self) -> int:
        """Number of completed steps."""
        return self._state.clock.step_count

    @property
    def time_step(self) -> float:
        """Present time step [s]."""
        return self._state.clock.time_step

    def snapshot(self, contacts: bool = False) -> Snapshot:
        """Return the current state as read-only arrays, particles ordered by id.

        `contacts`: also evaluate the contacts. Before the first step, the first stage begins: its walls are
        placed and its first particles inserted; the run gives the same results as without the snapshot.
        """
        self._state.begin()
        self._loop.prepare()
        quantities = {PARTICLES, WALLS, TOTALS, *([CONTACTS] if contacts else [])}
        return self.engine.snapshot(self.stage, frozenset(quantities))

    def run(
        self,
        until: float | str | None = None,
        duration: float | str | None = None,
        within_stages: bool = False,
    ) -> Result:
        """Run to the time `until` [s], for a `duration` [s], or to the end of all stages; repeatable.

        Times are numbers in s, or text with a unit, such as "20 ms".
        After the end of the last stage, `until` and `duration` continue it: its walls, motions and observers
        remain. With `within_stages`, the run ends with the last stage instead.
        `run()` completes the run: outside of a `with` block it ends with `close`.

        Returns:  numbers of the run so far; expectations of the scene are evaluated if its stages have ended
        Raises:   GranflowError for times that are not finite or a negative duration, and if an observer or
                  another thread calls it; RunError on an abort, FunctionError if a function from Python
                  fails, OutputError if files cannot be written; before the last two, a checkpoint is written
                  if possible
        """
        end = end_of_run(until, duration, self.time, self.time_step)
        with self._running("run"):
            self.is_stopped = False
            with self._session.running():
                self._advance(end, within_stages)
                result = self._loop.result()
            is_complete = until is None and duration is None and not self._in_block
            return self._session.close(self._loop.last_result) if is_complete else result

    def step(self, count: int = 1) -> None:
        """Take `count` steps with all events on the way, as `run`. Raises the exceptions of `run`."""
        wanted = self.step_count + whole_number("count", count)
        with self._running("step"), self._session.running():
            self.is_stopped = False
            while not self.is_stopped and (remaining := wanted - self.engine.step_count) > 0:
                steps = remaining if self.plan.adaptive_time_step is None else 1
                self._advance(self.time + steps * self.time_step)

    def save(self) -> None:
        """Write a checkpoint of the present time, from which the run can be resumed.

        Raises GranflowError without an output directory, and the exceptions of `run`.
        """
        if self.files.path is None:
            raise GranflowError("save needs an output directory: give out to Simulation.")
        with self._session.running():
            self._loop.save()

    def close(self) -> Result | None:
        """Finish all files: last frames and rows, checkpoint, result.

        The simulation cannot continue to write files.

        Returns the numbers of the run; None if no step was taken since the files were finished.
        """
        with self._running("close"):
            return self._session.close(self._loop.last_result) if self._session.is_open else None

    def __enter__(self) -> "Simulation":
        self._in_block = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        self._in_block = False
        if error is not None:
            self._session.abandon()
        self.free()

    def restart(self, particles: ParticleData, time_step: float | None = None) -> None:
        """Replace all particles, with initial forces and without contact history; no kernel is compiled.

        particles:  at the present time
        time_step:  of all further steps [s]; default: the present one
        """
        refuse_other("particles", particles, ParticleData, "arrays of granflow.ParticleData")
        refuse_other_particles(self.plan, particles)
        if time_step is not None and not (isinstance(time_step, Real) and 0.0 < time_step < inf):
            raise GranflowError(f"time_step is {shown(time_step)}, but must be a number [s] above 0.")
        with self._running("restart"):
            self._loop.last_good.clear()
            self.engine.restart(particles, time_step)

    def request_stop(self, error: BaseException) -> None:
        """Make `run` complete the current steps, write a checkpoint and raise `error`; for signal handlers.

        Also for other threads. Raises GranflowError if `error` is not an exception.
        """
        if not isinstance(error, BaseException):
            raise GranflowError(
                f"request_stop takes an exception, such as KeyboardInterrupt(), not {error!r}."
            )
        self._loop.stop_requested = error

    def free(self) -> None:
        """Finish all files and release the device memory; the simulation cannot continue afterwards."""
        try:
            if self._session.is_open:
                self.close()
        finally:
            if not self._is_running:
                self._state.free()
                self.observers.end()

    @contextmanager
    def _running(self, method: str) -> Iterator[None]:
        """In the block, methods that advance or end the simulation are refused.

        An observer must not call them.
        """
        refuse_other_thread(self._state.owner)
        if self._is_running:
            raise GranflowError(
                f"{method} cannot be called by an observer, while the simulation runs: raise "
                f"granflow.StopRun to end the run, and call {method} after it."
            )
        self._is_running = True
        try:
            yield
        finally:
            self._is_running = False

    def _advance(self, end: float, within_stages: bool = False) -> None:
        """Advance to `end` [s], unless an observer ends the run before."""
        try:
            with stopping_on_interrupt(self.request_stop):
                self._loop.run(end, within_stages)
        except StopRun:
            self.is_stopped = True

    def __repr__(self) -> str:
        """One line: title, simulated time [s], steps, stage."""
        stage = f", stage {self.stage}" if self.stage else ""
        state = f"{self.time:.4g} s, step {self.step_count}{stage}"
        return f'<Simulation "{visible_line(self.plan.scene.title)}": {state}>'

    def _repr_html_(self) -> str:
        """Table for notebooks: progress, contents, and the directory of the files."""
        present = [name for name, wall in self.walls.items() if wall.is_present]
        rows = [
            ("time", f"{self.time:.6g} s"),
            ("step", readable(self.step_count)),
            ("time step", f"{self.time_step:.4g} s"),
            ("stage", self.stage),
            ("particles", readable(len(self.particles))),
            ("walls", ", ".join(present) or "none"),
            ("forces", ", ".join(force.name for force in self.forces) or "none"),
            ("files", str(self.files.shown or "none")),
        ]
        return html_table(self.plan.scene.title, rows)


# What precedes a run: refusals, its checkpoint, its plan with changes from Python, its particles, its engine


def refuse_other_types(scene: object, particles: object, plan: object, resume: object) -> None:
    """Raise GranflowError for arguments of `Simulation` of other types than theirs."""
    refuse_other_object(scene)
    refuse_other("particles", particles, (ParticleData, NoneType), "arrays of granflow.ParticleData")
    refuse_other("plan", plan, (Plan, NoneType), "a plan of granflow.plan_for")
    refuse_other(
        "resume", resume, (Checkpoint, str, os.PathLike, NoneType), 'a directory, such as "out/hopper"'
    )


@dataclass(frozen=True)
class RunStart:
    """All decisions on a run before files are written and arrays allocated.

    plan:       of the run, with changes from Python
    original:   of the scene
    initial:    particles to insert; None for a resumed run
    earlier:    names of the groups whose particles do not come from the scene
    change:     differences of the scene from that of the checkpoint; None without one
    insertion:  inserters of the scene
    warnings:   sentences on the scene
    """

    plan: Plan
    original: Plan
    initial: ParticleData | None
    earlier: list[str]
    change: Change | None
    insertion: ParticleInsertion
    warnings: list[str]


def run_start(
    scene: Scene,
    backend: Backend,
    checkpoint: Checkpoint | None,
    *,
    given_particles: ParticleData | None,
    given_plan: Plan | None,
    forces: Sequence[ParticleForce],
    observers: Sequence[Observer],
    communicator: "Communicator | None",
    allow_changes: bool,
    allow_long: bool,
    writes_files: bool,
) -> RunStart:
    """Decide on a run from the arguments of `Simulation`, whose errors it raises."""
    if given_plan is None:
        original = plan_for(scene, on_gpu=not backend.on_cpu)
    elif given_plan.scene is scene:
        original = given_plan
    else:  # the scene of the run is the argument, such as the one with another precision
        original = replace(given_plan, scene=scene)
    original = with_workers(original, backend.worker_count)
    plan = original if checkpoint is None else changed_plan(original, checkpoint)
    plan = plan_with_forces(plan, forces, backend)
    refuse_run_time(plan, allow_long)
    refuse_size(plan if communicator is None else rank_plan(plan, communicator.size), backend)
    change = None
    if checkpoint is not None:
        change = accepted_change(checkpoint, plan, allow_changes)
        names = [name_of(observer) for observer in observers]
        refuse_other_functions(checkpoint, plan.external_forces, names, allow_changes)
    initial, earlier, of_particles = initial_state(plan, given_particles, checkpoint)
    of_files = {each.warning for each in plan.forecasts if each.of_files and not writes_files}
    warnings = [*(each for each in plan.warnings if each not in of_files), *of_particles]
    if checkpoint is not None:
        warnings += filter(None, [engine_difference(checkpoint)])
    elif writes_files:
        warnings += restitution_warnings(plan)
    return RunStart(
        plan=plan,
        original=original,
        initial=initial,
        earlier=earlier,
        change=change,
        insertion=ParticleInsertion(plan.scene, earlier),
        warnings=warnings,
    )


def checkpoint_given(resume: Checkpoint | Path | str | None, on_ranks: bool) -> Checkpoint | None:
    """The checkpoint of the argument `resume` of `Simulation`; on ranks without the particles of others."""
    if resume is None or isinstance(resume, Checkpoint):
        return resume
    return checkpoint_at(path_of("resume", resume), "root" if on_ranks else "all")


def refuse_size(plan: Plan, backend: Backend) -> None:
    """Raise SceneError if the particles of this process exceed the range of indices or the memory."""
    refuse_too_many(plan)
    if backend.on_cpu:
        refuse_without_memory(plan)
    else:
        refuse_without_device_memory(plan, free_device_memory(backend.arch), backend.largest_buffer)


def engine_for(plan: Plan, backend: Backend, communicator: "Communicator | None") -> Engine:
    """The engine of a run; with a communicator that of the root, and only such runs import it."""
    if communicator is None:
        return Engine(plan, backend)
    from granflow.parallel.rank_engine import RankEngine

    return RankEngine(plan, backend, communicator)


def end_of_run(
    until: float | str | None, duration: float | str | None, now: float, time_step: float
) -> float:
    """End [s] of a run until a time or for a duration, numbers in s or text with units; else infinite.

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
