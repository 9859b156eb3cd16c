"""Number of cores available to this process: limited by affinity, cgroup quota and Slurm."""

import os
from collections.abc import Iterator, Mapping
from math import ceil
from pathlib import Path

SLURM = "SLURM_CPUS_PER_TASK"
"""Environment variable with the number of cores of a Slurm task."""


def worker_count(requested: int | None, affinity: int | None = None, quota: int | None = None) -> tuple[int, str]:
    """Number of CPU threads to start, and a warning or an empty text.

    requested:        number from the command line; None: all available cores
    affinity, quota:  cores, in place of those of the operating system
    Returns:          at most `affinity`; without a request also at most the quota

    Taichi starts at most one thread per core of the machine, and surplus threads only delay each other.
    """
    affinity = affinity or allowed_cores()
    if requested is None:
        return min(affinity, quota or quota_cores() or affinity), ""
    if requested <= affinity:
        return requested, ""
    cores = "1 core" if affinity == 1 else f"{affinity} cores"
    return affinity, f"--threads {requested}: this process can use {cores}, so granflow uses {affinity}."


def allowed_cores() -> int:
    """Cores on which the operating system schedules this process, at most the cores of the machine."""
    machine = os.cpu_count() or 1
    return min(len(os.sched_getaffinity(0)), machine) if hasattr(os, "sched_getaffinity") else machine


def quota_cores(root: Path = Path("/"), environment: Mapping[str, str] = os.environ) -> int | None:
    """Cores by the smallest of the cgroup quotas and SLURM_CPUS_PER_TASK, rounded up; None without a limit.

    root:         root of the file system
    environment:  environment variables
    """
    limits = [ceil(limit) for limit in _cgroup_limits(root)]
    slurm = environment.get(SLURM, "")
    if slurm.isdecimal() and int(slurm) > 0:
        limits.append(int(slurm))
    return min(limits, default=None)


def _cgroup_limits(root: Path) -> Iterator[float]:
    """Quota over period [cores] of each cgroup that contains this process, of version 2 (cpu.max) and version 1."""
    mount = root / "sys/fs/cgroup"
    for controllers, path in _cgroups(root / "proc/self/cgroup"):
        base = mount / controllers if controllers else mount
        for directory in _upward(base, path):
            words = _words(directory / "cpu.max")
            if not words:
                words = [*_words(directory / "cpu.cfs_quota_us"), *_words(directory / "cpu.cfs_period_us")]
            if len(words) == 2 and all(word.isdecimal() and int(word) > 0 for word in words):
                yield int(words[0]) / int(words[1])


def _cgroups(listing: Path) -> Iterator[tuple[str, str]]:
    """Controllers (empty in version 2) and path of the cgroups that can limit CPU time."""
    for line in _text(listing).splitlines():
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        if not controllers:
            yield "", path
        elif "cpu" in controllers.split(","):
            yield from ((name, path) for name in ("cpu", controllers))


def _upward(base: Path, path: str) -> Iterator[Path]:
    """Directories of a cgroup and of all its parents; in a container possibly only the last one exists."""
    parts = [part for part in path.split("/") if part not in ("", "..")]
    for count in range(len(parts), -1, -1):
        yield base.joinpath(*parts[:count])


def _words(path: Path) -> list[str]:
    """Words of a text file; empty if it cannot be read."""
    return _text(path).split()


def _text(path: Path) -> str:
    """Content of a text file; empty if it cannot be read."""
    try:
        return path.read_text()
    except OSError:
        return ""
