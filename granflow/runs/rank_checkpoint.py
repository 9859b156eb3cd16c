"""The files of MPI ranks of a checkpoint: reading with all checks, on the rank that reads them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from granflow.io.checkpoint import Checkpoint
from granflow.io.checkpoint_file import damaged, insert_array
from granflow.io.checkpoint_parts import Part
from granflow.io.rank_files import RankFile
from granflow.io.regular_files import FormatError
from granflow.load import scene_of
from granflow.plan.plan import Plan
from granflow.runs.checkpoint_validation import check_particles, densities


@dataclass(frozen=True)
class CheckedRankFiles:
    """As `engine.saved_particles.RankFiles`. `density_by_name` [kg/m3]: of the materials of the checkpoint."""

    files: tuple[RankFile, ...]
    density_by_name: Mapping[str, float]

    @property
    def count(self) -> int:
        """Number of files."""
        return len(self.files)

    def read(self, number: int, plan: Plan, accounting: Mapping[str, Any]) -> Mapping[str, Any]:
        """Particles and contacts of a file. Raises CheckpointError."""
        file = self.files[number]
        saved: dict[str, Any] = {"engine": {"particles": {}, "contacts": {}}}
        try:
            for path, array in file.arrays().items():
                insert_array(saved, path, array)
        except FormatError as error:
            raise damaged(file.path, str(error)) from None
        engine = Part(file.path, "", saved)["engine"]
        check_particles(
            engine, file.count, Part(file.path, "accounting", dict(accounting)), plan, self.density_by_name, False
        )
        return engine.mapping()


def rank_files_of(checkpoint: Checkpoint) -> CheckedRankFiles | None:
    """The files of the ranks with particles that the checkpoint does not contain; None if it contains all."""
    if not checkpoint.rank_files:
        return None
    return CheckedRankFiles(checkpoint.rank_files, densities(scene_of(checkpoint.scene, str(checkpoint.path))))
