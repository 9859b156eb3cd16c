"""Limits of this machine, measured with Taichi: memory bandwidth and scalar f64 arithmetic."""

import time
from collections.abc import Callable
from typing import Any

from granflow.kernel_language import ti

IN_CACHE, IN_MEMORY = 1 << 18, 1 << 24
"""Length of each of three f64 arrays: 6 MiB and 384 MiB in total."""
STRIDE = 512
"""Smallest number of loop iterations per CPU thread in Taichi; the first of each STRIDE iterations does the
work."""
LENGTH = 1 << 22
"""Operations in a chain; several chains overlap in the pipeline of the processor."""
CHAINS = 8
TRIES = 5


def measure(threads: int) -> dict[str, float]:
    """Bandwidth [bytes/s] of copy and triad, in cache and in memory, and time [s] of one operation on all
    threads."""
    ti.init(arch=ti.cpu, default_fp=ti.f64, fast_math=False, cpu_max_num_threads=threads, log_level=ti.ERROR)
    found: dict[str, float] = {"threads": threads}
    for where, length in (("cache", IN_CACHE), ("memory", IN_MEMORY)):
        found |= bandwidth(where, length, threads)
    operations = threads * CHAINS * LENGTH
    for name, kernel in arithmetic(threads).items():
        found[f"{name}_seconds"] = fastest(kernel, 1.0 + 1e-9) / operations
    return found


def bandwidth(where: str, length: int, threads: int) -> dict[str, float]:
    """Bandwidth as in STREAM: copy counts two accesses per element, triad three; each thread accesses one
    part."""
    a, b, c = (ti.field(ti.f64, length) for _ in range(3))
    part = length // threads
    passes = max(2 * IN_MEMORY // length, 1)

    @ti.kernel
    def copy(scale: ti.f64):  # noqa: ANN202
        for task in range(threads * STRIDE):
            if task % STRIDE == 0:
                first = task // STRIDE * part
                for _ in range(passes):
                    for i in range(first, first + part):
                        a[i] = b[i]

    @ti.kernel
    def triad(scale: ti.f64):  # noqa: ANN202
        for task in range(threads * STRIDE):
            if task % STRIDE == 0:
                first = task // STRIDE * part
                for _ in range(passes):
                    for i in range(first, first + part):
                        a[i] = b[i] + scale * c[i]

    for each in (a, b, c):
        each.fill(1.0)
    elements = part * threads * passes
    return {
        f"copy_{where}": 16.0 * elements / fastest(copy, 0.5),
        f"triad_{where}": 24.0 * elements / fastest(triad, 0.5),
    }


def fastest(kernel: Callable[[float], Any], argument: float) -> float:
    """Shortest time [s] of several launches, after one that compiles."""
    kernel(argument)
    ti.sync()
    found = []
    for _ in range(TRIES):
        began = time.perf_counter()
        kernel(argument)
        ti.sync()
        found.append(time.perf_counter() - began)
    return min(found)


def arithmetic(threads: int) -> dict[str, Callable[[float], Any]]:
    """Kernels of one operation each: a product and a sum, a square root, a quotient."""

    @ti.func
    def product_sum(y, x):  # noqa: ANN001, ANN202
        return y * x + 1e-9

    @ti.func
    def root(y, x):  # noqa: ANN001, ANN202
        return ti.sqrt(y)

    @ti.func
    def quotient(y, x):  # noqa: ANN001, ANN202
        return x / y

    return {each.__name__: chains(each, threads) for each in (product_sum, root, quotient)}


def chains(operation: Any, threads: int) -> Callable[[float], Any]:
    """A kernel in which each thread applies `operation` repeatedly to CHAINS numbers."""
    out = ti.field(ti.f64, threads)

    @ti.kernel
    def work(x: ti.f64):  # noqa: ANN202
        for task in range(threads * STRIDE):
            if task % STRIDE == 0:
                y = ti.Vector([x + 1.0 * k for k in ti.static(range(CHAINS))])
                for _ in range(LENGTH):
                    for k in ti.static(range(CHAINS)):
                        y[k] = operation(y[k], x)
                out[task // STRIDE] = y.sum()

    return work
