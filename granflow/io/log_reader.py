"""Parser of `run.log`: start time, machine, warnings and end of a run."""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from granflow.errors import GranflowError
from granflow.io.regular_files import read_regular_text

ENTRY = re.compile(r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d),\d+ ([A-Z]+) ([\w.]+): (.*)")
"""Time, level, logger and text of an entry in the format of granflow.io.log."""

COMPILED = re.compile(r"(\w+) with (\w+)(?:, (\d+) threads?)?, compiled in (.+) s")
"""Entry with backend, precision, number of threads on a CPU and compilation time [s]."""

RESUMED_FROM = "resumed from"
"""Beginning of the entry of a resumed run."""

EVENTS = ("stage ", "checkpoint at ", "done at ", RESUMED_FROM)
"""Beginnings of the entries that follow the plan."""

REPORTED_LEVELS = ("WARNING", "ERROR", "CRITICAL")
"""Levels of entries that the page shows."""


@dataclass(frozen=True)
class LogEntry:
    """One entry of a log; the text may have several lines."""

    time: str
    level: str
    text: str


@dataclass(frozen=True)
class RunSession:
    """One session of a run, from its start or from a checkpoint: start time, versions, backend, checkpoint.

    `threads` is empty on a GPU.
    """

    started: str
    versions: str
    arch: str
    precision: str
    threads: str
    compiled: str
    resumed_from: str


def read_log(path: Path) -> list[LogEntry]:
    """Entries of a log; empty if the file does not exist. Raises GranflowError if it cannot be read.

    Lines without a time stamp continue the entry before them.
    """
    try:
        lines = read_regular_text(path).splitlines()
    except FileNotFoundError:
        return []
    except OSError as error:
        raise GranflowError(f"{path}: {error.strerror}.") from None
    entries: list[LogEntry] = []
    for line in lines:
        match = ENTRY.fullmatch(line)
        if match:
            entries.append(LogEntry(match[1], match[2], match[4]))
        elif entries:
            last = entries[-1]
            entries[-1] = LogEntry(last.time, last.level, f"{last.text}\n{line}")
    return entries


def sessions(entries: list[LogEntry]) -> list[RunSession]:
    """Sessions of a run in order; each begins with the entry of versions."""
    starts = [number for number, entry in enumerate(entries) if entry.text.startswith("granflow ")]
    return [_session(entries[start:end]) for start, end in pairwise([*starts, len(entries)])]


def _session(entries: list[LogEntry]) -> RunSession:
    """Session from its entries; texts are empty if the log lacks them."""
    compiled = next(filter(None, (COMPILED.fullmatch(entry.text) for entry in entries)), None)
    resumed_from = next((entry.text for entry in entries if entry.text.startswith(RESUMED_FROM)), "")
    arch, precision, threads, seconds = compiled.groups("") if compiled else ("",) * COMPILED.groups
    return RunSession(entries[0].time, entries[0].text, arch, precision, threads, seconds, resumed_from)


def explanation(entries: list[LogEntry]) -> str:
    """Logged output of `granflow explain` in the last session of the run: the text up to the first event."""
    starts = [number for number, entry in enumerate(entries) if COMPILED.fullmatch(entry.text)]
    lines: list[str] = []
    for entry in entries[starts[-1] + 1 :] if starts else ():
        if entry.level != "INFO" or entry.text.startswith(EVENTS):
            break
        lines.append(entry.text)
    return "\n".join(lines)


def warnings_and_errors(entries: list[LogEntry]) -> Iterator[tuple[str, str, str]]:
    """Time, level and text of each warning and error; repeated entries appear once, with their number."""
    count = Counter((entry.level, entry.text) for entry in entries if entry.level in REPORTED_LEVELS)
    first = {(entry.level, entry.text): entry.time for entry in reversed(entries)}
    for (level, text), times in count.items():
        yield first[level, text], level.lower(), text + (f" ({times} times)" if times > 1 else "")
