"""Kernel of a time step on a GPU, in two dispatches: integration, then contact forces; each chunk is a task.

The host launches many steps before it reads a flag. A step that requests a rebuild, or aborts, records the number of
its launch in `halted_at`; all later launches then do nothing. A phase compares numbers that no task of the same phase
can change for it, so that all of its tasks decide alike, and no serial task is needed between the phases.
"""

from collections.abc import Callable
from typing import Any

from granflow.engine.dispatch import build_tasks_of_thread, thread_count
from granflow.engine.limits import FORCES, INTEGRATION
from granflow.engine.state import State
from granflow.engine.wall_dynamics import build_move_walls
from granflow.kernel_language import ti


def build_gpu_step(state: State, integrate: Any, forces: Any) -> Callable[..., None]:
    """Kernel for one step on a GPU.

    integrate, forces:  device functions of `build_integrate` and `build_forces`

    Arguments: number of the launch, number of steps before it since the flags were read, number of chunks, particle
    count, pose, time step [s], and whether to integrate (`moving`) and compute forces (`forcing`).

    The loops have constant lengths: Taichi computes any other length in a dispatch of its own.

    Reads:   as the phases
    Writes:  as the phases; halted_at, steps_done
    """
    control, real, most_chunks = state.control, state.backend.real, state.plan.capacities.chunks
    threads = thread_count(most_chunks)
    move, compute_forces = (
        build_tasks_of_thread(body, most_chunks) for body in _build_phases(state, integrate, forces)
    )

    @ti.kernel
    def step_on_gpu(
        number: ti.i32, steps_before: ti.i32, chunks: ti.i32, count: ti.i32, pose: ti.i32, dt: real, moving: ti.i32,
        forcing: ti.i32
    ):  # fmt: skip
        for thread in range(threads):
            if moving == 1 and ti.min(control.halted_at[INTEGRATION], control.halted_at[FORCES]) >= number:
                launch = ti.Struct(
                    number=number, steps_before=steps_before, chunks=chunks, count=count, pose=pose, dt=dt
                )  # fmt: skip
                move(thread, chunks, launch)
        for thread in range(threads):
            if forcing == 1 and control.halted_at[INTEGRATION] > number:
                if control.halted_at[FORCES] >= number:
                    launch = ti.Struct(number=number, count=count, pose=pose, dt=dt)
                    compute_forces(thread, chunks, launch)

    return step_on_gpu


def _build_phases(state: State, integrate: Any, forces: Any) -> tuple[Any, Any]:
    """Device functions (chunk, launch) of the integration and of the forces; `launch`: arguments of the kernel."""
    control, force_controlled = state.control, state.plan.features.force_controlled_walls
    move_walls = build_move_walls(state) if force_controlled else None

    @ti.func
    def record_halt(phase: ti.template(), number):
        """Record that this launch requests a rebuild or aborts; each task that does so sees its own request."""
        if control.abort[0] != 0 or (phase == INTEGRATION and control.rebuild_requested[0] == 1):
            if control.halted_at[phase] != number:
                control.halted_at[phase] = number

    @ti.func
    def move(chunk, launch):
        if chunk == 0:
            control.steps_done[0] = launch.steps_before
            if ti.static(force_controlled):
                move_walls(launch.chunks, launch.pose, launch.dt)
        integrate(chunk, launch.count, launch.pose, launch.dt)
        record_halt(INTEGRATION, launch.number)

    @ti.func
    def compute_forces(chunk, launch):
        forces(0, chunk, launch.count, launch.pose, launch.dt)
        record_halt(FORCES, launch.number)

    return move, compute_forces
