"""The phases of a time step, in order: integration, neighbor-list rebuild if it is due, contact forces.

One launch takes many steps on a CPU and one on a GPU. If a particle has moved by half the skin, all further phases of
the launch do nothing until the host has rebuilt the neighbor list, so that no step needs a transfer to the host. If the
list capacity is too small, the host reallocates the fields and repeats the rebuild.
"""

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import taichi as ti

from granflow.engine.force.contact_forces import build_forces
from granflow.engine.integrate import build_integrate
from granflow.engine.neighbor.cell_grid import update_cell_grids
from granflow.engine.neighbor.deletion import check_coordinates
from granflow.engine.neighbor.neighbor_list import (
    build_bounds,
    build_class_lists,
    build_neighbor_list,
    build_reorder,
    build_save_history,
    build_sort,
)
from granflow.engine.periodic_box import build_wrap, upload_offsets
from granflow.engine.state import CACHE_LINE, CPU_STRIDE, WALL_BATCH, State
from granflow.engine.threads.affinity import worker_affinity
from granflow.engine.threads.barrier import CALIBRATION_POLLS, build_barrier, build_poll, seconds_per_poll
from granflow.engine.threads.worker_tuner import WorkerTuner
from granflow.engine.wall_dynamics import build_wall_dynamics, mark_rebuild
from granflow.engine.walls import upload_poses
from granflow.plan.capacities import list_capacity_for

GPU_BATCH = 16
"""Number of GPU steps between two reads of the flags; on a GPU each step is a separate launch."""

LAUNCH_SECONDS = 0.05
"""Wall-clock time of a CPU launch [s]. A launch cannot be interrupted: a stop takes effect between two launches."""

FIRST_LAUNCH = 50_000
"""Particle-steps of the first CPU launch, before the rate is known."""

CONTENTION_LIMIT, PATIENCE_CHUNKS = 3e-4, 4.0
"""A worker leaves the launch after waiting this time [s] plus the time for this number of chunks: longer than the
differences in cost between chunks, and shorter than the time for which an operating system preempts a thread."""

START_PATIENCE = 3e-3
"""Additional waiting time at the first barrier of a launch [s], for the start of the threads."""

SINGLE_WORKER_PARTICLES = 512
"""Particle count up to which one worker processes all chunks: barriers would cost more time than more workers save."""

SAMPLE_EVERY = 256
"""Interval in steps between sampled steps, whose phases are timed separately."""


@dataclass
class Timing:
    """Wall-clock time [s] by phase, and counts.

    neighbor_list:        neighbor-list rebuilds
    advance:              all other phases of the steps
    sampled_forces:       forces of the sampled steps
    sampled_integration:  integration of the sampled steps; the ratio of both divides `advance`
    rebuild_count:        number of neighbor-list rebuilds
    step_count:           number of completed steps
    particle_steps:       sum of the particle counts of all steps
    growth_count:         number of reallocations with a larger list capacity
    compile:              compilation of kernels
    """

    neighbor_list: float = 0.0
    advance: float = 0.0
    sampled_forces: float = 0.0
    sampled_integration: float = 0.0
    rebuild_count: int = 0
    step_count: int = 0
    particle_steps: int = 0
    growth_count: int = 0
    compile: float = 0.0

    @property
    def forces(self) -> float:
        """Wall-clock time [s] of contact forces."""
        sampled = self.sampled_forces + self.sampled_integration
        return self.advance * self.sampled_forces / sampled if sampled else self.advance

    @property
    def integration(self) -> float:
        """Wall-clock time [s] of time integration."""
        return self.advance - self.forces


class Stepper:
    """Advances a State by steps.

    state:       device data
    on_deleted:  receives the index range (first, last), `last` exclusive, of the particles to delete, before they are
                 deleted

    `interrupted` stops `advance` after the present launch.
    """

    def __init__(self, state: State, on_deleted: Callable[[int, int], None]) -> None:
        self.state = state
        self.timing = Timing()
        self._on_deleted = on_deleted
        self.steps_since_rebuild = 0
        self.interrupted = False
        self._since_sample = 0
        self._worker_tuner = WorkerTuner(state.backend.worker_count)
        self._pose = WALL_BATCH if state.plan.has_poses else 0
        self._step_seconds = self._chunk_seconds = self._patience = 0.0
        self._build()
        if state.backend.on_cpu:
            self._prepare_workers()

    def _build(self) -> None:
        """Compile all phases by launching them on empty ranges; repeated after a reallocation of the fields."""
        began, state = clock.perf_counter(), self.state
        periodic = state.plan.features.periodic != "none"
        self._wrap = build_wrap(state) if periodic else lambda count, pose, step: None
        self._bounds, self._sort, self._reorder = build_bounds(state), build_sort(state), build_reorder(state)
        self._sort_classes = (
            build_class_lists(state) if state.cell_sort.class_order is not None else lambda count, cells: None
        )
        self._save_contacts = build_save_history(state) if state.neighbors.history else lambda count: None
        self._fill_neighbor_list = build_neighbor_list(state)
        build = _build_cpu_steps if state.backend.on_cpu else _build_gpu_step
        self._step = build(state, build_integrate(state), build_forces(state))
        self._bounds(0)
        self._wrap(0, 0, 1.0)
        self._sort(0, 0)
        self._sort_classes(0, 0)
        self._reorder(0)
        self._fill_neighbor_list(0, 0.0, 0)
        self._save_contacts(0)
        self._step(0, 1, 0, 0, 0, 0.0, 1, 1)
        self.timing.compile += clock.perf_counter() - began

    def _prepare_workers(self) -> None:
        """Identify the threads of the pool and measure the time of a poll."""
        began, workers = clock.perf_counter(), self.state.backend.worker_count
        seconds_of = build_poll(self.state.control)
        self._seconds_per_poll = seconds_per_poll(seconds_of)
        self._affinity = worker_affinity(workers, lambda: seconds_of(CALIBRATION_POLLS, workers))
        self._set_patience(CONTENTION_LIMIT)
        self.timing.compile += clock.perf_counter() - began

    def rebuild_neighbor_lists(self, pose: int = 0) -> None:
        """Sort the particles, delete those outside the domain or in an outlet, and fill the neighbor lists.

        `pose`: index of the wall poses at the time of the positions.
        """
        began, compiled = clock.perf_counter(), self.timing.compile
        state = self.state
        if state.count:
            deleted = self._sort_particles(pose)
            if deleted:
                self._on_deleted(state.count - deleted, state.count)
                state.count -= deleted
        self._rebuild_neighbor_list(pose)
        self.steps_since_rebuild = 0
        self.timing.neighbor_list += clock.perf_counter() - began - (self.timing.compile - compiled)
        self.timing.rebuild_count += 1

    def _sort_particles(self, pose: int) -> int:
        """Sort the particles in cell order, with their contact histories saved.

        Returns the number of particles to delete, which are behind the others.
        """
        state = self.state
        self._wrap(state.count, pose, state.clock.time_step)
        self._bounds(state.count)
        if state.plan.domain.on_exit == "expand":
            check_coordinates(state)
        grids = update_cell_grids(state)
        self._sort(state.count, grids[0].cell_count)
        self._save_history()
        self._reorder(state.count)
        present = int(state.cell_sort.cell_start[grids[0].cell_count])
        self._sort_classes(present, sum(grid.cell_count for grid in grids))
        return state.count - present

    def _save_history(self) -> None:
        """Copy the contact histories to `saved`; increase the list capacity if they do not fit."""
        state = self.state
        if not state.neighbors.history:
            return
        while True:
            self._save_contacts(state.count)
            needed = self._length_needed()
            if needed <= state.neighbors.history_capacity_per_chunk:
                return
            self.grow_neighbor_lists(list_capacity_for(needed))

    def _length_needed(self) -> int:
        """Number of entries that the previous kernel needed in the fullest chunk."""
        return int(self.state.control.list_length_needed[0])

    def grow_neighbor_lists(self, needed: int) -> None:
        """Increase the list capacity per chunk to at least `needed` entries and build all kernels again."""
        self.timing.growth_count += 1
        self.state.grow_neighbor_list(int(1.3 * needed) + 8, self._build)

    def _rebuild_neighbor_list(self, pose: int) -> None:
        """Fill the neighbor lists; increase the list capacity and repeat if they do not fit."""
        state = self.state
        mark_rebuild(state)
        if not state.count:
            state.control.rebuild_due[0] = 0
            state.control.rebuild_requested[0] = 0
            return
        while True:
            self._fill_neighbor_list(state.count, state.plan.skin, pose)
            needed = self._length_needed()
            if needed <= state.neighbors.list_capacity_per_chunk:
                return
            self.grow_neighbor_lists(needed)

    def forces(self, pose: int = 0, history_step: float | None = None) -> None:
        """Forces at the present positions.

        pose:          index of the wall poses
        history_step:  time step [s] by which contact displacements change; 0: no change; None: the time step
        """
        step = self.state.clock.time_step if history_step is None else history_step
        self.state.control.steps_done[0] = 0
        self._launch_step(1, pose, step, moving=0, forcing=1)

    def refresh(self, step: int) -> None:
        """Rebuild the neighbor lists and compute forces after step number `step`, after particles or walls changed.

        Contact displacements do not change.
        """
        self.place_walls(step)
        self.rebuild_neighbor_lists()
        self.forces(history_step=0.0)

    def place_walls(self, step: int) -> None:
        """Upload the wall poses after step number `step`, as pose 0."""
        if self.state.plan.has_poses:
            self._upload(step)
            self._pose = WALL_BATCH

    def _upload(self, step: int) -> None:
        """Upload the poses of walls and images from step number `step`."""
        if self.state.plan.features.moving_walls:
            upload_poses(self.state, step)
        if self.state.plan.features.lees_edwards:
            upload_offsets(self.state, step)

    def advance(self, steps: int, step: int) -> int:
        """Take `steps` steps after step number `step`; returns the number of completed steps.

        It is smaller after an abort, if `interrupted` is set (by a signal handler), and, with an adaptive time step,
        after a neighbor-list rebuild, which adds candidate pairs.

        `interrupted` takes effect between two launches, each of which takes about LAUNCH_SECONDS.
        """
        done, rebuilds = 0, self.timing.rebuild_count
        is_adaptive = self.state.plan.adaptive_time_step is not None
        while done < steps and not self.abort_code and not (is_adaptive and self.timing.rebuild_count > rebuilds):
            if self.interrupted:
                break
            done += self._advance_batch(steps - done, step + done)
        return done

    @property
    def abort_code(self) -> int:
        """0, or the abort code."""
        return int(self.state.control.abort[0])

    def _advance_batch(self, steps: int, step: int) -> int:
        """Take up to `steps` steps in one launch; rebuild the neighbor lists if due.

        Returns the number of completed steps.
        """
        state, plan = self.state, self.state.plan
        if plan.has_poses:
            if self._steps_to_displacement_limit() < 1:
                self.refresh(step)
            if self._pose == WALL_BATCH:
                self._upload(step + 1)
                self._pose = 0
            steps = min(steps, WALL_BATCH - self._pose, max(self._steps_to_displacement_limit(), 1))
        state.control.steps_done[0] = 0
        began, rebuild_seconds = clock.perf_counter(), self.timing.neighbor_list
        done = self._launch(steps)
        if state.control.rebuild_due[0] and not self.abort_code:
            self.rebuild_neighbor_lists(pose=self._pose + done)
            self.forces(pose=self._pose + done)
            done += int(state.control.steps_done[0])
        else:
            self.steps_since_rebuild += done
        if plan.has_poses:
            self._pose += done
        self._since_sample += done
        self.timing.advance += clock.perf_counter() - began - (self.timing.neighbor_list - rebuild_seconds)
        self.timing.step_count += done
        self.timing.particle_steps += done * state.count
        return done

    def _launch(self, steps: int) -> int:
        """Launch up to `steps` steps; returns the number of completed steps."""
        step = self.state.clock.time_step
        if self._since_sample >= SAMPLE_EVERY:
            return self._sampled_step()
        if not self.state.backend.on_cpu:
            for _ in range(min(steps, GPU_BATCH)):
                self._launch_step(1, self._pose, step)
            return int(self.state.control.steps_done[0])
        began, wanted = clock.perf_counter(), min(steps, self._steps_per_launch)
        self._launch_step(wanted, self._pose, step)
        done = int(self.state.control.steps_done[0])
        if done:
            self._adapt_launch(done, clock.perf_counter() - began)
        return done

    @property
    def _steps_per_launch(self) -> int:
        """Number of steps that take LAUNCH_SECONDS at the rate of the previous launch."""
        if not self._step_seconds:
            return max(FIRST_LAUNCH // max(self.state.count, 1), 1)
        return max(int(LAUNCH_SECONDS / self._step_seconds), 1)

    def _adapt_launch(self, done: int, seconds: float) -> None:
        """Choose length, workers and patience of the next launch from the wall-clock time of `done` steps [s]."""
        self._step_seconds = seconds / done
        state = self.state
        if state.count <= SINGLE_WORKER_PARTICLES:
            return
        workers = self._worker_tuner.next_size
        contended = int(state.control.worker_count[0]) < workers
        self._worker_tuner.record(done * state.count, seconds, contended)
        if contended:
            return  # the time contains the waiting time of the workers that left
        chunk_seconds = workers * self._step_seconds / state.chunk_count
        self._chunk_seconds = min(chunk_seconds, 1.1 * (self._chunk_seconds or chunk_seconds))
        patience = CONTENTION_LIMIT + PATIENCE_CHUNKS * self._chunk_seconds
        if not 0.8 * self._patience < patience < 1.25 * self._patience:
            self._set_patience(patience)

    def _set_patience(self, seconds: float) -> None:
        """Set the time [s] after which a worker leaves a barrier."""
        self._patience, patience = seconds, self.state.control.patience
        patience[0] = int(seconds / self._seconds_per_poll)
        patience[1] = int((seconds + START_PATIENCE) / self._seconds_per_poll)

    def _launch_step(self, steps: int, pose: int, step: float, moving: int = 1, forcing: int = 1) -> None:
        """One launch: `steps` steps on a CPU, one on a GPU. If `moving` or `forcing` is 0, only the other phase."""
        state = self.state
        workers = 1 if state.count <= SINGLE_WORKER_PARTICLES else self._worker_tuner.next_size
        if state.backend.on_cpu:
            self._affinity.set_workers(workers)
        self._step(steps, workers, state.chunk_count, state.count, pose, step, moving, forcing)

    def _sampled_step(self) -> int:
        """Take one step and time its phases separately."""
        state, step, began = self.state, self.state.clock.time_step, clock.perf_counter()
        self._since_sample = 0
        self._launch_step(1, self._pose, step, forcing=0)
        ti.sync()
        integrated = clock.perf_counter()
        if state.control.rebuild_due[0] or self.abort_code:
            return 0
        forces_began = clock.perf_counter()
        self._launch_step(1, self._pose, step, moving=0)
        ti.sync()
        self.timing.sampled_integration += integrated - began
        self.timing.sampled_forces += clock.perf_counter() - forces_began
        return int(state.control.steps_done[0])

    def _steps_to_displacement_limit(self) -> int:
        """Steps until the fastest wall may reach its displacement limit between rebuilds, or an image the skin.

        Force-controlled walls request their rebuilds on the device. WALL_BATCH if nothing moves.
        """
        plan = self.state.plan
        displacement_limit, speed = (
            (plan.wall_displacement_limit, plan.wall_speed)
            if not plan.features.lees_edwards
            else (plan.skin, plan.image_speed)
        )
        if speed == 0.0:
            return WALL_BATCH
        return int(displacement_limit / (speed * plan.longest_time_step)) - self.steps_since_rebuild


def _build_gpu_step(state: State, integrate: Any, forces: Any) -> Callable[..., None]:
    """Kernel for one step on a GPU; each chunk is a separate task.

    integrate, forces:  device functions of `build_integrate` and `build_forces`

    Arguments: steps and workers (unused), number of chunks, particle count, pose, time step [s], and whether to
    integrate (`moving`) and compute forces (`forcing`).

    Reads:   as the phases
    Writes:  as the phases; rebuild_due, steps_done
    """
    control, real, force_controlled = state.control, state.backend.real, state.plan.features.force_controlled_walls
    move_walls = build_wall_dynamics(state) if force_controlled else None

    @ti.kernel
    def step_on_gpu(
        steps: ti.i32, workers: ti.i32, chunks: ti.i32, count: ti.i32, pose: ti.i32, dt: real, moving: ti.i32,
        forcing: ti.i32
    ):  # fmt: skip
        for chunk in range(moving * chunks):
            if control.rebuild_due[0] == 0 and control.abort[0] == 0:
                integrate(chunk, count, dt)
        if ti.static(force_controlled):
            for _ in range(moving):
                if control.rebuild_due[0] == 0 and control.abort[0] == 0:
                    move_walls(chunks, pose + control.steps_done[0], dt)
        if moving == 1:
            control.rebuild_due[0] = control.rebuild_requested[0]
        for chunk in range(forcing * chunks):
            if control.rebuild_due[0] == 0 and control.abort[0] == 0:
                forces(0, chunk, count, pose + control.steps_done[0], dt)
        if forcing == 1 and control.rebuild_due[0] == 0 and control.abort[0] == 0:
            control.steps_done[0] = control.steps_done[0] + 1

    return step_on_gpu


def _build_cpu_steps(state: State, integrate: Any, forces: Any) -> Callable[..., None]:
    """Kernel for up to `steps` steps on a CPU, with the arguments of `_build_gpu_step`.

    Workers process one chunk after the other; a barrier separates the phases. Taking chunks dynamically balances the
    load, and does not affect the results, because each chunk writes to its particles only.

    Reads:   as the phases
    Writes:  as the phases; rebuild_due, steps_done, running, and the fields of the barrier
    """
    control, real, force_controlled = state.control, state.backend.real, state.plan.features.force_controlled_walls
    move_walls = build_wall_dynamics(state) if force_controlled else None
    arrive, release, wait = build_barrier(control)

    @ti.func
    def barrier(number, computes_forces, steps_wanted, chunks, pose, dt):
        """Wait for all workers; the last one prepares the next phase. Returns 1 if this worker leaves the launch.

        Polling atomic counters takes 1 us; waking the threads of Taichi for each phase takes 60 us.
        """
        left = 0
        if arrive(number) == 1:
            control.next_chunk[CACHE_LINE] = 0
            if ti.static(force_controlled):
                if computes_forces == 0:
                    move_walls(chunks, pose, dt)
            if computes_forces == 1 and control.rebuild_due[0] == 0 and control.abort[0] == 0:
                control.steps_done[0] = control.steps_done[0] + 1
            control.rebuild_due[0] = control.rebuild_requested[0]
            continues = control.steps_done[0] < steps_wanted and control.rebuild_due[0] == 0 and control.abort[0] == 0
            if number == 1:
                control.started_count[0] = control.worker_count[0]
            if computes_forces == 1 and control.worker_count[0] < control.started_count[0]:
                continues = False  # without a worker the rest of a launch costs more than the start of the next one
            control.running[0] = ti.cast(continues, ti.i32)
            release(number)
        else:
            left = wait(number)
        return left

    @ti.func
    def next_chunk():
        """Index of the next chunk of this phase; at least the number of chunks if none is left."""
        return ti.atomic_add(control.next_chunk[CACHE_LINE], 1)

    @ti.func
    def work(worker, chunks, count, pose, dt, moving, forcing, steps):
        """Steps of one worker, until the launch ends or the worker leaves it."""
        barrier_number, left = 0, 0
        while left == 0 and control.running[0] == 1:
            if moving == 1:
                chunk = next_chunk()
                while chunk < chunks:
                    integrate(chunk, count, dt)
                    chunk = next_chunk()
                barrier_number += 1
                left = barrier(barrier_number, 0, forcing * steps, chunks, pose + control.steps_done[0], dt)
            if forcing == 1 and left == 0 and control.running[0] == 1:
                pose_now = pose + control.steps_done[0]
                chunk = next_chunk()
                while chunk < chunks:
                    forces(worker, chunk, count, pose_now, dt)
                    chunk = next_chunk()
                barrier_number += 1
                left = barrier(barrier_number, 1, steps, chunks, pose_now, dt)

    @ti.kernel
    def step_on_cpu(
        steps: ti.i32, workers: ti.i32, chunks: ti.i32, count: ti.i32, pose: ti.i32, dt: real, moving: ti.i32,
        forcing: ti.i32
    ):  # fmt: skip
        control.worker_count[0] = workers
        control.next_chunk[CACHE_LINE] = 0
        control.arrived[CACHE_LINE] = 0
        control.arrived[2 * CACHE_LINE] = 0
        control.released[CACHE_LINE] = 0
        control.running[0] = ti.cast(steps > 0 and control.rebuild_due[0] == 0 and control.abort[0] == 0, ti.i32)
        for task in range(workers * CPU_STRIDE):
            if task % CPU_STRIDE == 0:
                work(task // CPU_STRIDE, chunks, count, pose, dt, moving, forcing, steps)

    return step_on_cpu
