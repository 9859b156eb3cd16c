"""Worker processes that carry out commands of granflow one after the other.

The second run of a worker with equal kernels starts at once: Python is loaded, and the kernels are in memory. A run
that crashes ends its worker only; the next run has a new one.
"""

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from queue import Empty, Queue
from threading import Lock, Thread
from time import monotonic

PROGRAM = (sys.executable, "-m", "granflow.cli.run_worker")
"""Command that starts a worker; its protocol is in granflow/cli/run_worker.py."""

IDLE_SECONDS = 60.0
"""Time [s] after which an idle worker is not used again. Workers end by themselves after twice this time."""


class RunWorker:
    """A worker process. It has a session of its own: Ctrl-C in the terminal reaches the driver only."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [*PROGRAM, str(2.0 * IDLE_SECONDS)], bufsize=0, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        self._codes: Queue[int] = Queue()
        self._idle_since: float | None = monotonic()
        self._is_ending = False
        Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        """Receive the exit codes of commands; that of the process is the last one."""
        assert self._process.stdout is not None
        with self._process.stdout as answers:
            for line in answers:
                self._codes.put(int(line))
        self._codes.put(self._process.wait())

    @property
    def is_ready(self) -> bool:
        """Whether the process waits for a command, and will do so for some time."""
        is_idle = self._idle_since is not None and monotonic() - self._idle_since < IDLE_SECONDS
        return is_idle and not self._is_ending and self._process.poll() is None

    def start(self, command: Sequence[str]) -> None:
        """Begin a command: file for its messages, arguments of granflow."""
        assert self._process.stdin is not None
        self._idle_since = None
        with suppress(OSError):  # the process has ended; `exit_code` returns its code
            self._process.stdin.write(json.dumps(command).encode() + b"\n")

    def exit_code(self, timeout: float) -> int:
        """The exit code of the command, negative for a signal; waits for it.

        Raises TimeoutError if the command has not ended after `timeout` [s].
        """
        try:
            code = self._codes.get(timeout=timeout)
        except Empty:
            raise TimeoutError from None
        self._idle_since = monotonic()
        return code

    def terminate(self) -> None:
        """Request that the process ends, with a checkpoint of its run."""
        self._is_ending = True
        self._process.terminate()

    def close(self) -> None:
        """End the process; during a command it is killed."""
        assert self._process.stdin is not None
        if self._idle_since is None:
            self._process.kill()
        self._process.stdin.close()
        self._process.wait()


_kept: list[RunWorker] = []
_lock = Lock()


@contextmanager
def worker() -> Iterator[RunWorker]:
    """A worker for one command: one that is ready, or a new one. It is kept after the block, if it is ready again."""
    taken = _ready_worker() or RunWorker()
    try:
        yield taken
    finally:
        if taken.is_ready:
            with _lock:
                _kept.append(taken)
        else:
            taken.close()


def _ready_worker() -> RunWorker | None:
    """A kept worker that is ready, which is no longer kept; the others are ended."""
    while True:
        with _lock:
            if not _kept:
                return None
            found = _kept.pop()
        if found.is_ready:
            return found
        found.close()


def close_workers() -> None:
    """End all kept workers."""
    with _lock:
        ended, _kept[:] = list(_kept), []
    for each in ended:
        each.close()
