"""Checkpoints: one file each with everything from which a run goes on, whole or not there, the last few kept.

The format is npz without pickle: numpy reads it on every machine, it needs no further package, it is written in one
go, and nothing in it can be made to run. (h5py is a large dependency, and a file that is damaged when the process is
killed while it writes; zarr is many files, which cannot be renamed together.) A text in JSON stands beside the arrays:
versions, scene, and all that is no array. The archive's comment, its last bytes, is the SHA-256 of all bytes before
it, so that a file cut short or with a flipped bit is known before anything of it is believed.
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
from granflow.observe.checkpoint_archive import ARRAYS, HEADER, ArchiveError, read_archive
from granflow.observe.files import replacing
from granflow.observe.log import version_of
from granflow.regular_files import open_regular

FORMAT = 3
"""Version of what a checkpoint holds. Another one is refused: nothing is guessed."""

PATTERN = "checkpoint_*.npz"
CHECKSUM_PLACEHOLDER = b"0" * (2 * hashlib.sha256().digest_size)
READ_SIZE = 2**20
"""Bytes that are read at a time to take the checksum."""


class CheckpointError(GranflowError):
    """A checkpoint that cannot be used; the message says which and why."""


class DamagedCheckpoint(CheckpointError):
    """A checkpoint whose bytes are not those that were written: the one before takes its place."""


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint that was read: its file, the version of granflow and the scene it was written with, and the rest.

    `saved`: numbers, texts and numpy arrays in dictionaries within dictionaries.
    """

    path: Path
    version: str
    scene: str
    time: float
    saved: dict[str, Any]


def write_checkpoint(directory: Path, scene: str, time: float, step: int, saved: dict[str, Any]) -> Path:
    """Write `checkpoint_STEP.npz`, whole or not at all, and onto the disk before it gets its name."""
    path = Path(directory) / f"checkpoint_{step:012d}.npz"
    plain, arrays = _split_arrays(saved)
    header = {"format": FORMAT, "granflow": version_of("granflow"), "time": time, "scene": scene, "saved": plain}
    with replacing(path, durable=True) as temporary:
        with zipfile.ZipFile(temporary, "w") as archive:
            archive.comment = CHECKSUM_PLACEHOLDER
            archive.writestr(zipfile.ZipInfo(HEADER), json.dumps(header))
            for name, array in arrays.items():
                # Given a bare name, zipfile asks for the date, and fails where the computer's clock stands before 1980.
                with archive.open(zipfile.ZipInfo(name + ARRAYS), "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)
        with open(temporary, "r+b") as file:
            checksum = _checksum(file)
            file.write(checksum)
    return path


def read_checkpoint(path: Path) -> Checkpoint:
    """Read one. Raises DamagedCheckpoint, or CheckpointError for another format and where the system cannot read it."""
    try:
        with open_regular(path) as file:
            if _checksum(file) != file.read(len(CHECKSUM_PLACEHOLDER) + 1):
                raise DamagedCheckpoint(f"{path} is damaged: it is cut short, or bits of it have changed.")
            return _from_archive(path, *read_archive(file))
    except ArchiveError as error:
        raise DamagedCheckpoint(f"{path} {error}. Remove it to use the checkpoint before it.") from None
    except OSError as error:
        raise CheckpointError(
            f"{path} cannot be read: {error.strerror or error}. Make it readable, then try again."
        ) from error


def checkpoints(directory: Path) -> list[Path]:
    """The checkpoints in a directory, the newest first."""
    return sorted(Path(directory).glob(PATTERN), reverse=True)


def newest_checkpoint(directory: Path) -> tuple[Checkpoint | None, list[str]]:
    """The newest that is whole, if there is one, and a sentence for each damaged one after it.

    Raises CheckpointError for an intact one that this version or this user cannot read: older ones are no substitute.
    """
    skipped: list[str] = []
    for path in checkpoints(directory):
        try:
            return read_checkpoint(path), skipped
        except DamagedCheckpoint as error:
            skipped.append(str(error))
    return None, skipped


def remove_after(directory: Path, path: Path | None) -> None:
    """Remove the checkpoints after this one, which could not be read, or all: what comes now must be the newest."""
    for other in checkpoints(directory):
        if path is None or other.name > path.name:
            other.unlink()


def remove_old_checkpoints(directory: Path, count: int) -> None:
    """Remove all checkpoints but the newest `count`."""
    for path in checkpoints(directory)[count:]:
        path.unlink(missing_ok=True)


def _from_archive(path: Path, header: dict[str, Any], arrays: dict[str, np.ndarray]) -> Checkpoint:
    """The checkpoint, its arrays back in their places. Raises ArchiveError where the header has other keys or types."""
    version, scene, time = header.get("granflow"), header.get("scene"), header.get("time")
    if header.get("format") != FORMAT:
        raise CheckpointError(
            f"{path} is in format {header.get('format')!r:.40}, written by granflow {version!s:.40}; granflow "
            f"{version_of('granflow')} reads format {FORMAT}. Resume with the version that wrote it."
        )
    saved = header.get("saved")
    if not (isinstance(version, str) and isinstance(scene, str) and isinstance(saved, dict)):
        raise ArchiveError("lacks the version, the scene or the state of the run")
    if not (isinstance(time, int | float) and isfinite(time)):
        raise ArchiveError("lacks the time of the run")
    for name, array in arrays.items():
        _insert_array(saved, name, array)
    return Checkpoint(path, version, scene, time, saved)


def _checksum(file: BinaryIO) -> bytes:
    """Checksum of all but the room for it at the end, to whose beginning the file is moved."""
    end = max(file.seek(0, 2) - len(CHECKSUM_PLACEHOLDER), 0)
    file.seek(0)
    digest = hashlib.sha256()
    while file.tell() < end:
        digest.update(file.read(min(READ_SIZE, end - file.tell())))
    return digest.hexdigest().encode()


def _split_arrays(saved: dict[str, Any], path: str = "") -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The same dictionaries without arrays, and the arrays by their path of keys."""
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
    *parents, key = path.split("/")
    for name in parents:
        saved = saved.get(name)  # type: ignore[assignment]
        if not isinstance(saved, dict):
            raise ArchiveError(f"has the unexpected entry {path[:80]}")
    if key in saved:
        raise ArchiveError(f"has two values for {path[:80]}")
    saved[key] = array
