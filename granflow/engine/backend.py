"""Starts Taichi with architecture, precision and threads. No other module does.

`start` is for one set of settings per process and returns them as a `Backend`; `engine.state_cache.start`
also restarts Taichi with other settings if nothing is in use. The second section notices fields that the
user's program makes with Taichi. The third one reads which Vulkan devices exist, and refuses those whose
results would be wrong.
"""

import atexit
import ctypes
import logging
import os
import re
import shutil
import struct
import sys
import threading
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any, Literal
from weakref import WeakSet

from granflow.engine.kernel_cache import TEMPORARY, cache_folder, usable_folder
from granflow.errors import GranflowError
from granflow.io.machine import free_gpu_memory, worker_count
from granflow.kernel_language import KERNELS, ti
from granflow.taichi_patches import prepare_program

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
              settings and `engine.state_cache.start` is not possible
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


def optimize_kernels(wanted: bool) -> None:
    """Let the kernel language optimize, or not, the kernels that are compiled from now on; LLVM always
    does."""
    ti.lang.impl.current_cfg().advanced_optimization = wanted


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
    prepare_program(ti, KERNELS == "quadrants", _note_builder, _note_array)


def _stop_and_remove(folder: Path) -> None:
    """Stop Taichi, which then writes its kernel cache, and delete the temporary folder."""
    ti.reset()
    shutil.rmtree(folder, ignore_errors=True)


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
    if foreign_fields_exist():
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


# Fields and arrays that a user's program has made with Taichi: a restart of Taichi would destroy them.

_own: "WeakSet[Any]" = WeakSet()
"""Builders of the fields of granflow."""
_foreign_fields_allocated = False


def new_builder() -> Any:
    """A builder of fields of granflow."""
    builder = ti.FieldsBuilder()
    _own.add(builder)
    return builder


def foreign_fields_exist() -> bool:
    """Whether the program has allocated fields or arrays since the first start, or declared fields."""
    return _foreign_fields_allocated or not ti.root.empty


def _note_builder(builder: Any) -> None:
    global _foreign_fields_allocated
    _foreign_fields_allocated |= builder not in _own and not builder.empty


def _note_array() -> None:
    global _foreign_fields_allocated
    _foreign_fields_allocated = True


# Vulkan devices of this machine, read through the Vulkan loader. Taichi reports neither their drivers nor
# their memory.

MESA_MINIMUM = (25, 0)
"""First version of Mesa with a correct llvmpipe; 22.3 skips statements after an inner loop with two
atomics."""
ADDRESSED = 2**32
"""Largest buffer [bytes]: kernels address the fields of a run, which are in one buffer, with 32 bits."""


@dataclass(frozen=True)
class VulkanDevice:
    """A Vulkan device.

    name:        as reported by the driver, as `llvmpipe (LLVM 15.0.6, 256 bits)`
    driver:      name and version of the driver, as `llvmpipe Mesa 25.0.7 (LLVM 15.0.6)`
    on_cpu:      the driver executes on the CPU
    has_64_bit:  f64 and i64 in kernels
    free:        memory [bytes]; without VK_EXT_memory_budget all memory counts as free
    allocation:  largest allocation [bytes]
    """

    name: str
    driver: str
    on_cpu: bool
    has_64_bit: bool = True
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


def refuse_unreliable_vulkan(devices: Sequence[VulkanDevice]) -> None:
    """Raise GranflowError if results on Vulkan would be wrong, or a run would end early.

    devices:  all devices of this machine; kernels run on a GPU if there is one
    """
    if KERNELS == "taichi":
        raise GranflowError(
            "Taichi 1.7 overwrites fields on Vulkan and ends after some 12000 launches. Run pip install "
            "quadrants and add --kernels quadrants, or leave out --arch to run on the CPU."
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


def free_device_memory(arch: str) -> int | None:
    """Free memory [bytes] of the device of "cuda" or "vulkan"; None if it is unknown."""
    if arch == "cuda":
        return free_gpu_memory()
    device = used_device(vulkan_devices())
    return None if device is None else device.free


def used_device(devices: Sequence[VulkanDevice]) -> VulkanDevice | None:
    """The device that kernels run on: the first GPU, or the first device without a GPU; None without a
    device."""
    return min(devices, key=lambda device: device.on_cpu, default=None)


def vulkan_devices() -> list[VulkanDevice]:
    """All Vulkan devices in the order of the loader; empty without a loader or a driver."""
    names = {"win32": "vulkan-1.dll", "darwin": "libvulkan.dylib"}
    try:
        loader = ctypes.CDLL(names.get(sys.platform, "libvulkan.so.1"))
    except OSError:
        return []
    if not hasattr(loader, "vkGetPhysicalDeviceProperties2"):  # older than Vulkan 1.1
        return []
    application = _structure(0, 48)  # VkApplicationInfo
    struct.pack_into("=I", application, 44, 1 << 22 | 1 << 12)  # version 1.1
    info = _structure(1, 64)  # VkInstanceCreateInfo
    struct.pack_into("=Q", info, 24, ctypes.addressof(application))
    instance = ctypes.c_void_p()
    if loader.vkCreateInstance(info, None, ctypes.byref(instance)):
        return []
    try:
        count = ctypes.c_uint32()
        loader.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None)
        handles = (ctypes.c_void_p * count.value)()
        loader.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), handles)
        return [_device(loader, ctypes.c_void_p(handle)) for handle in handles[: count.value]]
    finally:
        loader.vkDestroyInstance(instance, None)


def _device(loader: Any, handle: ctypes.c_void_p) -> VulkanDevice:
    """Properties of one device. The offsets are those of the members of the structures in vulkan_core.h."""
    limits = _structure(1000168000, 32)  # VkPhysicalDeviceMaintenance3Properties
    driver = _structure(1000196000, 536, limits)  # VkPhysicalDeviceDriverProperties
    properties = _structure(1000059001, 840, driver)  # VkPhysicalDeviceProperties2
    loader.vkGetPhysicalDeviceProperties2(handle, properties)
    features = (ctypes.c_uint32 * 55)()  # VkPhysicalDeviceFeatures
    loader.vkGetPhysicalDeviceFeatures(handle, features)
    (device_type,) = struct.unpack_from("=I", properties, 32)
    (allocation,) = struct.unpack_from("=Q", limits, 24)
    return VulkanDevice(
        name=_text(properties, 36),
        driver=f"{_text(driver, 20)} {_text(driver, 276)}",
        on_cpu=device_type == 4,  # VK_PHYSICAL_DEVICE_TYPE_CPU
        has_64_bit=bool(features[39] and features[40]),  # shaderFloat64, shaderInt64
        free=_free_memory(loader, handle),
        allocation=allocation or ADDRESSED,
    )


def _free_memory(loader: Any, handle: ctypes.c_void_p) -> int:
    """Free memory [bytes] of the largest heap in the memory of the device."""
    budget = _structure(1000237000, 272)  # VkPhysicalDeviceMemoryBudgetPropertiesEXT, zeros without it
    memory = _structure(1000059006, 536, budget)  # VkPhysicalDeviceMemoryProperties2
    loader.vkGetPhysicalDeviceMemoryProperties2(handle, memory)
    (heap_count,) = struct.unpack_from("=I", memory, 276)
    heaps = [struct.unpack_from("=QI", memory, 280 + 16 * k) for k in range(heap_count)]  # size, flags
    local = [k for k, (_, flags) in enumerate(heaps) if flags & 1]  # VK_MEMORY_HEAP_DEVICE_LOCAL_BIT
    largest = max(local, key=lambda k: heaps[k][0], default=0)
    (allowed,) = struct.unpack_from("=Q", budget, 16 + 8 * largest)
    (used,) = struct.unpack_from("=Q", budget, 144 + 8 * largest)
    return max(allowed - used, 0) if allowed else int(heaps[largest][0])


def _structure(kind: int, size: int, following: Any = None) -> Any:
    """A Vulkan structure of `size` bytes: its VkStructureType, the structure that follows it, and zeros."""
    memory = (ctypes.c_uint64 * (size // 8))()  # aligned as pointers
    address = 0 if following is None else ctypes.addressof(following)
    struct.pack_into("=I4xQ", memory, 0, kind, address)
    return memory


def _text(structure: Any, offset: int) -> str:
    """Text in the 256 bytes from an offset."""
    return bytes(structure)[offset : offset + 256].split(b"\0")[0].decode(errors="replace")
