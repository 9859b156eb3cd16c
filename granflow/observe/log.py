"""The record of a run beside its output: `run.log` and `scene_as_run.yaml`."""

import logging
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path
from typing import Protocol

from granflow.observe.files import write_text
from granflow.visible_text import VisibleFormatter


class HasYamlText(Protocol):
    """Something that can be written as YAML: a scene."""

    def text(self) -> str:
        """The whole as YAML, all defaults filled in."""


@contextmanager
def run_log(directory: Path, append: bool = False) -> Iterator[logging.Logger]:
    """Write what the logger `granflow` says at INFO and above to `run.log` in the directory, while inside.

    An older log is replaced, or gone on with. The exception that ends the block, if any, is the last entry.
    """
    logger = logging.getLogger("granflow")
    level_before = logger.level
    handler = _file_handler(Path(directory), "a" if append else "w")
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield logger
    except BaseException as error:
        logger.error("ended by %s: %s", type(error).__name__, error)
        raise
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level_before)
        with suppress(OSError):
            handler.close()


def versions() -> str:
    """What computes here: granflow, Taichi, numpy, Python, and the system."""
    packages = ", ".join(f"{name} {version_of(name)}" for name in ("granflow", "taichi", "numpy"))
    return f"{packages}, Python {platform.python_version()}, {platform.platform()}"


def version_of(package: str) -> str:
    """Version of an installed package."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def write_scene_as_run(directory: Path, scene: HasYamlText) -> Path:
    """Write `scene_as_run.yaml`, the scene with all its defaults; loading it gives the same scene again."""
    path = Path(directory) / "scene_as_run.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, scene.text())
    return path


class _LogFile(logging.FileHandler):
    """A log that cannot be written must not keep a run from saying what else cannot be, and ending in order."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Leave the record out."""


def _file_handler(directory: Path, mode: str) -> logging.FileHandler:
    directory.mkdir(parents=True, exist_ok=True)
    handler = _LogFile(directory / "run.log", mode=mode, encoding="utf-8")
    handler.setFormatter(VisibleFormatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    return handler
