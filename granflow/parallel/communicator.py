"""Communication of the ranks of one run. The only module that imports mpi4py."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from granflow.engine.state import Arrays
from granflow.errors import GranflowError

COMMAND_TAG = 1
GHOST_TAG = 2
"""Tags of messages."""

END = "end"
"""Command that ends the other ranks."""

POLL_SECONDS = 2e-4
"""Interval [s] at which an idle rank looks for a command: it must not occupy a core while the root writes
files."""


class Communicator:
    """All ranks of the run; the root is rank 0. Raises GranflowError without mpi4py or an MPI library."""

    def __init__(self) -> None:
        try:
            from mpi4py import MPI
        except (ImportError, RuntimeError) as error:
            reason = str(error).splitlines()[0]
            raise GranflowError(
                f"--mpi needs mpi4py and an MPI library ({reason}): pip install mpi4py mpich."
            ) from None
        self._mpi = MPI
        self._world = MPI.COMM_WORLD
        self.rank = self._world.rank
        self.size = self._world.size
        self._depth = 0
        self._has_ended = False

    @property
    def is_root(self) -> bool:
        """Whether this rank controls the run and writes its files."""
        return self.rank == 0

    @property
    def is_idle(self) -> bool:
        """On the root: whether all other ranks wait for a command."""
        return self._depth == 0

    def local_size(self) -> int:
        """Number of ranks on this machine."""
        local = self._world.Split_type(self._mpi.COMM_TYPE_SHARED)
        size = int(local.size)
        local.Free()
        return size

    @contextmanager
    def commanding(self, name: str, arguments: Sequence[Any] = ()) -> Iterator[None]:
        """On the root: let the other ranks execute the command that the block executes here; nested blocks do
        not.

        Raises GranflowError after `end`, when no other rank would answer.
        """
        if self._has_ended:
            raise GranflowError("The other ranks have ended, and with them this simulation.")
        if self.is_root and self._depth == 0:
            self.send_command(name, arguments)
        self._depth += 1
        yield
        self._depth -= 1  # remains above 0 after an exception: the other ranks are then in unknown places

    def send_command(self, name: str, arguments: Sequence[Any] = ()) -> None:
        """On the root: send a command to all other ranks."""
        for rank in range(1, self.size):
            self._world.send((name, tuple(arguments)), dest=rank, tag=COMMAND_TAG)

    def end(self) -> None:
        """On the root: let all other ranks end."""
        self.send_command(END)
        self._has_ended = True

    def next_command(self) -> tuple[str, tuple[Any, ...]]:
        """Wait for the next command of the root: its name and arguments."""
        while not self._world.iprobe(source=0, tag=COMMAND_TAG):
            time.sleep(POLL_SECONDS)
        command: tuple[str, tuple[Any, ...]] = self._world.recv(source=0, tag=COMMAND_TAG)
        return command

    def abort(self, exit_code: int) -> None:
        """End all ranks at once."""
        self._world.Abort(exit_code)

    def barrier(self) -> None:
        """Wait for all ranks."""
        self._world.Barrier()

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sums (n,) of integers over all ranks, on all ranks."""
        return self._reduced(values, self._mpi.SUM)

    def largest_of(self, values: np.ndarray) -> np.ndarray:
        """Largest values (n,) of all ranks, on all ranks."""
        return self._reduced(values, self._mpi.MAX)

    def _reduced(self, values: np.ndarray, operation: Any) -> np.ndarray:
        found = np.ascontiguousarray(values).copy()
        self._world.Allreduce(self._mpi.IN_PLACE, found, operation)
        return found

    def from_each(self, value: Any) -> list[Any]:
        """The value of each rank, on all ranks."""
        return list(self._world.allgather(value))

    def to_root(self, value: Any) -> list[Any]:
        """The value of each rank on the root; empty on the others."""
        return list(self._world.gather(value) or [])

    def exchanged(self, parts: Sequence[Any]) -> list[Any]:
        """One part for each rank; returns that of each rank for this one."""
        sent = [part if rank != self.rank else None for rank, part in enumerate(parts)]
        received = list(self._world.alltoall(sent))
        received[self.rank] = parts[self.rank]  # most particles remain: serializing them would take time
        return received

    def exchange_buffers(self, sends: Sequence[tuple[int, Any]], receives: Sequence[tuple[int, Any]]) -> None:
        """Send contiguous arrays to ranks and receive others, given as (rank, array)."""
        requests = [self._world.Irecv(array, source=rank, tag=GHOST_TAG) for rank, array in receives]
        requests += [self._world.Isend(array, dest=rank, tag=GHOST_TAG) for rank, array in sends]
        self._mpi.Request.Waitall(requests)

    # The methods of `engine.state.Gathering`

    def total(self, words: np.ndarray) -> np.ndarray:
        """Integers (1, ...): the sum over the first axis of the arrays (n, ...) of all ranks."""
        return self.sums(words.sum(axis=0, keepdims=True))

    def largest(self, value: float) -> float:
        """The largest value of all ranks."""
        return float(self.largest_of(np.array([value]))[0])

    def gathered(self, arrays: Arrays) -> Arrays:
        """Arrays of all ranks, one rank after the other, on the root; those of this rank on the others.

        As bytes: serialized arrays would be in memory several times.
        """
        return {name: self._gathered(np.ascontiguousarray(values)) for name, values in arrays.items()}

    def _gathered(self, values: np.ndarray) -> np.ndarray:
        """One array (n, ...) of all ranks on the root; that of this rank on the others."""
        sizes = self._world.gather(values.nbytes)
        found = values
        receive = None
        if sizes is not None:
            row = values.dtype.itemsize * int(np.prod(values.shape[1:]))
            found = np.empty((sum(sizes) // row, *values.shape[1:]), values.dtype)
            receive = [found, sizes, self._mpi.BYTE]
        self._world.Gatherv([values, self._mpi.BYTE], receive)
        return found
