"""The time loop: advance to whatever is due next, show it, go on."""

import logging
import time as clock
from collections.abc import Sequence
from contextlib import ExitStack
from math import ceil, inf, isfinite
from pathlib import Path

import numpy as np

from granflow.device.backend import Arch, Precision, start
from granflow.device.engine import Engine
from granflow.device.guards import guard_message
from granflow.errors import RunError
from granflow.observe import (
    Observer,
    Result,
    TimeSeries,
    observers_for,
    progress_for,
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

REST_LOOKS = 200
"""How often a stage that waits for rest looks at the kinetic energy, over its longest duration."""

EVERYTHING = frozenset({"particles", "walls", "totals"})
TOTALS = frozenset({"totals"})


class Simulation:
    """One run of one scene.

    `out`: directory for the files of the scene's output block; without it nothing is written. `observers`: more of
    them, such as `granflow.observe.every(interval, function)`. `precision`: in place of the scene's. Raises
    SceneError for a scene that cannot be run, GranflowError where `arch` is absent, RunError from `run` when a
    guard trips.
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
        grains = initial_grains(scene)
        self._rains: tuple[Rain, ...] = rains(scene)
        self.engine = Engine(self.plan, backend)
        self.engine.insert(grains)
        self.stage = scene.schedule[0].name
        self._stage_times: dict[str, tuple[float, float]] = {}
        self._observers = [*self._own_observers(progress), *observers]
        self._changes = wall_change_times(scene)
        self._output_seconds = 0.0
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
        end = inf if until is None else until
        with ExitStack() as stack:
            if self.out is not None:
                self.out.mkdir(parents=True, exist_ok=True)
                stack.enter_context(run_log(self.out))
                write_scene_as_run(self.out, self.scene)
            stack.callback(self._finish_observers)
            self._log_plan()
            began = clock.perf_counter()
            for stage in self.scene.schedule:
                if self.time < end:
                    self._run_stage(stage, end)
            last = self._show_to(self._observers, TOTALS)
            result = self._result(last, clock.perf_counter() - began, judged=self.time < end or until is None)
            logging.getLogger("granflow").info("done at %.6g s after %d steps", self.time, self.engine.step_count)
            if self.out is not None:
                write_result(self.out, result)
        return result

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

    def _own_observers(self, progress: bool) -> list[Observer]:
        found: list[Observer] = []
        if self.out is not None:
            middle = 0.5 * (self.plan.domain_low + self.plan.domain_high)
            extent = 0.5 * float(np.max(self.plan.domain_high - self.plan.domain_low))
            surfaces = {wall.name: triangles(wall.shape, middle, extent) for wall in self.plan.walls}
            found += observers_for(self.scene, self.out, surfaces)
        elif self.scene.output.meters:
            found.append(time_series_for(self.scene, None))
        if progress:
            found.append(progress_for(self.scene))
        return found

    def _run_stage(self, stage: Stage, end: float) -> None:
        """From the start of a stage to its end, or to `end` [s]."""
        began = self.time
        self._enter(stage, began)
        logging.getLogger("granflow").info("stage %s begins at %.6g s", stage.name, began)
        longest = stage.duration if stage.duration is not None else stage.at_most
        assert longest is not None
        stop = min(began + longest, end)
        look = began + longest / REST_LOOKS
        while not self._reached(stop):
            waiting = look if stage.kinetic_energy_below is not None else inf
            self._advance_to(min(stop, waiting, self._next_event()))
            if self._reached(waiting):
                look += longest / REST_LOOKS
                assert stage.kinetic_energy_below is not None
                if self.engine.mean_kinetic_energy() < stage.kinetic_energy_below and self._rain_is_over():
                    break
        self._stage_times[stage.name] = (began, self.time)

    def _enter(self, stage: Stage, began: float) -> None:
        first = not self._stage_times
        self.stage = stage.name
        self._stage_times[stage.name] = (began, inf)
        self._set_walls()
        self._pour()
        self.engine.refresh()
        if first:
            self._show_to(self._observers)

    def _set_walls(self) -> None:
        times: StageTimes = self._stage_times
        presence = wall_presence(self.scene, self.stage, self.time + 0.5 * self.plan.time_step)
        self.engine.set_walls(presence, wall_motions(self.scene, times))

    def _reached(self, time: float) -> bool:
        return self.time >= time - 0.5 * self.plan.time_step

    def _next_event(self) -> float:
        """Simulated time [s] of whatever is due next."""
        due = [observer.next_time() for observer in self._observers] + [rain.next_time for rain in self._rains]
        due += [time for time in self._changes if not self._reached(time)]
        return min(due, default=inf)

    def _advance_to(self, time: float) -> None:
        steps = max(ceil((time - self.time) / self.plan.time_step - 1e-6), 1) if isfinite(time) else 1
        self.engine.advance(steps)
        if self.engine.trip is not None:
            self._stop()
        if self._pour() or any(self._reached(change) for change in self._changes):
            self._changes = tuple(change for change in self._changes if not self._reached(change))
            self._set_walls()
            self.engine.refresh()
        due = [observer for observer in self._observers if self._reached(observer.next_time())]
        if due:
            self._show_to(due)

    def _rain_is_over(self) -> bool:
        return all(rain.remaining == 0 for rain in self._rains)

    def _pour(self) -> bool:
        """Let in what is due of every rain; returns whether anything came."""
        came = False
        for rain in self._rains:
            if self._reached(rain.next_time):
                there = self.engine.transfer.taken(("position", "radius"))
                grains = rain.pour(self.time + 0.5 * self.plan.time_step, there["position"], there["radius"])
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

    def _stop(self) -> None:
        """A guard tripped: write what stands there, then say why."""
        trip = self.engine.trip
        assert trip is not None
        self._show_to(self._observers)
        raise RunError(guard_message(trip, self.plan, self.time, self.out))

    def _result(self, last: Snapshot, wall_clock: float, judged: bool) -> Result:
        timing = self.engine.timing
        computing = max(timing.search + timing.advance, 1e-9)
        particle_steps = timing.particle_steps
        run = {
            "simulated_time": self.time,
            "step_count": float(self.engine.step_count),
            "time_step": self.plan.time_step,
            "steps_per_second": self.engine.step_count / computing,
            "particle_steps_per_second": particle_steps / computing,
            "search_count": float(timing.search_count),
            "wall_clock": wall_clock + self._setup_seconds + timing.compile,
        }
        seconds = {
            "search": timing.search,
            "forces": timing.forces,
            "motion": timing.motion,
            "output": self._output_seconds,
            "compile": timing.compile,
        }
        series = [observer for observer in self._observers if isinstance(observer, TimeSeries)]
        meters = series[0].results() if series else {}
        result = Result(run=run, seconds=seconds, totals=last.totals, meters=meters)
        return result.held_to(self.scene.expect) if judged else result

    def free(self) -> None:
        """Give the device's memory back; the simulation cannot go on afterwards."""
        self.engine.free()
