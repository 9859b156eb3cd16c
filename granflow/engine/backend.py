"""Starts Taichi with architecture, precision and threads, once per process. No other module does."""

import atexit
import logging
import shutil
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any, Literal

import taichi as ti
from taichi.lang import kernel_impl
from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext

from granflow.engine.compilation import guarded
from granflow.engine.kernel_cache import TEMPORARY, usable_folder
from granflow.engine.kernel_source import source_lines
from granflow.errors import GranflowError
from granflow.io.machine import worker_count

Arch = Literal["cpu", "cuda", "vulkan", "metal", "gpu"]
"""Requested architecture; with "gpu" Taichi selects an available GPU architecture."""
Precision = Literal["f64", "f32", "mixed"]
"""Floating-point types: f64, f32, or mixed (positions float64, forces and velocities float32)."""


@dataclass(frozen=True)
class Backend:
    """The settings that Taichi runs with.

    arch:           architecture in use, never "gpu"
    precision:      requested precision
    threads:        requested CPU threads; None: all available
    real:           Taichi type of forces and velocities
    position_real:  Taichi type of positions
    worker_count:   CPU threads that take part in a loop
    """

    arch: str
    precision: Precision
    threads: int | None
    real: Any
    position_real: Any
    worker_count: int

    @property
    def on_cpu(self) -> bool:
        """True if kernels run on the cores of the host."""
        return self.arch == "cpu"


_started: Backend | None = None


def start(arch: Arch = "cpu", precision: Precision = "f64", threads: int | None = None) -> Backend:
    """Start Taichi, or return the running backend if its settings are the same.

    threads:  CPU threads; None: as many as this process may use
    Raises:   GranflowError if the architecture is absent or lacks float64, or if this process has started Taichi with
              other settings (a second start would invalidate every field)
    """
    global _started
    if _started is not None:
        _check_unchanged(_started, arch, precision, threads)
        return _started
    taichi_arch = getattr(ti, arch)
    ti.set_logging_level(ti.ERROR)  # Taichi would warn about each device that is absent
    if not _available(arch):
        raise GranflowError(
            f"This machine has no {arch} device that Taichi can use. Leave out --arch to run on the CPU."
        )
    real = ti.f64 if precision == "f64" else ti.f32
    position_real = ti.f32 if precision == "f32" else ti.f64
    workers, warning = worker_count(threads)
    if warning:
        logging.getLogger("granflow").warning("granflow: warning: %s", warning)
    folder = usable_folder()
    if folder.name.startswith(TEMPORARY):
        atexit.register(_stop_and_remove, folder)
    ASTTransformerContext.get_pos_info = _position_in_source
    kernel_impl.getsourcelines = source_lines
    ti._lib.core.Program.compile_kernel = guarded(ti._lib.core.Program.compile_kernel)
    _init(
        arch=taichi_arch,
        default_fp=real,
        fast_math=False,  # with it, F_ij and -F_ji differ in the last bit
        cfg_optimization=False,  # LLVM repeats these passes: the same rate, a third of the compile time
        log_level=ti.ERROR,
        cpu_max_num_threads=workers,
        offline_cache_file_path=str(folder),
    )
    name = _arch_name(arch)
    if position_real == ti.f64 and name in ("metal", "vulkan"):
        raise GranflowError(f"{name} has no reliable float64. Run with --precision f32 there, or on cpu or cuda.")
    _started = Backend(name, precision, threads, real, position_real, workers)
    return _started


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


def _init(**options: Any) -> None:
    """Start Taichi without its messages. Raises GranflowError if it cannot allocate memory."""
    with redirect_stdout(StringIO()):  # Taichi prints its version
        try:
            ti.init(**options)
        except RuntimeError as error:
            reason = str(error).rpartition("] ")[2].rstrip(". ")
            raise GranflowError(f"Taichi cannot start: {reason}. Raise the memory limit of the process.") from None


def _available(arch: Arch) -> bool:
    """Whether this build of Taichi supports the architecture on this machine."""
    if arch == "cpu":
        return True
    if arch == "gpu":
        return any(_available(kind) for kind in ("cuda", "vulkan", "metal"))
    return bool(ti._lib.core.__dict__[f"with_{arch}"]())


def _arch_name(requested: Arch) -> str:
    """Name of the architecture in use. Taichi falls back to the CPU without an exception."""
    running = ti.lang.impl.current_cfg().arch
    for name in ("cuda", "vulkan", "metal"):
        if running == getattr(ti, name):
            return name
    if requested != "cpu":
        raise GranflowError(
            f"Taichi could not start {requested} here and fell back to the CPU. Leave out --arch to accept that."
        )
    return "cpu"


def _check_unchanged(running: Backend, arch: Arch, precision: Precision, threads: int | None) -> None:
    """Raise GranflowError if the requested settings differ from the running ones."""
    same_arch = arch == running.arch or (arch == "gpu" and not running.on_cpu)
    if same_arch and precision == running.precision and threads in (None, running.threads):
        return
    raise GranflowError(
        f"Taichi already runs in this process on {running.arch} with {running.precision}; "
        f"start {arch} with {precision} in a separate process."
    )
