"""The compiled phases of one plan, in order: motion, search when it is due, contact forces.

One launch does many steps on a CPU, one on a GPU. Once a particle has travelled half the skin every later phase of
the launch does nothing until the host has run the search: no transfer per step.
"""

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import taichi as ti

from granflow.device.apart import build_wrap, upload_offsets
from granflow.device.contacts import build_forces
from granflow.device.crew import Crew
from granflow.device.drive import build_drive, mark_search
from granflow.device.grid import lay_grids
from granflow.device.motion import build_move
from granflow.device.search import (
    build_bounds,
    build_class_lists,
    build_gather,
    build_rows,
    build_set_aside,
    build_sort,
)
from granflow.device.state import CACHE_LINE, CPU_STRIDE, WALL_BATCH, State
from granflow.device.walls import upload_poses
from granflow.plan.slots import slots_to_keep

GPU_BATCH = 16
"""Steps launched between two looks at the flags on a GPU, where every step is a launch of its own."""

CPU_BATCH = 1_000_000
"""Particle-steps of one launch on a CPU: a tenth of a second, so that Ctrl-C is heard."""

LONG_WAIT = 500_000
"""Looks at a counter, 3 ms at the least: a thread waits so long only for one that has lost its core."""

ONE_WORKER = 512
"""Particles up to which one thread does all the work: meeting after every phase would cost more than it saves."""

SAMPLE_EVERY = 256
"""Every so many steps one is done phase by phase with a clock beside it."""


@dataclass
class Timing:
    """Wall seconds by phase. `forces` and `motion` come from sampled steps: their share of `advance` is theirs."""

    search: float = 0.0
    advance: float = 0.0
    sampled_forces: float = 0.0
    sampled_motion: float = 0.0
    search_count: int = 0
    step_count: int = 0
    particle_steps: int = 0
    growth_count: int = 0
    compile: float = 0.0

    @property
    def forces(self) -> float:
        """Wall seconds spent on contact forces."""
        sampled = self.sampled_forces + self.sampled_motion
        return self.advance * self.sampled_forces / sampled if sampled else self.advance

    @property
    def motion(self) -> float:
        """Wall seconds spent on motion."""
        return self.advance - self.forces


class Stepper:
    """Advances a State by steps. `on_gone` is told the index range of particles that left the domain."""

    def __init__(self, state: State, on_gone: Callable[[int, int], None]) -> None:
        self.state = state
        self.timing = Timing()
        self._on_gone = on_gone
        self.steps_since_search = 0
        self._since_sample = 0
        self._crew = Crew(state.backend.worker_count)
        self._pose = WALL_BATCH if state.plan.poses else 0
        self._build()

    def _build(self) -> None:
        """Compile all phases, by launching them over nothing."""
        began, state = clock.perf_counter(), self.state
        periodic = state.plan.features.periodic != "none"
        self._wrap = build_wrap(state) if periodic else lambda count, pose, step: None
        self._bounds, self._sort, self._gather = build_bounds(state), build_sort(state), build_gather(state)
        self._list_classes = build_class_lists(state) if state.sorting.listed is not None else lambda count, cells: None
        self._set_aside = build_set_aside(state) if state.contacts.history else lambda count: None
        self._rows = build_rows(state)
        build = _build_cpu_steps if state.backend.on_cpu else _build_gpu_step
        self._step = build(state, build_move(state), build_forces(state))
        self._bounds(0)
        self._wrap(0, 0, 1.0)
        self._sort(0, 0)
        self._list_classes(0, 0)
        self._gather(0)
        self._rows(0, 0.0, 0)
        self._set_aside(0)
        self._step(0, 1, 0, 0, 0, 0.0, 1, 1)
        self.timing.compile += clock.perf_counter() - began

    def search(self, pose: int = 0) -> None:
        """Sort, let go of what left the domain, and list who is near whom."""
        began, compiled = clock.perf_counter(), self.timing.compile
        state = self.state
        if state.count:
            gone = self._sort_particles(pose)
            if gone:
                self._on_gone(state.count - gone, state.count)
                state.count -= gone
        self._fill_rows(pose)
        self.steps_since_search = 0
        self.timing.search += clock.perf_counter() - began - (self.timing.compile - compiled)
        self.timing.search_count += 1

    def _sort_particles(self, pose: int) -> int:
        """Bring particles in cell order; returns how many stand outside the domain, behind the others."""
        state = self.state
        self._wrap(state.count, pose, state.clock.time_step)
        self._bounds(state.count)
        grids = lay_grids(state)
        self._sort(state.count, grids[0].cell_count)
        self._set_history_aside()
        self._gather(state.count)
        there = int(state.sorting.cell_start[grids[0].cell_count])
        self._list_classes(there, sum(grid.cell_count for grid in grids))
        return state.count - there

    def _set_history_aside(self) -> None:
        state = self.state
        if not state.contacts.history:
            return
        while True:
            self._set_aside(state.count)
            need = self._largest_need()
            if need <= state.contacts.kept_per_chunk:
                return
            self.grow(slots_to_keep(need))

    def _largest_need(self) -> int:
        return int(self.state.control.slots_needed[0])

    def grow(self, need: int) -> None:
        """Make room for so many contact slots in every chunk, and build all kernels anew."""
        self.timing.growth_count += 1
        self.state.grow_contacts(int(1.3 * need) + 8, self._build)

    def _fill_rows(self, pose: int) -> None:
        state = self.state
        mark_search(state)
        if not state.count:
            state.control.search_due[0] = 0
            state.control.search_wanted[0] = 0
            return
        while True:
            self._rows(state.count, state.plan.skin, pose)
            need = self._largest_need()
            if need <= state.contacts.slots_per_chunk:
                return
            self.grow(need)

    def forces(self, pose: int = 0, history_step: float | None = None) -> None:
        """Forces where the particles stand; a `history_step` of 0 leaves spring displacements as they are."""
        step = self.state.clock.time_step if history_step is None else history_step
        self.state.control.steps_done[0] = 0
        self._launch_step(1, pose, step, moving=0, forcing=1)

    def refresh(self, step: int) -> None:
        """Search and forces anew after step number `step`, without a step: after grains or walls came or went."""
        self.stand_walls(step)
        self.search()
        self.forces(history_step=0.0)

    def stand_walls(self, step: int) -> None:
        """Pose 0 on the device becomes that after step number `step`."""
        if self.state.plan.poses:
            self._upload(step)
            self._pose = WALL_BATCH

    def _upload(self, step: int) -> None:
        """Bring to the device where walls and images stand from step number `step` on."""
        if self.state.plan.features.moving_walls:
            upload_poses(self.state, step)
        if self.state.plan.features.shear:
            upload_offsets(self.state, step)

    def advance(self, steps: int, step: int) -> int:
        """Do `steps` steps after step number `step`; returns those done.

        Fewer if a guard tripped, or after a search where the time step follows the scene: it lists new neighbours.
        """
        done, searches = 0, self.timing.search_count
        follows = self.state.plan.pace is not None
        while done < steps and not self.guard_code and not (follows and self.timing.search_count > searches):
            done += self._advance_batch(steps - done, step + done)
        return done

    @property
    def guard_code(self) -> int:
        """0, or why the run must stop."""
        return int(self.state.control.guard[0])

    def _advance_batch(self, steps: int, step: int) -> int:
        state, plan = self.state, self.state.plan
        if plan.poses:
            if self._steps_walls_allow() < 1:
                self.refresh(step)
            if self._pose == WALL_BATCH:
                self._upload(step + 1)
                self._pose = 0
            steps = min(steps, WALL_BATCH - self._pose, max(self._steps_walls_allow(), 1))
        state.control.steps_done[0] = 0
        began, searched = clock.perf_counter(), self.timing.search
        done = self._launch(steps)
        if state.control.search_due[0]:
            if not self.guard_code:  # no grid holds a position that is infinite
                self.search(pose=self._pose + done)
                self.forces(pose=self._pose + done)
            done += 1
        else:
            self.steps_since_search += done
        if plan.poses:
            self._pose += done
        self._since_sample += done
        self.timing.advance += clock.perf_counter() - began - (self.timing.search - searched)
        self.timing.step_count += done
        self.timing.particle_steps += done * state.count
        return done

    def _launch(self, steps: int) -> int:
        """Start up to `steps` steps; returns those completed."""
        step = self.state.clock.time_step
        if self._since_sample >= SAMPLE_EVERY:
            return self._sampled_step()
        if not self.state.backend.on_cpu:
            for _ in range(min(steps, GPU_BATCH)):
                self._launch_step(1, self._pose, step)
            return int(self.state.control.steps_done[0])
        began, count = clock.perf_counter(), self.state.count
        self._launch_step(min(steps, max(CPU_BATCH // max(count, 1), 1)), self._pose, step)
        done = int(self.state.control.steps_done[0])
        if count > ONE_WORKER:
            waited = bool(self.state.control.waited[0])
            self._crew.record(done * count, clock.perf_counter() - began, waited)
        return done

    def _launch_step(self, steps: int, pose: int, step: float, moving: int = 1, forcing: int = 1) -> None:
        """One launch: `steps` steps on a CPU, one on a GPU; one step of either phase alone where the other is 0."""
        state = self.state
        workers = 1 if state.count <= ONE_WORKER else self._crew.next_size
        self._step(steps, workers, state.chunk_count, state.count, pose, step, moving, forcing)

    def _sampled_step(self) -> int:
        """One step phase by phase, timed."""
        state, step, began = self.state, self.state.clock.time_step, clock.perf_counter()
        self._since_sample = 0
        self._launch_step(1, self._pose, step, forcing=0)
        ti.sync()
        moved = clock.perf_counter()
        if state.control.search_due[0]:
            return 0
        looked = clock.perf_counter()
        self._launch_step(1, self._pose, step, moving=0)
        ti.sync()
        self.timing.sampled_motion += moved - began
        self.timing.sampled_forces += clock.perf_counter() - looked
        return 1

    def _steps_walls_allow(self) -> int:
        """Steps until the fastest wall may have gone as far as one may between two searches, or an image the skin.

        Driven walls see to it themselves.
        """
        plan = self.state.plan
        way, speed = (plan.wall_way, plan.wall_speed) if not plan.features.shear else (plan.skin, plan.border_speed)
        if speed == 0.0:
            return WALL_BATCH
        return int(way / (speed * plan.longest_time_step)) - self.steps_since_search


def _build_gpu_step(state: State, move: Any, forces: Any) -> Callable[..., None]:
    """One step, every chunk a task of its own."""
    control, real, driven = state.control, state.backend.real, state.plan.features.driven_walls
    drive = build_drive(state) if driven else None

    @ti.kernel
    def step_on_gpu(
        steps: ti.i32, workers: ti.i32, chunks: ti.i32, count: ti.i32, pose: ti.i32, dt: real, moving: ti.i32,
        forcing: ti.i32
    ):  # fmt: skip
        for chunk in range(moving * chunks):
            if control.search_due[0] == 0 and control.guard[0] == 0:
                move(chunk, count, dt)
        if ti.static(driven):
            for _ in range(moving):
                if control.search_due[0] == 0 and control.guard[0] == 0:
                    drive(chunks, pose + control.steps_done[0], dt)
        if moving == 1:
            control.search_due[0] = control.search_wanted[0]
        for chunk in range(forcing * chunks):
            if control.search_due[0] == 0 and control.guard[0] == 0:
                forces(0, chunk, count, pose + control.steps_done[0], dt)
        if forcing == 1 and control.search_due[0] == 0 and control.guard[0] == 0:
            control.steps_done[0] = control.steps_done[0] + 1

    return step_on_gpu


def _build_cpu_steps(state: State, move: Any, forces: Any) -> Callable[..., None]:
    """Many steps in one launch. Workers take chunk after chunk and meet after every phase; see `meet_others`."""
    control, real, driven = state.control, state.backend.real, state.plan.features.driven_walls
    drive = build_drive(state) if driven else None

    @ti.func
    def meet_others(workers, meeting, forced, steps_wanted, chunks, pose, dt):
        """Wait until every worker is here; the last one settles what comes next before it lets the others go.

        Spinning on atomic counters takes a microsecond where waking Taichi's threads for every phase took sixty.
        """
        if ti.atomic_add(control.arrived[CACHE_LINE], 1) == meeting * workers - 1:
            control.next_chunk[CACHE_LINE] = 0
            if ti.static(driven):
                if forced == 0:
                    drive(chunks, pose, dt)
            if forced == 1 and control.search_due[0] == 0 and control.guard[0] == 0:
                control.steps_done[0] = control.steps_done[0] + 1
            control.search_due[0] = control.search_wanted[0]
            on = control.steps_done[0] < steps_wanted and control.search_due[0] == 0 and control.guard[0] == 0
            control.running[0] = ti.cast(on and (forced == 0 or control.waited[0] == 0), ti.i32)
            ti.atomic_add(control.meetings[CACHE_LINE], 1)
        looks = 0
        while ti.atomic_add(control.meetings[CACHE_LINE], 0) < meeting:
            looks += 1
        if looks > LONG_WAIT:
            control.waited[0] = 1

    @ti.func
    def next_chunk():
        return ti.atomic_add(control.next_chunk[CACHE_LINE], 1)

    @ti.func
    def work(worker, workers, chunks, count, pose, dt, moving, forcing, steps):
        meeting = 0
        while control.running[0] == 1:
            if moving == 1:
                chunk = next_chunk()
                while chunk < chunks:
                    move(chunk, count, dt)
                    chunk = next_chunk()
                meeting += 1
                meet_others(workers, meeting, 0, forcing * steps, chunks, pose + control.steps_done[0], dt)
            if forcing == 1 and control.running[0] == 1:
                pose_now = pose + control.steps_done[0]
                chunk = next_chunk()
                while chunk < chunks:
                    forces(worker, chunk, count, pose_now, dt)
                    chunk = next_chunk()
                meeting += 1
                meet_others(workers, meeting, 1, steps, chunks, pose_now, dt)

    @ti.kernel
    def step_on_cpu(
        steps: ti.i32, workers: ti.i32, chunks: ti.i32, count: ti.i32, pose: ti.i32, dt: real, moving: ti.i32,
        forcing: ti.i32
    ):  # fmt: skip
        control.waited[0] = 0
        control.next_chunk[CACHE_LINE] = 0
        control.arrived[CACHE_LINE] = 0
        control.meetings[CACHE_LINE] = 0
        control.running[0] = ti.cast(steps > 0 and control.search_due[0] == 0 and control.guard[0] == 0, ti.i32)
        for task in range(workers * CPU_STRIDE):
            if task % CPU_STRIDE == 0:
                work(task // CPU_STRIDE, workers, chunks, count, pose, dt, moving, forcing, steps)

    return step_on_cpu
