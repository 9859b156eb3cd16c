"""The time loop: advance to whatever is due next, show it, go on."""

import logging
import time as clock
from collections.abc import Sequence
from contextlib import ExitStack
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from granflow.device.backend import Arch, Precision, start
from granflow.device.checkpoint import EngineKeeper
from granflow.device.engine import Engine
from granflow.device.guards import Trip, guard_message
from granflow.errors import OutputError, RunError
from granflow.observe import (
    Change,
    Checkpoint,
    CheckpointWriter,
    Keepable,
    Observer,
    Result,
    TimeSeries,
    accepted_change,
    decided,
    earlier_grains,
    locked,
    observers_for,
    progress_for,
    remove_after,
    remove_parts,
    run_log,
    time_series_for,
    versions,
    write_result,
    write_scene_as_run,
)
from granflow.plan import Plan, explain, plan_for
from granflow.plan.room import refuse_too_many, refuse_without_memory
from granflow.plan.walls import StageTimes, wall_change_times, wall_motions, wall_presence
from granflow.scene import Scene
from granflow.scene.generate import Rain, initial_grains, rains
from granflow.scene.schema import Stage
from granflow.snapshot import Snapshot
from granflow.walls.catalogue import triangles

PART_SECONDS = 0.2
"""Wall seconds that the device is left alone; in between, signals are heard and checkpoints written."""

REST_LOOKS = 200
"""How often a stage that waits for rest looks at the kinetic energy, over its longest duration."""

EVERYTHING = frozenset({"particles", "walls", "totals"})
TOTALS = frozenset({"totals"})


class Simulation:
    """One run of one scene.

    `out`: directory for the files of the scene's output block; without it nothing is written. `observers`: more of
    them, such as `granflow.observe.every(interval, function)`. `precision`: in place of the scene's. `resume`: go on
    from this checkpoint, with `anyway` also where the scene differs in what may not change. Raises SceneError for a
    scene that cannot be run, GranflowError where `arch` is absent or a run cannot go on, and from `run` RunError when
    a guard trips, OutputError when files cannot be written.
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
        anyway: bool = False,
    ) -> None:
        if precision is not None:
            scene = scene.model_copy(update={"run": scene.run.model_copy(update={"precision": precision})})
        self.scene = scene
        self.out = None if out is None else Path(out)
        began = clock.perf_counter()
        backend = start(arch, scene.run.precision, threads)
        self.plan: Plan = plan_for(scene, on_gpu=not backend.on_cpu)
        refuse_too_many(self.plan)
        if backend.on_cpu:
            refuse_without_memory(self.plan)
        change = accepted_change(resume, self.plan, anyway) if resume is not None else None
        earlier = earlier_grains(scene) if resume is None else resume.kept["earlier"]
        self._earlier = list(earlier)
        grains = initial_grains(scene, earlier) if resume is None else None
        self._rains: tuple[Rain, ...] = tuple(rain for rain in rains(scene) if rain.group_name not in earlier)
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)
        self.engine = Engine(self.plan, backend)
        self._keeper = EngineKeeper(self.engine)
        self.stage = scene.schedule[0].name
        self._stage_times: dict[str, tuple[float, float]] = {}
        self._observers = [*self._own_observers(progress), *observers]
        self._changes = wall_change_times(scene)
        self._output_seconds, self._seconds_before = 0.0, 0.0
        self._began = began
        self._look = inf
        self._target: float | None = None
        self._arrived = False
        self._part = 1
        self._stop_wanted: BaseException | None = None
        self._writer = None if self.out is None else CheckpointWriter(self.out, scene.output.checkpoint)
        self._resumed = resume
        if grains is not None:
            self.engine.insert(grains)
        if resume is not None and change is not None:
            self._put_back(resume, change)
        self._setup_seconds = clock.perf_counter() - began - self.engine.timing.compile

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.engine.time

    def snapshot(self, contacts: bool = False) -> Snapshot:
        """The present state as read-only numpy arrays, particles ordered by id; `contacts` for those too."""
        return self.engine.snapshot(self.stage, EVERYTHING | ({"contacts"} if contacts else frozenset()))

    def run(self, until: float | None = None) -> Result:
        """Run all stages, or to the simulated time `until` [s]; returns the numbers of the run."""
        try:
            with ExitStack() as stack:
                if self.out is not None:
                    stack.enter_context(locked(self.out))
                    self._tidy(self.out)
                    stack.enter_context(run_log(self.out, go_on=self._resumed is not None))
                stack.callback(self._finish_observers)
                self._log_plan()
                return self._run(until)
        except OSError as error:
            raise self._unwritable(error) from error

    def _run(self, until: float | None) -> Result:
        self._began = clock.perf_counter()
        if self._writer is not None:
            self._writer.start(self.time)
        end = inf if until is None else until
        for stage in self.scene.schedule:
            _, ended = self._stage_times.get(stage.name, (0.0, inf))
            if self.time < end and ended == inf:
                self._run_stage(stage, end)
        self._save()
        last = self._show_to(self._observers, TOTALS)
        result = self._result(last, judged=self.time < end or until is None)
        logging.getLogger("granflow").info("done at %.6g s after %d steps", self.time, self.engine.step_count)
        if self.out is not None:
            write_result(self.out, result)
        return result

    def ask_to_stop(self, error: BaseException) -> None:
        """Have `run` finish its present steps, write a checkpoint and raise `error`; made for signal handlers."""
        self._stop_wanted = error

    @property
    def rows_are_there(self) -> bool:
        """Whether the time series still has all rows of the run that is gone on with."""
        return all(observer.rows_are_there for observer in self._observers if isinstance(observer, TimeSeries))

    def _tidy(self, out: Path) -> None:
        """Leave of an earlier run only what this one goes on from."""
        remove_parts(out)
        remove_after(out, self._resumed.path if self._resumed else None)
        write_scene_as_run(out, self.scene)
        if self._resumed is not None:
            (out / "result.json").unlink(missing_ok=True)
            for observer in self._observers:
                if isinstance(observer, Keepable):
                    observer.cut_back()

    def _log_plan(self) -> None:
        """What is run and why, for the log of the run."""
        if self.out is None:
            return
        log = logging.getLogger("granflow")
        backend = self.engine.state.backend
        log.info("%s", versions())
        log.info("%s with %s, compiled in %.3g s", backend.arch, backend.precision, self.engine.timing.compile)
        for line in explain(self.plan).splitlines():
            log.info("%s", line)
        for warning in self.plan.step.warnings:
            log.warning("%s", warning)
        if self._resumed is not None:
            log.info("goes on from %s at %.6g s", self._resumed.path, self.time)

    def _own_observers(self, progress: bool) -> list[Observer]:
        found: list[Observer] = []
        if self.out is not None:
            middle = 0.5 * (self.plan.domain_low + self.plan.domain_high)
            extent = 0.5 * float(np.max(self.plan.domain_high - self.plan.domain_low))
            surfaces = {wall.name: triangles(wall.shape, middle, extent) for wall in self.plan.walls}
            found += observers_for(self.scene, self.out, surfaces)
        elif self.scene.output.meters or self.scene.loaded_walls:
            found.append(time_series_for(self.scene, None))
        if progress:
            found.append(progress_for(self.scene))
        return found

    def _run_stage(self, stage: Stage, end: float) -> None:
        """From the start of a stage to its end, or to `end` [s]."""
        longest = stage.duration if stage.duration is not None else stage.at_most
        assert longest is not None
        if stage.name not in self._stage_times:
            self._enter(stage, self.time + longest / REST_LOOKS)
        began, _ = self._stage_times[stage.name]
        stop = began + longest
        while self._target is not None or not self._reached(min(stop, end)):
            waiting = self._look if stage.kinetic_energy_below is not None else inf
            self._advance_to(min(stop, end, waiting, self._next_event()))
            if self._reached(waiting):
                self._look += longest / REST_LOOKS
                if self._at_rest(stage):
                    break
        else:
            if not self._reached(stop):
                return
        self._stage_times[stage.name] = (began, self.time)

    def _at_rest(self, stage: Stage) -> bool:
        limit = stage.kinetic_energy_below
        return limit is not None and self.engine.mean_kinetic_energy() < limit and self._rain_is_over()

    def _enter(self, stage: Stage, first_look: float) -> None:
        first = not self._stage_times
        logging.getLogger("granflow").info("stage %s begins at %.6g s", stage.name, self.time)
        self.stage, self._look = stage.name, first_look
        self._stage_times[stage.name] = (self.time, inf)
        self._set_walls()
        self._pour()
        self.engine.refresh()
        if first:
            self._show_to(self._observers)

    def _set_walls(self) -> None:
        times: StageTimes = self._stage_times
        presence = wall_presence(self.scene, self.stage, self.time + 0.5 * self.engine.time_step)
        self.engine.set_walls(presence, wall_motions(self.scene, times))

    def _reached(self, time: float) -> bool:
        return self.engine.reached(time)

    def _next_event(self) -> float:
        """Simulated time [s] of whatever is due next."""
        due = [observer.next_time() for observer in self._observers] + [rain.next_time for rain in self._rains]
        due += [time for time in self._changes if not self._reached(time)]
        return min(due, default=inf)

    def _advance_to(self, time: float) -> None:
        if self._target is None:
            self._target, self._arrived = max(time, self.time + self.engine.time_step), False
        self._advance(self._target)
        trip = self.engine.trip
        if trip is not None:
            self._stop(trip)
        if not self._arrived:
            self._let_in()
            self._arrived = True
        due = [observer for observer in self._observers if self._reached(observer.next_time())]
        if due:
            self._show_to(due)
        self._target = None

    def _advance(self, target: float) -> None:
        """Do the steps up to `target` [s] in parts, between which signals are heard and checkpoints written."""
        while self.engine.steps_to(target) > 0 and not self.engine.tripped:
            began, before = clock.perf_counter(), self.engine.step_count
            checkpoint = self._writer.next_time() if self._writer is not None else inf
            in_time = max(self.engine.steps_to(checkpoint), 1) if isfinite(checkpoint) else self._part
            self.engine.advance(min(self._part, self.engine.steps_to(target), in_time))
            pace = (self.engine.step_count - before) / max(clock.perf_counter() - began, 1e-9)
            self._part = max(min(int(pace * PART_SECONDS), 2 * self._part), 1)
            if not self.engine.tripped:
                self._look_up()

    def _look_up(self) -> None:
        if self._stop_wanted is not None:
            self._save()
            raise self._stop_wanted
        if self._writer is not None and self._writer.due(self.time):
            try:
                self._save()
            except OSError as error:
                if self.out is None or not self.out.is_dir():
                    raise
                logging.getLogger("granflow.checkpoint").warning("No checkpoint at %.6g s: %s", self.time, error)

    def _let_in(self) -> None:
        """Particles that are due to come, walls that are due to appear or vanish."""
        if self._pour() or any(self._reached(change) for change in self._changes):
            self._changes = tuple(change for change in self._changes if not self._reached(change))
            self._set_walls()
            self.engine.refresh()

    def _rain_is_over(self) -> bool:
        return all(rain.remaining == 0 for rain in self._rains)

    def _pour(self) -> bool:
        """Let in what is due of every rain; returns whether anything came."""
        came = False
        for rain in self._rains:
            if self._reached(rain.next_time):
                there = self.engine.transfer.taken(("position", "radius"))
                grains = rain.pour(self.time + 0.5 * self.engine.time_step, there["position"], there["radius"])
                self.engine.insert(grains)
                came = came or len(grains) > 0
        return came

    def _show_to(self, observers: Sequence[Observer], wants: frozenset[str] = frozenset()) -> Snapshot:
        began = clock.perf_counter()
        wants = wants.union(*(observer.wants for observer in observers))
        snapshot = self.engine.snapshot(self.stage, wants)
        for observer in observers:
            observer.observe(snapshot)
        self._output_seconds += clock.perf_counter() - began
        return snapshot

    def _finish_observers(self) -> None:
        for observer in self._observers:
            observer.finish()

    def _stop(self, trip: Trip) -> None:
        """A guard tripped: write what stands there, then say why."""
        self._show_to(self._observers)
        raise RunError(guard_message(trip, self.plan, self.time, self.out))

    def _save(self) -> None:
        """Write a checkpoint, if there is a directory to write to."""
        if self._writer is not None:
            began = clock.perf_counter()
            self._writer.write(self.scene, self.time, self.engine.step_count, self._keep())
            seconds = clock.perf_counter() - began
            self._output_seconds += seconds
            logging.getLogger("granflow").info("checkpoint at %.6g s, written in %.3g s", self.time, seconds)

    def _keep(self) -> dict[str, Any]:
        """Everything that decides how the run goes on, but for the scene."""
        return {
            "stage": self.stage,
            "stage_times": {name: list(times) for name, times in self._stage_times.items()},
            "look": self._look,
            "target": self._target,
            "arrived": self._arrived,
            "changes": list(self._changes),
            "output_seconds": self._output_seconds,
            "wall_clock": self._wall_clock(),
            "plan": decided(self.plan),
            "earlier": self._earlier,
            "rains": {rain.group_name: rain.keep() for rain in self._rains},
            "observers": {name: observer.keep() for name, observer in self._keepable()},
            "engine": self._keeper.keep(),
        }

    def _put_back(self, checkpoint: Checkpoint, change: Change) -> None:
        """Stand where the checkpoint stood, and let changes of the scene come into force."""
        kept = checkpoint.kept
        self.stage = kept["stage"]
        self._stage_times = {name: (began, ended) for name, (began, ended) in kept["stage_times"].items()}
        if change.of_stage(len(self._stage_times) - 1):
            self._stage_times[self.stage] = (self._stage_times[self.stage][0], inf)
        self._keeper.put_back(kept["engine"], wall_motions(self.scene, self._stage_times))
        for rain in self._rains:
            rain.put_back(kept["rains"][rain.group_name])
        for name, observer in self._keepable():
            if name in kept["observers"]:
                observer.put_back(kept["observers"][name])
        self._look, self._changes = kept["look"], tuple(kept["changes"])
        self._output_seconds, self._seconds_before = kept["output_seconds"], kept["wall_clock"]
        if not change.differences:
            self._target, self._arrived = kept["target"], kept["arrived"]
        if change.of_contacts:
            self._changes = tuple(time for time in wall_change_times(self.scene) if not self._reached(time))
            self._set_walls()
            self.engine.refresh()

    def _keepable(self) -> list[tuple[str, Keepable]]:
        """Observers that go into checkpoints, each with a name of its own."""
        found: dict[str, Keepable] = {}
        for observer in self._observers:
            if isinstance(observer, Keepable):
                kind = type(observer).__name__
                found[f"{kind} {sum(name.startswith(kind) for name in found)}"] = observer
        return list(found.items())

    def _unwritable(self, error: OSError) -> OutputError:
        """What to say when files cannot be written, once the state has been saved if there is a way."""
        where = f"{error.filename}: " if error.filename else f"{self.out}: "
        try:
            if self.out is not None and self._target is not None:
                self.out.mkdir(parents=True, exist_ok=True)
                self._save()
        except OSError:
            logging.getLogger("granflow").debug("nor can a checkpoint be written")
        last = self._writer.last_time if self._writer is not None else None
        remedy = f"Put that right; granflow resume {self.out} goes on from {last:.6g} s." if last is not None else ""
        return OutputError(f"{where}{error.strerror}. Stopped at {self.time:.6g} s. {remedy}".rstrip())

    def _wall_clock(self) -> float:
        """Wall seconds of the run so far, those before it was gone on with included."""
        now = clock.perf_counter() - self._began
        return self._seconds_before + now + self._setup_seconds + self.engine.timing.compile

    def _result(self, last: Snapshot, judged: bool) -> Result:
        timing = self.engine.timing
        computing = max(timing.search + timing.advance, 1e-9)
        particle_steps = timing.particle_steps
        run = {
            "simulated_time": self.time,
            "step_count": float(self.engine.step_count),
            "time_step": self.engine.mean_time_step,
            "steps_per_second": self.engine.step_count / computing,
            "particle_steps_per_second": particle_steps / computing,
            "search_count": float(timing.search_count),
            "wall_clock": self._wall_clock(),
        }
        seconds = {
            "search": timing.search,
            "forces": timing.forces,
            "motion": timing.motion,
            "output": self._output_seconds,
            "compile": timing.compile,
        }
        series = [observer for observer in self._observers if isinstance(observer, TimeSeries)]
        meters, loads = (series[0].results(), series[0].load_results()) if series else ({}, {})
        result = Result(run=run, seconds=seconds, totals=last.totals, meters=meters, loads=loads)
        return result.held_to(self.scene.expect) if judged else result

    def free(self) -> None:
        """Give the device's memory back; the simulation cannot go on afterwards."""
        self.engine.free()
