"""What cannot run on MPI ranks."""

from collections.abc import Sequence

from granflow.errors import GranflowError


def refuse_on_ranks(arch: str = "cpu", forces: Sequence[object] = ()) -> None:
    """Raise GranflowError for an architecture other than the CPU, and for forces from Python."""
    if arch != "cpu":
        raise GranflowError(f"--arch {arch} does not work with --mpi, which runs on CPUs only: leave --arch out.")
    if forces:
        raise GranflowError("Forces from Python do not work on MPI ranks: run without a communicator.")
