"""One run of a study: the request, the process that carries it out, and the outcome.

`execute` carries out a `RunRequest` in a process of its own and returns the `Outcome`. The directory of the
run is the only memory: a run whose files say that it has ended is not repeated, one with a checkpoint is
resumed.
"""

import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from math import nan
from pathlib import Path
from typing import Any

from granflow import OutputError, Scene, read_run
from granflow.errors import GranflowError, RunError
from granflow.io.checkpoint import PATTERN, RANK_PATTERN, newest_checkpoint
from granflow.io.files import file_digest, write_text
from granflow.io.lock import locked
from granflow.load import program_version

# The request, and the files that a run reads


@dataclass(frozen=True)
class RunInputs:
    """Scene file and input files with their contents when the run was checked, and the version of granflow.

    `files`: absolute path and SHA-256 of each; `source`: directory of the run in `start_from`, or "", and the
    digest of its particles. Plain data, for workers on other machines.
    """

    files: tuple[tuple[str, str], ...]
    source: tuple[str, str]
    version: str

    @classmethod
    def of(cls, scene: Scene) -> "RunInputs":
        """The inputs of a scene as they are now."""
        paths = [scene.path.resolve(), *((scene.folder / name).resolve() for _, name in scene.input_names())]
        source = (
            ("", "")
            if scene.start_from is None
            else (scene.start_from, source_digest(Path(scene.start_from)))
        )
        return cls(tuple((str(path), file_digest(path)) for path in paths), source, program_version())

    def change(self) -> str:
        """Sentence on the first input that is no longer the same; empty without one."""
        changed = [path for path, digest in self.files if file_digest(Path(path)) != digest]
        if self.source[0] and source_digest(Path(self.source[0])) != self.source[1]:
            changed.append(self.source[0])
        if changed:
            return f"{changed[0]} has changed since the run was checked; repeat the command."
        if program_version() != self.version:
            return (
                f"The worker has {program_version()}, the command was started with {self.version}: "
                "install the same version, and repeat the command."
            )
        return ""


def source_digest(directory: Path) -> str:
    """SHA-256 of what `start_from` reads from a run: the particles in its newest intact checkpoint.

    It is "none" without a checkpoint. It does not change with the wall-clock times in the checkpoint: a run
    that is repeated has the same digest. Raises CheckpointError for a checkpoint that this version cannot
    read.
    """
    files = [*directory.glob(PATTERN), *directory.glob(RANK_PATTERN)]
    states = ((path.name, path.stat()) for path in sorted(files))
    return _source_digest(
        directory, tuple((name, each.st_ino, each.st_size, each.st_mtime_ns) for name, each in states)
    )


@lru_cache(maxsize=64)
def _source_digest(directory: Path, _states: tuple[tuple[str, int, int, int], ...]) -> str:
    """As `source_digest`; `_states`: of the checkpoint files, which change with their contents."""
    checkpoint, _ = newest_checkpoint(directory)
    if checkpoint is None:
        return "none"
    engine = checkpoint.saved["engine"]
    digest = hashlib.sha256(f"{checkpoint.scene}\n{engine['clock']['time_step']!r}".encode())
    arrays = {**engine["particles"], "group": engine["accounting"]["group"]}
    for name in sorted(arrays):
        digest.update(f"\n{name} {arrays[name].dtype} {arrays[name].shape}".encode())
        digest.update(arrays[name].tobytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class RunRequest:
    """A run to be carried out; plain data, so that it can be sent to a worker on another machine.

    `scene`, `directory`: absolute paths, which all workers must be able to read and write; `stop_file`: the
    run is stopped as soon as this file exists; `inputs`: files that it reads, with their contents when it was
    checked.
    """

    scene: str
    overrides: tuple[str, ...]
    directory: str
    threads: int
    arch: str
    stop_file: str
    inputs: RunInputs | None = None

    @property
    def new(self) -> list[str]:
        """Arguments of granflow that start the run and replace files of an earlier attempt."""
        values = [f"--set={override}" for override in self.overrides]
        return ["run", self.scene, *values, "--out", self.directory, "--overwrite", *self._machine]

    @property
    def resumed(self) -> list[str]:
        """Arguments of granflow that continue the run from its newest checkpoint."""
        return ["resume", self.directory, *self._machine]

    @property
    def _machine(self) -> list[str]:
        return ["--threads", str(self.threads), "--arch", self.arch]


# The outcome and the numbers of a run, from the files in its directory

DONE = "done"
MISSED = "expectation missed"
NOT_RUN = "not run"
REFUSED = "refused"
ABORTED = "aborted"
CRASHED = "crashed"
SEVERITY = (DONE, MISSED, NOT_RUN, REFUSED, ABORTED, CRASHED)
"""Statuses of a run in ascending severity; a run that was stopped, or not started, has the status NOT_RUN."""
RESULT = "result.json"
"""File in the directory of a run with its numbers, written at its end."""
RECORD = "outcome.json"
"""File in the directory of a run with its outcome, written when the process has ended."""


@dataclass(frozen=True)
class Outcome:
    """Status of a run, its reason in full, and the wall clock [s]; nan if it is unknown.

    `is_lost`: the process ended without a decision of its own (killed, lost worker, full disk), so that
    another attempt can succeed.
    """

    status: str
    reason: str = ""
    seconds: float = nan
    is_lost: bool = False

    @property
    def has_numbers(self) -> bool:
        """Whether the run has reached its end."""
        return self.status in (DONE, MISSED)


UNFINISHED = Outcome(NOT_RUN)
"""Outcome of a run that was stopped, or not started."""


def worst(outcomes: Iterable[Outcome]) -> Outcome:
    """The most severe status of several runs, with the different reasons of all of them and the sum of the
    seconds."""
    found = list(outcomes)
    status = max((each.status for each in found), key=SEVERITY.index, default=NOT_RUN)
    reasons = dict.fromkeys(each.reason for each in found if each.reason)
    return Outcome(
        status, " ".join(reasons), sum(each.seconds for each in found if each.seconds == each.seconds)
    )


def final_outcome(directory: Path) -> Outcome | None:
    """The outcome of a run that is not repeated: completed or aborted; None for all others.

    A result or a record that is damaged, such as one that a full disk has cut off, is that of a run to
    repeat.
    """
    if (directory / RESULT).exists():
        try:
            result = read_run(directory).result
        except GranflowError:
            return None
        if result is None or "wall_clock" not in result.run:
            return None
        missed = [each.sentence for each in result.expectations if not each.met]
        return Outcome(MISSED if missed else DONE, " ".join(missed), result.run["wall_clock"])
    record = read_json(directory / RECORD)
    if (
        isinstance(record, dict)
        and record.get("status") == ABORTED
        and set(record) == {f.name for f in fields(Outcome)}
    ):
        return Outcome(**record)
    return None


def read_json(path: Path) -> Any:
    """The content of a JSON file; None if it does not exist or is damaged."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def write_outcome(directory: Path, outcome: Outcome) -> None:
    """Write the outcome to the directory of the run, atomically."""
    write_text(directory / RECORD, json.dumps(asdict(outcome), indent=2) + "\n")


@contextmanager
def naming_write_errors(out: Path, remedy: str) -> Iterator[None]:
    """In the block, an error of the operating system, such as a full disk, becomes an OutputError with a
    `remedy`.

    `out`: directory of the study, for errors that do not name a file.
    """
    try:
        yield
    except OSError as error:
        where = error.filename or out
        raise OutputError(f"{where} cannot be written or read: {error.strerror or error}. {remedy}") from None


def numbers_of(directory: Path) -> dict[str, float]:
    """All numbers of a completed run by the names of the `expect:` block.

    A number that is not finite is nan. The result is empty if the run has no result.
    """
    try:
        result = read_run(directory).result
    except GranflowError:
        return {}
    return {} if result is None else result.numbers


def warnings_of(directory: Path) -> tuple[str, ...]:
    """The warnings of a completed run; empty if it has no result."""
    try:
        result = read_run(directory).result
    except GranflowError:
        return ()
    return () if result is None else tuple(map(str, result.warnings))


def reason_without(quantity: str, directory: Path) -> str:
    """Why a completed run has no number for a quantity: that it is NaN, with the warnings of the run on its
    metric."""
    if quantity not in numbers_of(directory):
        return f"{quantity} is missing."
    part = quantity.partition(".")[2]
    sources = (f"output.metrics.{part}: ", f"output.flow_meters.{part}: ")
    content = read_json(directory / "result.json") or {}
    reasons = [str(each) for each in content.get("warnings", ()) if str(each).startswith(sources)]
    return " ".join([f"{quantity} is NaN.", *reasons])


def error_name(quantity: str) -> str:
    """Name of the standard error of a number, such as angle_of_repose_error_mean.left.

    Few quantities have one.
    """
    name, dot, part = quantity.partition(".")
    base, end = (name[: -len("_mean")], "_mean") if name.endswith("_mean") else (name, "")
    return f"{base}_error{end}{dot}{part}"


# Carrying out a run: started, or resumed from its checkpoint, and watched until it ends

POLL = 0.2
"""Interval [s] at which a request to stop is checked."""
STOP_TIMEOUT = 120.0
"""Time [s] for a stopped run to write its checkpoint; after it the process is killed."""
PROGRAM = (sys.executable, "-m", "granflow")
"""Command that carries out a run with the arguments of granflow."""
MESSAGES = "stderr.txt"
"""File in the directory of a run with the messages of its last attempt."""
REFUSAL = GranflowError.exit_code
ABORT = RunError.exit_code


def execute(request: RunRequest, should_stop: Callable[[], bool] = lambda: False) -> Outcome:
    """Carry out a run and return its outcome, which is also written to its directory.

    A run that has ended is not repeated; one with a checkpoint is resumed. A process that still writes into
    the directory, such as one whose worker was killed, is waited for. The run is stopped with a checkpoint if
    the stop file exists or `should_stop` returns True. A run whose inputs have changed since it was checked
    does not belong to its directory: it has the status NOT_RUN with a reason, and leaves no files.
    """
    directory = Path(request.directory)
    stop_file = Path(request.stop_file)

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
    code: int | None = REFUSAL
    if has_checkpoint:  # a resumed run reads the copies of the inputs in its directory
        code = _watch(request.resumed, directory, stopping)
    if code == REFUSAL:
        if request.inputs is not None and (change := request.inputs.change()):
            shutil.rmtree(directory, ignore_errors=True)
            return Outcome(NOT_RUN, change)
        code = _watch(request.new, directory, stopping)
    outcome = _outcome(directory, code, time.monotonic() - began)
    if outcome.status != NOT_RUN:
        write_outcome(directory, outcome)
    return outcome


def _wait_until_free(directory: Path, stopping: Callable[[], bool]) -> bool:
    """Wait until no process has locked the directory, which is created.

    Returns False if a stop is requested before.
    """
    while not stopping():
        try:
            with locked(directory):
                return True
        except GranflowError:
            time.sleep(POLL)
    return False


def _watch(arguments: Sequence[str], directory: Path, stopping: Callable[[], bool]) -> int | None:
    """Carry out a command of granflow and return its exit code: negative for a signal, None if stopped.

    The process has a session of its own: Ctrl-C in the terminal reaches this one only.
    """
    with open(directory / MESSAGES, "wb") as messages:
        process = subprocess.Popen(
            [*PROGRAM, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=messages,
            start_new_session=True,
        )
    while True:
        try:
            return process.wait(POLL)
        except subprocess.TimeoutExpired:
            if stopping():
                break
    process.terminate()
    try:
        code = process.wait(STOP_TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return None
    return code if code in (0, 1, REFUSAL, ABORT) else None  # the run may have just ended


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
    return Outcome(
        CRASHED, reason or f"The process ended with exit code {code}.", seconds, code < 0 or code > ABORT
    )


def _signal_name(number: int) -> str:
    """Name of a signal, such as SIGKILL."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _reason(directory: Path) -> str:
    """The messages of a process on one line: without progress and warnings; of a traceback the last line.

    The directory of the run is shown as runs/HASH, so that the reason does not depend on the place of the
    study; see `from_working_directory`.
    """
    text = (directory / MESSAGES).read_text(encoding="utf-8", errors="replace")
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    if any(line.startswith("Traceback") for line in lines):
        return lines[-1]
    problems = [
        line for line in lines if line.startswith(("granflow: ", "--set", os.sep)) or ".yaml:" in line
    ]
    words = [
        line.removeprefix("granflow: ") for line in problems if not line.startswith("granflow: warning:")
    ]
    return " ".join(words).replace(str(directory), f"{directory.parent.name}/{directory.name}")


def from_working_directory(reason: str, out: Path) -> str:
    """A reason with the path of each run from the working directory, so that its commands can be repeated
    there.

    out:  directory of the study
    """
    return re.sub(r"(?<![\w/])runs/(?=[0-9a-f]{16}\b)", lambda _: f"{out}/runs/", reason)
