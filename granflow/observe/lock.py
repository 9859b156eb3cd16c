"""One run at a time in a directory: a lock that the operating system takes back when its process ends, however."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from granflow.errors import GranflowError

LOCK = ".lock"
_HELD: ContextVar[frozenset[Path]] = ContextVar("_HELD", default=frozenset())
"""Directories that this thread has locked: a verb keeps the lock while it calls what locks the directory itself."""
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
    """Hold the directory, made if need be, against other runs. Raises GranflowError where one is at work in it.

    Inside, the same thread may lock it again. The file `.lock` stays when the lock is gone: removing it could take it
    from a run that has just locked it.
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
                f"Another run is writing into {directory}: wait for it, stop it, or name another directory with --out."
            ) from None
        token = _HELD.set(_HELD.get() | {path})
        try:
            yield
        finally:
            _HELD.reset(token)
    finally:
        os.close(descriptor)
