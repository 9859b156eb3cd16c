"""A copy of the clone in which tools insert errors, and the replacement of one of its files."""

import os
import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("granflow", "tests", "tools", "scenes", "docs", "pyproject.toml", "README.md", "CHANGELOG.md")


def copy_to(folder: Path, root: Path = ROOT) -> Path:
    """Copies the source, the tests and the files that they read; returns the folder."""
    for name in PARTS:
        source = root / name
        if source.is_dir():
            ignored = shutil.ignore_patterns("__pycache__", ".pytest_cache")
            shutil.copytree(source, folder / name, ignore=ignored)
        elif source.is_file():
            folder.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, folder / name)
    return folder


def write_later(path: Path, text: str) -> None:
    """Replaces the text and sets a time of change 1 s or more after the previous one.

    Python takes stored bytecode as valid if the size of the source and its time of change in whole seconds
    agree; two errors of equal length within one second would otherwise run the code of the first.
    """
    later = path.stat().st_mtime + 1.0
    path.write_text(text, encoding="utf-8")
    os.utime(path, (later, later))
