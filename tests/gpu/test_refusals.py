"""Backends that return wrong results, or end early, are refused with one sentence and a remedy; no GPU is
needed."""

import os
import subprocess
import sys

import pytest

from granflow.engine import backend
from granflow.engine.backend import VulkanDevice
from granflow.errors import GranflowError

LLVMPIPE = "llvmpipe (LLVM 15.0.6, 256 bits)"
OLD = VulkanDevice(LLVMPIPE, "llvmpipe Mesa 22.3.6 (LLVM 15.0.6)", on_cpu=True)
NEW = VulkanDevice(LLVMPIPE, "llvmpipe Mesa 25.0.7-2~bpo12+1 (LLVM 15.0.6)", on_cpu=True)
CARD = VulkanDevice("NVIDIA A100", "NVIDIA 550.54.14", on_cpu=False)
CARD_32_BIT = VulkanDevice(
    "Intel Arc", "Intel open-source Mesa driver Mesa 24.1.0", on_cpu=False, has_64_bit=False
)


def refusal(monkeypatch, language, *devices):
    monkeypatch.setattr(backend, "KERNELS", language)
    with pytest.raises(GranflowError) as error:
        backend.refuse_unreliable_vulkan(devices)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_taichi_on_vulkan_is_refused_with_the_remedy(monkeypatch):
    message = refusal(monkeypatch, "taichi", CARD)
    assert "pip install 'quadrants<1.4'" in message and "GRANFLOW_KERNELS=quadrants" in message


def test_old_llvmpipe_is_refused(monkeypatch):
    assert "Mesa 22.3.6 (LLVM 15.0.6) returns wrong results" in refusal(monkeypatch, "quadrants", OLD)


def test_device_without_64_bit_numbers_is_refused_by_name(monkeypatch):
    message = refusal(monkeypatch, "quadrants", NEW, CARD_32_BIT)
    assert message.startswith("Intel Arc has no 64-bit numbers") and "in every precision, f32 too" in message


@pytest.mark.parametrize("devices", [(NEW,), (OLD, CARD), ()])
def test_reliable_devices_are_accepted(monkeypatch, devices):
    monkeypatch.setattr(backend, "KERNELS", "quadrants")
    backend.refuse_unreliable_vulkan(devices)


def granflow(*arguments, **environment):
    """Exit code and stderr of the command line."""
    command = [sys.executable, "-m", "granflow", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=os.environ | environment)
    return done.returncode, done.stderr


def test_metal_is_no_choice():
    code, message = granflow("run", "scene.yaml", "--arch", "metal")
    assert code == 2 and "invalid choice: 'metal'" in message


def test_unknown_kernel_language_is_refused_in_one_sentence():
    code, message = granflow("check", "scene.yaml", GRANFLOW_KERNELS="numba")
    assert code == 2
    assert message.strip().endswith("the kernel languages are taichi (default) and quadrants.")
    assert len(message.strip().splitlines()) == 1
