"""The processor of this machine, and which kernel language is faster on it.

The command line asks before it imports a kernel language. Measurements: `tools/benchmark/README.md`.
"""

import re
from contextlib import suppress
from os import environ
from pathlib import Path

KNOWN_TO_TAICHI = {"GenuineIntel": range(3, 16), "AuthenticAMD": range(4, 26)}
"""Families of x86 processors that LLVM 15, the compiler in Taichi 1.7, knows by vendor."""


def processor_text() -> str:
    """What the operating system says of the processor: on Linux cpuinfo, on Windows the identifier."""
    with suppress(OSError):
        return Path("/proc/cpuinfo").read_text()
    import platform  # takes some ms, which every command would wait for

    return f"{platform.processor()} {environ.get('PROCESSOR_IDENTIFIER', '')}"


def family_in(text: str) -> tuple[str, int] | None:
    """Vendor and family of an x86 processor in its text, such as ("AuthenticAMD", 26); None without them."""
    vendor = re.search(r"GenuineIntel|AuthenticAMD|HygonGenuine", text)
    family = re.search(r"\bfamily\s*:?\s*(\d+)", text, re.IGNORECASE)
    return (vendor[0], int(family[1])) if vendor and family else None


def unknown_to_taichi() -> tuple[str, int] | None:
    """Vendor and family if this is an x86 processor that Taichi's compiler does not know.

    For such a processor, LLVM optimizes for x86 without AVX: two numbers per instruction in place of four.
    """
    found = family_in(processor_text())
    return None if found is None or found[1] in KNOWN_TO_TAICHI.get(found[0], ()) else found


def is_faster_with_taichi() -> bool:
    """Whether steps take less time with Taichi than with Quadrants on this processor.

    On an Intel Xeon with AVX-512, Quadrants takes 1.12 to 1.21 times as long: it calls LLVM without the
    vectorization of straight-line code. On AMD's Zen 4 it is 7 % faster nevertheless.
    """
    found = family_in(processor_text())
    return found is not None and found[0] == "GenuineIntel" and unknown_to_taichi() is None
