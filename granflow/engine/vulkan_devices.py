"""Vulkan devices and drivers of this machine, read through the Vulkan loader."""

import ctypes
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

MESA_MINIMUM = (25, 0)
"""First version of Mesa with a correct llvmpipe; 22.3 skips statements after an inner loop with two atomics."""
CPU_TYPE = 4
"""VkPhysicalDeviceType of a device that is a CPU."""
API_VERSION = 1 << 22 | 1 << 12
"""Vulkan 1.1, as VK_MAKE_API_VERSION."""
FEATURE_COUNT, FLOAT64, INT64 = 55, 39, 40
"""Number of entries of VkPhysicalDeviceFeatures, and indices of shaderFloat64 and shaderInt64."""
INSTANCE_INFO, PROPERTIES_2, MEMORY_2, LIMITS, DRIVER_PROPERTIES, BUDGET = (
    *(1, 1000059001, 1000059006, 1000168000, 1000196000),
    1000237000,
)
"""VkStructureType of the structures."""
MEMORY_TYPES, MEMORY_HEAPS, DEVICE_LOCAL = 32, 16, 1
"""Lengths of the arrays of VkPhysicalDeviceMemoryProperties, and flag of a heap in the memory of the device."""
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
    info, instance = _InstanceInfo(kind=INSTANCE_INFO, application=ctypes.pointer(application)), ctypes.c_void_p()
    if loader.vkCreateInstance(ctypes.byref(info), None, ctypes.byref(instance)):
        return []
    try:
        return [_device(loader, handle) for handle in _handles(loader, instance)]
    finally:
        loader.vkDestroyInstance(instance, None)


def used_device(devices: Sequence[VulkanDevice]) -> VulkanDevice | None:
    """The device that kernels run on: the first GPU, or the first device without a GPU; None without a device."""
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
    name, on_cpu = found.name.decode(errors="replace"), found.type == CPU_TYPE
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
