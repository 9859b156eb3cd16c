"""What cannot run on MPI ranks."""

from collections.abc import Sequence

from granflow.errors import GranflowError
from granflow.kernel_language import KERNELS, VARIABLE


def refuse_on_ranks(arch: str = "cpu", forces: Sequence[object] = (), has_clumps: bool = False) -> None:
    """Raise GranflowError for other architectures and kernel languages, forces from Python and clumps."""
    if arch != "cpu":
        raise GranflowError(f"--arch {arch} does not work with --mpi, which runs on CPUs only: leave --arch out.")
    if KERNELS != "taichi":
        raise GranflowError(f"{VARIABLE}={KERNELS} does not work with --mpi: unset {VARIABLE}.")
    if forces:
        raise GranflowError("Forces from Python do not work on MPI ranks: run without a communicator.")
    if has_clumps:
        raise GranflowError("Clumps do not work on MPI ranks: run without a communicator (without --mpi).")
