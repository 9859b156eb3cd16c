"""Starts and restarts Taichi with architecture, precision and threads. No other module does."""

import atexit
import logging
import os
import shutil
import threading
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any, Literal

from granflow.engine import foreign_fields
from granflow.engine.compilation import guarded, in_context
from granflow.engine.kernel_cache import TEMPORARY, cache_folder, usable_folder
from granflow.engine.vulkan_devices import MESA_MINIMUM, VulkanDevice, used_device, vulkan_devices
from granflow.errors import GranflowError
from granflow.io.machine import worker_count
from granflow.kernel_language import KERNELS, VARIABLE, ti

Arch = Literal["cpu", "cuda", "vulkan", "gpu"]
"""Requested architecture; "gpu" is CUDA, or Vulkan where that is absent."""
Precision = Literal["f64", "f32", "mixed"]
"""Floating-point types: f64, f32, or mixed (positions float64, forces and velocities float32)."""


MOST_THREADS = 1024
"""Number of threads in the key of compiled kernels; larger than any pool."""


@dataclass(frozen=True, eq=False)
class Backend:
    """The settings that Taichi runs with; each start has its own object.

    arch:           architecture in use, never "gpu"
    precision:      requested precision
    threads:        requested CPU threads; None: all available
    real:           Taichi type of forces and velocities
    position_real:  Taichi type of positions
    worker_count:   CPU threads that take part in a loop
    process:        number of the process of the start
    owner:          Python thread of the start: Taichi allocates fields in no other one
    largest_buffer: bytes that fields of a GPU may have together in one tree; None: unlimited
    """

    arch: str
    precision: Precision
    threads: int | None
    real: Any
    position_real: Any
    worker_count: int
    largest_buffer: int | None = None
    process: int = field(default_factory=os.getpid)
    owner: threading.Thread = field(default_factory=threading.current_thread)

    @property
    def types(self) -> dict[str, Any]:
        """Taichi types by the names of `granflow.fields.DeviceType`."""
        return {"position": self.position_real, "real": self.real, "f64": ti.f64, "i32": ti.i32, "i64": ti.i64}

    @property
    def on_cpu(self) -> bool:
        """True if kernels run on the cores of the host."""
        return self.arch == "cpu"


_started: Backend | None = None


def refuse_forked_process() -> None:
    """Raise GranflowError in a process that was forked after the start: its first loop would wait forever."""
    if _started is not None and _started.process != os.getpid():
        raise GranflowError(
            "This process is a fork of one that has used granflow, without its threads: start processes with "
            'multiprocessing.get_context("spawn") instead of "fork".'
        )


def refuse_other_thread(owner: threading.Thread) -> None:
    """Raise GranflowError in another thread than that of the start, or in a forked process."""
    refuse_forked_process()
    if owner is not threading.current_thread():
        raise GranflowError(
            f"This simulation belongs to the thread {owner.name}, which created it, and works in no other one: create "
            f"and use it in the thread {threading.current_thread().name}, or leave all calls to {owner.name}. Other "
            "threads may call request_stop and read time, step_count and stage."
        )


def start(arch: Arch = "cpu", precision: Precision = "f64", threads: int | None = None) -> Backend:
    """Start Taichi, or return the running backend if its settings are the same.

        granflow.start("cpu", precision="mixed", threads=2)

    threads:  CPU threads; None: as many as this process may use
    Raises:   GranflowError if the architecture is absent or lacks float64, or if Taichi runs with other settings and
              `state_cache.restart` is not possible
    """
    global _started
    refuse_forked_process()
    if _started is not None:
        if _started.owner is not threading.current_thread():
            raise GranflowError(
                f"A simulation is in use in the thread {_started.owner.name}, and granflow runs in one thread of a "
                'process at a time: end it by simulation.free(), or start a process with multiprocessing.get_context("'
                'spawn").'
            )
        if is_running_with(arch, precision, threads):
            return _started
        raise _refusal(_started, arch, precision, threads)
    ti.set_logging_level(ti.ERROR)  # Taichi would warn about each device that is absent
    name = _resolved(arch)
    if name is None:
        raise GranflowError(
            f"This machine has no {arch} device that Taichi can use. Leave out --arch to run on the CPU."
        )
    largest_buffer = None
    if name == "vulkan":
        refuse_unreliable_vulkan(devices := vulkan_devices())
        device = used_device(devices)
        largest_buffer = None if device is None else device.largest_buffer
    real = ti.f64 if precision == "f64" else ti.f32
    position_real = ti.f32 if precision == "f32" else ti.f64
    workers, warning = worker_count(threads)
    if warning:
        logging.getLogger("granflow").warning("granflow: warning: %s", warning)
    _prepare_module()
    _init(
        workers,
        arch=getattr(ti, name),
        default_fp=real,
        fast_math=False,  # with it, F_ij and -F_ji differ in the last bit
        cfg_optimization=False,  # LLVM repeats these passes: the same rate, a third of the compile time
        log_level=ti.CRITICAL,  # errors also raise exceptions
        offline_cache_file_path=str(_folder(cache_folder())),
    )
    _check_started(name)
    _started = Backend(name, precision, threads, real, position_real, workers, largest_buffer)
    return _started


def stop() -> None:
    """Stop Taichi, if it runs; all fields and compiled kernels are lost. `start` numbers new fields from 0 again."""
    global _started
    if _started is not None:
        ti.reset()
        _started = None


def running() -> Backend | None:
    """The backend since the last `start`."""
    return _started


def is_used() -> bool:
    """Whether fields have been allocated since the start, so that new ones have other numbers than the first."""
    return bool(ti.lang.impl.get_runtime().prog.get_snode_tree_size())


@cache
def _folder(named: Path) -> Path:
    """The folder of compiled kernels; in place of an unusable one, one temporary folder per process."""
    folder = usable_folder()
    if folder.name.startswith(TEMPORARY):
        atexit.register(_stop_and_remove, folder)
    return folder


@cache
def _prepare_module() -> None:
    """Replace functions of the kernel language, once per process."""
    foreign_fields.watch()
    if KERNELS == "taichi":
        ti.lang.ast.ast_transformer_utils.ASTTransformerContext.get_pos_info = _position_in_source
        for module in (ti.lang.impl, ti.lang.matrix, ti.lang.snode):
            module.get_traceback = _no_traceback
    wrapped = guarded if KERNELS == "taichi" else in_context
    ti._lib.core.Program.compile_kernel = wrapped(ti._lib.core.Program.compile_kernel)


def _stop_and_remove(folder: Path) -> None:
    """Stop Taichi, which then writes its kernel cache, and delete the temporary folder."""
    ti.reset()
    shutil.rmtree(folder, ignore_errors=True)


def _position_in_source(context: Any, node: Any) -> str:
    """File and line of a syntax tree node for error messages; replaces the function of Taichi.

    The function of Taichi formats the source line of every node of every kernel, needed or not: 0.5 s per start.
    """
    line = f'File "{context.file}", line {node.lineno + context.lineno_offset}, in {context.func.func.__name__}:\n'
    return line + context.src[node.lineno - 1] + "\n"


def _no_traceback(stacklevel: int = 1) -> str:
    """Replaces the function of Taichi that formats the call stack of each field: it reads some 60 source files."""
    return ""


def _init(workers: int, **options: Any) -> None:
    """Start Taichi with a pool of `workers` threads, without its messages.

    The number of threads is part of the key of compiled kernels, but only limits how many threads of the pool a loop
    uses. After the start of the pool it is therefore set to MOST_THREADS, so that all pools use the same kernels.

    Raises GranflowError if Taichi cannot allocate memory.
    """
    with redirect_stdout(StringIO()):  # Taichi prints its version
        try:
            ti.init(cpu_max_num_threads=workers, **options)
            ti.lang.impl.current_cfg().cpu_max_num_threads = MOST_THREADS
        except RuntimeError as error:
            reason = str(error).rpartition("] ")[2].rstrip(". ")
            raise GranflowError(f"Taichi cannot start: {reason}. Raise the memory limit of the process.") from None


def _resolved(arch: Arch) -> str | None:
    """The architecture, or the first one that this machine supports for "gpu"; None without support for it."""
    for name in ("cuda", "vulkan") if arch == "gpu" else (arch,):
        if name == "cpu" or getattr(ti._lib.core, f"with_{name}")():
            return name
    return None


def _check_started(name: str) -> None:
    """Raise GranflowError if Taichi fell back to another architecture, which it does without an exception."""
    if ti.lang.impl.current_cfg().arch != getattr(ti, name):
        raise GranflowError(
            f"Taichi could not start {name} here and fell back to the CPU. Leave out --arch to accept that."
        )


def refuse_unreliable_vulkan(devices: Sequence[VulkanDevice]) -> None:
    """Raise GranflowError if results on Vulkan would be wrong, or a run would end early.

    devices:  all devices of this machine; kernels run on a GPU if there is one
    """
    if KERNELS == "taichi":
        raise GranflowError(
            "Taichi 1.7 overwrites fields on Vulkan and ends after some 12000 launches. Run pip install "
            f"'quadrants<1.4' and set {VARIABLE}=quadrants, or leave out --arch to run on the CPU."
        )
    used = used_device(devices)
    if used is not None and used.is_wrong:
        raise GranflowError(
            f"The Vulkan driver {used.driver} returns wrong results; llvmpipe is reliable from Mesa "
            f"{'.'.join(map(str, MESA_MINIMUM))} on. Update Mesa, or leave out --arch to run on the CPU."
        )
    if used is not None and not used.has_64_bit:
        raise GranflowError(
            f"{used.name} has no 64-bit numbers in Vulkan, but sums are in float64 and 64-bit integers in every "
            "precision, f32 too. Use another device, or leave out --arch to run on the CPU."
        )


def is_running_with(arch: Arch, precision: Precision, threads: int | None) -> bool:
    """Whether Taichi runs with these settings."""
    if _started is None:
        return False
    same_arch = arch == _started.arch or (arch == "gpu" and not _started.on_cpu)
    return same_arch and precision == _started.precision and threads in (None, _started.threads)


def _refusal(running: Backend, arch: Arch, precision: Precision, threads: int | None) -> GranflowError:
    """The error if Taichi runs with other settings."""
    before, now = _settings(running.arch, running.precision, running.threads), _settings(arch, precision, threads)
    if foreign_fields.found():
        return GranflowError(
            f"Taichi runs in this process on {before}, and a restart would destroy the fields that your program has "
            f"made with Taichi; start {now} in a separate process."
        )
    return GranflowError(
        f"A simulation in this process uses {before}: end it by simulation.free() before one on {now}, or start that "
        "in a separate process."
    )


def _settings(arch: str, precision: Precision, threads: int | None) -> str:
    """Settings of a start in words."""
    return f"{arch} with {precision} and {'all' if threads is None else threads} threads"
