"""Compares the memory that a run needs with the available memory, before any array is allocated."""

import os
from collections.abc import Iterator
from pathlib import Path

from granflow.errors import SceneError
from granflow.plan.memory_estimate import estimate_memory
from granflow.plan.plan import Plan

RUNTIME = 100_000_000
"""Memory [bytes] of the compiler, independent of the scene."""

HOST_PER_PARTICLE = 600
"""Host memory [bytes] per particle when a frame is written (measured: 510); insertion needs less."""

MAX_LIST_ENTRIES = 2**31 - 1
"""Neighbor-list entries have 32-bit indices."""

WARNED_SHARE = 0.8
"""Share of the available memory above which a warning appears: lists may grow, other processes need some."""

PROC, CGROUPS = Path("/proc"), Path("/sys/fs/cgroup")
"""Directories of the kernel with the memory of the machine and of control groups; tests replace them."""


def required_memory(plan: Plan) -> int:
    """Peak memory [bytes] of a run on a CPU, with the initial estimate of contacts.

    Sum of device fields, frames on the host (HOST_PER_PARTICLE) and compiler (RUNTIME).
    """
    host = HOST_PER_PARTICLE * plan.particle_capacity
    return estimate_memory(plan, plan.precision).total + host + RUNTIME


def available_memory() -> int | None:
    """Memory [bytes] available to this process: free memory of the machine, limited by its control groups.

    None if neither can be read; without /proc, the total memory of the machine.
    """
    known = [*_machine(), *_control_groups()]
    return min(known) if known else None


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
    list_entries = plan.chunk_capacity * plan.list_capacity_per_chunk
    if list_entries > MAX_LIST_ENTRIES:
        max_count = float(f"{plan.particle_capacity * (MAX_LIST_ENTRIES / list_entries):.2g}")
        request = f"{plan.particle_capacity} particles are requested, but about {max_count:.0f} is the maximum"
        raise SceneError(f"{_location(plan)}: {request} for 32-bit neighbor-list indices. Lower the count.")


def refuse_without_memory(plan: Plan) -> None:
    """Raise SceneError if a run on a CPU does not fit into the available memory; never if that is unknown."""
    if not fits(plan):
        raise SceneError(f"{_location(plan)}: {memory_warning(plan)}")


def fits(plan: Plan) -> bool:
    """True if a run fits or the available memory is unknown."""
    available = available_memory()
    return available is None or required_memory(plan) <= available


def _location(plan: Plan) -> str:
    """File and line of the count of the largest group."""
    return max(plan.groups, key=lambda group: group.count).source


def _remedies(plan: Plan, needed: int, available: int) -> str:
    """Remedies: fewer particles, lower precision, more memory.

    `needed`, `available` [bytes]; the suggested number of particles fills WARNED_SHARE of the available memory.
    """
    fitting_count = int(WARNED_SHARE * max(available - RUNTIME, 0) / ((needed - RUNTIME) / plan.particle_capacity))
    precision_remedy = ", set run.precision to mixed" if plan.precision == "f64" else ""
    count_remedy = f"lower the count to about {float(f'{fitting_count:.2g}'):.0f}" if fitting_count else "free memory"
    return f"{count_remedy}{precision_remedy}, or use a machine with more memory"


def _machine() -> Iterator[int]:
    """Memory [bytes] available without swapping, or the total memory."""
    try:
        lines = (PROC / "meminfo").read_text().splitlines()
        yield from (1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))
    except OSError:
        if "SC_PHYS_PAGES" in getattr(os, "sysconf_names", {}):
            yield os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _control_groups() -> Iterator[int]:
    """Remaining memory [bytes] of each control group of this process, version 1 or 2."""
    try:
        lines = (PROC / "self" / "cgroup").read_text().splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            yield from _available_in(CGROUPS, path, "memory.max", "memory.current", "inactive_file")
        elif "memory" in controllers.split(","):
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
            yield from _available_in(CGROUPS / "memory", path, *names)


def _available_in(root: Path, path: str, limit: str, usage: str, cached: str) -> Iterator[int]:
    """Limit minus usage [bytes] of a group and of its parents; cached files count as free.

    `root`: mount point of the controller; `path`: group; `limit`, `usage`: file names; `cached`: key in memory.stat.
    Groups without a limit are skipped.
    """
    group = root / path.strip("/")
    for folder in (group, *group.parents):
        try:
            limit_bytes, used = int((folder / limit).read_text()), int((folder / usage).read_text())
            pages = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
            yield max(limit_bytes - used + int(pages.get(cached, 0)), 0)
        except (OSError, ValueError):  # not a group, or one without a limit ("max")
            pass
        if folder == root:
            return
