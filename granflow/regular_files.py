"""Opens files that come from elsewhere: regular files only, never a pipe or a device that would block or never end."""

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO


def open_regular(path: Path) -> BinaryIO:
    """The file, opened for reading. Raises OSError with a reason in words; a named pipe does not block."""
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


PIECE = 2**20
"""Bytes that are read at a time."""

LARGEST_FILE = 2**30
"""Bytes of a text that is read at once."""


def read_regular(path: Path, largest: int = LARGEST_FILE) -> bytes:
    """All bytes of the file. Raises OSError as `open_regular` does, and for more than `largest` bytes."""
    raw = bytearray()
    with open_regular(path) as file:
        long = os.fstat(file.fileno()).st_size > largest
        while not long and (piece := file.read(PIECE)):  # read(largest) would allocate that much for any file
            raw += piece
            long = len(raw) > largest
    if long:
        raise OSError(errno.EFBIG, f"it is larger than {largest / 2**20:.3g} MiB", str(path))
    return bytes(raw)


def read_regular_text(path: Path, largest: int = LARGEST_FILE) -> str:
    """The file as UTF-8, a byte order mark left out and wrong bytes replaced. Raises OSError."""
    return read_regular(path, largest).decode("utf-8-sig", errors="replace")


def resolved(path: Path) -> Path:
    """The path without symbolic links. Raises OSError for links that lead in a circle, whatever the Python version."""
    try:
        return Path(path).resolve()
    except RuntimeError:
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path)) from None
    except ValueError as error:  # a NUL in the name
        raise OSError(errno.EINVAL, str(error), str(path)) from None
