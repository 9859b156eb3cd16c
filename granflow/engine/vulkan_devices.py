"""Vulkan devices and drivers of this machine, read through the Vulkan loader."""

import ctypes
import re
import sys
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
INSTANCE_INFO, PROPERTIES_2, DRIVER_PROPERTIES = 1, 1000059001, 1000196000
"""VkStructureType of the structures."""


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


@dataclass(frozen=True)
class VulkanDevice:
    """A Vulkan device.

    name:        as reported by the driver, as `llvmpipe (LLVM 15.0.6, 256 bits)`
    driver:      name and version of the driver, as `llvmpipe Mesa 25.0.7 (LLVM 15.0.6)`
    on_cpu:      the driver executes on the CPU
    has_64_bit:  f64 and i64 in kernels
    """

    name: str
    driver: str
    on_cpu: bool
    has_64_bit: bool = True

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
    driver = _Driver(kind=DRIVER_PROPERTIES)
    found = _Properties(kind=PROPERTIES_2, next=ctypes.addressof(driver))
    loader.vkGetPhysicalDeviceProperties2(handle, ctypes.byref(found))
    features = (ctypes.c_uint32 * FEATURE_COUNT)()
    loader.vkGetPhysicalDeviceFeatures(handle, features)
    text = f"{driver.name.decode(errors='replace')} {driver.info.decode(errors='replace')}"
    return VulkanDevice(
        found.name.decode(errors="replace"), text, found.type == CPU_TYPE, bool(features[FLOAT64] and features[INT64])
    )
