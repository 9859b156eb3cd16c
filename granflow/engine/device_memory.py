"""Free memory of the GPU that kernels run on."""

from granflow.engine.vulkan_devices import used_device, vulkan_devices
from granflow.io.gpu_memory import free_gpu_memory


def free_device_memory(arch: str) -> int | None:
    """Free memory [bytes] of the device of "cuda" or "vulkan"; None if it is unknown."""
    if arch == "cuda":
        return free_gpu_memory()
    device = used_device(vulkan_devices())
    return None if device is None else device.free
