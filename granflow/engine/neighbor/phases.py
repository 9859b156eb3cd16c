"""Phases of a neighbor-list rebuild in one launch: tasks in any order, then a serial part, one phase after the other.

On a CPU, workers share the tasks of each phase, with a barrier after it: waking the threads of Taichi for each phase
takes 15 to 60 us, a barrier 1 us. On a GPU each phase is a loop over its tasks.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from granflow.engine.control import CACHE_LINE
from granflow.engine.dispatch import build_tasks_of_thread, thread_count
from granflow.engine.state import CPU_STRIDE, State
from granflow.engine.threads.barrier import arrive, release, wait
from granflow.kernel_language import ti
from granflow.plan.capacities import BOUNDS, SCAN_BLOCK


@ti.func
def _nothing(rebuild):
    """The serial part of most phases."""
    pass


@ti.func
def is_count(number):
    """True for all counts and indices, which the compiler does not know.

    A loop that ends where a number from memory is no count is neither unrolled nor vectorized. Unrolled eight times,
    with versions for each remainder, the short loops of a rebuild are half of its machine code, and no faster.
    """
    return number >= 0


@dataclass(frozen=True)
class Phase:
    """Device functions of a phase; `rebuild` is a struct with the arguments of the launch, see `build_rebuild`.

    count:   (rebuild): number of tasks
    body:    (task, rebuild): one task
    most:    largest number of tasks; on a GPU the length of the loop
    serial:  (rebuild): after all tasks, on one thread
    """

    count: Any
    body: Any
    most: int
    serial: Any = _nothing

    @property
    def has_serial(self) -> bool:
        """Whether the phase has a serial part."""
        return self.serial is not _nothing


def granularity(state: State) -> tuple[int, int]:
    """Largest number of parts of the particle list in a phase, and cells per task; a GPU has a thread for each."""
    return (BOUNDS, SCAN_BLOCK) if state.backend.on_cpu else (2**31 - 1, 1)


@ti.func
def part_range(part, parts, count):
    """Begin and end of a part of `count` consecutive entries, distributed evenly."""
    share, rest = count // parts, count % parts
    begin = part * share + ti.min(part, rest)
    return begin, begin + share + ti.cast(part < rest, ti.i32)


def build_rebuild(state: State, phases: list[Phase]) -> Callable[..., None]:
    """Kernel that runs the phases from number `first`.

    Arguments: workers, first, particle count, skin [m], time [s] of the reach, time step [s], pose.

    A phase that sets `control.running` to 0 is the last one.

    Reads:   as the phases
    Writes:  as the phases; running; on a CPU the fields of the barrier
    """
    return _build_cpu_rebuild(state, phases) if state.backend.on_cpu else _build_gpu_rebuild(state, phases)


def _build_gpu_rebuild(state: State, phases: list[Phase]) -> Callable[..., None]:
    control, real, position_real = state.control, state.backend.real, state.backend.position_real
    numbered = [
        (number, phase, thread_count(phase.most), build_tasks_of_thread(phase.body, phase.most))
        for number, phase in enumerate(phases)
    ]

    @ti.kernel
    def rebuild_on_gpu(
        workers: ti.i32, first: ti.i32, count: ti.i32, skin: position_real, reach_time: position_real, dt: real,
        pose: ti.i32
    ):  # fmt: skip
        control.running[0], control.list_length_needed[0] = 1, 0
        for number, phase, threads, tasks_of_thread in ti.static(numbered):
            # A constant length: Taichi computes any other one in a dispatch of its own.
            for thread in range(threads):
                rebuild = ti.Struct(count=count, skin=skin, reach_time=reach_time, dt=dt, pose=pose)
                if number >= first and control.running[0] == 1:
                    tasks_of_thread(thread, phase.count(rebuild), rebuild)
            if ti.static(phase.has_serial):
                for _ in range(1):  # one task of the kernel
                    if number >= first and control.running[0] == 1:
                        phase.serial(ti.Struct(count=count, skin=skin, reach_time=reach_time, dt=dt, pose=pose))

    return rebuild_on_gpu


def _build_cpu_rebuild(state: State, phases: list[Phase]) -> Callable[..., None]:
    control, real, position_real = state.control, state.backend.real, state.backend.position_real
    numbered, phase_count = [*enumerate(phases)], len(phases)

    @ti.func
    def next_task():
        return ti.atomic_add(control.next_chunk[CACHE_LINE], 1)

    @ti.func
    def run_tasks(current, rebuild):
        """Tasks of one phase of one worker."""
        task, task_count = next_task(), 0
        for number, phase in ti.static(numbered):
            if number == current:
                task_count = phase.count(rebuild)
        while task < task_count:
            for number, phase in ti.static(numbered):
                if number == current:
                    phase.body(task, rebuild)
            task = next_task()

    @ti.func
    def complete(current, barrier, rebuild):
        """Wait for all workers; the last one runs the serial part. Returns 1 if this worker leaves the launch."""
        left = 0
        if arrive(control, barrier) == 1:
            for number, phase in ti.static(numbered):
                if number == current:
                    phase.serial(rebuild)
            control.next_chunk[CACHE_LINE] = 0
            release(control, barrier)
        else:
            left = wait(control, barrier)
        return left

    @ti.kernel
    def rebuild_on_cpu(
        workers: ti.i32, first: ti.i32, count: ti.i32, skin: position_real, reach_time: position_real, dt: real,
        pose: ti.i32
    ):  # fmt: skip
        control.worker_count[0], control.running[0], control.list_length_needed[0] = workers, 1, 0
        control.next_chunk[CACHE_LINE], control.released[CACHE_LINE] = 0, 0
        control.arrived[CACHE_LINE], control.arrived[2 * CACHE_LINE] = 0, 0
        for task in range(workers * CPU_STRIDE):
            if task % CPU_STRIDE == 0:
                rebuild = ti.Struct(count=count, skin=skin, reach_time=reach_time, dt=dt, pose=pose)
                # One loop with the phase chosen in it, not a sequence of phases: half the compile time.
                current, left = first, 0
                while current < phase_count and left == 0 and control.running[0] == 1:
                    run_tasks(current, rebuild)
                    left = complete(current, current - first + 1, rebuild)
                    current += 1

    return rebuild_on_cpu
