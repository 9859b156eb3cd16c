"""One file of a checkpoint: an archive of a JSON header and arrays, with a checksum of all its bytes.

The format is npz without pickle: numpy reads it on every machine, it requires no further package, it is
written in one pass, and it cannot execute code. (h5py is a large dependency, and its file is damaged if the
process is killed during a write; zarr consists of many files, which cannot be renamed together.) The comment
of the archive, its last bytes, is the SHA-256 of all preceding bytes: a truncated file or a flipped bit is
detected before the content is used.
"""

import hashlib
import json
import math
import struct
import tokenize
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from granflow.errors import GranflowError
from granflow.io.files import FormatError, open_regular, replacing

# Reads the zip archive of a checkpoint without trusting any size, count or name in the file.
#
# granflow stores the entries without compression, so their total size never exceeds that of the file:
# because the reader refuses compressed entries, it allocates no more memory than the file has bytes.

HEADER, ARRAYS = "header.json", ".npy"
"""Name of the JSON entry, and suffix of the entries of arrays."""
MOST_ENTRIES = 100_000
"""Largest number of entries of an archive."""
LARGEST_HEADER = 2**28
"""Largest size of the JSON header [bytes]; it contains the history of each flow meter, one entry per CSV
row."""
MOST_AXES = 3
"""Largest number of axes of an array."""
LARGEST_ITEM = 8
"""Largest size of one number [bytes]."""


def read_archive(file: BinaryIO, with_arrays: bool = True) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the JSON header and the arrays by name, without the suffix ".npy"; without arrays, none.

    `file`: seekable binary file. Arrays have at most three axes, C order and a native boolean, integer or
    real type of at most 8 bytes.

    Raises FormatError if the archive differs from what `write_checkpoint` writes, or OSError if the file is
    unreadable.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            entries = _entries(archive, file.seek(0, 2))
            header = json.loads(archive.read(entries.pop(HEADER)))
            arrays = {name: _array(archive, entry) for name, entry in entries.items() if with_arrays}
    except OSError:
        raise
    except RecursionError:
        raise FormatError("has a header that is nested too deeply") from None
    except (zipfile.BadZipFile, struct.error, KeyError, ValueError, ArithmeticError) as error:
        raise FormatError(f"is not a checkpoint: {error}") from None
    except (RuntimeError, EOFError, MemoryError, SyntaxError, TypeError, tokenize.TokenError) as error:
        raise FormatError(f"is not a checkpoint: {error}") from None
    if not isinstance(header, dict):
        raise FormatError("has a header that is not a mapping")
    return header, arrays


def _entries(archive: zipfile.ZipFile, file_size: int) -> dict[str, zipfile.ZipInfo]:
    """Return the entries by name, without ".npy".

    Raises FormatError for compressed, oversized or duplicate entries.
    """
    found: dict[str, zipfile.ZipInfo] = {}
    for problem in _problems(archive.infolist(), file_size):
        raise FormatError(problem)
    for entry in archive.infolist():
        name = entry.filename if entry.filename == HEADER else entry.filename.removesuffix(ARRAYS)
        if name in found or (name == entry.filename) != (name == HEADER):
            raise FormatError(f"has the unexpected entry {entry.filename[:80]}")
        found[name] = entry
    return found


def _problems(entries: list[zipfile.ZipInfo], file_size: int) -> Iterator[str]:
    """Yield a predicate for each limit that the entries exceed; `file_size` [bytes] bounds their total
    size."""
    if len(entries) > MOST_ENTRIES:
        yield f"has {len(entries)} entries, more than {MOST_ENTRIES}"
    for entry in entries:
        if entry.compress_type != zipfile.ZIP_STORED or entry.compress_size != entry.file_size:
            yield (
                f"has the compressed entry {entry.filename[:80]}, but checkpoints are written without "
                "compression"
            )
        if entry.filename == HEADER and entry.file_size > LARGEST_HEADER:
            yield f"has a header of {entry.file_size} bytes, more than {LARGEST_HEADER}"
    total = sum(entry.file_size for entry in entries)
    if total > file_size:
        yield f"has entries of {total} bytes, but only {file_size} bytes"


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    """Return one numeric array; the size of its entry must match its type and shape exactly."""
    with archive.open(entry) as member:
        version = np.lib.format.read_magic(member)
        if version != (1, 0):
            raise FormatError(f"has the entry {entry.filename[:80]} in npy version {version}, not (1, 0)")
        shape, by_column, dtype = np.lib.format.read_array_header_1_0(member)
        numbers = (
            dtype.kind in "bif" and dtype.itemsize <= LARGEST_ITEM and dtype.isnative and dtype.shape == ()
        )
        if not numbers or len(shape) > MOST_AXES or by_column or min(shape, default=0) < 0:
            raise FormatError(
                f"has the entry {entry.filename[:80]} with the unexpected type {dtype} or shape {shape}"
            )
        size = math.prod(shape) * dtype.itemsize
        if size != entry.file_size - member.tell():
            raise FormatError(
                f"has the entry {entry.filename[:80]} whose length does not match its shape {shape}"
            )
        return np.frombuffer(bytearray(member.read()), dtype).reshape(shape)


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
                # With a bare name, zipfile uses the current date and fails if the system clock is before
                # 1980.
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

    The checksum is verified before the content is parsed. `expected`: checksum that the file must have, if
    not None; `with_arrays`: whether the arrays are read. Raises DamagedCheckpoint for a truncated or modified
    file, and CheckpointError for an unreadable one.
    """
    try:
        with open_regular(path) as file:
            found = _checksum(file)
            if found != file.read(len(CHECKSUM_PLACEHOLDER) + 1) or expected not in (None, found.decode()):
                remedy = " Remove it to use the checkpoint before it." if expected else ""
                raise DamagedCheckpoint(
                    f"{path} is damaged: it is truncated, or its bytes have changed.{remedy}"
                )
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
    """Return the nested dictionaries without arrays, and the arrays by their key paths, such as
    engine/particles/id."""
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
