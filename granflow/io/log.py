"""The record of a run in its output directory: `run.log`, `run.jsonl` and `scene_as_run.yaml`.

`run_log` writes the log of a run for people, and of the same entries those that the report of the run needs
as a record: its sessions with the output of `granflow explain`, its warnings and errors.
"""

import json
import logging
import platform
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from granflow.errors import GranflowError
from granflow.io.files import read_text, separate_from_links, write_text
from granflow.kernel_language import KERNELS
from granflow.visible_text import VisibleFormatter, numbered

LOG = "run.log"
"""Log of a run, for people: all entries."""
RECORD = "run.jsonl"
"""Record of a run, for programs: one JSON object per session, warning and error."""
FACTS = "facts"
"""Attribute of a log record with the fields that its entry in the record of the run has in addition."""


@contextmanager
def run_log(directory: Path, append: bool = False) -> Iterator[logging.Logger]:
    """In the block, write the entries of the logger `granflow` from level INFO to LOG in the directory.

    Those that are warnings, errors or have FACTS go to RECORD as well. Older files are replaced, or extended
    with `append`. An exception that ends the block is the last entry and propagates. Creates the directory if
    necessary. The level of the logger is restored afterwards.
    """
    logger = logging.getLogger("granflow")
    level_before = logger.level
    directory.mkdir(parents=True, exist_ok=True)
    mode = "a" if append else "w"
    with ExitStack() as handlers:
        for name, formatter in ((LOG, LINE), (RECORD, _RecordFormatter("%(message)s"))):
            separate_from_links(directory / name)
            handler = _LogFile(directory / name, mode=mode, encoding="utf-8")
            handler.setFormatter(formatter)
            if name == RECORD:
                handler.addFilter(_is_recorded)
                handler.end_line()
            logger.addHandler(handler)
            handlers.callback(_remove, logger, handler)
        logger.setLevel(logging.INFO)
        handlers.callback(logger.setLevel, level_before)
        try:
            yield logger
        except BaseException as error:
            name = type(error).__name__
            for problem in getattr(error, "problems", (error,)):
                logger.error("ended by %s: %s", name, problem, extra={FACTS: {"ended_by": name}})
            raise


LINE = VisibleFormatter("%(asctime)s %(levelname)s %(name)s: %(message)s")
"""Lines of the log; control characters in messages are shown as escapes."""


class _LogFile(logging.FileHandler):
    """A log file whose write errors do not stop a run: it must still report other errors and end properly."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Drop the record."""

    def end_line(self) -> None:
        """End the last line of the file, which a killed session may have cut off."""
        with suppress(OSError):
            content = Path(self.baseFilename).read_bytes()
            if self.stream is not None and content and not content.endswith(b"\n"):
                self.stream.write("\n")


class _RecordFormatter(VisibleFormatter):
    """Formats log records as JSON objects: time, level, text and facts."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the object on one line."""
        entry = {
            "time": self.formatTime(record, "%Y-%m-%d %H:%M:%S"),
            "level": record.levelname,
            "text": super().format(record),
        }
        return json.dumps(entry | getattr(record, FACTS, {}))


def _is_recorded(record: logging.LogRecord) -> bool:
    """Whether a log record belongs in the record of the run."""
    return record.levelno >= logging.WARNING or hasattr(record, FACTS)


def _remove(logger: logging.Logger, handler: logging.Handler) -> None:
    """Remove a handler and close its file; a write error is not raised."""
    logger.removeHandler(handler)
    with suppress(OSError):
        handler.close()


def warning_handler(shown: Collection[str] = ()) -> logging.Handler:
    """A handler that prints warnings to stderr, with the prefix of those of commands, except those in
    `shown`; errors end a run and are reported as exceptions."""
    handler = logging.StreamHandler()
    handler.setLevel(logging.WARNING)
    handler.addFilter(lambda record: record.levelno == logging.WARNING and record.getMessage() not in shown)
    handler.setFormatter(VisibleFormatter("granflow: warning: %(message)s"))
    return handler


@contextmanager
def warnings_shown(shown: Collection[str] = (), always: bool = True) -> Iterator[None]:
    """In the block, print the warnings of the log to stderr, except those in `shown`.

    Without `always` only if the logger has no handler: otherwise the program has decided what becomes of its
    entries.
    """
    logger = logging.getLogger("granflow")
    if not always and logger.hasHandlers():
        yield
        return
    handler = warning_handler(shown)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


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
    from importlib import metadata  # its import takes 15 ms of each start

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


# Reading the record


@dataclass(frozen=True)
class SessionFacts:
    """Facts on one session of a run, from its start or from a checkpoint.

    versions:         of granflow and the packages that it uses, and the platform
    threads:          number of CPU threads; None on a GPU
    compile_seconds:  time of compilation [s]
    resumed_from:     file of the checkpoint; empty for the first session
    resumed_at:       simulated time of the checkpoint [s]
    explanation:      output of `granflow explain`
    """

    versions: str
    arch: str
    precision: str
    threads: int | None
    compile_seconds: float
    resumed_from: str
    resumed_at: float
    explanation: str


@dataclass(frozen=True)
class RecordEntry:
    """One entry of the record of a run: the start of a session, a warning or an error.

    session:   facts on the session that starts; None for other entries
    ended_by:  name of the exception that ended the run; empty for other entries
    """

    time: str
    level: str
    text: str
    session: SessionFacts | None = None
    ended_by: str = ""


class Record(list[RecordEntry]):
    """Entries of the record of a run; its display is one line."""

    def __repr__(self) -> str:
        """Numbers of sessions, warnings and errors."""
        starts = sum(entry.session is not None for entry in self)
        levels = [entry.level for entry in self]
        parts = [
            numbered(starts, "session"),
            numbered(levels.count("WARNING"), "warning"),
            numbered(levels.count("ERROR"), "error"),
        ]
        return f"<Record: {', '.join(parts)}>"


def read_record(path: Path) -> Record:
    """Entries of a record; empty if the file does not exist. Raises GranflowError if it cannot be read.

    Lines that are no entry are skipped: the last one of a session that was killed may be cut off.
    """
    try:
        lines = read_text(path).splitlines()
    except FileNotFoundError:
        return Record()
    except OSError as error:
        raise GranflowError(f"{path}: {error.strerror}.") from None
    entries = Record()
    for line in lines:
        with suppress(ValueError, TypeError):
            found = json.loads(line)
            facts = found.pop("session", None)
            entries.append(RecordEntry(**found, session=None if facts is None else SessionFacts(**facts)))
    return entries


def sessions(entries: list[RecordEntry]) -> list[tuple[str, SessionFacts]]:
    """Start time and facts of each session of a run, in order."""
    return [(entry.time, entry.session) for entry in entries if entry.session is not None]


REPORTED_LEVELS = ("WARNING", "ERROR", "CRITICAL")
"""Levels of entries that the page shows."""


def warnings_and_errors(entries: list[RecordEntry]) -> Iterator[tuple[str, str, str]]:
    """Time, level and text of each warning and error; repeated entries appear once, with their number."""
    count = Counter((entry.level, entry.text) for entry in entries if entry.level in REPORTED_LEVELS)
    first = {(entry.level, entry.text): entry.time for entry in reversed(entries)}
    for (level, text), times in count.items():
        yield first[level, text], level.lower(), text + (f" ({times} times)" if times > 1 else "")
