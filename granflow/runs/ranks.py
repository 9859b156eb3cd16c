"""What cannot run on MPI ranks."""

from collections.abc import Sequence

from granflow.contact import registry
from granflow.errors import GranflowError
from granflow.kernel_language import KERNELS, VARIABLE
from granflow.load import Scene


def refuse_on_ranks(arch: str = "cpu", forces: Sequence[object] = (), scene: Scene | None = None) -> None:
    """Raise GranflowError for other architectures and kernel languages, forces from Python, clumps and
    films."""
    if arch != "cpu":
        raise GranflowError(
            f"--arch {arch} does not work with --mpi, which runs on CPUs only: leave --arch out."
        )
    if KERNELS != "taichi":
        raise GranflowError(f"{VARIABLE}={KERNELS} does not work with --mpi: unset {VARIABLE}.")
    if forces:
        raise GranflowError("Forces from Python do not work on MPI ranks: run without a communicator.")
    if scene is None:
        return
    alone = "run without a communicator (without --mpi)"
    cohesion = scene.contact.name("cohesion")
    if any(group.clump is not None for group in scene.particles.values()):
        raise GranflowError(f"Clumps do not work on MPI ranks: {alone}.")
    if cohesion in registry.liquid_models():
        raise GranflowError(f"contact.cohesion: {cohesion} does not work on MPI ranks: {alone}.")
