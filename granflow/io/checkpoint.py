"""Checkpoints: the complete state of a run, written atomically; the newest few are kept.

A checkpoint is one file, with a JSON header: versions, scene, and all values that are not arrays. On MPI
ranks it has the particles of the root, and names a file of each other rank, see `rank_files`.
"""

import hashlib
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from math import inf, isfinite, isnan
from pathlib import Path
from typing import Any, Literal

import numpy as np

from granflow.io.archive import (
    CheckpointError,
    DamagedCheckpoint,
    damaged,
    insert_array,
    read_file,
    split_arrays,
    write_file,
)
from granflow.io.files import FormatError
from granflow.io.log import version_of
from granflow.io.rank_files import RankFile, listed_files, refuse_missing, remove_unused, with_rank_files

FORMAT = 12
"""Version of the content of a checkpoint. Files of other versions are refused."""
PATTERN = "checkpoint_*.npz"
"""Names of checkpoint files; the number is the step, with leading zeros, so that names sort by time."""
ENGINE_SOURCES = (
    "contact",
    "device_functions.py",
    "engine",
    "fields",
    "geometry",
    "kernel_language.py",
    "live",
    "parallel",
    "particles",
    "plan",
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
    as nested dictionaries of numbers, texts and numpy arrays; `rank_files`: those with particles that `saved`
    lacks.
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
    """Start of the SHA-256 of the sources of the engine, at the first call: a run loads its modules
    before."""
    return digest_of_sources(Path(__file__).parents[1], ENGINE_SOURCES)


def digest_of_sources(package: Path, names: Sequence[str]) -> str:
    """Start of the SHA-256 of the names and contents of Python files, given folders and files in a
    package."""
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
    """Write `checkpoint_STEP.npz` atomically: the file is on the disk before it gets its name. Return its
    path.

    `scene`: YAML text of the resolved scene; `time` [s] and `step`: of the state; `saved`: nested
    dictionaries with text keys of numbers, texts, lists and numpy arrays (numeric types, no objects). An
    existing file of the same step is replaced. Raises OSError if the file cannot be written; an older file
    then stays unchanged.
    """
    path = Path(directory) / f"checkpoint_{step:012d}.npz"
    plain, arrays = split_arrays(saved)
    header = {"format": FORMAT, "granflow": version_of("granflow"), "engine": engine_digest()}
    header |= {"time": time, "scene": scene, "saved": plain}
    write_file(path, header, arrays)
    return path


def read_checkpoint(path: Path, content: Content = "all") -> Checkpoint:
    """Read a checkpoint; with "all", the particles of the root are first.

    Raises DamagedCheckpoint for a truncated, modified or missing file, and CheckpointError for another format
    version or an unreadable file.
    """
    header, arrays = read_file(path, with_arrays=content != "header")
    try:
        files = listed_files(Path(path).parent, _rank_entries(header))
        refuse_missing(path, files)
        if content == "all":
            arrays = with_rank_files(arrays, files)
            files = ()
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

    Raises CheckpointError for an intact one that this version or this user cannot read: an older one is no
    substitute.
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
    """Remove all checkpoints except the newest `count`; a file that another process has already removed is
    skipped."""
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
    """Return the checkpoint with its arrays. Raises FormatError if the header has unexpected keys or
    types."""
    version = header.get("granflow")
    scene = header.get("scene")
    time = header.get("time")
    if header.get("format") != FORMAT:
        raise CheckpointError(
            f"{path} is in format {header.get('format')!r:.40}, written by granflow {version!s:.40}; "
            f"granflow {version_of('granflow')} reads format {FORMAT}. Resume with the version that wrote it."
        )
    saved = header.get("saved")
    engine = header.get("engine")
    if not (
        isinstance(version, str)
        and isinstance(scene, str)
        and isinstance(engine, str)
        and isinstance(saved, dict)
    ):
        raise FormatError("lacks the version, the scene or the state of the run")
    if not (isinstance(time, int | float) and isfinite(time)):
        raise FormatError("lacks the time of the run")
    for name, array in arrays.items():
        insert_array(saved, name, array)
    return Checkpoint(path, version, scene, time, saved, rank_files, engine)


# A value of a checkpoint with its key path; each check raises CheckpointError with the file, key and value.
#
# A checkpoint may be crafted, including its checksum. No value is used before its type and range are
# checked.

SHOWN = 60
"""Largest number of characters of a value in a message."""
LARGEST_REAL = float(np.finfo(np.float32).max)
"""Largest magnitude of physical quantities: larger ones overflow in single precision."""
LARGEST_COUNT = 2**53
"""Largest number of steps or of collisions: larger ones are not exact in double precision."""


@dataclass(frozen=True)
class Part:
    """A value in a checkpoint: `file` of the checkpoint, `key` such as engine/particles/id, `value` as
    read."""

    file: Path
    key: str
    value: Any

    @classmethod
    def of(cls, checkpoint: Checkpoint) -> "Part":
        """Return the complete state in a checkpoint."""
        return cls(checkpoint.path, "", checkpoint.saved)

    def __getitem__(self, name: str) -> "Part":
        """Return the entry `name` of a mapping. Raises CheckpointError if the value is not a mapping or lacks
        it."""
        values = self.mapping()
        if name not in values:
            raise self.error(f"lacks {name}")
        return self._within(name, values[name])

    def error(self, predicate: str) -> CheckpointError:
        """Return the error to raise; `predicate` follows the key in the message."""
        return CheckpointError(
            f"{self.file}: {self.key or 'the state'} {predicate}, so the file is damaged or belongs to "
            "another scene. Remove it to use the checkpoint before it."
        )

    def mismatch(self, expected: str) -> CheckpointError:
        """Return the error for a value other than `expected`."""
        array = isinstance(self.value, np.ndarray)
        shown = f"an array {self.value.shape} of {self.value.dtype}" if array else repr(self.value)[:SHOWN]
        return self.error(f"is {shown}, but must be {expected}")

    def mapping(self, names: Collection[str] | None = None) -> dict[str, Any]:
        """Return the value, a dictionary; if `names` is given, with exactly these keys. Raises
        CheckpointError."""
        if not isinstance(self.value, dict):
            raise self.mismatch("a mapping")
        if names is not None and set(self.value) != set(names):
            there, expected = (", ".join(sorted(each))[:200] or "none" for each in (self.value, names))
            raise self.error(f"has the keys {there}, but must have {expected}")
        return self.value

    def parts(self, names: Collection[str] | None = None) -> Iterator["Part"]:
        """Yield the values of a mapping, checked for `names` as in `mapping`. Raises CheckpointError."""
        yield from (self._within(name, value) for name, value in self.mapping(names).items())

    def items(self, length: int | None = None) -> list["Part"]:
        """Return the values of a list, of the given length if not None. Raises CheckpointError."""
        if not isinstance(self.value, list) or length not in (None, len(self.value)):
            raise self.mismatch("a list" if length is None else f"a list of {length}")
        return [self._within(str(index), value) for index, value in enumerate(self.value)]

    def number(self, low: float = -inf, high: float = inf) -> float:
        """Return the value, a number in [low, high], possibly infinite; never NaN. Raises CheckpointError."""
        value = self.value
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or isnan(value)
            or not low <= value <= high
        ):
            raise self.mismatch(f"a number in [{low:.10g}, {high:.10g}]")
        return value

    def integer(self, low: int = 0, high: int = LARGEST_COUNT) -> int:
        """Return the value, a whole number in [low, high]; true and false are not numbers. Raises
        CheckpointError."""
        if isinstance(self.value, bool) or not isinstance(self.value, int) or not low <= self.value <= high:
            raise self.mismatch(f"a whole number in [{low}, {high}]")
        return self.value

    def amount(self, kind: type, low: float = -LARGEST_REAL) -> float:
        """Return the value, of `kind` int or float, at least `low` and in single precision. Raises
        CheckpointError."""
        return self.integer() if kind is int else self.number(low, LARGEST_REAL)

    def flag(self) -> bool:
        """Return the value, true or false. Raises CheckpointError."""
        if not isinstance(self.value, bool):
            raise self.mismatch("true or false")
        return self.value

    def text(self, among: Collection[str] | None = None) -> str:
        """Return the value, a text; if `among` is given, one of these. Raises CheckpointError."""
        if not isinstance(self.value, str) or not (among is None or self.value in among):
            raise self.mismatch("a text" if among is None else f"one of {', '.join(among)[:200] or 'none'}")
        return self.value

    def plain(self) -> None:
        """Check that the value is a number, possibly NaN, or None. Raises CheckpointError."""
        if isinstance(self.value, bool) or not (self.value is None or isinstance(self.value, int | float)):
            raise self.mismatch("a number")

    def floats(self, *shape: int, low: float = -LARGEST_REAL, high: float = LARGEST_REAL) -> np.ndarray:
        """Return the value, an array of floating-point numbers of the given shape in [low, high], without
        NaN.

        The default bounds are those of single precision. Raises CheckpointError.
        """
        return self._array("f", shape, low, high)

    def integers(self, *shape: int, low: int = 0, high: int = 2**31 - 1) -> np.ndarray:
        """Return the value, an array of signed integers of the given shape in [low, high].

        The default bounds are those of indices on the device (int32, not negative). Raises CheckpointError.
        """
        return self._array("i", shape, low, high)

    def distinct(self, *shape: int, high: int = 2**31 - 1) -> np.ndarray:
        """Return the value, an array of distinct integers of the given shape in [0, high].

        Raises CheckpointError.
        """
        found = self.integers(*shape, low=0, high=high)
        if len(np.unique(found)) < found.size:
            raise self.error("holds a number twice")
        return found

    def _array(self, kind: str, shape: Sequence[int], low: float, high: float) -> np.ndarray:
        """Return the value, an array of the type kind ("f" or "i") and shape with all entries in [low,
        high]."""
        value = self.value
        noun = "floating-point" if kind == "f" else "whole"
        if not isinstance(value, np.ndarray) or value.dtype.kind != kind or value.shape != tuple(shape):
            raise self.mismatch(f"an array {tuple(shape)} of {noun} numbers")
        outside = ~((value >= low) & (value <= high))
        if outside.any():
            raise self.error(f"holds {value[outside][0]:.10g}, but must lie in [{low:.10g}, {high:.10g}]")
        return value

    def _within(self, name: str, value: Any) -> "Part":
        return Part(self.file, f"{self.key}/{name[:SHOWN]}".lstrip("/"), value)
