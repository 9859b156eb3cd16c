"""Vulkan on this machine: why tests cannot run on it, and the environment of those that can."""

from importlib.util import find_spec

from granflow.engine.backend import MESA_MINIMUM, vulkan_devices

PACKAGES = (
    f"quadrants, and a GPU with a Vulkan driver or Mesa >= {MESA_MINIMUM[0]} (mesa-vulkan-drivers, "
    "libvulkan1)"
)
ENVIRONMENT = {"GRANFLOW_KERNELS": "quadrants", "LP_NUM_THREADS": "1"}
"""Kernel language, and number of threads of llvmpipe: the tests run beside others."""


def missing():
    """Reason why tests cannot run on Vulkan; empty if they can."""
    if find_spec("quadrants") is None:
        return f"quadrants is not installed; needs {PACKAGES}"
    devices = vulkan_devices()
    if not devices:
        return f"no Vulkan device; needs {PACKAGES}"
    wrong = [device.driver for device in devices if device.is_wrong or not device.has_64_bit]
    return f"{wrong[0]} is not reliable; needs {PACKAGES}" if wrong else ""
