"""Reads input files, regular files only: a pipe or a device could block or never end."""

import errno
import hashlib
import os
import stat
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO


class FormatError(Exception):
    """Content that cannot be used; the message is a predicate that follows the name of the file."""


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading; never blocks.

    Returns:  binary file, which the caller closes
    Raises:   OSError with the reason if the file does not exist, cannot be read or is not a regular file
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except ValueError as error:  # a NUL in the name
        raise OSError(errno.EINVAL, str(error), str(path)) from None
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        code = errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL
        raise OSError(code, "it is a directory" if stat.S_ISDIR(mode) else "it is not a regular file", str(path))
    return os.fdopen(descriptor, "rb")


CHUNK_SIZE = 2**20
"""Bytes read at a time."""

LARGEST_FILE = 2**30
"""Largest size of a file that is read into memory [bytes]."""


def read_regular(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """Return all bytes of the file.

    largest:  maximum size [bytes]
    Raises:   OSError as `open_regular` does, and for a larger file
    """
    raw = bytearray()
    with open_regular(path) as file:
        too_large = os.fstat(file.fileno()).st_size > largest
        while not too_large and (piece := file.read(CHUNK_SIZE)):  # read(largest) would allocate that much for any file
            raw += piece
            too_large = len(raw) > largest
    if too_large:
        raise OSError(errno.EFBIG, f"it is larger than {largest / 2**20:.3g} MiB", str(path))
    return bytes(raw)


def file_digest(path: Path) -> str:
    """SHA-256 of the content of a file, or "missing". A file that has not changed since the last call is not read."""
    try:
        found = os.stat(path)
    except FileNotFoundError:
        return "missing"
    return _digest(path, (found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns))


@lru_cache(maxsize=1024)
def _digest(path: Path, _state: tuple[int, ...]) -> str:
    """SHA-256 of the content of a file; `_state`: what changes with its content."""
    digest = hashlib.sha256()
    with open_regular(path) as file:
        while piece := file.read(CHUNK_SIZE):
            digest.update(piece)
    return digest.hexdigest()


def read_regular_text(path: Path, largest: int = LARGEST_FILE) -> str:
    """Return the text of a UTF-8 file without byte order mark, with invalid bytes replaced.

    largest:  maximum size [bytes]
    Raises:   OSError as `read_regular` does
    """
    return read_regular(path, largest).decode("utf-8-sig", errors="replace")


def resolved(path: Path) -> Path:
    """Return the path without symbolic links. Raises OSError for circular links, on all Python versions."""
    try:
        return Path(path).resolve()
    except RuntimeError:
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path)) from None
    except ValueError as error:  # a NUL in the name
        raise OSError(errno.EINVAL, str(error), str(path)) from None
