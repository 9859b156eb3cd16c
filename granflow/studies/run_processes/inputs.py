"""Files that a run of a study reads, and whether they have changed since the run was checked."""

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from granflow import Scene
from granflow.io.checkpoint import PATTERN, newest_checkpoint
from granflow.io.rank_files import PATTERN as RANK_PATTERN
from granflow.io.regular_files import file_digest
from granflow.load import program_version


@dataclass(frozen=True)
class RunInputs:
    """Scene file and input files with their contents when the run was checked, and the version of granflow.

    `files`: absolute path and SHA-256 of each; `source`: directory of the run in `start_from`, or "", and the digest of
    its particles. Plain data, for workers on other machines.
    """

    files: tuple[tuple[str, str], ...]
    source: tuple[str, str]
    version: str

    @classmethod
    def of(cls, scene: Scene) -> "RunInputs":
        """The inputs of a scene as they are now."""
        paths = [scene.path.resolve(), *((scene.folder / name).resolve() for _, name in scene.input_names())]
        source = ("", "") if scene.start_from is None else (scene.start_from, source_digest(Path(scene.start_from)))
        return cls(tuple((str(path), file_digest(path)) for path in paths), source, program_version())

    def change(self) -> str:
        """Sentence on the first input that is no longer the same; empty without one."""
        changed = [path for path, digest in self.files if file_digest(Path(path)) != digest]
        if self.source[0] and source_digest(Path(self.source[0])) != self.source[1]:
            changed.append(self.source[0])
        if changed:
            return f"{changed[0]} has changed since the run was checked; repeat the command."
        if program_version() != self.version:
            return (
                f"The worker has {program_version()}, the command was started with {self.version}: "
                "install the same version, and repeat the command."
            )
        return ""


def source_digest(directory: Path) -> str:
    """SHA-256 of what `start_from` reads from a run: the particles in its newest intact checkpoint; "none" without.

    It does not change with the wall-clock times in the checkpoint: a run that is repeated has the same digest. Raises
    CheckpointError for a checkpoint that this version cannot read.
    """
    files = [*directory.glob(PATTERN), *directory.glob(RANK_PATTERN)]
    states = ((path.name, path.stat()) for path in sorted(files))
    return _source_digest(
        directory, tuple((name, each.st_ino, each.st_size, each.st_mtime_ns) for name, each in states)
    )


@lru_cache(maxsize=64)
def _source_digest(directory: Path, _states: tuple[tuple[str, int, int, int], ...]) -> str:
    """As `source_digest`; `_states`: of the checkpoint files, which change with their contents."""
    checkpoint, _ = newest_checkpoint(directory)
    if checkpoint is None:
        return "none"
    engine = checkpoint.saved["engine"]
    digest = hashlib.sha256(f"{checkpoint.scene}\n{engine['clock']['time_step']!r}".encode())
    arrays = {**engine["particles"], "group": engine["accounting"]["group"]}
    for name in sorted(arrays):
        digest.update(f"\n{name} {arrays[name].dtype} {arrays[name].shape}".encode())
        digest.update(arrays[name].tobytes())
    return digest.hexdigest()
