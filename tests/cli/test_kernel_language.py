"""The remark on processors that the compiler of Taichi does not know."""

import pytest

from granflow import kernel_language

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
