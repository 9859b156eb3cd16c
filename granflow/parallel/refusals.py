"""What is refused with MPI: processes that would all run the same scene, and scenes that ranks cannot run."""

import os
from collections.abc import Sequence

from granflow.contact import registry
from granflow.errors import GranflowError
from granflow.load import Scene

SIZE_VARIABLES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MPI_LOCALNRANKS", "SLURM_STEP_NUM_TASKS")
"""Environment variables with the number of ranks, set by the mpirun of Open MPI, MPICH and Intel MPI, and by
srun."""


def refuse_without_mpi_flag() -> None:
    """Raise GranflowError if mpirun has started several processes, which would all run the same scene."""
    numbers = [os.environ.get(name, "") for name in SIZE_VARIABLES]
    ranks = max((int(number) for number in numbers if number.isdecimal()), default=1)
    if ranks > 1:
        raise GranflowError(
            f"mpirun has started {ranks} processes that would all run the whole scene: add --mpi to "
            "distribute it, or start granflow without mpirun."
        )


def refuse_on_ranks(arch: str = "cpu", forces: Sequence[object] = (), scene: Scene | None = None) -> None:
    """Raise GranflowError for other architectures, forces from Python, films and deforming
    boxes."""
    if arch != "cpu":
        raise GranflowError(
            f"--arch {arch} does not work with --mpi, which runs on CPUs only: leave --arch out."
        )
    if forces:
        raise GranflowError("Forces from Python do not work on MPI ranks: run without a communicator.")
    if scene is None:
        return
    for path, _ in scene.deformations():
        key = ".".join(map(str, path))
        raise GranflowError(f"{key} does not work on MPI ranks: run without a communicator (without --mpi).")
    cohesion = scene.contact.name("cohesion")
    if cohesion in registry.liquid_models():
        raise GranflowError(
            f"contact.cohesion: {cohesion} does not work on MPI ranks: run without a communicator (without "
            "--mpi)."
        )
