"""Checkpoints: one file with the complete state of a run, written atomically; the newest few are kept.

The format is npz without pickle: numpy reads it on every machine, it requires no further package, it is written in one
pass, and it cannot execute code. (h5py is a large dependency, and its file is damaged if the process is killed during
a write; zarr consists of many files, which cannot be renamed together.) A JSON header accompanies the arrays: versions,
scene, and all values that are not arrays. The comment of the archive, its last bytes, is the SHA-256 of all preceding
bytes: a truncated file or a flipped bit is detected before the content is used.
"""

import hashlib
import json
import zipfile
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from granflow.errors import GranflowError
from granflow.io.atomic_files import replacing
from granflow.io.checkpoint_archive import ARRAYS, HEADER, read_archive
from granflow.io.log import version_of
from granflow.io.regular_files import FormatError, open_regular

FORMAT = 6
"""Version of the content of a checkpoint. Files of other versions are refused."""

PATTERN = "checkpoint_*.npz"
"""Names of checkpoint files; the number is the step, with leading zeros, so that names sort by time."""

CHECKSUM_PLACEHOLDER = b"0" * (2 * hashlib.sha256().digest_size)
"""Comment of the archive while it is written; the hexadecimal SHA-256 of the same length replaces it."""

READ_SIZE = 2**20
"""Bytes read at a time for the checksum."""


class CheckpointError(GranflowError):
    """A checkpoint that cannot be used; the message says which and why."""


class DamagedCheckpoint(CheckpointError):
    """A checkpoint whose bytes differ from those written; the previous checkpoint replaces it."""


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint read from a file.

    `path`: file; `version`: of granflow that wrote it; `scene`: YAML text; `time`: simulated time [s]; `saved`: state,
    as nested dictionaries of numbers, texts and numpy arrays.
    """

    path: Path
    version: str
    scene: str
    time: float
    saved: dict[str, Any]


def write_checkpoint(directory: Path, scene: str, time: float, step: int, saved: dict[str, Any]) -> Path:
    """Write `checkpoint_STEP.npz` atomically: the file is on the disk before it gets its name. Return its path.

    `scene`: YAML text of the resolved scene; `time` [s] and `step`: of the state; `saved`: nested dictionaries with
    text keys of numbers, texts, lists and numpy arrays (numeric types, no objects). An existing file of the same step
    is replaced. Raises OSError if the file cannot be written; an older file then stays unchanged.
    """
    path = Path(directory) / f"checkpoint_{step:012d}.npz"
    plain, arrays = _split_arrays(saved)
    header = {"format": FORMAT, "granflow": version_of("granflow"), "time": time, "scene": scene, "saved": plain}
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
    return path


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint.

    The checksum is verified before the content is parsed; arrays are writable and in the byte order of the machine.

    Raises DamagedCheckpoint for a truncated or modified file, and CheckpointError for another format version or an
    unreadable file.
    """
    try:
        with open_regular(path) as file:
            if _checksum(file) != file.read(len(CHECKSUM_PLACEHOLDER) + 1):
                raise DamagedCheckpoint(f"{path} is damaged: it is truncated, or its bytes have changed.")
            return _from_archive(path, *read_archive(file))
    except FormatError as error:
        raise DamagedCheckpoint(f"{path} {error}. Remove it to use the checkpoint before it.") from None
    except OSError as error:
        raise CheckpointError(
            f"{path} cannot be read: {error.strerror or error}. Make it readable, then try again."
        ) from error


def checkpoints(directory: Path) -> list[Path]:
    """Return the checkpoint files in a directory, the newest first, by the step in the name."""
    return sorted(Path(directory).glob(PATTERN), reverse=True)


def newest_checkpoint(directory: Path) -> tuple[Checkpoint | None, list[str]]:
    """Return the newest intact checkpoint, or None, and a sentence for each newer damaged one.

    Raises CheckpointError for an intact one that this version or this user cannot read: an older one is no substitute.
    """
    skipped: list[str] = []
    for path in checkpoints(directory):
        try:
            return read_checkpoint(path), skipped
        except DamagedCheckpoint as error:
            skipped.append(str(error))
    return None, skipped


def checkpoint_at(path: Path | str) -> Checkpoint:
    """Return the checkpoint in a file, or the newest intact one in the directory of a run.

    Raises CheckpointError for a damaged file, or a directory without a usable checkpoint.
    """
    path = Path(path)
    if not path.exists():
        raise CheckpointError(
            f"{path}: there is no such file or directory; give a checkpoint or the directory of a run."
        )
    if not path.is_dir():
        return read_checkpoint(path)
    found, damaged = newest_checkpoint(path)
    if found is None:
        reason = (
            damaged[0]
            if damaged
            else ("a run writes them at its end, when it is stopped, and as set in output.checkpoint.")
        )
        raise CheckpointError(f"{path} contains no usable checkpoint: {reason}")
    return found


def remove_after(directory: Path, path: Path | None) -> None:
    """Remove the checkpoints after `path`, or all if None, so that the next one written is the newest.

    "After" refers to the step in the file name, not to the modification time.
    """
    for other in checkpoints(directory):
        if path is None or other.name > path.name:
            other.unlink()


def remove_old_checkpoints(directory: Path, count: int) -> None:
    """Remove all checkpoints except the newest `count`; a file that another process has already removed is skipped."""
    for path in checkpoints(directory)[count:]:
        path.unlink(missing_ok=True)


def _from_archive(path: Path, header: dict[str, Any], arrays: dict[str, np.ndarray]) -> Checkpoint:
    """Return the checkpoint with its arrays. Raises FormatError if the header has unexpected keys or types."""
    version, scene, time = header.get("granflow"), header.get("scene"), header.get("time")
    if header.get("format") != FORMAT:
        raise CheckpointError(
            f"{path} is in format {header.get('format')!r:.40}, written by granflow {version!s:.40}; granflow "
            f"{version_of('granflow')} reads format {FORMAT}. Resume with the version that wrote it."
        )
    saved = header.get("saved")
    if not (isinstance(version, str) and isinstance(scene, str) and isinstance(saved, dict)):
        raise FormatError("lacks the version, the scene or the state of the run")
    if not (isinstance(time, int | float) and isfinite(time)):
        raise FormatError("lacks the time of the run")
    for name, array in arrays.items():
        _insert_array(saved, name, array)
    return Checkpoint(path, version, scene, time, saved)


def _checksum(file: BinaryIO) -> bytes:
    """Return the checksum of all bytes before the placeholder at the end; leave the file position there."""
    end = max(file.seek(0, 2) - len(CHECKSUM_PLACEHOLDER), 0)
    file.seek(0)
    digest = hashlib.sha256()
    while file.tell() < end:
        digest.update(file.read(min(READ_SIZE, end - file.tell())))
    return digest.hexdigest().encode()


def _split_arrays(saved: dict[str, Any], path: str = "") -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the nested dictionaries without arrays, and the arrays by their key paths, such as engine/particles/id."""
    plain: dict[str, Any] = {}
    arrays: dict[str, np.ndarray] = {}
    for key, value in saved.items():
        if isinstance(value, dict):
            plain[key], within = _split_arrays(value, f"{path}{key}/")
            arrays |= within
        elif isinstance(value, np.ndarray):
            arrays[f"{path}{key}"] = value
        else:
            plain[key] = value
    return plain, arrays


def _insert_array(saved: dict[str, Any], path: str, array: np.ndarray) -> None:
    """Insert the array at the key path. Raises FormatError for a path that does not exist or is taken."""
    *parents, key = path.split("/")
    for name in parents:
        saved = saved.get(name)  # type: ignore[assignment]
        if not isinstance(saved, dict):
            raise FormatError(f"has the unexpected entry {path[:80]}")
    if key in saved:
        raise FormatError(f"has two values for {path[:80]}")
    saved[key] = array
