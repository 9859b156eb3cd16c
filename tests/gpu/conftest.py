"""The fixture of tests on Vulkan; they use subprocesses, because the session runs on the CPU."""

from importlib.util import find_spec

import pytest

from granflow.engine.backend import MESA_MINIMUM, vulkan_devices

NEEDS = (
    f"needs quadrants, and a GPU with a Vulkan driver or Mesa >= {MESA_MINIMUM[0]} (mesa-vulkan-drivers, "
    "libvulkan1)"
)


@pytest.fixture
def vulkan(monkeypatch):
    """Subprocesses use Quadrants, and one thread of llvmpipe: other tests run at the same time."""
    devices = vulkan_devices() if find_spec("quadrants") else []
    if not devices or any(device.is_wrong or not device.has_64_bit for device in devices):
        pytest.skip(f"{devices[0].driver if devices else 'no Vulkan'}: {NEEDS}")
    monkeypatch.setenv("GRANFLOW_KERNELS", "quadrants")
    monkeypatch.setenv("LP_NUM_THREADS", "1")
