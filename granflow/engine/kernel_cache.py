"""The folder that keeps compiled kernels between runs, for fast later starts.

This module works with files only and does not import Taichi, which reads and writes the folder.
"""

import logging
import os
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from granflow.kernel_language import KERNELS

CACHE_VARIABLE = "GRANFLOW_CACHE"
"""Environment variable with the path of the folder."""
PATTERNS = {"taichi": "*.tic", "quadrants": "kernel_compilation_manager/*.qdc"}
"""Pattern of the paths of compiled kernels in the folder, by kernel language."""
CACHED_KERNELS = PATTERNS[KERNELS]
"""Pattern of the kernel language in use."""
INDEXES = {"taichi": "ticache.tcb", "quadrants": "kernel_compilation_manager/qdcache.qdb"}
LOCKS = {"taichi": "ticache.lock", "quadrants": "kernel_compilation_manager/qdcache.lock"}
"""Paths of the index and of the lock of the cache in the folder, by kernel language."""
TEMPORARY = "granflow_kernels_"
"""Prefix of a temporary folder for one process, deleted at its end."""
STALE_LOCK = 60.0
"""Age [s] of an abandoned lock. Taichi holds its lock briefly; the lock of a killed process would disable the
cache."""


@dataclass(frozen=True)
class CacheContents:
    """Contents of the cache folder: number of kernels, and size [bytes] of all files."""

    kernel_count: int
    size: int


def cache_folder() -> Path:
    """The folder in GRANFLOW_CACHE as an absolute path, or granflow/kernels in the cache folder of the
    platform."""
    named = os.environ.get(CACHE_VARIABLE)
    if named:
        return Path(named).expanduser().absolute()
    from platformdirs import user_cache_path

    return user_cache_path("granflow", appauthor=False, opinion=False) / "kernels"


def usable_folder() -> Path:
    """The cache folder, created if necessary. If it is not writable: a warning, and a temporary folder.

    The caller deletes a temporary folder, whose name begins with TEMPORARY. A lock older than STALE_LOCK is
    removed.

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
            "granflow: %s cannot be written, so kernels are compiled again in every run. Set %s to another "
            "folder.",
            folder,
            CACHE_VARIABLE,
        )
        return Path(tempfile.mkdtemp(prefix=TEMPORARY))
    with suppress(OSError):
        lock = folder / LOCKS[KERNELS]
        if time.time() - lock.stat().st_mtime > STALE_LOCK:
            lock.unlink()
    return folder


def cache_contents() -> CacheContents:
    """Number of kernels and size of the folder; zeros without a folder."""
    files = _files()
    return CacheContents(
        sum(any(map(path.match, PATTERNS.values())) for path in files), sum(map(_size, files))
    )


def clear_cache() -> CacheContents:
    """Delete the files of both kernel languages in the folder and no others; returns their number and
    size."""
    removed = cache_contents()
    for path in _files():
        path.unlink(missing_ok=True)
    return removed


def _files() -> list[Path]:
    """Files of both kernel languages in the cache folder."""
    folder = cache_folder()
    kernels = [path for pattern in PATTERNS.values() for path in folder.glob(pattern)]
    others = [folder / name for name in (*INDEXES.values(), *LOCKS.values())]
    return [*kernels, *(path for path in others if path.exists())]


def _size(path: Path) -> int:
    """Size of a file [bytes]; 0 if it does not exist."""
    try:
        return path.stat().st_size
    except FileNotFoundError:  # another process has deleted it
        return 0
