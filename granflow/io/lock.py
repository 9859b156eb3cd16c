"""Lock of a directory: one run at a time writes into it, and notices if it loses it.

`locked` takes the lock of a directory, which is a file `.lock` in it; the operating system releases it when
the process ends for any reason. `writing` takes it for a run, and gives the run a `DirectoryLock`, with which
it checks that its path still leads to the directory that it has locked.

filelock is not used: its import (asyncio, sqlite3) delays each start by about 80 ms, and on file systems
without flock it falls back to a lock file that remains when a process is killed.
"""

import errno
import os
import platform
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from granflow.errors import GranflowError
from granflow.io.files import Identity, LostFiles, identity_of

LOCK = ".lock"
"""Name of the lock file in the output directory."""


class DirectoryLock:
    """A directory that is locked, with the identity of the directory and of its lock file.

    `path`: absolute; `identity`: of the directory.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path = path
        self._lock = descriptor
        self._folder = _folder_descriptor(path)
        self.identity = identity_of(os.stat(path))

    def check(self) -> None:
        """Raise LostFiles if the path leads to another directory or lock file than those locked, or to
        none."""
        try:
            found = identity_of(os.stat(self.path))
        except OSError:
            raise LostFiles(self.path, "the directory was moved or deleted during the run") from None
        if found != self.identity:
            raise LostFiles(self.path, "another directory has replaced that of the run")
        try:
            locked_file = identity_of(os.stat(self.path / LOCK))
        except OSError:
            raise LostFiles(
                self.path / LOCK, "the lock of the run was deleted, and another run could start"
            ) from None
        if locked_file != identity_of(os.fstat(self._lock)):
            raise LostFiles(self.path / LOCK, "another file has replaced the lock of the run")

    def present_path(self) -> Path | None:
        """Where the directory is now; None if it was deleted, or if the system does not tell."""
        if self._folder is None:
            return None
        with suppress(OSError):
            path = self._told_path()
            if path is not None and identity_of(os.stat(path)) == self.identity:
                return path
        return None

    def _told_path(self) -> Path | None:
        """Path of the directory according to the system."""
        assert self._folder is not None
        if sys.platform == "linux":
            return Path(os.readlink(f"/proc/self/fd/{self._folder}"))
        if sys.platform == "darwin":
            told: bytes = fcntl.fcntl(self._folder, fcntl.F_GETPATH, bytes(1024))
            return Path(os.fsdecode(told.rstrip(b"\0")))
        return None

    def close(self) -> None:
        """Release the lock; its file is then empty."""
        _write_holder(self._lock, "")
        os.close(self._lock)
        if self._folder is not None:
            os.close(self._folder)


_HELD: dict[tuple[int, Path], DirectoryLock] = {}
"""Locks by thread and resolved path: a verb holds the lock while it calls functions that also lock."""
_WRITING: dict[Identity, Path] = {}
"""Directories into which a run of this process writes; the same thread can have several runs."""


@contextmanager
def locked(directory: Path) -> Iterator[DirectoryLock]:
    """Create the directory if necessary and lock it.

    In the block, the same thread may lock it again. The file `.lock` remains after the release, because its
    deletion could remove the lock of a run that has just acquired it.

    Raises GranflowError if another process or thread has locked it, and OSError if it cannot be created.
    """
    directory.mkdir(parents=True, exist_ok=True)
    key = threading.get_ident(), directory.resolve()
    if key in _HELD:
        yield _HELD[key]
        return
    descriptor = _open_lock(directory / LOCK)
    try:
        _take(descriptor)
    except BlockingIOError:
        os.close(descriptor)
        raise GranflowError(
            f"Another run is writing into {directory}: wait for it, stop it, or give another directory with "
            "--out."
        ) from None
    except BaseException:
        os.close(descriptor)
        raise
    _write_holder(descriptor, f"process {os.getpid()} on {platform.node()}")
    lock = DirectoryLock(Path(os.path.abspath(directory)), descriptor)
    _HELD[key] = lock
    try:
        yield lock
    finally:
        del _HELD[key]
        lock.close()


@contextmanager
def writing(directory: Path) -> Iterator[DirectoryLock]:
    """Lock the directory for the files of one run. Raises the errors of `locked` and of
    `refuse_second_run`."""
    refuse_second_run(directory)
    with locked(directory) as lock:
        _WRITING[lock.identity] = directory
        try:
            yield lock
        finally:
            del _WRITING[lock.identity]


def refuse_second_run(directory: Path) -> None:
    """Raise GranflowError if a run of this process writes into the directory."""
    with suppress(OSError):
        if identity_of(os.stat(directory)) in _WRITING:
            raise GranflowError(
                f"Another Simulation of this process is writing into {directory}: call its close first, or "
                "give another directory."
            )


def holder_of(directory: Path) -> str:
    """Who has locked a directory, such as `process 1234 on node7`; empty if it is free or does not exist."""
    if not (directory / LOCK).exists():
        return ""
    try:
        with locked(directory):
            return ""
    except GranflowError:
        with suppress(OSError):
            return (directory / LOCK).read_text(encoding="utf-8", errors="replace") or "another process"
        return "another process"


# The lock file, and the calls of the operating system for it

if sys.platform == "win32":
    import msvcrt

    def _take(descriptor: int) -> None:
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError from error

    def _folder_descriptor(_path: Path) -> None:
        """None: Windows does not open directories."""
else:
    import fcntl

    def _take(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _folder_descriptor(path: Path) -> int:
        """Descriptor of a directory: while it is open, no other directory can get its inode number."""
        return os.open(path, os.O_RDONLY)


def _open_lock(path: Path) -> int:
    """Descriptor of the lock file; a symbolic link in its place is removed, so that no file outside is
    created."""
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
    try:
        return os.open(path, flags, 0o644)
    except OSError as error:
        if error.errno != errno.ELOOP:
            raise
        path.unlink()
        return os.open(path, flags, 0o644)


def _write_holder(descriptor: int, holder: str) -> None:
    """Replace the content of the lock file; a full disk does not matter. A hard link to another file is not
    written."""
    with suppress(OSError):
        if os.fstat(descriptor).st_nlink <= 1:
            os.ftruncate(descriptor, 0)
            os.lseek(descriptor, 0, os.SEEK_SET)
            os.write(descriptor, holder.encode())
