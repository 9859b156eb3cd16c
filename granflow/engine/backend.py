"""Starts and restarts Taichi with architecture, precision and threads. No other module does."""

import atexit
import ctypes
import logging
import os
import re
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass, field
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any, Literal
from weakref import WeakSet

from granflow.engine.compilation import guarded, in_context
from granflow.errors import GranflowError
from granflow.io.machine import free_gpu_memory, worker_count
from granflow.kernel_language import KERNELS, VARIABLE, ti
from granflow.kernel_language import KERNELS as LANGUAGE

# Fields and arrays that a user's program has made with Taichi: a restart of Taichi would destroy them.

_own: "WeakSet[Any]" = WeakSet()
_found = False


def new_builder() -> Any:
    """A builder of fields of granflow."""
    builder = ti.FieldsBuilder()
    _own.add(builder)
    return builder


def found() -> bool:
    """Whether the program has allocated fields or arrays since the first start, or declared fields."""
    return _found or not ti.root.empty


def watch() -> None:
    """Notice fields and arrays that are allocated from now on; once per process."""
    builder = ti.FieldsBuilder
    program = ti._lib.core.Program
    builder._finalize = _watched_builder(builder._finalize)
    program.create_ndarray = _watched(program.create_ndarray)


def _watched_builder(finalize: Any) -> Any:
    def finalize_builder(builder: Any, *arguments: Any, **options: Any) -> Any:
        global _found
        _found |= builder not in _own and not builder.empty
        return finalize(builder, *arguments, **options)

    return finalize_builder


def _watched(create: Any) -> Any:
    def create_array(*arguments: Any, **options: Any) -> Any:
        global _found
        _found = True
        return create(*arguments, **options)

    return create_array


# The folder that keeps compiled kernels between runs, for fast later starts. File operations only, no
# Taichi.

CACHE_VARIABLE = "GRANFLOW_CACHE"
"""Environment variable with the path of the folder."""
PATTERNS = {"taichi": "*.tic", "quadrants": "kernel_compilation_manager/*.qdc"}
"""Pattern of the paths of compiled kernels in the folder, by kernel language."""
CACHED_KERNELS = PATTERNS[LANGUAGE]
"""Pattern of the kernel language in use."""
INDEXES = {"taichi": "ticache.tcb", "quadrants": "kernel_compilation_manager/qdcache.qdb"}
LOCKS = {"taichi": "ticache.lock", "quadrants": "kernel_compilation_manager/qdcache.lock"}
"""Paths of the index and of the lock of the cache in the folder, by kernel language."""
TEMPORARY = "granflow_kernels_"
"""Prefix of a temporary folder for one process, deleted at its end."""
STALE_LOCK = 60.0
"""Age [s] of an abandoned lock. Taichi holds its lock briefly; the lock of a killed process would disable the
cache."""


@dataclass(frozen=True)
class CacheContents:
    """Contents of the cache folder: number of kernels, and size [bytes] of all files."""

    kernel_count: int
    size: int


def cache_folder() -> Path:
    """The folder in GRANFLOW_CACHE as an absolute path, or granflow/kernels in the cache folder of the
    platform."""
    named = os.environ.get(CACHE_VARIABLE)
    if named:
        return Path(named).expanduser().absolute()
    from platformdirs import user_cache_path

    return user_cache_path("granflow", appauthor=False, opinion=False) / "kernels"


def usable_folder() -> Path:
    """The cache folder, created if necessary. If it is not writable: a warning, and a temporary folder.

    The caller deletes a temporary folder, whose name begins with TEMPORARY. A lock older than STALE_LOCK is
    removed.

    Taichi without any cache folder crashes at the end of a process that has compiled many kernels (SIGSEGV).
    """
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK)
    except OSError:
        writable = False
    if not writable:
        logging.getLogger("granflow").warning(
            "granflow: %s cannot be written, so kernels are compiled again in every run. Set %s to another "
            "folder.",
            folder,
            CACHE_VARIABLE,
        )
        return Path(tempfile.mkdtemp(prefix=TEMPORARY))
    with suppress(OSError):
        lock = folder / LOCKS[LANGUAGE]
        if time.time() - lock.stat().st_mtime > STALE_LOCK:
            lock.unlink()
    return folder


def cache_contents() -> CacheContents:
    """Number of kernels and size of the folder; zeros without a folder."""
    files = _files()
    return CacheContents(
        sum(any(map(path.match, PATTERNS.values())) for path in files), sum(map(_size, files))
    )


def clear_cache() -> CacheContents:
    """Delete the files of both kernel languages in the folder and no others; returns their number and
    size."""
    removed = cache_contents()
    for path in _files():
        path.unlink(missing_ok=True)
    return removed


def _files() -> list[Path]:
    """Files of both kernel languages in the cache folder."""
    folder = cache_folder()
    kernels = [path for pattern in PATTERNS.values() for path in folder.glob(pattern)]
    others = [folder / name for name in (*INDEXES.values(), *LOCKS.values())]
    return [*kernels, *(path for path in others if path.exists())]


def _size(path: Path) -> int:
    """Size of a file [bytes]; 0 if it does not exist."""
    try:
        return path.stat().st_size
    except FileNotFoundError:  # another process has deleted it
        return 0


# Vulkan devices and drivers of this machine, read through the Vulkan loader.

MESA_MINIMUM = (25, 0)
"""First version of Mesa with a correct llvmpipe; 22.3 skips statements after an inner loop with two
atomics."""
CPU_TYPE = 4
"""VkPhysicalDeviceType of a device that is a CPU."""
API_VERSION = 1 << 22 | 1 << 12
"""Vulkan 1.1, as VK_MAKE_API_VERSION."""
FEATURE_COUNT, FLOAT64, INT64 = 55, 39, 40
"""Number of entries of VkPhysicalDeviceFeatures, and indices of shaderFloat64 and shaderInt64."""
INSTANCE_INFO, PROPERTIES_2, MEMORY_2, LIMITS, DRIVER_PROPERTIES, BUDGET = (
    1,
    1000059001,
    1000059006,
    1000168000,
    1000196000,
    1000237000,
)
"""VkStructureType of the structures."""
MEMORY_TYPES, MEMORY_HEAPS, DEVICE_LOCAL = 32, 16, 1
"""Lengths of the arrays of VkPhysicalDeviceMemoryProperties, and flag of a heap in the memory of the
device."""
ADDRESSED = 2**32
"""Largest buffer [bytes]: kernels address the fields of a run, which are in one buffer, with 32 bits."""


class _ApplicationInfo(ctypes.Structure):
    """VkApplicationInfo."""

    _fields_ = (
        ("kind", ctypes.c_int32),
        ("next", ctypes.c_void_p),
        ("name", ctypes.c_char_p),
        ("version", ctypes.c_uint32),
        ("engine", ctypes.c_char_p),
        ("engine_version", ctypes.c_uint32),
        ("api", ctypes.c_uint32),
    )


class _InstanceInfo(ctypes.Structure):
    """VkInstanceCreateInfo."""

    _fields_ = (
        ("kind", ctypes.c_int32),
        ("next", ctypes.c_void_p),
        ("flags", ctypes.c_uint32),
        ("application", ctypes.POINTER(_ApplicationInfo)),
        ("layer_count", ctypes.c_uint32),
        ("layers", ctypes.c_void_p),
        ("extension_count", ctypes.c_uint32),
        ("extensions", ctypes.c_void_p),
    )


class _Driver(ctypes.Structure):
    """VkPhysicalDeviceDriverProperties."""

    _fields_ = (
        ("kind", ctypes.c_int32),
        ("next", ctypes.c_void_p),
        ("id", ctypes.c_int32),
        ("name", ctypes.c_char * 256),
        ("info", ctypes.c_char * 256),
        ("conformance", ctypes.c_uint8 * 4),
    )


class _Properties(ctypes.Structure):
    """VkPhysicalDeviceProperties2; `rest` is longer than the remaining members."""

    _fields_ = (
        ("kind", ctypes.c_int32),
        ("next", ctypes.c_void_p),
        *((name, ctypes.c_uint32) for name in ("api", "driver_version", "vendor", "device", "type")),
        ("name", ctypes.c_char * 256),
        ("rest", ctypes.c_char * 4096),
    )


class _Limits(ctypes.Structure):
    """VkPhysicalDeviceMaintenance3Properties."""

    _fields_ = (
        ("kind", ctypes.c_int32),
        ("next", ctypes.c_void_p),
        ("descriptors", ctypes.c_uint32),
        ("allocation", ctypes.c_uint64),
    )


class _Heap(ctypes.Structure):
    """VkMemoryHeap."""

    _fields_ = (("size", ctypes.c_uint64), ("flags", ctypes.c_uint32))


class _Memory(ctypes.Structure):
    """VkPhysicalDeviceMemoryProperties2."""

    _fields_ = (
        ("kind", ctypes.c_int32),
        ("next", ctypes.c_void_p),
        ("type_count", ctypes.c_uint32),
        ("types", ctypes.c_uint32 * (2 * MEMORY_TYPES)),
        ("heap_count", ctypes.c_uint32),
        ("heaps", _Heap * MEMORY_HEAPS),
    )


class _Budget(ctypes.Structure):
    """VkPhysicalDeviceMemoryBudgetPropertiesEXT; zeros from a driver without the extension."""

    _fields_ = (
        ("kind", ctypes.c_int32),
        ("next", ctypes.c_void_p),
        ("budget", ctypes.c_uint64 * MEMORY_HEAPS),
        ("usage", ctypes.c_uint64 * MEMORY_HEAPS),
    )


@dataclass(frozen=True)
class VulkanDevice:
    """A Vulkan device.

    name:        as reported by the driver, as `llvmpipe (LLVM 15.0.6, 256 bits)`
    driver:      name and version of the driver, as `llvmpipe Mesa 25.0.7 (LLVM 15.0.6)`
    on_cpu:      the driver executes on the CPU
    has_64_bit:  f64 and i64 in kernels
    total, free: memory [bytes]; without VK_EXT_memory_budget all memory counts as free
    allocation:  largest allocation [bytes]
    """

    name: str
    driver: str
    on_cpu: bool
    has_64_bit: bool = True
    total: int = 0
    free: int = 0
    allocation: int = ADDRESSED

    @property
    def largest_buffer(self) -> int:
        """Largest buffer [bytes] for the fields of a run."""
        return min(self.allocation, ADDRESSED)

    @property
    def is_wrong(self) -> bool:
        """True for llvmpipe of a Mesa that returns wrong results without an error."""
        version = re.search(r"Mesa (\d+)\.(\d+)", self.driver)
        known = (int(version[1]), int(version[2])) if version else (0, 0)
        return self.name.startswith("llvmpipe") and known < MESA_MINIMUM


def vulkan_devices() -> list[VulkanDevice]:
    """All Vulkan devices in the order of the loader; empty without a loader or a driver."""
    loader = _loader()
    if loader is None:
        return []
    application = _ApplicationInfo(api=API_VERSION)
    info = _InstanceInfo(kind=INSTANCE_INFO, application=ctypes.pointer(application))
    instance = ctypes.c_void_p()
    if loader.vkCreateInstance(ctypes.byref(info), None, ctypes.byref(instance)):
        return []
    try:
        return [_device(loader, handle) for handle in _handles(loader, instance)]
    finally:
        loader.vkDestroyInstance(instance, None)


def used_device(devices: Sequence[VulkanDevice]) -> VulkanDevice | None:
    """The device that kernels run on: the first GPU, or the first device without a GPU; None without a
    device."""
    return min(devices, key=lambda device: device.on_cpu, default=None)


def _loader() -> Any:
    """The Vulkan loader; None if it is not installed or older than Vulkan 1.1."""
    names = {"win32": "vulkan-1.dll", "darwin": "libvulkan.dylib"}
    try:
        loader = ctypes.CDLL(names.get(sys.platform, "libvulkan.so.1"))
    except OSError:
        return None
    return loader if hasattr(loader, "vkGetPhysicalDeviceProperties2") else None


def _handles(loader: Any, instance: ctypes.c_void_p) -> list[ctypes.c_void_p]:
    """Handles of the physical devices."""
    count = ctypes.c_uint32()
    loader.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None)
    handles = (ctypes.c_void_p * count.value)()
    loader.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), handles)
    return [ctypes.c_void_p(handle) for handle in handles[: count.value]]


def _device(loader: Any, handle: ctypes.c_void_p) -> VulkanDevice:
    """Properties of one device."""
    limits = _Limits(kind=LIMITS)
    driver = _Driver(kind=DRIVER_PROPERTIES, next=ctypes.addressof(limits))
    found = _Properties(kind=PROPERTIES_2, next=ctypes.addressof(driver))
    loader.vkGetPhysicalDeviceProperties2(handle, ctypes.byref(found))
    features = (ctypes.c_uint32 * FEATURE_COUNT)()
    loader.vkGetPhysicalDeviceFeatures(handle, features)
    text = f"{driver.name.decode(errors='replace')} {driver.info.decode(errors='replace')}"
    has_64_bit, (total, free) = bool(features[FLOAT64] and features[INT64]), _memory(loader, handle)
    name = found.name.decode(errors="replace")
    on_cpu = found.type == CPU_TYPE
    return VulkanDevice(name, text, on_cpu, has_64_bit, total, free, int(limits.allocation) or ADDRESSED)


def _memory(loader: Any, handle: ctypes.c_void_p) -> tuple[int, int]:
    """Total and free memory [bytes] of the largest heap of a device."""
    budget = _Budget(kind=BUDGET)
    memory = _Memory(kind=MEMORY_2, next=ctypes.addressof(budget))
    loader.vkGetPhysicalDeviceMemoryProperties2(handle, ctypes.byref(memory))
    local = [k for k in range(memory.heap_count) if memory.heaps[k].flags & DEVICE_LOCAL]
    largest = max(local, key=lambda k: memory.heaps[k].size, default=0)
    total = int(memory.heaps[largest].size)
    free = int(budget.budget[largest]) - int(budget.usage[largest]) if budget.budget[largest] else total
    return total, max(free, 0)


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
        return {
            "position": self.position_real,
            "real": self.real,
            "f64": ti.f64,
            "i32": ti.i32,
            "i64": ti.i64,
        }

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
            f"This simulation belongs to the thread {owner.name}, which created it, and works in no other "
            f"one: create and use it in the thread {threading.current_thread().name}, or leave all calls to "
            f"{owner.name}. Other threads may call request_stop and read time, step_count and stage."
        )


def start(arch: Arch = "cpu", precision: Precision = "f64", threads: int | None = None) -> Backend:
    """Start Taichi, or return the running backend if its settings are the same.

        granflow.start("cpu", precision="mixed", threads=2)

    threads:  CPU threads; None: as many as this process may use
    Raises:   GranflowError if the architecture is absent or lacks float64, or if Taichi runs with other
              settings and `state_cache.restart` is not possible
    """
    global _started
    refuse_forked_process()
    if _started is not None:
        if _started.owner is not threading.current_thread():
            raise GranflowError(
                f"A simulation is in use in the thread {_started.owner.name}, and granflow runs in one "
                "thread of a process at a time: end it by simulation.free(), or start a process with "
                'multiprocessing.get_context("spawn").'
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
    """Stop Taichi, if it runs; all fields and compiled kernels are lost. `start` numbers new fields from 0
    again."""
    global _started
    if _started is not None:
        ti.reset()
        _started = None


def running() -> Backend | None:
    """The backend since the last `start`."""
    return _started


def is_used() -> bool:
    """Whether fields have been allocated since the start, so that new ones have other numbers than the
    first."""
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
    watch()
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

    The function of Taichi formats the source line of every node of every kernel, needed or not: 0.5 s per
    start.
    """
    number = node.lineno + context.lineno_offset
    line = f'File "{context.file}", line {number}, in {context.func.func.__name__}:\n'
    return line + context.src[node.lineno - 1] + "\n"


def _no_traceback(stacklevel: int = 1) -> str:
    """Replaces the function of Taichi that formats the call stack of each field: it reads some 60 source
    files."""
    return ""


def _init(workers: int, **options: Any) -> None:
    """Start Taichi with a pool of `workers` threads, without its messages.

    The number of threads is part of the key of compiled kernels, but only limits how many threads of the pool
    a loop uses. After the start of the pool it is therefore set to MOST_THREADS, so that all pools use the
    same kernels.

    Raises GranflowError if Taichi cannot allocate memory.
    """
    with redirect_stdout(StringIO()):  # Taichi prints its version
        try:
            ti.init(cpu_max_num_threads=workers, **options)
            ti.lang.impl.current_cfg().cpu_max_num_threads = MOST_THREADS
        except RuntimeError as error:
            reason = str(error).rpartition("] ")[2].rstrip(". ")
            raise GranflowError(
                f"Taichi cannot start: {reason}. Raise the memory limit of the process."
            ) from None


def _resolved(arch: Arch) -> str | None:
    """The architecture, or the first one that this machine supports for "gpu"; None without support for
    it."""
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
            f"{used.name} has no 64-bit numbers in Vulkan, but sums are in float64 and 64-bit integers in "
            "every precision, f32 too. Use another device, or leave out --arch to run on the CPU."
        )


def is_running_with(arch: Arch, precision: Precision, threads: int | None) -> bool:
    """Whether Taichi runs with these settings."""
    if _started is None:
        return False
    same_arch = arch == _started.arch or (arch == "gpu" and not _started.on_cpu)
    return same_arch and precision == _started.precision and threads in (None, _started.threads)


def _refusal(running: Backend, arch: Arch, precision: Precision, threads: int | None) -> GranflowError:
    """The error if Taichi runs with other settings."""
    before = _settings(running.arch, running.precision, running.threads)
    now = _settings(arch, precision, threads)
    if found():
        return GranflowError(
            f"Taichi runs in this process on {before}, and a restart would destroy the fields that your "
            f"program has made with Taichi; start {now} in a separate process."
        )
    return GranflowError(
        f"A simulation in this process uses {before}: end it by simulation.free() before one on {now}, or "
        "start that in a separate process."
    )


def _settings(arch: str, precision: Precision, threads: int | None) -> str:
    """Settings of a start in words."""
    return f"{arch} with {precision} and {'all' if threads is None else threads} threads"


# Free memory of the GPU that kernels run on.


def free_device_memory(arch: str) -> int | None:
    """Free memory [bytes] of the device of "cuda" or "vulkan"; None if it is unknown."""
    if arch == "cuda":
        return free_gpu_memory()
    device = used_device(vulkan_devices())
    return None if device is None else device.free
