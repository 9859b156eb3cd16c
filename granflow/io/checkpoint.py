"""Checkpoints: the complete state of a run, written atomically; the newest few are kept.

A checkpoint is one file, with a JSON header: versions, scene, and all values that are not arrays. On MPI ranks it has
the particles of the root, and names a file of each other rank, see `rank_files`.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import isfinite
from pathlib import Path
from typing import Any, Literal

import numpy as np

from granflow.io.checkpoint_file import (
    CheckpointError,
    DamagedCheckpoint,
    damaged,
    insert_array,
    read_file,
    split_arrays,
    write_file,
)
from granflow.io.log import version_of
from granflow.io.rank_files import RankFile, listed_files, refuse_missing, remove_unused, with_rank_files
from granflow.io.regular_files import FormatError

FORMAT = 12
"""Version of the content of a checkpoint. Files of other versions are refused."""

PATTERN = "checkpoint_*.npz"
"""Names of checkpoint files; the number is the step, with leading zeros, so that names sort by time."""

ENGINE_SOURCES = (
    *("contact", "device_functions.py", "engine", "fields", "geometry", "kernel_language.py", "live", "parallel"),
    *("particles", "plan"),
)
"""Parts of the package that determine the motion of a run."""

DIGEST_LENGTH = 12
"""Number of hexadecimal digits of a digest of sources."""

Content = Literal["all", "root", "header"]
"""What is read: the arrays of all files, those of the file of the root, or none."""


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint read from a file.

    `path`: file; `version`: of granflow that wrote it; `engine`: digest of its sources, see `engine_digest`;
    `scene`: YAML text; `time`: simulated time [s]; `saved`: state,
    as nested dictionaries of numbers, texts and numpy arrays; `rank_files`: those with particles that `saved` lacks.
    """

    path: Path
    version: str
    scene: str
    time: float
    saved: dict[str, Any]
    rank_files: tuple[RankFile, ...] = ()
    engine: str = ""


@cache
def engine_digest() -> str:
    """Start of the SHA-256 of the sources of the engine, at the first call: a run loads its modules before."""
    return digest_of_sources(Path(__file__).parents[1], ENGINE_SOURCES)


def digest_of_sources(package: Path, names: Sequence[str]) -> str:
    """Start of the SHA-256 of the names and contents of Python files, given folders and files in a package."""
    digest = hashlib.sha256()
    found = (
        path
        for name in names
        for path in ([package / name] if name.endswith(".py") else (package / name).rglob("*.py"))
    )
    for path in sorted(found):
        digest.update(f"{path.relative_to(package).as_posix()}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:DIGEST_LENGTH]


def write_checkpoint(directory: Path, scene: str, time: float, step: int, saved: dict[str, Any]) -> Path:
    """Write `checkpoint_STEP.npz` atomically: the file is on the disk before it gets its name. Return its path.

    `scene`: YAML text of the resolved scene; `time` [s] and `step`: of the state; `saved`: nested dictionaries with
    text keys of numbers, texts, lists and numpy arrays (numeric types, no objects). An existing file of the same step
    is replaced. Raises OSError if the file cannot be written; an older file then stays unchanged.
    """
    path = Path(directory) / f"checkpoint_{step:012d}.npz"
    plain, arrays = split_arrays(saved)
    header = {"format": FORMAT, "granflow": version_of("granflow"), "engine": engine_digest()}
    header |= {"time": time, "scene": scene, "saved": plain}
    write_file(path, header, arrays)
    return path


def read_checkpoint(path: Path, content: Content = "all") -> Checkpoint:
    """Read a checkpoint; with "all", the particles of the root are first.

    Raises DamagedCheckpoint for a truncated, modified or missing file, and CheckpointError for another format version
    or an unreadable file.
    """
    header, arrays = read_file(path, with_arrays=content != "header")
    try:
        files = listed_files(Path(path).parent, _rank_entries(header))
        refuse_missing(path, files)
        if content == "all":
            arrays, files = with_rank_files(arrays, files), ()
        return _from_archive(path, header, arrays, files)
    except FormatError as error:
        raise damaged(path, str(error)) from None


def _rank_entries(header: dict[str, Any]) -> Any:
    """The entries of the files of ranks in the header; another format or header is refused later."""
    saved = header.get("saved")
    return saved.get("rank_files", []) if isinstance(saved, dict) and header.get("format") == FORMAT else []


def checkpoints(directory: Path) -> list[Path]:
    """Return the checkpoint files in a directory, the newest first, by the step in the name."""
    return sorted(Path(directory).glob(PATTERN), reverse=True)


def newest_checkpoint(directory: Path, content: Content = "all") -> tuple[Checkpoint | None, list[str]]:
    """Return the newest intact checkpoint, or None, and a sentence for each newer damaged one.

    Raises CheckpointError for an intact one that this version or this user cannot read: an older one is no substitute.
    """
    skipped: list[str] = []
    for path in checkpoints(directory):
        try:
            return read_checkpoint(path, content), skipped
        except DamagedCheckpoint as error:
            skipped.append(str(error))
    return None, skipped


def checkpoint_at(path: Path | str, content: Content = "all") -> Checkpoint:
    """Return the checkpoint in a file, or the newest intact one in the directory of a run.

    Raises CheckpointError for a damaged file, or a directory without a usable checkpoint.
    """
    path = Path(path)
    if not path.exists():
        raise CheckpointError(
            f"{path}: there is no such file or directory; give a checkpoint or the directory of a run."
        )
    if not path.is_dir():
        return read_checkpoint(path, content)
    found, skipped = newest_checkpoint(path, content)
    if found is None:
        reason = (
            skipped[0]
            if skipped
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
    remove_unused(directory, map(_step_of, checkpoints(directory)))


def remove_old_checkpoints(directory: Path, count: int) -> None:
    """Remove all checkpoints except the newest `count`; a file that another process has already removed is skipped."""
    for path in checkpoints(directory)[count:]:
        path.unlink(missing_ok=True)
    remove_unused(directory, map(_step_of, checkpoints(directory)))


def _step_of(path: Path) -> int:
    """The step in the name of a checkpoint; -1 for another file."""
    digits = path.stem.partition("_")[2]
    return int(digits) if digits.isdecimal() else -1


def _from_archive(
    path: Path, header: dict[str, Any], arrays: dict[str, np.ndarray], rank_files: tuple[RankFile, ...]
) -> Checkpoint:
    """Return the checkpoint with its arrays. Raises FormatError if the header has unexpected keys or types."""
    version, scene, time = header.get("granflow"), header.get("scene"), header.get("time")
    if header.get("format") != FORMAT:
        raise CheckpointError(
            f"{path} is in format {header.get('format')!r:.40}, written by granflow {version!s:.40}; granflow "
            f"{version_of('granflow')} reads format {FORMAT}. Resume with the version that wrote it."
        )
    saved, engine = header.get("saved"), header.get("engine")
    if not (
        isinstance(version, str) and isinstance(scene, str) and isinstance(engine, str) and isinstance(saved, dict)
    ):
        raise FormatError("lacks the version, the scene or the state of the run")
    if not (isinstance(time, int | float) and isfinite(time)):
        raise FormatError("lacks the time of the run")
    for name, array in arrays.items():
        insert_array(saved, name, array)
    return Checkpoint(path, version, scene, time, saved, rank_files, engine)
