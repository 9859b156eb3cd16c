"""One run in a worker process: started, or resumed from its checkpoint, and watched until it ends."""

import os
import shutil
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from granflow.errors import GranflowError, RunError
from granflow.io.lock import locked
from granflow.studies.run_processes.inputs import RunInputs
from granflow.studies.run_processes.outcome import (
    ABORTED,
    CRASHED,
    NOT_RUN,
    REFUSED,
    RESULT,
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

AS_RUN = "scene_as_run.yaml"
"""File that a run writes to its directory when it has read its inputs."""

MESSAGES = "stderr.txt"
"""File in the directory of a run with the messages of its last attempt."""

REFUSAL, ABORT = GranflowError.exit_code, RunError.exit_code


@dataclass(frozen=True)
class RunRequest:
    """A run to be carried out; plain data, so that it can be sent to a worker on another machine.

    `scene`, `directory`: absolute paths, which all workers must be able to read and write; `until`: simulated time at
    which the run ends early, as in `granflow run --until`, or ""; `stop_file`: the run is stopped as soon as this file
    exists; `inputs`: files that the run reads, with their contents when it was checked.
    """

    scene: str
    overrides: tuple[str, ...]
    directory: str
    threads: int
    arch: str
    stop_file: str
    until: str = ""
    inputs: RunInputs | None = None

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
    exists or `should_stop` returns True. A run whose inputs have changed since it was checked does not belong to its
    directory: it has the status NOT_RUN with a reason, and leaves no files.
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
    is_damaged = (directory / RESULT).exists()  # it has no final outcome: its result is cut off
    has_checkpoint = not is_damaged and any(directory.glob("checkpoint_*.npz"))
    starting = _Start(request)
    code: int | None = REFUSAL
    if has_checkpoint:  # a resumed run reads the copies of the inputs in its directory
        code = _watch(request.resumed, directory, stopping)
    if code == REFUSAL and not starting.has_changed():
        code = _watch(request.new, directory, lambda: stopping() or starting.has_changed())
        starting.complete()
    if starting.change:
        shutil.rmtree(directory, ignore_errors=True)
        return Outcome(NOT_RUN, starting.change)
    outcome = _outcome(directory, code, time.monotonic() - began)
    if outcome.status != NOT_RUN:
        write_outcome(directory, outcome)
    return outcome


class _Start:
    """Compares the inputs of a run with their contents when it was checked: before it starts, and once it has begun.

    A run has read its inputs when it has written its scene. Later changes of the files do not concern it. `change`:
    sentence on an input that has changed.
    """

    def __init__(self, request: RunRequest) -> None:
        self._inputs = request.inputs
        self._record = Path(request.directory) / AS_RUN
        self._before: int | None = None
        self._is_known = self._has_started = False
        self.change = ""

    def has_changed(self) -> bool:
        """Whether an input has changed; compared at the first call, and at the first one after the start of the run."""
        if not self._is_known:
            self._before, self._is_known = self._written(), True
            self._compare()
        elif not self._has_started and self._written() != self._before:
            self._has_started = True
            self._compare()
        return bool(self.change)

    def complete(self) -> None:
        """Compare the inputs of a run that has ended before its start was seen."""
        if not self._has_started:
            self._compare()

    def _compare(self) -> None:
        if self._inputs is not None and not self.change:
            self.change = self._inputs.change()

    def _written(self) -> int | None:
        """When the scene was written to the directory of the run [ns]; None if it is not."""
        try:
            return self._record.stat().st_mtime_ns
        except OSError:
            return None


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
