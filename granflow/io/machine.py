"""Memory and cores available to this process: those of the machine, limited by control groups, affinity and
Slurm."""

import os
import re
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import suppress
from math import ceil
from numbers import Integral
from pathlib import Path

from granflow.errors import GranflowError

ROOT = Path("/")
"""Root of the file system; tests replace it."""

# Memory

MEMORY_FILES = (
    ("memory.max", "memory.current", "inactive_file"),
    ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
)
"""Files of control groups, versions 2 and 1: limit and usage [bytes]; key of the cached files in
memory.stat."""


def available_memory() -> int | None:
    """Memory [bytes] available without swapping, limited by control groups (psutil does not know these).

    None if nothing can be read.
    """
    known = list(_memory_of_groups())
    with suppress(OSError):
        known.append(_memory_of_machine())
    return min(known, default=None)


def _memory_of_machine() -> int:
    """Available memory [bytes]; on Linux without psutil, whose import takes longer than `granflow --help`."""
    available = re.search(r"^MemAvailable:\s*(\d+) kB$", _text(ROOT / "proc/meminfo"), re.MULTILINE)
    if available:
        return int(available[1]) * 1024
    import psutil

    return psutil.virtual_memory().available


def _memory_of_groups() -> Iterator[int]:
    """Limit minus usage [bytes] of each control group with a limit; cached files count as free."""
    for folder in _group_folders("memory"):
        for limit, usage, cached in MEMORY_FILES:
            with suppress(OSError, ValueError):  # another version, or no limit ("max")
                limit_bytes = int((folder / limit).read_text())
                used = int((folder / usage).read_text())
                pages = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
                yield max(limit_bytes - used + int(pages.get(cached, 0)), 0)


def free_gpu_memory() -> int | None:
    """Free memory [bytes] of the NVIDIA GPU that CUDA uses; None if it is unknown.

    The GPU is the first in CUDA_VISIBLE_DEVICES, or the first. The source is nvidia-smi, which is part of the
    driver.
    """
    device = os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",")[0] or "0"
    command = ["nvidia-smi", f"--id={device}", "--query-gpu=memory.free", "--format=csv,noheader,nounits"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=30)
        return int(done.stdout.split()[0]) << 20  # in MiB
    except (OSError, ValueError, IndexError, subprocess.TimeoutExpired):
        return None


# Cores

SLURM = "SLURM_CPUS_PER_TASK"
"""Environment variable with the number of cores of a Slurm task."""


def worker_count(
    requested: int | None, affinity: int | None = None, quota: int | None = None
) -> tuple[int, str]:
    """Number of CPU threads to start, and a warning or an empty text.

    requested:        number from the command line; None: all available cores
    affinity, quota:  cores, in place of those of the operating system
    Returns:          at most `affinity`; without a request also at most the quota
    Raises:           GranflowError for less than one thread, with which Taichi ends the process, or no whole
                      number

    Taichi starts at most one thread per core of the machine, and surplus threads only delay each other.
    """
    if requested is not None and not (isinstance(requested, Integral) and requested >= 1):
        raise GranflowError(
            f"threads is {requested!r}; give a whole number of at least 1, or None for all available cores."
        )
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


def quota_cores(environment: Mapping[str, str] = os.environ) -> int | None:
    """Cores by the smallest of the CPU quotas and SLURM_CPUS_PER_TASK, rounded up; None without a limit."""
    limits = [ceil(limit) for limit in _quotas_of_groups()]
    slurm = environment.get(SLURM, "")
    if slurm.isdecimal() and int(slurm) > 0:
        limits.append(int(slurm))
    return min(limits, default=None)


def _quotas_of_groups() -> Iterator[float]:
    """Quota over period [cores] of each control group, of version 2 (cpu.max) or 1."""
    for folder in _group_folders("cpu"):
        words = _text(folder / "cpu.max").split()
        if not words:
            words = [
                *_text(folder / "cpu.cfs_quota_us").split(),
                *_text(folder / "cpu.cfs_period_us").split(),
            ]
        if len(words) == 2 and all(word.isdecimal() and int(word) > 0 for word in words):
            yield int(words[0]) / int(words[1])


# Control groups


def _group_folders(controller: str) -> Iterator[Path]:
    """Folders of the control groups of this process and of their parents; in a container possibly only the
    last exists.

    Version 2 has one tree; version 1 one for each controller, or for several, such as "cpu,cpuacct".
    """
    for line in _text(ROOT / "proc/self/cgroup").splitlines():
        _, controllers, path = [*line.split(":", 2), "", ""][:3]
        if controllers and controller not in controllers.split(","):
            continue
        parts = [part for part in path.split("/") if part not in ("", "..")]
        for mount in {controller, controllers} if controllers else {""}:
            for count in range(len(parts), -1, -1):
                yield (ROOT / "sys/fs/cgroup" / mount).joinpath(*parts[:count])


def _text(path: Path) -> str:
    """Content of a text file; empty if it cannot be read."""
    with suppress(OSError):
        return path.read_text()
    return ""
