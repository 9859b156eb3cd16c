"""One file of a checkpoint: an archive of a JSON header and arrays, with a checksum of all its bytes.

The format is npz without pickle: numpy reads it on every machine, it requires no further package, it is written in one
pass, and it cannot execute code. (h5py is a large dependency, and its file is damaged if the process is killed during
a write; zarr consists of many files, which cannot be renamed together.) The comment of the archive, its last bytes, is
the SHA-256 of all preceding bytes: a truncated file or a flipped bit is detected before the content is used.
"""

import hashlib
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from granflow.errors import GranflowError
from granflow.io.atomic_files import replacing
from granflow.io.checkpoint_archive import ARRAYS, HEADER, read_archive
from granflow.io.regular_files import FormatError, open_regular

CHECKSUM_PLACEHOLDER = b"0" * (2 * hashlib.sha256().digest_size)
"""Comment of the archive while it is written; the hexadecimal SHA-256 of the same length replaces it."""

READ_SIZE = 2**20
"""Bytes read at a time for the checksum."""


class CheckpointError(GranflowError):
    """A checkpoint that cannot be used; the message says which and why."""


class DamagedCheckpoint(CheckpointError):
    """A checkpoint whose bytes differ from those written; the previous checkpoint replaces it."""


def write_file(path: Path, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> str:
    """Write a file atomically: it is on the disk before it gets its name. Return its checksum.

    `arrays`: by key path, numeric types, no objects. Raises OSError if the file cannot be written.
    """
    with replacing(path, durable=True) as temporary:
        with zipfile.ZipFile(temporary, "w") as archive:
            archive.comment = CHECKSUM_PLACEHOLDER
            archive.writestr(zipfile.ZipInfo(HEADER), json.dumps(header))
            for name, array in arrays.items():
                # With a bare name, zipfile uses the current date and fails if the system clock is before 1980.
                with archive.open(zipfile.ZipInfo(name + ARRAYS), "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)
        with open(temporary, "r+b") as file:
            checksum = _checksum(file)
            file.write(checksum)
    return checksum.decode()


def read_file(
    path: Path, expected: str | None = None, with_arrays: bool = True
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the header and the arrays by key path, writable and in the byte order of the machine.

    The checksum is verified before the content is parsed. `expected`: checksum that the file must have, if not None;
    `with_arrays`: whether the arrays are read. Raises DamagedCheckpoint for a truncated or modified file, and
    CheckpointError for an unreadable one.
    """
    try:
        with open_regular(path) as file:
            found = _checksum(file)
            if found != file.read(len(CHECKSUM_PLACEHOLDER) + 1) or expected not in (None, found.decode()):
                remedy = " Remove it to use the checkpoint before it." if expected else ""
                raise DamagedCheckpoint(f"{path} is damaged: it is truncated, or its bytes have changed.{remedy}")
            return read_archive(file, with_arrays)
    except FormatError as error:
        raise damaged(path, str(error)) from None
    except OSError as error:
        raise CheckpointError(
            f"{path} cannot be read: {error.strerror or error}. Make it readable, then try again."
        ) from error


def damaged(path: Path, predicate: str) -> DamagedCheckpoint:
    """The error for a file of which the predicate is true."""
    return DamagedCheckpoint(f"{path} {predicate}. Remove it to use the checkpoint before it.")


def recorded_checksum(path: Path) -> str:
    """The checksum at the end of a file, which is not verified here. Raises OSError."""
    with open_regular(path) as file:
        file.seek(max(file.seek(0, 2) - len(CHECKSUM_PLACEHOLDER), 0))
        return file.read(len(CHECKSUM_PLACEHOLDER)).decode(errors="replace")


def _checksum(file: BinaryIO) -> bytes:
    """Return the checksum of all bytes before the placeholder at the end; leave the file position there."""
    end = max(file.seek(0, 2) - len(CHECKSUM_PLACEHOLDER), 0)
    file.seek(0)
    digest = hashlib.sha256()
    while file.tell() < end:
        digest.update(file.read(min(READ_SIZE, end - file.tell())))
    return digest.hexdigest().encode()


def split_arrays(saved: Mapping[str, Any], path: str = "") -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the nested dictionaries without arrays, and the arrays by their key paths, such as engine/particles/id."""
    plain: dict[str, Any] = {}
    arrays: dict[str, np.ndarray] = {}
    for key, value in saved.items():
        if isinstance(value, dict):
            plain[key], within = split_arrays(value, f"{path}{key}/")
            arrays |= within
        elif isinstance(value, np.ndarray):
            arrays[f"{path}{key}"] = value
        else:
            plain[key] = value
    return plain, arrays


def insert_array(saved: dict[str, Any], path: str, array: np.ndarray) -> None:
    """Insert the array at the key path. Raises FormatError for a path that does not exist or is taken."""
    *parents, key = path.split("/")
    for name in parents:
        saved = saved.get(name)  # type: ignore[assignment]
        if not isinstance(saved, dict):
            raise FormatError(f"has the unexpected entry {path[:80]}")
    if key in saved:
        raise FormatError(f"has two values for {path[:80]}")
    saved[key] = array
