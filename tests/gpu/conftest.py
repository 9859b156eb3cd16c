"""The fixture of tests on Vulkan; they use subprocesses, because the session runs on the CPU."""

import pytest
from gpu.vulkan import ENVIRONMENT, missing


@pytest.fixture
def vulkan(monkeypatch):
    """Subprocesses use Quadrants; skipped with the missing packages."""
    reason = missing()
    if reason:
        pytest.skip(reason)
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)
