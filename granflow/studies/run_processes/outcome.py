"""Outcome of a run, from the files in its directory: nothing else is known about runs after a restart."""

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from math import nan
from pathlib import Path
from typing import Any

from granflow import GranflowError, OutputError, read_run
from granflow.io.atomic_files import write_text

DONE, MISSED, REFUSED, ABORTED = "done", "expectation missed", "refused", "aborted"
CRASHED, NOT_RUN = "crashed", "not run"
SEVERITY = (DONE, MISSED, NOT_RUN, REFUSED, ABORTED, CRASHED)
"""Statuses of a run in ascending severity; a run that was stopped, or not started, has the status NOT_RUN."""

RESULT = "result.json"
"""File in the directory of a run with its numbers, written at its end."""

RECORD = "outcome.json"
"""File in the directory of a run with its outcome, written when the process has ended."""


@dataclass(frozen=True)
class Outcome:
    """Status of a run, its reason in full, and the wall clock [s]; nan if it is unknown.

    `is_lost`: the process ended without a decision of its own (killed, lost worker, full disk), so that another attempt
    can succeed.
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


def final_outcome(directory: Path) -> Outcome | None:
    """The outcome of a run that is not repeated: completed or aborted; None for all others.

    A result or a record that is damaged, such as one that a full disk has cut off, is that of a run to repeat.
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


@contextmanager
def naming_write_errors(out: Path, remedy: str) -> Iterator[None]:
    """In the block, an error of the operating system, such as a full disk, becomes an OutputError with a `remedy`.

    `out`: directory of the study, for errors that do not name a file.
    """
    try:
        yield
    except OSError as error:
        where = error.filename or out
        raise OutputError(f"{where} cannot be written or read: {error.strerror or error}. {remedy}") from None


def write_outcome(directory: Path, outcome: Outcome) -> None:
    """Write the outcome to the directory of the run, atomically."""
    write_text(directory / RECORD, json.dumps(asdict(outcome), indent=2) + "\n")


def read_json(path: Path) -> Any:
    """The content of a JSON file; None if it does not exist or is damaged."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def numbers_of(directory: Path) -> dict[str, float]:
    """All numbers of a completed run by the names of the `expect:` block; nan for a number that is not finite.

    Empty if the run has no result.
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
    """Why a completed run has no number for a quantity: that it is NaN, with the warnings of the run on its metric."""
    if quantity not in numbers_of(directory):
        return f"{quantity} is missing."
    metric = f"output.metrics.{quantity.partition('.')[2]}: "
    content = read_json(directory / "result.json") or {}
    reasons = [str(each) for each in content.get("warnings", ()) if str(each).startswith(metric)]
    return " ".join([f"{quantity} is NaN.", *reasons])


def worst(outcomes: Iterable[Outcome]) -> Outcome:
    """The most severe status of several runs, with the different reasons of all of them and the sum of the seconds."""
    found = list(outcomes)
    status = max((each.status for each in found), key=SEVERITY.index, default=NOT_RUN)
    reasons = dict.fromkeys(each.reason for each in found if each.reason)
    return Outcome(status, " ".join(reasons), sum(each.seconds for each in found if each.seconds == each.seconds))
