"""What cannot run on MPI ranks."""

from collections.abc import Sequence

from granflow.errors import GranflowError
from granflow.kernel_language import KERNELS, VARIABLE


def refuse_on_ranks(arch: str = "cpu", forces: Sequence[object] = ()) -> None:
    """Raise GranflowError for another architecture than the CPU, another kernel language, and forces from Python."""
    if arch != "cpu":
        raise GranflowError(f"--arch {arch} does not work with --mpi, which runs on CPUs only: leave --arch out.")
    if KERNELS != "taichi":
        raise GranflowError(f"{VARIABLE}={KERNELS} does not work with --mpi: unset {VARIABLE}.")
    if forces:
        raise GranflowError("Forces from Python do not work on MPI ranks: run without a communicator.")
