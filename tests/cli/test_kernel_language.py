"""The choice of the kernel language, and the remark on processors that the compiler of Taichi does not know."""

import os
import sys
from argparse import Namespace

import pytest

from granflow import kernel_language
from granflow.cli import arguments
from granflow.cli.arguments import select_kernels

ZEN_5 = "vendor_id\t: AuthenticAMD\ncpu family\t: 26\nmodel\t\t: 2\nmodel name\t: AMD EPYC\n"
ZEN_4 = ZEN_5.replace(": 26", ": 25")
SAPPHIRE_RAPIDS = "vendor_id\t: GenuineIntel\ncpu family\t: 6\nmodel\t\t: 143\n"
HYGON = "vendor_id\t: HygonGenuine\ncpu family\t: 24\n"
ZEN_5_ON_WINDOWS = "AMD64 Family 26 Model 68 Stepping 0, AuthenticAMD"
ARM = "BogoMIPS\t: 50.00\nCPU implementer\t: 0x41\n"


@pytest.mark.parametrize(
    ("text", "family"),
    [
        (ZEN_5, ("AuthenticAMD", 26)),
        (SAPPHIRE_RAPIDS, ("GenuineIntel", 6)),
        (ZEN_5_ON_WINDOWS, ("AuthenticAMD", 26)),
        (ARM, None),
        ("", None),
    ],
)
def test_vendor_and_family_are_read(text: str, family: tuple[str, int] | None) -> None:
    """On Linux, on Windows, and None where there is no x86 family."""
    assert kernel_language.family_in(text) == family


@pytest.mark.parametrize(
    ("text", "kernels", "is_said"),
    [
        (ZEN_5, "taichi", True),
        (ZEN_5_ON_WINDOWS, "taichi", True),
        (HYGON, "taichi", True),
        (ZEN_5, "quadrants", False),
        (ZEN_4, "taichi", False),
        (SAPPHIRE_RAPIDS, "taichi", False),
        (ARM, "taichi", False),
    ],
)
def test_quadrants_is_named_for_processors_unknown_to_taichi(
    text: str, kernels: str, is_said: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """LLVM 15 in Taichi 1.7 knows AMD families up to 25 and Intel's family 6; on ARM all vectors are the same."""
    monkeypatch.setattr(kernel_language, "processor_text", lambda: text)
    monkeypatch.setattr(kernel_language, "KERNELS", kernels)
    sentence = kernel_language.slower_than_quadrants()
    assert bool(sentence) == is_said
    assert ("--kernels quadrants" in sentence) == is_said


def test_processor_of_this_machine_is_read() -> None:
    """The text of the operating system has no surprise: its family is found or absent, without an error."""
    found = kernel_language.family_in(kernel_language.processor_text())
    assert found is None or found[1] > 0


@pytest.mark.parametrize(
    ("installed", "variable", "expected"),
    [
        ({"taichi"}, None, "taichi"),
        ({"quadrants"}, None, "quadrants"),
        ({"taichi", "quadrants"}, None, "taichi"),
        ({"taichi", "quadrants"}, "quadrants", "quadrants"),
        (set(), "", "taichi"),  # whose absence is an error with the command that installs it
    ],
)
def test_programs_use_taichi_where_it_is_installed(
    installed: set[str], variable: str | None, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their functions may contain those of the module taichi."""
    monkeypatch.setattr(kernel_language, "find_spec", lambda name: name if name in installed else None)
    monkeypatch.delenv(kernel_language.VARIABLE, raising=False)
    if variable is not None:
        monkeypatch.setenv(kernel_language.VARIABLE, variable)
    assert kernel_language._selected() == expected


@pytest.mark.parametrize(
    ("options", "variable", "is_installed", "expected"),
    [
        ({}, "", True, "quadrants"),  # --version and verbs without these options
        ({"arch": "cpu", "kernels": None}, "", True, "quadrants"),
        ({"arch": "cpu", "kernels": None}, "", False, ""),
        ({"arch": "cpu", "kernels": None}, "taichi", True, "taichi"),
        ({"arch": "cpu", "kernels": "taichi"}, "quadrants", True, "taichi"),
        ({"arch": "vulkan", "kernels": None}, "", True, "quadrants"),
        ({"arch": "cuda", "kernels": None}, "", True, ""),
        ({"arch": "gpu", "kernels": None}, "", True, ""),
        ({"arch": "cuda", "kernels": "quadrants"}, "", True, "quadrants"),
    ],
)
def test_commands_use_quadrants_on_cpus_where_they_are_installed(
    options: dict[str, str | None],
    variable: str,
    is_installed: bool,
    expected: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The option and the environment variable override that; all checks on a GPU passed with Taichi."""
    monkeypatch.delitem(sys.modules, "granflow.kernel_language")  # as before its first import
    monkeypatch.setattr(arguments, "find_spec", lambda name: name if is_installed else None)
    monkeypatch.setenv(kernel_language.VARIABLE, variable)
    select_kernels(Namespace(**options))
    assert os.environ[kernel_language.VARIABLE] == expected
