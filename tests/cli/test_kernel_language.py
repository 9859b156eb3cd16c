"""The choice of the kernel language, and the remark on processors that the compiler of Taichi does not know."""

import os
import sys
from argparse import Namespace

import pytest

from granflow import kernel_language, processors
from granflow.cli import arguments

ZEN_5 = "vendor_id\t: AuthenticAMD\ncpu family\t: 26\nmodel\t\t: 2\nmodel name\t: AMD EPYC\n"
XEON = "vendor_id\t: GenuineIntel\ncpu family\t: 6\n"
ZEN_5_ON_WINDOWS = "AMD64 Family 26 Model 68 Stepping 0, AuthenticAMD"


@pytest.mark.parametrize(
    ("text", "kernels", "is_said"),
    [
        (ZEN_5, "taichi", True),
        (ZEN_5_ON_WINDOWS, "taichi", True),
        (ZEN_5, "quadrants", False),
        (ZEN_5.replace(": 26", ": 25"), "taichi", False),
        (XEON, "taichi", False),
        ("BogoMIPS\t: 50.00\nCPU implementer\t: 0x41\n", "taichi", False),
    ],
)
def test_quadrants_is_named_for_processors_unknown_to_taichi(text, kernels, is_said, monkeypatch):
    """LLVM 15 in Taichi 1.7 knows AMD families up to 25 and Intel's family 6; on ARM all vectors are the same."""
    assert processors.processor_text().strip()
    monkeypatch.setattr(processors, "processor_text", lambda: text)
    monkeypatch.setattr(kernel_language, "KERNELS", kernels)
    assert ("--kernels quadrants" in kernel_language.slower_than_quadrants()) == is_said


@pytest.mark.parametrize(
    ("installed", "variable", "expected"),
    [
        (["quadrants"], "", "quadrants"),
        (["taichi", "quadrants"], "", "taichi"),
        (["taichi"], "quadrants", "quadrants"),
    ],
)
def test_programs_use_taichi_where_it_is_installed(installed, variable, expected, monkeypatch):
    """Their functions may contain those of the module taichi."""
    monkeypatch.setattr(kernel_language, "find_spec", lambda name: name if name in installed else None)
    monkeypatch.setenv(kernel_language.VARIABLE, variable)
    assert kernel_language._selected() == expected


@pytest.mark.parametrize(
    ("options", "text", "variable", "installed", "expected"),
    [
        ({}, ZEN_5, "", ["taichi", "quadrants"], "quadrants"),  # verbs without these options
        ({}, XEON, "", ["taichi", "quadrants"], ""),
        ({}, XEON.replace(": 6", ": 18"), "", ["taichi", "quadrants"], "quadrants"),
        ({"arch": "vulkan", "kernels": None}, XEON, "", ["taichi", "quadrants"], "quadrants"),
        ({"arch": "cpu", "kernels": None}, XEON, "", ["quadrants"], "quadrants"),
        ({"arch": "cpu", "kernels": None}, ZEN_5, "", ["taichi"], ""),
        ({"arch": "cpu", "kernels": "taichi"}, ZEN_5, "quadrants", ["taichi", "quadrants"], "taichi"),
        ({"arch": "cuda", "kernels": None}, ZEN_5, "", ["taichi", "quadrants"], ""),
    ],
)
def test_commands_use_the_faster_kernel_language(options, text, variable, installed, expected, monkeypatch):
    """It is Quadrants but on Intel's processors that Taichi knows, and on CUDA, where all checks passed with Taichi.

    Vulkan works with Quadrants only. The option and the environment variable override the choice; empty: Taichi.
    """
    monkeypatch.delitem(sys.modules, "granflow.kernel_language")  # as before its first import
    monkeypatch.setattr(arguments, "find_spec", lambda name: name if name in installed else None)
    monkeypatch.setattr(processors, "processor_text", lambda: text)
    monkeypatch.setenv(kernel_language.VARIABLE, variable)
    arguments.select_kernels(Namespace(**options))
    assert os.environ[kernel_language.VARIABLE] == expected
