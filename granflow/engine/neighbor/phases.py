"""How a neighbor-list rebuild runs: a list of phases in one launch.

A phase has tasks, which run in any order, and then perhaps a serial part. On a CPU, workers share the tasks
of each phase, with a barrier after it: waking the threads of Taichi for each phase takes 15 to 60 us, a
barrier 1 us. On a GPU each phase is a loop over its tasks. `rebuild.py` lists the phases.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from granflow.engine.fields import build_tasks_of_thread, thread_count
from granflow.engine.state import CACHE_LINE, CPU_STRIDE, State
from granflow.engine.threads import arrive, release, wait
from granflow.kernel_language import ti
from granflow.plan.capacities import BOUNDS, SCAN_BLOCK

EVENLY = 0
"""Entries per task of a phase that distributes its entries evenly over at most BOUNDS tasks."""


@ti.func
def all_particles(rebuild: ti.template()):
    """Number of entries of most phases."""
    return rebuild.count


@dataclass(frozen=True)
class Phase:
    """Device functions of a phase; `rebuild` is a struct with the number of particles, `count`, and with
    `skin` to `pose` of `RebuildLaunch`.

    body:      (task, rebuild): one task, a struct of its `index` and its entries `begin` to `end`, exclusive
    most:      largest number of tasks; on a GPU the length of the loop
    count:     (rebuild): number of entries
    per_task:  entries of a task, or EVENLY
    serial:    (rebuild): after all tasks, on one thread; None: nothing
    """

    body: Any
    most: int
    count: Any = all_particles
    per_task: int = EVENLY
    serial: Any = None

    @property
    def has_serial(self) -> bool:
        """Whether the phase has a serial part."""
        return self.serial is not None


def granularity(state: State) -> tuple[int, int]:
    """Particles per task and cells per task; a GPU has a thread for each."""
    return (EVENLY, SCAN_BLOCK) if state.backend.on_cpu else (1, 1)


class RebuildLaunch(NamedTuple):
    """Arguments of the kernel of a rebuild, in their order; by default there are no particles.

    first:       number of the first phase
    skin:        [m]
    reach_time:  time [s] of the reach, see `sort.Bounds`
    dt:          time step [s]
    pose:        index of the poses of the walls
    """

    workers: int = 1
    first: int = 0
    particle_count: int = 0
    skin: float = 0.0
    reach_time: float = 0.0
    dt: float = 0.0
    pose: int = 0


def build_rebuild(state: State, phases: list[Phase]) -> Callable[..., None]:
    """Kernel that runs the phases from number `first`; its arguments are those of `RebuildLaunch`.

    A phase that sets `control.running` to 0 is the last one.

    Reads:   as the phases
    Writes:  as the phases; running; on a CPU the fields of the barrier
    """
    return _build_cpu_rebuild(state, phases) if state.backend.on_cpu else _build_gpu_rebuild(state, phases)


def _build_cpu_rebuild(state: State, phases: list[Phase]) -> Callable[..., None]:
    control = state.control
    real = state.backend.real
    position_real = state.backend.position_real
    cpu_phases = CpuPhases(state, phases)

    @ti.kernel
    def rebuild_on_cpu(
        workers: ti.i32,
        first: ti.i32,
        count: ti.i32,
        skin: position_real,
        reach_time: position_real,
        dt: real,
        pose: ti.i32,
    ):
        control.worker_count[0] = workers
        control.running[0] = 1
        control.list_length_needed[0] = 0
        control.next_chunk[CACHE_LINE] = 0
        control.released[CACHE_LINE] = 0
        control.arrived[CACHE_LINE] = 0
        control.arrived[2 * CACHE_LINE] = 0
        for task in range(workers * CPU_STRIDE):
            if task % CPU_STRIDE == 0:
                rebuild = ti.Struct(count=count, skin=skin, reach_time=reach_time, dt=dt, pose=pose)
                cpu_phases.work(first, rebuild)

    return rebuild_on_cpu


class CpuPhases:
    """What one worker does in the launch of a rebuild."""

    def __init__(self, state: State, phases: list[Phase]) -> None:
        self.control = state.control
        self.numbered = [*enumerate(phases)]
        self.phase_count = len(phases)
        self.special = [
            each for each in self.numbered if (each[1].count, each[1].per_task) != (all_particles, EVENLY)
        ]
        self.serial = [each for each in self.numbered if each[1].has_serial]

    @ti.func
    def work(self, first, rebuild: ti.template()):
        """Phases from number `first`, until the launch ends or the worker leaves it."""
        # One loop with the phase chosen in it, not a sequence of phases: half the compile time.
        current = first
        left = 0
        while current < self.phase_count and left == 0 and self.control.running[0] == 1:
            self._run_tasks(current, rebuild)
            left = self._complete(current, current - first + 1, rebuild)
            current += 1

    @ti.func
    def _next_task(self):
        return ti.atomic_add(self.control.next_chunk[CACHE_LINE], 1)

    @ti.func
    def _run_tasks(self, current, rebuild: ti.template()):
        """Tasks of one phase of one worker."""
        index = self._next_task()
        entries = all_particles(rebuild)
        per_task = EVENLY
        for number, phase in ti.static(self.special):
            if number == current:
                entries = phase.count(rebuild)
                per_task = phase.per_task
        tasks = task_count(entries, per_task)
        while index < tasks:
            begin, end = entry_range(index, entries, per_task)
            task = ti.Struct(index=index, begin=begin, end=end)
            for number, phase in ti.static(self.numbered):
                if number == current:
                    phase.body(task, rebuild)
            index = self._next_task()

    @ti.func
    def _complete(self, current, barrier, rebuild: ti.template()):
        """Wait for all workers; the last one runs the serial part. Returns 1 if this worker leaves the
        launch."""
        left = 0
        if arrive(self.control, barrier) == 1:
            for number, phase in ti.static(self.serial):
                if number == current:
                    phase.serial(rebuild)
            self.control.next_chunk[CACHE_LINE] = 0
            release(self.control, barrier)
        else:
            left = wait(self.control, barrier)
        return left


def _build_gpu_rebuild(state: State, phases: list[Phase]) -> Callable[..., None]:
    control = state.control
    real = state.backend.real
    position_real = state.backend.position_real
    numbered = [
        (number, phase, thread_count(phase.most), _build_tasks_of_thread(phase))
        for number, phase in enumerate(phases)
    ]

    @ti.kernel
    def rebuild_on_gpu(
        workers: ti.i32,
        first: ti.i32,
        count: ti.i32,
        skin: position_real,
        reach_time: position_real,
        dt: real,
        pose: ti.i32,
    ):
        control.running[0] = 1
        control.list_length_needed[0] = 0
        for number, phase, threads, tasks_of_thread in ti.static(numbered):
            # A constant length: Taichi computes any other one in a dispatch of its own.
            for thread in range(threads):
                rebuild = ti.Struct(count=count, skin=skin, reach_time=reach_time, dt=dt, pose=pose)
                if number >= first and control.running[0] == 1:
                    tasks_of_thread(thread, rebuild)
            if ti.static(phase.has_serial):
                for _ in range(1):  # one task of the kernel
                    if number >= first and control.running[0] == 1:
                        phase.serial(
                            ti.Struct(count=count, skin=skin, reach_time=reach_time, dt=dt, pose=pose)
                        )

    return rebuild_on_gpu


def _build_tasks_of_thread(phase: Phase) -> Any:
    """Device function (thread, rebuild): the tasks of a phase that one thread of a GPU has."""
    per_task = phase.per_task

    @ti.func
    def body(index, rebuild: ti.template()):
        begin = index
        end = index + 1
        if ti.static(per_task != 1):
            begin, end = entry_range(index, phase.count(rebuild), per_task)
        phase.body(ti.Struct(index=index, begin=begin, end=end), rebuild)

    tasks = build_tasks_of_thread(body, phase.most)

    @ti.func
    def tasks_of_thread(thread, rebuild: ti.template()):
        tasks(thread, task_count(phase.count(rebuild), per_task), rebuild)

    return tasks_of_thread


@ti.func
def task_count(entries, per_task):
    """Number of tasks of a phase."""
    tasks = ti.min(entries, BOUNDS)
    if per_task != EVENLY:
        tasks = (entries + per_task - 1) // per_task
    return tasks


@ti.func
def entry_range(index, entries, per_task):
    """Begin and end of the entries of a task."""
    begin = index * per_task
    end = ti.min((index + 1) * per_task, entries)
    if per_task == EVENLY:
        begin, end = part_range(index, ti.min(entries, BOUNDS), entries)
    return begin, end


@ti.func
def part_range(part, parts, count):
    """Begin and end of a part of `count` consecutive entries, distributed evenly."""
    share = count // parts
    rest = count % parts
    begin = part * share + ti.min(part, rest)
    return begin, begin + share + ti.cast(part < rest, ti.i32)


@ti.func
def is_count(number: ti.template()):
    """True for all counts and indices, which the compiler does not know.

    A loop that ends where a number from memory is no count is neither unrolled nor vectorized. Unrolled eight
    times, with versions for each remainder, the short loops of a rebuild are half of its machine code, and no
    faster.
    """
    return number >= 0
