"""Files of the particles of MPI ranks: each rank but the root writes one for each checkpoint.

The checkpoint of the root names them, with their checksums, and is written last: files that no checkpoint names are
ignored, and removed with the next checkpoints.
"""

import re
import secrets
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from granflow.io.checkpoint_file import damaged, read_file, recorded_checksum, split_arrays, write_file
from granflow.io.regular_files import FormatError

PATTERN = "rank_*.npz"
"""Names of the files: rank_STEP_TOKEN_RANK.npz."""

NAME = re.compile(r"rank_(\d{12})_[0-9a-f]{8}_\d{4,}\.npz")
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
        return read_file(self.path, self.checksum)[1]


@dataclass(frozen=True)
class RankFileWriter:
    """Writes the files of all ranks for one checkpoint; each rank has a copy.

    `step`: of the checkpoint; `token`: distinguishes the files of two checkpoints of the same step, so that no file
    that an earlier checkpoint names is replaced.
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

        `count`: number of particles; `saved`: "particles" and "contacts" as in `engine.checkpoint`. Raises OSError.
        """
        name = f"{self._step_prefix}{self.token}_{rank:04d}.npz"
        arrays = split_arrays(saved, ENGINE)[1]
        return {"file": name, "checksum": write_file(self.directory / name, {"rank": rank}, arrays), "count": count}

    def remove_replaced(self) -> None:
        """Remove the files of an earlier checkpoint of the same step, which this one has replaced."""
        for path in self.directory.glob(f"{self._step_prefix}*.npz"):
            if NAME.fullmatch(path.name) and not path.name.startswith(self._step_prefix + self.token):
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
        name, checksum, count = str(values.get("file")), str(values.get("checksum")), values.get("count")
        is_named = NAME.fullmatch(name) and CHECKSUM.fullmatch(checksum)
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
    names, parts = {name for name in arrays if name.startswith((f"{ENGINE}particles/", f"{ENGINE}contacts/"))}, []
    for file in files:
        parts.append(file.arrays())
        for name in names.symmetric_difference(parts[-1]):
            raise damaged(file.path, f"has other arrays than its checkpoint: {name[:80]}")
        for name in names:
            own, other = arrays[name], parts[-1][name]
            if own.dtype != other.dtype or own.shape[1:] != other.shape[1:]:
                raise damaged(file.path, f"has an array {other.shape} of {other.dtype} for {name[:80]}")
    return arrays | {name: np.concatenate([arrays[name], *(part[name] for part in parts)]) for name in names}


def remove_unused(directory: Path, steps: Iterable[int]) -> None:
    """Remove the files of all ranks except those of checkpoints of these steps."""
    kept = {*steps}
    for path in directory.glob(PATTERN):
        name = NAME.fullmatch(path.name)
        if name and int(name[1]) not in kept:
            path.unlink(missing_ok=True)
