"""What `run.log` says: when a run began, on what machine, what it warned of, and how it ended."""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from granflow.errors import GranflowError
from granflow.regular_files import read_regular_text

ENTRY = re.compile(r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d),\d+ ([A-Z]+) ([\w.]+): (.*)")
"""Time, level, logger, and words of an entry, as granflow.observe.log writes them."""

COMPILED = re.compile(r"(\w+) with (\w+), compiled in (.+) s")
FROM_CHECKPOINT = "goes on from"
EVENTS = ("stage ", "checkpoint at ", "done at ", FROM_CHECKPOINT)
SERIOUS = ("WARNING", "ERROR", "CRITICAL")


@dataclass(frozen=True)
class Entry:
    """One entry of a log; words may have several lines."""

    time: str
    level: str
    words: str


@dataclass(frozen=True)
class Session:
    """One stretch of a run, from its start or a checkpoint on: when, with what, where, and from where."""

    began: str
    versions: str
    arch: str
    precision: str
    compiled: str
    goes_on: str


def read_log(path: Path) -> list[Entry]:
    """The entries of a log; none where there is no file. Raises GranflowError where it cannot be read."""
    try:
        lines = read_regular_text(path).splitlines()
    except FileNotFoundError:
        return []
    except OSError as error:
        raise GranflowError(f"{path}: {error.strerror}.") from None
    entries: list[Entry] = []
    for line in lines:
        match = ENTRY.fullmatch(line)
        if match:
            entries.append(Entry(match[1], match[2], match[4]))
        elif entries:
            last = entries[-1]
            entries[-1] = Entry(last.time, last.level, f"{last.words}\n{line}")
    return entries


def sessions(entries: list[Entry]) -> list[Session]:
    """The stretches of a run, the first one first: each begins with the entry of versions."""
    starts = [number for number, entry in enumerate(entries) if entry.words.startswith("granflow ")]
    ends = [*starts[1:], len(entries)]
    return [_session(entries[start:end]) for start, end in zip(starts, ends, strict=False)]


def _session(entries: list[Entry]) -> Session:
    compiled = next(filter(None, (COMPILED.fullmatch(entry.words) for entry in entries)), None)
    goes_on = next((entry.words for entry in entries if entry.words.startswith(FROM_CHECKPOINT)), "")
    arch, precision, seconds = compiled.groups() if compiled else ("", "", "")
    return Session(entries[0].time, entries[0].words, arch, precision, seconds, goes_on)


def explanation(entries: list[Entry]) -> str:
    """What `granflow explain` said of the last stretch of the run, as far as it is logged: up to the first event."""
    starts = [number for number, entry in enumerate(entries) if COMPILED.fullmatch(entry.words)]
    lines: list[str] = []
    for entry in entries[starts[-1] + 1 :] if starts else ():
        if entry.level != "INFO" or entry.words.startswith(EVENTS):
            break
        lines.append(entry.words)
    return "\n".join(lines)


def complaints(entries: list[Entry]) -> Iterator[tuple[str, str, str]]:
    """Time, level and words of every warning and error; one that comes again is said once, with how often."""
    count = Counter((entry.level, entry.words) for entry in entries if entry.level in SERIOUS)
    first = {(entry.level, entry.words): entry.time for entry in reversed(entries)}
    for (level, words), times in count.items():
        yield first[level, words], level.lower(), words + (f" ({times} times)" if times > 1 else "")
