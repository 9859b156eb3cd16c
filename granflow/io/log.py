"""The record of a run in its output directory: `run.log` and `scene_as_run.yaml`."""

import logging
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path
from typing import Protocol

from granflow.io.atomic_files import separate_from_links, write_text
from granflow.kernel_language import KERNELS
from granflow.visible_text import VisibleFormatter


class HasYamlText(Protocol):
    """Protocol of objects with a YAML text, such as a scene."""

    def to_yaml(self) -> str:
        """Return the YAML text with all defaults."""


@contextmanager
def run_log(directory: Path, append: bool = False) -> Iterator[logging.Logger]:
    """In the block, write the records of the logger `granflow` from level INFO to `run.log` in the directory.

    An older log is replaced, or extended with `append`. An exception that ends the block is the last entry and
    propagates. Creates the directory if necessary. The level of the logger is restored afterwards.
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


def write_scene_as_run(directory: Path, scene: HasYamlText) -> Path:
    """Write the resolved scene as `scene_as_run.yaml`, which loads as the same scene. Return its path.

    The file is written atomically, in UTF-8; the directory is created if necessary.
    """
    path = Path(directory) / "scene_as_run.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, scene.to_yaml())
    return path


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
