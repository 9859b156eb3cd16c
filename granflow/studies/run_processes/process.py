"""One run in a worker process: started, or resumed from its checkpoint, and watched until it ends."""

import os
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from granflow.errors import GranflowError, RunError
from granflow.io.lock import locked
from granflow.studies.run_processes.outcome import (
    ABORTED,
    CRASHED,
    REFUSED,
    UNFINISHED,
    Outcome,
    final_outcome,
    write_outcome,
)
from granflow.studies.run_processes.run_worker import RunWorker, worker

POLL = 0.2
"""Interval [s] at which a request to stop is checked."""

STOP_TIMEOUT = 120.0
"""Time [s] for a stopped run to write its checkpoint; after it the process is killed."""

MESSAGES = "stderr.txt"
"""File in the directory of a run with the messages of its last attempt."""

REFUSAL, ABORT = GranflowError.exit_code, RunError.exit_code


@dataclass(frozen=True)
class RunRequest:
    """A run to be carried out; plain data, so that it can be sent to a worker on another machine.

    `scene`, `directory`: absolute paths, which all workers must be able to read and write; `until`: simulated time at
    which the run ends early, as in `granflow run --until`, or ""; `stop_file`: the run is stopped as soon as this file
    exists.
    """

    scene: str
    overrides: tuple[str, ...]
    directory: str
    threads: int
    arch: str
    stop_file: str
    until: str = ""

    @property
    def new(self) -> list[str]:
        """Arguments of granflow that start the run and replace files of an earlier attempt."""
        values = [f"--set={override}" for override in self.overrides]
        until = ["--until", self.until] if self.until else []
        return ["run", self.scene, *values, "--out", self.directory, "--overwrite", *until, *self._machine]

    @property
    def resumed(self) -> list[str]:
        """Arguments of granflow that continue the run from its newest checkpoint."""
        return ["resume", self.directory, *self._machine]

    @property
    def _machine(self) -> list[str]:
        return ["--threads", str(self.threads), "--arch", self.arch]


def execute(request: RunRequest, should_stop: Callable[[], bool] = lambda: False) -> Outcome:
    """Carry out a run and return its outcome, which is also written to its directory.

    A run that has ended is not repeated; one with a checkpoint is resumed. A process that still writes into the
    directory, such as one whose worker was killed, is waited for. The run is stopped with a checkpoint if the stop file
    exists or `should_stop` returns True.
    """
    directory, stop_file = Path(request.directory), Path(request.stop_file)

    def stopping() -> bool:
        return stop_file.exists() or should_stop()

    if not _wait_until_free(directory, stopping):
        return UNFINISHED
    known = final_outcome(directory)
    if known is not None:
        return known
    began = time.monotonic()
    has_checkpoint = any(directory.glob("checkpoint_*.npz"))
    code = _watch(request.resumed if has_checkpoint else request.new, directory, stopping)
    if code == REFUSAL and has_checkpoint:
        code = _watch(request.new, directory, stopping)
    outcome = _outcome(directory, code, time.monotonic() - began)
    if outcome != UNFINISHED:
        write_outcome(directory, outcome)
    return outcome


def _wait_until_free(directory: Path, stopping: Callable[[], bool]) -> bool:
    """Wait until no process has locked the directory, which is created; False if a stop is requested before."""
    while not stopping():
        try:
            with locked(directory):
                return True
        except GranflowError:
            time.sleep(POLL)
    return False


def _watch(arguments: Sequence[str], directory: Path, stopping: Callable[[], bool]) -> int | None:
    """Carry out a command of granflow in a worker and return its exit code, negative for a signal; None if stopped."""
    with worker() as taken:
        taken.start([str(directory / MESSAGES), *arguments])
        while True:
            try:
                return taken.exit_code(POLL)
            except TimeoutError:
                if stopping():
                    return _stop(taken)


def _stop(taken: RunWorker) -> int | None:
    """Stop a worker with a checkpoint of its run; the exit code if the run had just ended, else None."""
    taken.terminate()
    try:
        code = taken.exit_code(STOP_TIMEOUT)
    except TimeoutError:
        return None
    return code if code in (0, 1, REFUSAL, ABORT) else None


def _outcome(directory: Path, code: int | None, seconds: float) -> Outcome:
    """The outcome of a process by its exit code (None: stopped on request) and its files."""
    if code is None:
        return UNFINISHED
    ended = final_outcome(directory) if code in (0, 1) else None
    if ended is not None:
        return ended
    reason = _reason(directory)
    if code in (REFUSAL, ABORT):
        return Outcome(REFUSED if code == REFUSAL else ABORTED, reason, seconds)
    if code < 0:
        reason = f"The process was ended by {_signal_name(-code)}. {reason}".rstrip()
    return Outcome(CRASHED, reason or f"The process ended with exit code {code}.", seconds, code < 0 or code > ABORT)


def _signal_name(number: int) -> str:
    """Name of a signal, such as SIGKILL."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _reason(directory: Path) -> str:
    """The messages of a process on one line: without progress and warnings; of a traceback the last line.

    The directory of the run is shown as runs/HASH, so that the reason does not depend on the place of the study.
    """
    text = (directory / MESSAGES).read_text(encoding="utf-8", errors="replace")
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    if any(line.startswith("Traceback") for line in lines):
        return lines[-1]
    problems = [line for line in lines if line.startswith(("granflow: ", "--set", os.sep)) or ".yaml:" in line]
    words = [line.removeprefix("granflow: ") for line in problems if not line.startswith("granflow: warning:")]
    return " ".join(words).replace(str(directory), f"{directory.parent.name}/{directory.name}")
