"""Whether the machine has the memory that a run needs, before any of it is taken."""

import os
from collections.abc import Iterator
from pathlib import Path

from granflow.errors import SceneError
from granflow.plan.memory_estimate import estimate_memory
from granflow.plan.plan import Plan

RUNTIME = 100_000_000
"""Bytes that compiling takes, whatever the scene."""

HOST_PER_PARTICLE = 600
"""Bytes on the host for each particle when a frame is written (measured: 510); placing takes less than a run does."""

MAX_LIST_ENTRIES = 2**31 - 1
"""Contact slots are numbered with 32 bits."""

WARNED_SHARE = 0.8
"""Share of the free memory from which on a run is warned of: rows of near partners may grow, others may want some."""

PROC, CGROUPS = Path("/proc"), Path("/sys/fs/cgroup")


def required_memory(plan: Plan) -> int:
    """Bytes that a run takes at its height on a CPU, first guess of contacts included."""
    host = HOST_PER_PARTICLE * plan.particle_capacity
    return estimate_memory(plan, plan.scene.run.precision).total + host + RUNTIME


def available_memory() -> int | None:
    """Bytes that this process can still get: what the machine has free and what its control groups leave it.

    None where neither can be read; without /proc, all that the machine has.
    """
    known = [*_machine(), *_control_groups()]
    return min(known) if known else None


def memory_warning(plan: Plan) -> str | None:
    """A sentence if a run will not fit, or only just; None if it fits or nothing is known."""
    needed, available = required_memory(plan), available_memory()
    if available is None or needed <= WARNED_SHARE * available:
        return None
    count = plan.particle_capacity
    verdict = "there are only" if needed > available else "that leaves little of the"
    sizes = (
        f"{count} particles need about {needed / 1e9:.3g} GB of memory, and "
        f"{verdict} {available / 1e9:.3g} GB free here"
    )
    return f"{sizes}: {_remedies(plan, needed, available)}."


def refuse_too_many(plan: Plan) -> None:
    """Raise SceneError for more particles than can be numbered."""
    list_entries = plan.chunk_capacity * plan.list_capacity_per_chunk
    if list_entries > MAX_LIST_ENTRIES:
        max_count = float(f"{plan.particle_capacity * (MAX_LIST_ENTRIES / list_entries):.2g}")
        request = f"{plan.particle_capacity} particles are asked for, but about {max_count:.0f} are the most"
        raise SceneError(f"{_location(plan)}: {request} whose contacts can be numbered. Lower the count.")


def refuse_without_memory(plan: Plan) -> None:
    """Raise SceneError if a run on a CPU will not fit into the memory that is free."""
    if not fits(plan):
        raise SceneError(f"{_location(plan)}: {memory_warning(plan)}")


def fits(plan: Plan) -> bool:
    """Whether a run fits, as far as is known."""
    available = available_memory()
    return available is None or required_memory(plan) <= available


def _location(plan: Plan) -> str:
    """Where the count of the largest group stands."""
    groups = plan.scene.particles
    return plan.scene.locate("particles", max(groups, key=lambda name: groups[name].count), "count")


def _remedies(plan: Plan, needed: int, available: int) -> str:
    """What to do: fewer particles, narrower numbers, another machine."""
    fitting_count = int(WARNED_SHARE * max(available - RUNTIME, 0) / ((needed - RUNTIME) / plan.particle_capacity))
    precision_remedy = ", set run.precision to mixed" if plan.scene.run.precision == "f64" else ""
    count_remedy = f"lower the count to about {float(f'{fitting_count:.2g}'):.0f}" if fitting_count else "free some"
    return f"{count_remedy}{precision_remedy}, or use a machine with more"


def _machine() -> Iterator[int]:
    """Memory that programs can get without swapping, or all there is."""
    try:
        lines = (PROC / "meminfo").read_text().splitlines()
        yield from (1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))
    except OSError:
        if "SC_PHYS_PAGES" in getattr(os, "sysconf_names", {}):
            yield os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _control_groups() -> Iterator[int]:
    """What is left in each of the control groups around this process, of either version."""
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
    """Limit less usage of a group and of those around it; files kept in memory count as free."""
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
