"""What a run needs: memory and run time, and the refusal of runs that need too much of one.

Memory is estimated from the arrays of the plan before any of them is allocated; a test compares the estimate
with the allocated memory. The run time is a lower bound from rates that no machine exceeds, so that only
probable mistakes of units are refused; `explain` shows an estimate from typical rates.
"""

from dataclasses import dataclass
from itertools import groupby
from math import ceil
from typing import get_args

from granflow.arguments import refuse_other, shown
from granflow.errors import GranflowError, SceneError
from granflow.io.machine import available_memory
from granflow.plan.arrays import (
    cell_arrays,
    mesh_arrays,
    neighbor_arrays,
    particle_arrays,
    sum_arrays,
)
from granflow.plan.capacities import Capacities
from granflow.plan.plan import Plan
from granflow.scene.blocks.run import Precision


@dataclass(frozen=True)
class MemoryEstimate:
    """Initial device memory [bytes]; neighbor lists grow if they are too short.

    `per_particle`, `per_neighbor`: for one particle and one list entry; all others: totals.
    """

    per_particle: int
    per_neighbor: int
    """Per list entry: partner index, contact history, and the share of an entry saved during a rebuild."""
    particles: int
    neighbor_lists: int
    cells: int
    meshes: int = 0
    sums: int = 0
    """Energies and wall forces: per chunk, on a GPU per particle."""

    @property
    def total(self) -> int:
        """Total device memory [bytes]."""
        return self.particles + self.neighbor_lists + self.cells + self.meshes + self.sums


def estimate_memory(plan: Plan, precision: Precision, capacities: Capacities | None = None) -> MemoryEstimate:
    """Sum of the sizes [bytes] of all arrays that scale with particles, contacts, cells or triangles.

    capacities:  of the neighbor lists; None: those at the start

    >>> gf.estimate_memory(gf.plan_for(gf.load_scene("two.yaml")), "f64").total > 0
    True
    """
    refuse_other("plan", plan, Plan, "a plan of granflow.plan_for")
    if precision not in get_args(Precision):
        raise GranflowError(f"precision is {shown(precision)}; give one of {', '.join(get_args(Precision))}.")
    capacities = capacities or plan.capacities
    lists = neighbor_arrays(plan, capacities)
    cells = cell_arrays(plan)
    particles = sum(
        each.size(precision) for each in (*particle_arrays(plan), *lists, *cells) if each.per_particle
    )
    list_bytes = sum(each.size(precision) for each in lists if not each.per_particle)
    return MemoryEstimate(
        per_particle=particles // capacities.particles,
        per_neighbor=list_bytes // capacities.list_entries,
        particles=particles,
        neighbor_lists=list_bytes,
        cells=sum(each.size(precision) for each in cells if not each.per_particle),
        meshes=sum(each.size(precision) for each in mesh_arrays(plan)) if plan.meshes else 0,
        sums=sum(each.size(precision) for each in sum_arrays(plan)),
    )


def largest_block(plan: Plan, capacities: Capacities) -> int:
    """Bytes of the largest array, or arrays that are interleaved entry by entry."""
    arrays = [
        *particle_arrays(plan),
        *neighbor_arrays(plan, capacities),
        *cell_arrays(plan),
        *sum_arrays(plan),
    ]
    blocks = groupby(arrays, key=lambda array: array.block or array.name)
    return max(sum(array.size(plan.scene.run.precision) for array in block) for _, block in blocks)


# The memory of a run on a CPU.

RUNTIME = 100_000_000
"""Memory [bytes] of the compiler, independent of the scene."""
HOST_PER_PARTICLE = 600
"""Host memory [bytes] per particle when a frame is written (measured: 510); insertion needs less."""
WARNED_SHARE = 0.8
"""Share of the available memory above which a warning appears: lists may grow, other processes need some."""


def required_memory(plan: Plan) -> int:
    """Peak memory [bytes] of a run on a CPU, with the initial estimate of contacts.

    Sum of device fields, frames on the host (HOST_PER_PARTICLE) and compiler (RUNTIME).
    """
    host = HOST_PER_PARTICLE * plan.particle_capacity
    return estimate_memory(plan, plan.scene.run.precision).total + host + RUNTIME


def fits(plan: Plan) -> bool:
    """True if a run fits or the available memory is unknown."""
    available = available_memory()
    return available is None or required_memory(plan) <= available


def refuse_without_memory(plan: Plan) -> None:
    """Raise SceneError if a run on a CPU does not fit into the available memory; never if that is unknown."""
    if not fits(plan):
        raise SceneError(f"{_location(plan)}: {memory_warning(plan)}")


def memory_warning(plan: Plan) -> str | None:
    """A sentence if a run does not fit or almost fills the memory; None if it fits or the memory is unknown.

    "Almost" is WARNED_SHARE of the available memory. The sentence names needed and free memory [GB] and
    remedies.
    """
    needed = required_memory(plan)
    available = available_memory()
    if available is None or needed <= WARNED_SHARE * available:
        return None
    count = plan.particle_capacity
    free = f"{available / 1e9:.3g} GB"
    excess = (
        f"but only {free} are free" if needed > available else f"which is most of the {free} that are free"
    )
    return (
        f"{count} particles need about {needed / 1e9:.3g} GB of memory, {excess}: "
        f"{_remedies(plan, needed, available)}."
    )


def _remedies(plan: Plan, needed: int, available: int) -> str:
    """Remedies: fewer particles, lower precision, more memory.

    `needed`, `available` [bytes]; the suggested number of particles fills WARNED_SHARE of the available
    memory.
    """
    per_particle = (needed - RUNTIME) / plan.particle_capacity
    fitting_count = int(WARNED_SHARE * max(available - RUNTIME, 0) / per_particle)
    count_remedy = "free memory"
    if fitting_count:
        count_remedy = f"lower the count to about {float(f'{fitting_count:.2g}'):.0f}"
    precision_remedy = ", set run.precision to mixed" if plan.scene.run.precision == "f64" else ""
    return f"{count_remedy}{precision_remedy}, or use a machine with more memory"


# The range of the indices of neighbor lists.

MAX_LIST_ENTRIES = 2**31 - 1
"""Neighbor-list entries have 32-bit indices."""


def refuse_too_many(plan: Plan) -> None:
    """Raise SceneError if the neighbor-list entries of all chunks exceed the range of 32-bit indices.

    The message suggests a number of particles, rounded to two digits.
    """
    list_entries = plan.capacities.list_entries
    if list_entries > MAX_LIST_ENTRIES:
        max_count = float(f"{plan.particle_capacity * (MAX_LIST_ENTRIES / list_entries):.2g}")
        raise SceneError(
            f"{_location(plan)}: {plan.particle_capacity} particles are requested, but about {max_count:.0f} "
            "is the maximum for 32-bit neighbor-list indices. Lower the count."
        )


# The memory of a GPU.


def refuse_without_device_memory(plan: Plan, free: int | None, largest_buffer: int | None) -> None:
    """Raise SceneError if the fields of a run on a GPU exceed its free memory, or one of them the largest
    buffer.

    free, largest_buffer:  [bytes]; None if unknown
    """
    total = estimate_memory(plan, plan.scene.run.precision).total
    longest = largest_block(plan, plan.capacities)
    if free is not None and total > free:
        excess = f"on the GPU, but only {free / 1e9:.3g} GB are free"
        raise _too_large(plan, total, free, excess)
    if largest_buffer is not None and longest > largest_buffer:
        excess = f"in one buffer, but this GPU allows at most {largest_buffer / 1e9:.3g} GB"
        raise _too_large(plan, longest, largest_buffer, excess)


def refuse_growth(plan: Plan, grown: Capacities, available: int | None, largest_buffer: int | None) -> None:
    """Raise SceneError if the fields of a run on a GPU with longer neighbor lists do not fit.

    available, largest_buffer:  [bytes], those of the present fields included; None if unknown
    """
    total = estimate_memory(plan, plan.scene.run.precision, grown).total
    longest = largest_block(plan, grown)
    exceeds_memory = available is not None and total > available
    exceeds_buffer = largest_buffer is not None and longest > largest_buffer
    if exceeds_memory or exceeds_buffer:
        entries = f"{grown.list_entries / plan.particle_capacity:.3g} candidate pairs per particle"
        raise SceneError(
            f"{_location(plan)}: the neighbor lists of {entries} no longer fit into the memory of the GPU, "
            f"because all fields need {total / 1e9:.3g} GB. Lower the count, or numerics.skin."
        )


def _too_large(plan: Plan, needed: int, available: int, excess: str) -> SceneError:
    """The error for `needed` above `available` [bytes], with the number of particles that fits."""
    count = float(f"{plan.particle_capacity * WARNED_SHARE * available / needed:.2g}")
    remedy = " or set run.precision to mixed" if plan.scene.run.precision == "f64" else ""
    return SceneError(
        f"{_location(plan)}: {plan.particle_capacity} particles need about {needed / 1e9:.3g} GB {excess}: "
        f"lower the count to about {count:.0f}{remedy}."
    )


def _location(plan: Plan) -> str:
    """File and line of the count of the largest group."""
    return max(plan.groups, key=lambda group: group.spec.sphere_count).locate("count")


# The run time: what is typical, for `explain`, and what no machine exceeds, for the refusal of a scene.

TYPICAL_PARTICLE_STEPS_PER_SECOND = 5e6
"""Usual particle-steps per second of wall-clock time on two CPU cores: settled particles with friction."""
TYPICAL_STEPS_PER_SECOND = 2e5
"""Usual steps per second of wall-clock time on a CPU where the number of particles no longer matters."""
MAX_STEPS_PER_SECOND = 1e6
"""Upper bound of steps per second of wall-clock time for few particles (measured on a CPU: 3e5)."""
MAX_PARTICLE_STEPS_PER_SECOND = 1e9
"""Upper bound of particle-steps per second of wall-clock time (measured on two CPU cores: 2e7).

The bounds are far above the usual rates because a scene is refused only if no machine can compute it.
"""
WRITES_PER_SECOND = 1e4
"""Upper bound of frames, time-series rows and checkpoints per second of wall-clock time (measured: 1e3)."""
YEAR = 365.25 * 86400.0
"""Seconds per year."""
LONGEST = YEAR
"""Lower bound of the run time [s] above which a scene is refused: probably a wrong unit or exponent."""
CLOCK_STEPS = 2.0**52
"""Number of steps above which single steps no longer advance the time in double precision."""
ROUNDING = 1e-6
"""Tolerance, as a fraction of the time step, for a stage shorter than one step."""


def refuse_run_time(plan: Plan, allow_long: bool = False) -> None:
    """Raise SceneError if a stage is shorter than a step, steps do not advance the time, or the run time is
    excessive.

    `allow_long` allows an excessive run time.
    """
    _refuse_no_step(plan)
    steps = plan.scene.longest_duration / plan.time_step
    if steps > CLOCK_STEPS:
        raise SceneError(
            f"{_steps_text(plan, steps)}, more than the {CLOCK_STEPS:.2g} that time in f64 resolves."
        )
    seconds = least_run_time(plan)
    if seconds > LONGEST and not allow_long:
        steps = plan.scene.longest_duration / plan.longest_time_step
        years = f"{seconds / YEAR:.3g}"
        raise SceneError(
            f"{_steps_text(plan, steps)}. With a particle count of {plan.particle_capacity} and "
            f"{_writes(plan):.3g} frames, rows and checkpoints, the run would take at least {years} "
            f"{'year' if years == '1' else 'years'}. Check the units of durations, intervals, sizes, "
            "densities and moduli, or allow it with --allow-long."
        )


def _refuse_no_step(plan: Plan) -> None:
    """Raise SceneError for the first stage that is shorter than one time step."""
    step = plan.time_step
    for stage in plan.stages:
        if stage.longest < step * (1.0 - ROUNDING):
            enough = float(f"{1.05 * step:.2g}")  # two digits, and not below the step
            key, where = plan.scene.end_of_stage(stage.name)
            raise SceneError(
                f"{where}: {key} is {stage.longest:.3g} s, shorter than one time step of "
                f"{step:.3g} s ({plan.step.limited_by}). Set it to at least {enough:.3g} s, or lower "
                "run.time_step."
            )


def least_run_time(plan: Plan) -> float:
    """Lower bound of the wall-clock time [s] of a run, from upper bounds of all rates.

        t = max(N / MAX_STEPS_PER_SECOND, N P / MAX_PARTICLE_STEPS_PER_SECOND) + W / WRITES_PER_SECOND

    N: steps of the longest possible duration, P: particles, W: frames, rows and checkpoints.
    """
    steps = plan.scene.longest_duration / plan.longest_time_step
    of_steps = steps / MAX_STEPS_PER_SECOND
    of_particles = steps * plan.particle_capacity / MAX_PARTICLE_STEPS_PER_SECOND
    return max(of_steps, of_particles) + _writes(plan) / WRITES_PER_SECOND


def typical_run_time(plan: Plan) -> float:
    """Estimate of the wall-clock time [s] of the steps on a CPU, from the usual rates; without output.

    The number of particles or the number of steps determines it, whichever takes longer.
    """
    steps = ceil(plan.scene.longest_duration / plan.time_step)
    return max(steps * plan.particle_capacity / typical_rate(plan)[0], steps / TYPICAL_STEPS_PER_SECOND)


SLOW_CLUMPS = 3.5
"""Duration of a step with clumps of three spheres over that of as many single spheres (measured)."""
SLOW_TRIANGLES = 0.3
"""Increase of the duration of a step by a mesh on which the particles lie, for triangles of the size of the
particles; it is proportional to diameter over edge (measured: 1.2 and 2.6 times at 0.9 and 5.3)."""


def typical_rate(plan: Plan) -> tuple[float, tuple[str, ...]]:
    """Usual particle-steps per second of wall-clock time on two CPU cores, and the features that lower it.

    The largest factor counts: some of them do not add up.
    """
    factors = []
    if plan.features.clumps:
        factors.append((SLOW_CLUMPS, "clumps"))
    factors += [
        (law.relative_cost, f"{slot} {law.name}")
        for slot, law in plan.laws.by_slot.items()
        if law.relative_cost > 1.0
    ]
    edges = [mesh.typical_edge for mesh in plan.meshes.values()]
    if edges:
        mesh_factor = 1.0 + SLOW_TRIANGLES * 2.0 * plan.radius_min / min(edges)
        factors.append((mesh_factor, "triangles of meshes"))
    slowest = max((factor for factor, _ in factors), default=1.0)
    return TYPICAL_PARTICLE_STEPS_PER_SECOND / slowest, tuple(name for _, name in factors)


OPTIMIZED_ABOVE = 5.0
"""Typical run time [s] above which the kernels are optimized twice: by the kernel language and by LLVM.

The former takes as long as the latter (hopper 1.7 s, mixer 9 s) and shortens the steps by a fifth, so that a
shorter run ends later with it. The results are the same bits.
"""


def is_worth_optimizing(plan: Plan) -> bool:
    """Whether a run on a CPU is long enough for the optimization of the kernel language, see
    OPTIMIZED_ABOVE."""
    return typical_run_time(plan) > OPTIMIZED_ABOVE


def _writes(plan: Plan) -> float:
    """Number of frames, rows and checkpoints at intervals of simulated time: at most one of each per step."""
    output = plan.scene.output
    duration = plan.scene.longest_duration
    intervals = (output.interval, output.timeseries_interval, output.checkpoint.interval)
    steps = duration / plan.longest_time_step
    return sum(min(duration / interval, steps) for interval in intervals if interval is not None)


def _steps_text(plan: Plan, steps: float) -> str:
    """Location and number of the steps, and the reason for their length."""
    scene = plan.scene
    if not isinstance(scene.run.time_step, str):
        where = scene.locate("run", "time_step")
    elif scene.stages:
        where = scene.locate("stages")
    else:
        where = scene.locate("run", "duration")
    return (
        f"{where}: {plan.scene.longest_duration:.3g} s in time steps of {plan.time_step:.3g} s "
        f"({plan.step.limited_by}) are {float(ceil(steps)):.3g} steps"
    )
