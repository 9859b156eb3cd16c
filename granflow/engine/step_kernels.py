"""Kernels of the time step: integration, wall motion and contact forces, in one launch for many steps on a CPU.

If a neighbor-list rebuild is due, all further phases of a launch do nothing.
"""

from collections.abc import Callable
from typing import Any

from granflow.engine.control import CACHE_LINE
from granflow.engine.force.contact_forces import build_forces
from granflow.engine.gpu_step import build_gpu_step
from granflow.engine.integrate import build_integrate
from granflow.engine.state import CPU_STRIDE, State
from granflow.engine.threads.barrier import arrive, release, wait
from granflow.engine.wall_dynamics import build_move_walls
from granflow.kernel_language import ti


def build_steps(state: State) -> Callable[..., None]:
    """The kernel of the time steps on the device of the state."""
    build = build_cpu_steps if state.backend.on_cpu else build_gpu_step
    return build(state, build_integrate(state), build_forces(state))


def build_cpu_steps(state: State, integrate: Any, forces: Any) -> Callable[..., None]:
    """Kernel for up to `steps` steps on a CPU.

    integrate, forces:  device functions of `build_integrate` and `build_forces`

    Arguments: steps, workers, number of chunks, particle count, pose, time step [s], and whether to integrate
    (`moving`) and compute forces (`forcing`).

    Reads:   as the phases
    Writes:  as the phases; rebuild_due, steps_done, running, and the fields of the barrier
    """
    control, real, cpu_steps = state.control, state.backend.real, CpuSteps(state, integrate, forces)

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
                launch = ti.Struct(
                    worker=task // CPU_STRIDE, steps=steps, chunks=chunks, count=count, pose=pose, dt=dt,
                    moving=moving, forcing=forcing,
                )  # fmt: skip
                cpu_steps.work(launch)

    return step_on_cpu


class CpuSteps:
    """Device functions of one worker in a launch; `launch` is a struct of its number and the arguments of the kernel.

    Workers process one chunk after the other; a barrier separates the phases. Taking chunks dynamically balances the
    load, and does not affect the results, because each chunk writes to its particles only.
    """

    def __init__(self, state: State, integrate: Any, forces: Any) -> None:
        self.control, self.force_controlled = state.control, state.plan.features.force_controlled_walls
        self.move_walls = build_move_walls(state) if self.force_controlled else None
        self.integrate, self.forces = integrate, forces

    @ti.func
    def work(self, launch: ti.template()):
        """Steps of one worker, until the launch ends or the worker leaves it."""
        barrier_number, left, computes_forces = 0, 0, 1 - launch.moving
        while left == 0 and self.control.running[0] == 1:
            pose_now, chunk = launch.pose + self.control.steps_done[0], self._next_chunk()
            if computes_forces == 0:
                while chunk < launch.chunks:
                    self.integrate(chunk, launch.count, pose_now, launch.dt)
                    chunk = self._next_chunk()
            else:
                while chunk < launch.chunks:
                    self.forces(launch.worker, chunk, launch.count, pose_now, launch.dt)
                    chunk = self._next_chunk()
            barrier_number += 1  # one barrier in the code for both phases: compiled once
            left = self._barrier(launch, barrier_number, computes_forces)
            if launch.moving == 1:
                computes_forces = 1 - computes_forces

    @ti.func
    def _next_chunk(self):
        """Index of the next chunk of this phase; at least the number of chunks if none is left."""
        return ti.atomic_add(self.control.next_chunk[CACHE_LINE], 1)

    @ti.func
    def _barrier(self, launch: ti.template(), number, computes_forces):
        """Wait for all workers; the last one prepares the next phase. Returns 1 if this worker leaves the launch.

        Polling atomic counters takes 1 us; waking the threads of Taichi for each phase takes 60 us.
        """
        left = 0
        if arrive(self.control, number) == 1:
            self._prepare_phase(launch, number, computes_forces)
            release(self.control, number)
        else:
            left = wait(self.control, number)
        return left

    @ti.func
    def _prepare_phase(self, launch: ti.template(), number, computes_forces):
        """Move the walls after the integration, count the step after the forces, and decide whether to continue."""
        self.control.next_chunk[CACHE_LINE] = 0
        if ti.static(self.force_controlled):
            if computes_forces == 0:
                pose = launch.pose + self.control.steps_done[0]
                self.move_walls(launch.chunks, pose, launch.dt)
        if computes_forces == 1 and self.control.rebuild_due[0] == 0 and self.control.abort[0] == 0:
            self.control.steps_done[0] = self.control.steps_done[0] + 1
        self.control.rebuild_due[0] = self.control.rebuild_requested[0]
        continues = self.control.steps_done[0] < launch.forcing * launch.steps
        continues = continues and self.control.rebuild_due[0] == 0 and self.control.abort[0] == 0
        if number == 1:
            self.control.started_count[0] = self.control.worker_count[0]
        if computes_forces == 1 and self.control.worker_count[0] < self.control.started_count[0]:
            continues = False  # without a worker the rest of a launch costs more than the start of the next one
        self.control.running[0] = ti.cast(continues, ti.i32)
