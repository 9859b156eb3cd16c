"""How the process was launched: alone, or by mpirun as one of several."""

import os

from granflow.errors import GranflowError

SIZE_VARIABLES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MPI_LOCALNRANKS", "SLURM_STEP_NUM_TASKS")
"""Environment variables with the number of ranks, set by the mpirun of Open MPI, MPICH and Intel MPI, and by
srun."""


def launched_ranks() -> int:
    """Number of ranks with which mpirun has started this process; 1 without mpirun."""
    numbers = (os.environ.get(name, "") for name in SIZE_VARIABLES)
    return max((int(number) for number in numbers if number.isdecimal()), default=1)


def refuse_without_mpi_flag() -> None:
    """Raise GranflowError if mpirun has started several processes, which would all run the same scene."""
    if launched_ranks() > 1:
        raise GranflowError(
            f"mpirun has started {launched_ranks()} processes that would all run the whole scene: add --mpi "
            "to distribute it, or start granflow without mpirun."
        )
