"""Checkpoints: the complete state of a run, written atomically; the newest few are kept.

A run writes `checkpoint_STEP.npz` into its directory, and `granflow resume` continues from the newest intact
one. On MPI ranks, this file has the particles of the root and names one more file for each other rank; it is
written last, so that files of ranks that no checkpoint names are leftovers.

The file is an npz archive without pickle: a JSON header, with the versions, the scene and all values that are
not arrays, and the arrays by key path, such as `engine/particles/id`. numpy reads it on every machine, it
requires no further package, it is written in one pass, and it cannot execute code. (h5py is a large
dependency, and its file is damaged if the process is killed during a write; zarr consists of many files,
which cannot be renamed together.) The comment of the archive, its last bytes, is the SHA-256 of all preceding
bytes: a truncated file or a flipped bit is detected before the content is used. `runs/resume.py` checks
whether the state fits the scene that continues the run.
"""

import hashlib
import json
import re
import secrets
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np

from granflow.errors import GranflowError
from granflow.io.files import replacing
from granflow.io.log import version_of


class CheckpointError(GranflowError):
    """A checkpoint that cannot be used; the message says which and why."""


class DamagedCheckpoint(CheckpointError):
    """A checkpoint whose bytes differ from those written; the previous checkpoint replaces it."""


FORMAT = 16
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
    if header.get("format") != FORMAT:
        raise CheckpointError(
            f"{path} is in format {header.get('format')!r:.40}, written by granflow "
            f"{header.get('granflow')!s:.40}; granflow {version_of('granflow')} reads format {FORMAT}. "
            "Resume with the version that wrote it."
        )
    saved = header["saved"]
    files = tuple(
        RankFile(Path(path).parent / each["file"], each["checksum"], each["count"])
        for each in saved.get("rank_files", ())
    )
    refuse_missing(path, files)
    if content == "all":
        arrays = with_rank_files(arrays, files)
        files = ()
    for name, array in arrays.items():
        insert_array(saved, name, array)
    return Checkpoint(
        path, header["granflow"], header["scene"], header["time"], saved, files, header["engine"]
    )


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

    def read(self) -> dict[str, Any]:
        """Particles and contacts, as in `engine.checkpoint.saved_state`; raises as `arrays`."""
        saved: dict[str, Any] = {"particles": {}, "contacts": {}}
        for path, array in self.arrays().items():
            insert_array(saved, path.removeprefix(ENGINE), array)
        return saved


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


def refuse_missing(checkpoint: Path, files: Iterable[RankFile]) -> None:
    """Raise DamagedCheckpoint if a file that a checkpoint names is missing or ends with another checksum."""
    for file in files:
        try:
            if recorded_checksum(file.path) == file.checksum:
                continue
            reason = "is another one or truncated"
        except OSError as error:
            reason = f"cannot be read ({error.strerror or error})"
        raise DamagedCheckpoint(
            f"{checkpoint} needs the file {file.path.name} of a rank, which {reason}. Remove it to use the "
            "checkpoint before it."
        )


def with_rank_files(arrays: dict[str, np.ndarray], files: Sequence[RankFile]) -> dict[str, np.ndarray]:
    """The arrays of a checkpoint by key path, with those of the ranks behind those of the root.

    Raises DamagedCheckpoint.
    """
    parts = [file.arrays() for file in files]
    names = parts[0] if parts else ()
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
        with open(path, "rb") as file:
            found = _checksum(file)
            if found != file.read(len(CHECKSUM_PLACEHOLDER) + 1) or expected not in (None, found.decode()):
                remedy = " Remove it to use the checkpoint before it." if expected else ""
                raise DamagedCheckpoint(
                    f"{path} is damaged: it is truncated, or its bytes have changed.{remedy}"
                )
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                names = [name for name in archive.files if name != HEADER and with_arrays]
                return json.loads(archive[HEADER]), {name: archive[name] for name in names}
    except OSError as error:
        raise CheckpointError(
            f"{path} cannot be read: {error.strerror or error}. Make it readable, then try again."
        ) from error


def recorded_checksum(path: Path) -> str:
    """The checksum at the end of a file, which is not verified here. Raises OSError."""
    with open(path, "rb") as file:
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
    """Insert the array at the key path."""
    *parents, key = path.split("/")
    for name in parents:
        saved = saved[name]
    saved[key] = array
