"""Backends that return wrong results, or end early, are refused with one sentence and a remedy; no GPU is
needed."""

import os
import subprocess
import sys

import pytest

from granflow.cli.main import main
from granflow.engine import backend
from granflow.engine.backend import VulkanDevice
from granflow.errors import GranflowError
from granflow.kernel_language import KERNELS

LLVMPIPE = "llvmpipe (LLVM 15.0.6, 256 bits)"
OLD = VulkanDevice(LLVMPIPE, "llvmpipe Mesa 22.3.6 (LLVM 15.0.6)", on_cpu=True)
NEW = VulkanDevice(LLVMPIPE, "llvmpipe Mesa 25.0.7-2~bpo12+1 (LLVM 15.0.6)", on_cpu=True)
CARD = VulkanDevice("NVIDIA A100", "NVIDIA 550.54.14", on_cpu=False)
CARD_32_BIT = VulkanDevice(
    "Intel Arc", "Intel open-source Mesa driver Mesa 24.1.0", on_cpu=False, has_64_bit=False
)


REFUSED = {
    "taichi": ("taichi", (CARD,), ["pip install quadrants", "--kernels quadrants"]),
    "old llvmpipe": ("quadrants", (OLD,), ["Mesa 22.3.6 (LLVM 15.0.6) returns wrong results"]),
    "no 64-bit numbers": (
        "quadrants", (NEW, CARD_32_BIT), ["Intel Arc has no 64-bit numbers", "in every precision, f32 too"]
    ),
}  # fmt: skip
"""Kernel language, devices, and words of the message."""


@pytest.mark.parametrize("case", REFUSED)
def test_unreliable_devices_are_refused_in_one_line_with_a_remedy(monkeypatch, case):
    language, devices, words = REFUSED[case]
    monkeypatch.setattr(backend, "KERNELS", language)
    with pytest.raises(GranflowError) as error:
        backend.refuse_unreliable_vulkan(devices)
    assert all(each in str(error.value) for each in words) and "\n" not in str(error.value)
    if language == "quadrants":
        for reliable in ((NEW,), (OLD, CARD), ()):
            backend.refuse_unreliable_vulkan(reliable)


def test_unknown_kernel_languages_are_refused():
    command = [sys.executable, "-m", "granflow", "check", "scene.yaml"]
    environment = os.environ | {"GRANFLOW_KERNELS": "numba"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)
    assert done.returncode == 2
    assert done.stderr.strip().endswith("the kernel languages are taichi and quadrants.")


@pytest.mark.skipif(KERNELS != "taichi", reason="the other kernel language is Quadrants")
def test_another_kernel_language_than_that_of_the_process_is_refused(capsys, monkeypatch):
    monkeypatch.setenv("GRANFLOW_KERNELS", "taichi")
    assert main(["run", "scene.yaml", "--kernels", "quadrants"]) == 2
    assert capsys.readouterr().err.strip() == (
        "granflow: --kernels quadrants: this process already uses taichi."
    )
