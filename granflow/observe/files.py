"""Files that are whole or not there: written under a temporary name beside the target, then renamed."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PART = ".part"


@contextmanager
def replacing(path: Path, durable: bool = False) -> Iterator[Path]:
    """Give a temporary path in the same directory and rename it to `path` when the block ends well.

    With `durable` what was written is on the disk before the name changes, so that even a machine without power finds
    the one file or the other. If the block raises, the temporary file goes and an older file under `path` stays as it
    was.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}{PART}")
    try:
        yield temporary
        if durable:
            sync(temporary)
        os.replace(temporary, path)
        if durable:
            sync(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path` as UTF-8, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def remove_parts(directory: Path) -> None:
    """Remove temporary files that a killed process left behind."""
    for path in directory.glob(f".*{PART}"):
        path.unlink(missing_ok=True)


def sync(path: Path) -> None:
    """Have a file, or the names in a directory, on the disk; Windows has no such call for directories."""
    if sys.platform == "win32" and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
