"""Where compiled kernels are kept between runs, so that the second start is fast. Knows files only, not Taichi."""

import logging
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

VARIABLE = "GRANFLOW_CACHE"
KERNELS = "*.tic"
INDEX, LOCK = "ticache.tcb", "ticache.lock"
TEMPORARY = "granflow_kernels_"
"""Prefix of a folder for one process, deleted at its end."""
STALE_LOCK = 60.0
"""Seconds. Taichi holds its lock for a moment; one that a killed process left would switch the cache off for good."""


@dataclass(frozen=True)
class Contents:
    """What lies in the folder: kernels, and the bytes of all files."""

    kernel_count: int
    size: int


def cache_folder() -> Path:
    """The folder named by GRANFLOW_CACHE, or granflow/kernels in the cache folder of the platform."""
    named = os.environ.get(VARIABLE)
    if named:
        return Path(named).expanduser().absolute()
    if sys.platform == "win32":
        home = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        home = Path.home() / "Library" / "Caches"
    else:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return home / "granflow" / "kernels"


def usable_folder() -> Path:
    """The folder, made if need be; a temporary one, and a warning, where nothing can be written into it.

    Taichi without any cache folder crashes at the end of a process that has compiled many kernels (SIGSEGV).
    """
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK)
    except OSError:
        writable = False
    if not writable:
        logging.getLogger("granflow").warning(
            "granflow: %s cannot be written, so kernels are compiled anew in every run. Set %s to another folder.",
            folder, VARIABLE,
        )  # fmt: skip
        return Path(tempfile.mkdtemp(prefix=TEMPORARY))
    _break_stale_lock(folder / LOCK)
    return folder


def cache_contents() -> Contents:
    """Kernels and bytes in the folder; none where there is no folder."""
    sizes = [_size(path) for path in _files()]
    return Contents(sum(path.suffix == Path(KERNELS).suffix for path in _files()), sum(sizes))


def clear_cache() -> Contents:
    """Delete what Taichi put into the folder, nothing else; returns what that was."""
    removed = cache_contents()
    for path in _files():
        path.unlink(missing_ok=True)
    return removed


def _files() -> list[Path]:
    folder = cache_folder()
    return [*folder.glob(KERNELS), *(folder / name for name in (INDEX, LOCK) if (folder / name).exists())]


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:  # another process cleared it meanwhile
        return 0


def _break_stale_lock(lock: Path) -> None:
    try:
        if time.time() - lock.stat().st_mtime > STALE_LOCK:
            lock.unlink()
    except OSError:
        return
