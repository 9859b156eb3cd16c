"""Atomic file writes: under a temporary name in the directory of the target, then renamed."""

import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

PART = ".part"
"""Suffix of temporary files."""

SYNC_THREADS = 8
"""Threads that flush files at the same time."""


@contextmanager
def replacing(path: Path, durable: bool = False) -> Iterator[Path]:
    """Yield a temporary path in the same directory and rename it to `path` when the block completes.

    With `durable`, the data are on the disk before the rename, so that either the old or the new file is intact after a
    power failure. If the block raises, the temporary file is deleted and an older file at `path` stays unchanged. The
    name contains the process id, so that two processes do not share a temporary file.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}{PART}")
    try:
        with named_errors(path, temporary):
            yield temporary
            if durable:
                sync(temporary)
            os.replace(temporary, path)
            if durable:
                sync(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def named_errors(path: Path, temporary: Path | None = None) -> Iterator[None]:
    """In the block, an OSError without a file, or about the temporary one, is about `path`: a full disk names none."""
    try:
        yield
    except OSError as error:
        is_unnamed = error.filename is None and error.errno is not None
        if is_unnamed or (temporary is not None and str(error.filename) == str(temporary)):
            error.filename, error.filename2 = str(path), None
        raise


def separate_from_links(path: Path) -> None:
    """Replace a symbolic link, or a file with further hard links, by a copy: a run changes only its own files.

    A link to something that is not a regular file is removed. Raises OSError.
    """
    if not path.is_symlink() and not (path.is_file() and path.stat().st_nlink > 1):
        return
    if not path.is_file():
        path.unlink()
        return
    with replacing(path) as temporary:
        shutil.copyfile(path, temporary)


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path` as UTF-8, atomically.

    Raises OSError if the directory does not exist or is not writable.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def remove_parts(directory: Path) -> None:
    """Remove temporary files that a killed process left behind."""
    for path in directory.glob(f".*{PART}"):
        path.unlink(missing_ok=True)


def sync_all(paths: Sequence[Path]) -> None:
    """Flush files to the disk, except those that no longer exist. Raises OSError.

    Several threads: a file system flushes waiting files together, 143 files in 0.02 s in place of 0.37 s.
    """

    def sync_existing(path: Path) -> None:
        with suppress(FileNotFoundError):
            sync(path)

    with ThreadPoolExecutor(min(len(paths), SYNC_THREADS) or 1) as threads:
        try:
            started = threads.map(sync_existing, paths)
        except RuntimeError:  # no thread starts while the interpreter ends
            started = map(sync_existing, paths)
        for _ in started:
            pass


def sync(path: Path) -> None:
    """Flush a file, or the entries of a directory, to the disk; Windows has no such call for directories.

    Raises FileNotFoundError if the path does not exist.
    """
    if sys.platform == "win32" and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
