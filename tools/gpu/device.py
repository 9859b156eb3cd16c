"""The device: what it is, what it holds, how fast it moves memory."""

import os
import subprocess
from pathlib import Path
from typing import Any

ARRAY_LENGTH = 1 << 27
"""Numbers (f32) in each of three arrays on a GPU: 512 MiB, far above its caches."""


def present(arch: str) -> dict[str, Any]:
    """Job of a child: start the architecture and describe it; a GranflowError's sentence where it is not there."""
    from granflow.device.backend import start
    from granflow.errors import GranflowError

    try:
        start(arch, "f32")  # type: ignore[arg-type]
    except GranflowError as error:
        return {"absent": str(error)}
    return describe(arch)


def describe(arch: str) -> dict[str, Any]:
    """Name, driver, and bytes of memory in all and free; None where the system does not tell."""
    unknown: dict[str, Any] = {"name": None, "driver": None, "memory_total": None, "memory_free": None}
    return unknown | (_host_memory() if arch == "cpu" else _ask_driver())


def _host_memory() -> dict[str, Any]:
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return {"name": "host"}
    held = {line.split(":")[0]: 1024 * int(line.split()[1]) for line in lines}
    return {"name": "host", "memory_total": held["MemTotal"], "memory_free": held["MemAvailable"]}


def _ask_driver() -> dict[str, Any]:
    requested = "--query-gpu=name,driver_version,memory.total,memory.free"
    try:
        done = subprocess.run(
            ["nvidia-smi", requested, "--format=csv,noheader,nounits"], capture_output=True, text=True, timeout=60
        )
        name, driver, total, free = (word.strip() for word in done.stdout.splitlines()[0].split(","))
        mebi = 1 << 20
        return {"name": name, "driver": driver, "memory_total": mebi * int(total), "memory_free": mebi * int(free)}
    except (OSError, IndexError, ValueError, subprocess.TimeoutExpired):
        return {}


def bandwidth(on_cpu: bool) -> dict[str, float]:
    """Bytes/s of a copy (two accesses an element) and a triad (three), as STREAM counts them, the best of several."""
    from benchmark import limits  # it imports Taichi, whose banner granflow has to switch off first

    if on_cpu:
        found = limits.bandwidth("memory", limits.IN_MEMORY, os.cpu_count() or 1)
        return {"copy": found["copy_memory"], "triad": found["triad_memory"]}
    return _gpu_bandwidth(ARRAY_LENGTH)


def _gpu_bandwidth(count: int) -> dict[str, float]:
    """The same where neighboring threads take neighboring numbers."""
    import taichi as ti
    from benchmark import limits

    builder = ti.FieldsBuilder()
    a, b, c = (ti.field(ti.f32) for _ in range(3))
    for field in (a, b, c):
        builder.dense(ti.i, count).place(field)
    tree = builder.finalize()

    @ti.kernel
    def copy(scale: ti.f32):  # noqa: ANN202
        for i in range(count):
            a[i] = b[i]

    @ti.kernel
    def triad(scale: ti.f32):  # noqa: ANN202
        for i in range(count):
            a[i] = b[i] + scale * c[i]

    found = {"copy": 8.0 * count / limits.fastest(copy, 0.5), "triad": 12.0 * count / limits.fastest(triad, 0.5)}
    tree.destroy()
    return found
