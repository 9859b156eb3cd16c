"""Reads the zip archive of a checkpoint without trusting any size, count or name in the file.

granflow stores the entries without compression, so their total size never exceeds that of the file: because the reader
refuses compressed entries, it allocates no more memory than the file has bytes.
"""

import json
import math
import struct
import tokenize
import zipfile
from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np

from granflow.io.regular_files import FormatError

HEADER, ARRAYS = "header.json", ".npy"
"""Name of the JSON entry, and suffix of the entries of arrays."""


MOST_ENTRIES = 100_000
"""Largest number of entries of an archive."""

LARGEST_HEADER = 2**28
"""Largest size of the JSON header [bytes]; it contains the history of each flow meter, one entry per CSV row."""

MOST_AXES = 3
"""Largest number of axes of an array."""

LARGEST_ITEM = 8
"""Largest size of one number [bytes]."""


def read_archive(file: BinaryIO, with_arrays: bool = True) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the JSON header and the arrays by name, without the suffix ".npy"; without arrays, none.

    `file`: seekable binary file. Arrays have at most three axes, C order and a native boolean, integer or real type of
    at most 8 bytes.

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
    """Yield a predicate for each limit that the entries exceed; `file_size` [bytes] bounds their total size."""
    if len(entries) > MOST_ENTRIES:
        yield f"has {len(entries)} entries, more than {MOST_ENTRIES}"
    for entry in entries:
        if entry.compress_type != zipfile.ZIP_STORED or entry.compress_size != entry.file_size:
            yield f"has the compressed entry {entry.filename[:80]}, but checkpoints are written without compression"
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
        numbers = dtype.kind in "bif" and dtype.itemsize <= LARGEST_ITEM and dtype.isnative and dtype.shape == ()
        if not numbers or len(shape) > MOST_AXES or by_column or min(shape, default=0) < 0:
            raise FormatError(f"has the entry {entry.filename[:80]} with the unexpected type {dtype} or shape {shape}")
        size = math.prod(shape) * dtype.itemsize
        if size != entry.file_size - member.tell():
            raise FormatError(f"has the entry {entry.filename[:80]} whose length does not match its shape {shape}")
        return np.frombuffer(bytearray(member.read()), dtype).reshape(shape)
