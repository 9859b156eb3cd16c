"""Compares the memory that a run needs with the available memory, before any array is allocated."""

from granflow.errors import SceneError
from granflow.io.gpu_memory import free_gpu_memory
from granflow.io.machine import available_memory
from granflow.plan.memory_estimate import estimate_memory
from granflow.plan.plan import Plan

RUNTIME = 100_000_000
"""Memory [bytes] of the compiler, independent of the scene."""

HOST_PER_PARTICLE = 600
"""Host memory [bytes] per particle when a frame is written (measured: 510); insertion needs less."""

MAX_LIST_ENTRIES = 2**31 - 1
"""Neighbor-list entries have 32-bit indices."""

VULKAN_BUFFER = 2**32
"""Largest Vulkan buffer [bytes]; all fields of a run are in one."""

WARNED_SHARE = 0.8
"""Share of the available memory above which a warning appears: lists may grow, other processes need some."""


def required_memory(plan: Plan) -> int:
    """Peak memory [bytes] of a run on a CPU, with the initial estimate of contacts.

    Sum of device fields, frames on the host (HOST_PER_PARTICLE) and compiler (RUNTIME).
    """
    host = HOST_PER_PARTICLE * plan.particle_capacity
    return estimate_memory(plan, plan.precision).total + host + RUNTIME


def memory_warning(plan: Plan) -> str | None:
    """A sentence if a run does not fit or almost fills the memory; None if it fits or the memory is unknown.

    "Almost" is WARNED_SHARE of the available memory. The sentence names needed and free memory [GB] and remedies.
    """
    needed, available = required_memory(plan), available_memory()
    if available is None or needed <= WARNED_SHARE * available:
        return None
    count = plan.particle_capacity
    free = f"{available / 1e9:.3g} GB"
    statement = f"but only {free} are free" if needed > available else f"which is most of the {free} that are free"
    sizes = f"{count} particles need about {needed / 1e9:.3g} GB of memory, {statement}"
    return f"{sizes}: {_remedies(plan, needed, available)}."


def refuse_too_many(plan: Plan) -> None:
    """Raise SceneError if the neighbor-list entries of all chunks exceed the range of 32-bit indices.

    The message suggests a number of particles, rounded to two digits.
    """
    list_entries = plan.capacities.list_entries
    if list_entries > MAX_LIST_ENTRIES:
        max_count = float(f"{plan.particle_capacity * (MAX_LIST_ENTRIES / list_entries):.2g}")
        request = f"{plan.particle_capacity} particles are requested, but about {max_count:.0f} is the maximum"
        raise SceneError(f"{_location(plan)}: {request} for 32-bit neighbor-list indices. Lower the count.")


def refuse_without_memory(plan: Plan) -> None:
    """Raise SceneError if a run on a CPU does not fit into the available memory; never if that is unknown."""
    if not fits(plan):
        raise SceneError(f"{_location(plan)}: {memory_warning(plan)}")


def refuse_without_device_memory(plan: Plan, arch: str) -> None:
    """Raise SceneError if the fields of a run on a GPU exceed its free memory, or the largest buffer of Vulkan.

    arch:  "cuda" or "vulkan"; the free memory is known on CUDA only
    """
    needed, is_vulkan = estimate_memory(plan, plan.precision).total, arch == "vulkan"
    available = VULKAN_BUFFER if is_vulkan else free_gpu_memory()
    if available is None or needed <= available:
        return
    limit = f"{available / 1e9:.3g} GB"
    statement = f"but a Vulkan buffer has at most {limit}" if is_vulkan else f"but only {limit} are free"
    sizes = f"{plan.particle_capacity} particles need about {needed / 1e9:.3g} GB on the GPU, {statement}"
    count = float(f"{plan.particle_capacity * WARNED_SHARE * available / needed:.2g}")
    remedy = " or set run.precision to mixed" if plan.precision == "f64" else ""
    raise SceneError(f"{_location(plan)}: {sizes}: lower the count to about {count:.0f}{remedy}.")


def fits(plan: Plan) -> bool:
    """True if a run fits or the available memory is unknown."""
    available = available_memory()
    return available is None or required_memory(plan) <= available


def _location(plan: Plan) -> str:
    """File and line of the count of the largest group."""
    return max(plan.groups, key=lambda group: group.sphere_count).source


def _remedies(plan: Plan, needed: int, available: int) -> str:
    """Remedies: fewer particles, lower precision, more memory.

    `needed`, `available` [bytes]; the suggested number of particles fills WARNED_SHARE of the available memory.
    """
    fitting_count = int(WARNED_SHARE * max(available - RUNTIME, 0) / ((needed - RUNTIME) / plan.particle_capacity))
    precision_remedy = ", set run.precision to mixed" if plan.precision == "f64" else ""
    count_remedy = f"lower the count to about {float(f'{fitting_count:.2g}'):.0f}" if fitting_count else "free memory"
    return f"{count_remedy}{precision_remedy}, or use a machine with more memory"
