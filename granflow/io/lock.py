"""Directory lock for one run at a time; the operating system releases it when the process ends for any reason.

filelock is not used: its import (asyncio, sqlite3) delays each start by about 80 ms, and on file systems without flock
it falls back to a lock file that remains when a process is killed.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from granflow.errors import GranflowError

LOCK = ".lock"
"""Name of the lock file in the output directory."""

_HELD: ContextVar[frozenset[Path]] = ContextVar("_HELD", default=frozenset())
"""Directories that this thread has locked: a verb holds the lock while it calls functions that also lock."""
if sys.platform == "win32":
    import msvcrt

    def _take(descriptor: int) -> None:
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError from error
else:
    import fcntl

    def _take(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def locked(directory: Path) -> Iterator[None]:
    """Create the directory if necessary and lock it.

    In the block, the same thread may lock it again. The file `.lock` remains after the release, because its deletion
    could remove the lock of a run that has just acquired it.

    Raises GranflowError if another process or thread has locked it, and OSError if it cannot be created.
    """
    directory.mkdir(parents=True, exist_ok=True)
    path = directory.resolve()
    if path in _HELD.get():
        yield
        return
    descriptor = os.open(directory / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            _take(descriptor)
        except BlockingIOError:
            raise GranflowError(
                f"Another run is writing into {directory}: wait for it, stop it, or give another directory with --out."
            ) from None
        token = _HELD.set(_HELD.get() | {path})
        try:
            yield
        finally:
            _HELD.reset(token)
    finally:
        os.close(descriptor)
