"""The record of a run in its output directory: `run.log` and `scene_as_run.yaml`.

`run_log` writes the log of a run, which the parser at the end of this file reads again for the report of the
run: its sessions, the output of `granflow explain`, warnings and errors.
"""

import logging
import platform
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import metadata
from itertools import pairwise
from pathlib import Path
from typing import Protocol

from granflow.errors import GranflowError
from granflow.io.files import read_regular_text, separate_from_links, write_text
from granflow.kernel_language import KERNELS
from granflow.visible_text import VisibleFormatter


@contextmanager
def run_log(directory: Path, append: bool = False) -> Iterator[logging.Logger]:
    """In the block, write the records of the logger `granflow` from level INFO to `run.log` in the directory.

    An older log is replaced, or extended with `append`. An exception that ends the block is the last entry
    and propagates. Creates the directory if necessary. The level of the logger is restored afterwards.
    """
    logger = logging.getLogger("granflow")
    level_before = logger.level
    handler = _file_handler(Path(directory), "a" if append else "w")
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield logger
    except BaseException as error:
        for problem in getattr(error, "problems", (error,)):
            logger.error("ended by %s: %s", type(error).__name__, problem)
        raise
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level_before)
        with suppress(OSError):
            handler.close()


class _LogFile(logging.FileHandler):
    """A log file whose write errors do not stop a run: it must still report other errors and end properly."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Drop the record."""


def _file_handler(directory: Path, mode: str) -> logging.FileHandler:
    """Return a handler that writes to `run.log`; control characters in messages are shown as escapes."""
    directory.mkdir(parents=True, exist_ok=True)
    separate_from_links(directory / "run.log")
    handler = _LogFile(directory / "run.log", mode=mode, encoding="utf-8")
    handler.setFormatter(VisibleFormatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    return handler


LOGGERS = ("granflow", "granflow.checkpoint")
"""Loggers of warnings during a run."""


@contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """In the block, add the text of each warning of LOGGERS to the list.

    A filter, not a handler: without any handler, Python prints warnings on stderr.
    """
    found: list[str] = []

    def collect(record: logging.LogRecord) -> bool:
        if record.levelno >= logging.WARNING:
            found.append(record.getMessage())
        return True

    for name in LOGGERS:
        logging.getLogger(name).addFilter(collect)
    try:
        yield found
    finally:
        for name in LOGGERS:
            logging.getLogger(name).removeFilter(collect)


def versions() -> str:
    """Return the versions of granflow, the kernel language, numpy and Python, and the platform."""
    packages = ", ".join(f"{name} {version_of(name)}" for name in ("granflow", KERNELS, "numpy"))
    return f"{packages}, Python {platform.python_version()}, {platform.platform()}"


def version_of(package: str) -> str:
    """Return the version of an installed package, or "not installed"."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


class HasYamlText(Protocol):
    """An object with a YAML text: a scene, whose class is in a higher layer."""

    def to_yaml(self) -> str:
        """Return the YAML text with all defaults."""


def write_scene_as_run(directory: Path, scene: HasYamlText) -> Path:
    """Write the resolved scene as `scene_as_run.yaml`, which loads as the same scene. Return its path.

    The file is written atomically, in UTF-8; the directory is created if necessary.
    """
    path = Path(directory) / "scene_as_run.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, scene.to_yaml())
    return path


# Reading the log

ENTRY = re.compile(r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d),\d+ ([A-Z]+) ([\w.]+): (.*)")
"""Time, level, logger and text of an entry, see `_file_handler`."""
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
    arch, precision, threads, seconds = compiled.groups("") if compiled else ("", "", "", "")
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
