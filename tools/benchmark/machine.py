"""Description of the machine and the versions of a measurement."""

import os
import platform
import subprocess
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from granflow.kernel_language import KERNELS
from granflow.processors import family_in, processor_text

ROOT = Path(__file__).resolve().parent.parent.parent


def machine() -> dict[str, Any]:
    """Processor, kernel language, cores, caches, memory, operating system, packages, commit and date."""
    return {
        "processor": _processor(),
        "kernels": KERNELS,
        "instructions": "AVX-512"
        if "avx512f" in (_line("/proc/cpuinfo", "flags") or "")
        else platform.machine(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "last_level_cache": last_level_cache(),
        "memory": _memory(),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in ("granflow", "taichi", "quadrants", "numpy")},
        "commit": _git("rev-parse", "--short", "HEAD"),
        "changed": bool(_git("status", "--porcelain", "--untracked-files=no", "--", "granflow")),
        "date": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),
    }


def _processor() -> str:
    """Name of the processor, on x86 with its family: the name of a virtual machine is the same for many."""
    name = _line("/proc/cpuinfo", "model name") or platform.processor() or platform.machine()
    family = family_in(processor_text())
    return name if family is None else f"{name}, family {family[1]}"


def last_level_cache() -> int | None:
    """Size of the largest cache [bytes], or None if unknown."""
    sizes = [
        path.read_text().strip() for path in Path("/sys/devices/system/cpu/cpu0/cache").glob("index*/size")
    ]
    units = {"K": 1024, "M": 1024**2}
    return max((int(size[:-1]) * units[size[-1]] for size in sizes if size[-1:] in units), default=None)


def _line(path: str, key: str) -> str | None:
    try:
        lines = Path(path).read_text().splitlines()
    except OSError:
        return None
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith(key)), None)


def _memory() -> int | None:
    words = (_line("/proc/meminfo", "MemTotal") or "").split()
    return 1024 * int(words[0]) if words else None


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _git(*words: str) -> str | None:
    try:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True)
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None
