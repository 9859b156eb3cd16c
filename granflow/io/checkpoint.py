"""Checkpoints: the complete state of a run, written atomically; the newest few are kept.

A run writes `checkpoint_STEP.npz` into its directory, and `granflow resume` continues from the newest intact
one. On MPI ranks, this file has the particles of the root and names one more file for each other rank; it is
written last, so that files of ranks that no checkpoint names are leftovers.

The file is an npz archive without pickle: a JSON header, with the versions, the scene and all values that are
not arrays, and the arrays by key path, such as `engine/particles/id`. numpy reads it on every machine, it
requires no further package, it is written in one pass, and it cannot execute code. (h5py is a large
dependency, and its file is damaged if the process is killed during a write; zarr consists of many files,
which cannot be renamed together.) The comment of the archive, its last bytes, is the SHA-256 of all preceding
bytes: a truncated file or a flipped bit is detected before the content is used.

A checkpoint may be crafted, including its checksum. The reader therefore trusts no size, count or name in the
archive, and `Part` gives each value of the state only after a check of its type and range.
"""

import hashlib
import json
import math
import re
import secrets
import struct
import tokenize
import zipfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from math import inf, isfinite, isnan
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np

from granflow.errors import GranflowError
from granflow.io.files import FormatError, open_regular, replacing
from granflow.io.log import version_of


class CheckpointError(GranflowError):
    """A checkpoint that cannot be used; the message says which and why."""


class DamagedCheckpoint(CheckpointError):
    """A checkpoint whose bytes differ from those written; the previous checkpoint replaces it."""


FORMAT = 12
"""Version of the content of a checkpoint. Files of other versions are refused."""
PATTERN = "checkpoint_*.npz"
"""Names of checkpoint files; the number is the step, with leading zeros, so that names sort by time."""
Content = Literal["all", "root", "header"]
"""What is read: the arrays of all files, those of the file of the root, or none."""


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint read from a file.

    path:        the file
    version:     of granflow that wrote it
    scene:       YAML text of the resolved scene
    time:        simulated time [s]
    saved:       state, as nested dictionaries of numbers, texts and numpy arrays
    rank_files:  the files of MPI ranks with particles that `saved` lacks
    engine:      digest of the sources of the engine that wrote it, see `engine_digest`
    """

    path: Path
    version: str
    scene: str
    time: float
    saved: dict[str, Any]
    rank_files: "tuple[RankFile, ...]" = ()
    engine: str = ""


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
    write_archive(path, header, arrays)
    return path


def read_checkpoint(path: Path, content: Content = "all") -> Checkpoint:
    """Read a checkpoint; with "all", the particles of the root are first.

    Raises DamagedCheckpoint for a truncated, modified or missing file, and CheckpointError for another format
    version or an unreadable file.
    """
    header, arrays = read_archive(path, with_arrays=content != "header")
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


def _from_archive(
    path: Path, header: dict[str, Any], arrays: dict[str, np.ndarray], rank_files: "tuple[RankFile, ...]"
) -> Checkpoint:
    """Return the checkpoint with its arrays. Raises FormatError if the header has unexpected keys or
    types."""
    version = header.get("granflow")
    if header.get("format") != FORMAT:
        raise CheckpointError(
            f"{path} is in format {header.get('format')!r:.40}, written by granflow {version!s:.40}; "
            f"granflow {version_of('granflow')} reads format {FORMAT}. Resume with the version that wrote it."
        )
    engine = header.get("engine")
    scene = header.get("scene")
    saved = header.get("saved")
    if not (
        isinstance(version, str)
        and isinstance(engine, str)
        and isinstance(scene, str)
        and isinstance(saved, dict)
    ):
        raise FormatError("lacks the version, the scene or the state of the run")
    time = header.get("time")
    if not (isinstance(time, int | float) and isfinite(time)):
        raise FormatError("lacks the time of the run")
    for name, array in arrays.items():
        insert_array(saved, name, array)
    return Checkpoint(path, version, scene, time, saved, rank_files, engine)


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
        reason = "a run writes them at its end, when it is stopped, and as set in output.checkpoint."
        if skipped:
            reason = skipped[0]
        raise CheckpointError(f"{path} contains no usable checkpoint: {reason}")
    return found


def remove_after(directory: Path, path: Path | None) -> None:
    """Remove the checkpoints after `path`, or all if None, so that the next one written is the newest.

    "After" refers to the step in the file name, not to the modification time.
    """
    for other in checkpoints(directory):
        if path is None or other.name > path.name:
            other.unlink()
    _remove_unused_rank_files(directory)


def remove_old_checkpoints(directory: Path, count: int) -> None:
    """Remove all checkpoints except the newest `count`; a file that another process has already removed is
    skipped."""
    for path in checkpoints(directory)[count:]:
        path.unlink(missing_ok=True)
    _remove_unused_rank_files(directory)


# The sources that determine the motion of a run

ENGINE_SOURCES = (
    "contact",
    "device_functions.py",
    "engine",
    "fields.py",
    "geometry",
    "kernel_language.py",
    "live",
    "parallel",
    "particles",
    "plan",
    "scene/blocks/insertions.py",
    "scene/blocks/motions.py",
    "scene/blocks/outlets.py",
    "scene/blocks/particle_shapes",
    "scene/blocks/sizes.py",
    "scene/blocks/walls",
    "taichi_patches.py",
)
"""Parts of the package that determine the motion of a run."""
DIGEST_LENGTH = 12
"""Number of hexadecimal digits of a digest of sources."""


@cache
def engine_digest() -> str:
    """Start of the SHA-256 of the sources of the engine, at the first call: a run loads its modules
    before."""
    return digest_of_sources(Path(__file__).parents[1], ENGINE_SOURCES)


def digest_of_sources(package: Path, names: Sequence[str]) -> str:
    """Start of the SHA-256 of the names and contents of Python files, given folders and files in a
    package."""
    paths: list[Path] = []
    for name in names:
        paths += [package / name] if name.endswith(".py") else (package / name).rglob("*.py")
    digest = hashlib.sha256()
    for path in sorted(paths):
        digest.update(f"{path.relative_to(package).as_posix()}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:DIGEST_LENGTH]


# Files of the particles of MPI ranks

RANK_PATTERN = "rank_*.npz"
"""Names of the files of ranks."""
RANK_NAME = re.compile(r"rank_(\d{12})_[0-9a-f]{8}_\d{4,}\.npz")
"""The same names exactly: rank_STEP_TOKEN_RANK.npz."""
CHECKSUM = re.compile("[0-9a-f]{64}")
ENGINE = "engine/"
"""Start of the key paths of particles and contacts in a checkpoint."""


@dataclass(frozen=True)
class RankFile:
    """A file that a checkpoint names, the checksum that it must have, and its number of particles."""

    path: Path
    checksum: str
    count: int

    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays by key path. Raises DamagedCheckpoint, CheckpointError."""
        return read_archive(self.path, self.checksum)[1]


@dataclass(frozen=True)
class RankFileWriter:
    """Writes the files of all ranks for one checkpoint; each rank has a copy.

    `step`: of the checkpoint; `token`: distinguishes the files of two checkpoints of the same step, so that
    no file that an earlier checkpoint names is replaced.
    """

    directory: Path
    step: int
    token: str

    @classmethod
    def of(cls, directory: Path, step: int) -> "RankFileWriter":
        """The writer for a checkpoint in a directory."""
        return cls(Path(directory).absolute(), step, secrets.token_hex(4))

    def write(self, rank: int, count: int, saved: Mapping[str, Any]) -> dict[str, Any]:
        """Write the file of a rank; return its entry in the checkpoint.

        `count`: number of particles; `saved`: "particles" and "contacts" as in `engine.checkpoint`. Raises
        OSError.
        """
        name = f"{self._step_prefix}{self.token}_{rank:04d}.npz"
        arrays = split_arrays(saved, ENGINE)[1]
        checksum = write_archive(self.directory / name, {"rank": rank}, arrays)
        return {"file": name, "checksum": checksum, "count": count}

    def remove_replaced(self) -> None:
        """Remove the files of an earlier checkpoint of the same step, which this one has replaced."""
        for path in self.directory.glob(f"{self._step_prefix}*.npz"):
            if RANK_NAME.fullmatch(path.name) and not path.name.startswith(self._step_prefix + self.token):
                path.unlink(missing_ok=True)

    @property
    def _step_prefix(self) -> str:
        return f"rank_{self.step:012d}_"


def listed_files(directory: Path, entries: Any) -> tuple[RankFile, ...]:
    """The files of the entries that `RankFileWriter.write` returned. Raises FormatError for other values."""
    if not isinstance(entries, list):
        raise FormatError("has no list of the files of ranks")
    found = []
    for entry in entries:
        values = entry if isinstance(entry, dict) else {}
        name = str(values.get("file"))
        checksum = str(values.get("checksum"))
        count = values.get("count")
        is_named = RANK_NAME.fullmatch(name) and CHECKSUM.fullmatch(checksum)
        if not (is_named and isinstance(count, int) and 0 <= count < 2**31):
            raise FormatError(f"has the unexpected file of a rank {str(entry)[:80]}")
        found.append(RankFile(directory / name, checksum, count))
    return tuple(found)


def refuse_missing(checkpoint: Path, files: Iterable[RankFile]) -> None:
    """Raise DamagedCheckpoint if a file that a checkpoint names is missing or ends with another checksum."""
    for file in files:
        try:
            if recorded_checksum(file.path) == file.checksum:
                continue
            reason = "is another one or truncated"
        except OSError as error:
            reason = f"cannot be read ({error.strerror or error})"
        raise damaged(checkpoint, f"needs the file {file.path.name} of a rank, which {reason}")


def with_rank_files(arrays: dict[str, np.ndarray], files: Sequence[RankFile]) -> dict[str, np.ndarray]:
    """The arrays of a checkpoint by key path, with those of the ranks behind those of the root.

    Raises DamagedCheckpoint if the files do not have the same arrays.
    """
    if not files:
        return arrays
    names = {name for name in arrays if name.startswith((f"{ENGINE}particles/", f"{ENGINE}contacts/"))}
    parts = []
    for file in files:
        parts.append(file.arrays())
        for name in names.symmetric_difference(parts[-1]):
            raise damaged(file.path, f"has other arrays than its checkpoint: {name[:80]}")
        for name in names:
            own = arrays[name]
            other = parts[-1][name]
            if own.dtype != other.dtype or own.shape[1:] != other.shape[1:]:
                raise damaged(file.path, f"has an array {other.shape} of {other.dtype} for {name[:80]}")
    return arrays | {name: np.concatenate([arrays[name], *(part[name] for part in parts)]) for name in names}


def _remove_unused_rank_files(directory: Path) -> None:
    """Remove the files of ranks of steps of which the directory has no checkpoint."""
    numbers = [path.stem.partition("_")[2] for path in checkpoints(directory)]
    kept = {int(number) for number in numbers if number.isdecimal()}
    for path in directory.glob(RANK_PATTERN):
        name = RANK_NAME.fullmatch(path.name)
        if name and int(name[1]) not in kept:
            path.unlink(missing_ok=True)


# The archive

CHECKSUM_PLACEHOLDER = b"0" * (2 * hashlib.sha256().digest_size)
"""Comment of the archive while it is written; the hexadecimal SHA-256 of the same length replaces it."""
READ_SIZE = 2**20
"""Bytes read at a time for the checksum."""
HEADER = "header.json"
"""Name of the JSON entry."""
ARRAYS = ".npy"
"""Suffix of the entries of arrays."""
MOST_ENTRIES = 100_000
"""Largest number of entries of an archive."""
LARGEST_HEADER = 2**28
"""Largest size of the JSON header [bytes]; it contains the history of each flow meter, one entry per CSV
row."""
MOST_AXES = 3
"""Largest number of axes of an array."""
LARGEST_ITEM = 8
"""Largest size of one number [bytes]."""


def write_archive(path: Path, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> str:
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


def read_archive(
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
            return _content_of(file, with_arrays)
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


def _content_of(file: BinaryIO, with_arrays: bool) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
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

    granflow stores the entries without compression, so their total size never exceeds that of the file, here
    `file_size` [bytes]: the reader refuses others, and thus allocates no more memory than the file has bytes.
    Raises FormatError for compressed, oversized or duplicate entries.
    """
    entries = archive.infolist()
    if len(entries) > MOST_ENTRIES:
        raise FormatError(f"has {len(entries)} entries, more than {MOST_ENTRIES}")
    for entry in entries:
        if entry.compress_type != zipfile.ZIP_STORED or entry.compress_size != entry.file_size:
            raise FormatError(
                f"has the compressed entry {entry.filename[:80]}, but checkpoints are written without "
                "compression"
            )
        if entry.filename == HEADER and entry.file_size > LARGEST_HEADER:
            raise FormatError(f"has a header of {entry.file_size} bytes, more than {LARGEST_HEADER}")
    total = sum(entry.file_size for entry in entries)
    if total > file_size:
        raise FormatError(f"has entries of {total} bytes, but only {file_size} bytes")
    found: dict[str, zipfile.ZipInfo] = {}
    for entry in entries:
        name = entry.filename if entry.filename == HEADER else entry.filename.removesuffix(ARRAYS)
        if name in found or (name == entry.filename) != (name == HEADER):
            raise FormatError(f"has the unexpected entry {entry.filename[:80]}")
        found[name] = entry
    return found


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    """Return one numeric array; the size of its entry must match its type and shape exactly."""
    with archive.open(entry) as member:
        version = np.lib.format.read_magic(member)
        if version != (1, 0):
            raise FormatError(f"has the entry {entry.filename[:80]} in npy version {version}, not (1, 0)")
        shape, by_column, dtype = np.lib.format.read_array_header_1_0(member)
        is_number = dtype.kind in "bif" and dtype.itemsize <= LARGEST_ITEM and dtype.isnative
        if (
            not (is_number and dtype.shape == ())
            or len(shape) > MOST_AXES
            or by_column
            or min(shape, default=0) < 0
        ):
            raise FormatError(
                f"has the entry {entry.filename[:80]} with the unexpected type {dtype} or shape {shape}"
            )
        size = math.prod(shape) * dtype.itemsize
        if size != entry.file_size - member.tell():
            raise FormatError(
                f"has the entry {entry.filename[:80]} whose length does not match its shape {shape}"
            )
        return np.frombuffer(bytearray(member.read()), dtype).reshape(shape)


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


# The values of a saved state

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
            found = ", ".join(sorted(self.value))[:200] or "none"
            expected = ", ".join(sorted(names))[:200] or "none"
            raise self.error(f"has the keys {found}, but must have {expected}")
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
