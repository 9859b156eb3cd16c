"""The device: name, driver, memory and memory bandwidth."""

import os
import subprocess
from pathlib import Path
from typing import Any

ARRAY_LENGTH = 1 << 27
"""Length of each of three f32 arrays on a GPU: 512 MiB, much larger than its caches."""


def present(arch: str) -> dict[str, Any]:
    """Job of a subprocess: starts the architecture and describes it; an error message if it is not
    available."""
    from granflow.engine.backend import start
    from granflow.errors import GranflowError

    try:
        start(arch, "f32")  # type: ignore[arg-type]
    except GranflowError as error:
        return {"absent": str(error)}
    return describe(arch)


def describe(arch: str) -> dict[str, Any]:
    """Name, driver, total and free memory, largest buffer [bytes]; None if unknown or unlimited."""
    names = ("name", "driver", "memory_total", "memory_free", "largest_buffer")
    queries = {"cpu": _host_memory, "cuda": _query_driver, "vulkan": _query_vulkan}
    return dict.fromkeys(names) | queries[arch]()


def _host_memory() -> dict[str, Any]:
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return {"name": "host"}
    memory = {line.split(":")[0]: 1024 * int(line.split()[1]) for line in lines}
    return {"name": "host", "memory_total": memory["MemTotal"], "memory_free": memory["MemAvailable"]}


def _query_vulkan() -> dict[str, Any]:
    from granflow.engine.backend import used_device, vulkan_devices

    device = used_device(vulkan_devices())
    if device is None:
        return {}
    memory = {
        "memory_free": device.free,
        "largest_buffer": device.largest_buffer,
    }
    return {"name": device.name, "driver": device.driver, **memory}


def _query_driver() -> dict[str, Any]:
    requested = "--query-gpu=name,driver_version,memory.total,memory.free"
    try:
        done = subprocess.run(
            ["nvidia-smi", requested, "--format=csv,noheader,nounits"],
            capture_output=True,
            text=True,
            timeout=60,
        )
        name, driver, total, free = (word.strip() for word in done.stdout.splitlines()[0].split(","))
        mebi = 1 << 20
        return {
            "name": name,
            "driver": driver,
            "memory_total": mebi * int(total),
            "memory_free": mebi * int(free),
        }
    except (OSError, IndexError, ValueError, subprocess.TimeoutExpired):
        return {}


def bandwidth(on_cpu: bool) -> dict[str, float]:
    """Bandwidth [bytes/s] of copy (two accesses per element) and triad (three), as in STREAM; best of
    several."""
    from benchmark import limits  # imports Taichi, whose banner granflow must disable first

    if on_cpu:
        found = limits.bandwidth("memory", limits.IN_MEMORY, os.cpu_count() or 1)
        return {"copy": found["copy_memory"], "triad": found["triad_memory"]}
    return _gpu_bandwidth(ARRAY_LENGTH)


def _gpu_bandwidth(count: int) -> dict[str, float]:
    """Bandwidth with coalesced access: neighboring threads access neighboring elements; `count` is a power of
    2."""
    from benchmark import limits

    from granflow.engine.fields import thread_count
    from granflow.kernel_language import ti

    threads = thread_count(count)
    builder = ti.FieldsBuilder()
    a, b, c = (ti.field(ti.f32) for _ in range(3))
    for field in (a, b, c):
        builder.dense(ti.i, count).place(field)
    tree = builder.finalize()

    @ti.kernel
    def copy(scale: ti.f32):  # noqa: ANN202
        for i in range(threads):
            for k in range(count // threads):
                a[k * threads + i] = b[k * threads + i]

    @ti.kernel
    def triad(scale: ti.f32):  # noqa: ANN202
        for i in range(threads):
            for k in range(count // threads):
                a[k * threads + i] = b[k * threads + i] + scale * c[k * threads + i]

    found = {
        "copy": 8.0 * count / limits.fastest(copy, 0.5),
        "triad": 12.0 * count / limits.fastest(triad, 0.5),
    }
    tree.destroy()
    return found
