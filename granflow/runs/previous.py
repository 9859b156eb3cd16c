"""The previous run in an output directory: a new run replaces it only once the new run has begun.

The results move to `previous_run/` in the directory (on the same file system) and are deleted after the first frame of
the new run. An earlier error moves them back. A killed process leaves one of the following states, which
`restore_previous_run` recognizes:

    .previous_run.part/   some results moved, the others in place; no new file exists
    previous_run/         all results moved; new files may exist
    .discarded_run/       the new run has begun; deletion is incomplete
"""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from granflow.errors import GranflowError
from granflow.load import Scene
from granflow.runs.input_copies import input_files

RESULT_FILES = (
    *("particles.pvd", "contacts.pvd", "walls.pvd"),
    *("particles_*.vtu", "particles_*.pvtu", "contacts_*.vtu", "walls_*.vtu"),
    *("fields_*.pvd", "fields_*.vtu", "analysis/fields_*.pvd", "analysis/fields_*.vtu", "analysis/metrics.csv"),
    *("timeseries.csv", "result.json", "scene_as_run.yaml", "run.log", "checkpoint_*.npz", "rank_*.npz"),
    *("report.html", "pictures/picture_*.png", "pictures/film_*.mp4"),
)
"""Patterns of the result files of a run, which distinguish an earlier run from other files."""

PREVIOUS, MOVING, DISCARDED = "previous_run", ".previous_run.part", ".discarded_run"
"""Names of the directories for the three states in the module docstring."""


def results_in(directory: Path) -> list[Path]:
    """Return the result files of a run in the directory; empty if it does not exist."""
    return [path for pattern in RESULT_FILES for path in directory.glob(pattern)]


def refuse_inputs_inside(scene: Scene, directory: Path, only_results: bool = False) -> None:
    """Raise GranflowError if `start_from` or an input file of the scene is in the directory.

    With `only_results`, only if the new run would delete it: result files, or the directory itself.
    """
    folder = directory.resolve()
    lost = {folder, *(path.resolve() for path in results_in(directory))}
    start = [] if scene.start_from is None else [("start_from", Path(scene.start_from))]
    for key, path in ((key, path.resolve()) for key, path in [*start, *input_files(scene)]):
        if path in lost or (path.is_relative_to(folder) and not only_results):
            raise GranflowError(
                f"{key} is {path}, which is in the output directory {directory} of the run to be replaced: "
                "give another directory with --out."
            )


def restore_previous_run(directory: Path) -> list[str]:
    """Move the results of the previous run back if the new run did not begin; return a sentence in that case.

    The caller must have locked the directory. The function may be interrupted at any point and called again. Result
    files of the new run are deleted. Raises OSError if a file cannot be moved.
    """
    previous, moving = directory / PREVIOUS, directory / MOVING
    shutil.rmtree(directory / DISCARDED, ignore_errors=True)
    if previous.is_dir():
        for path in results_in(directory):
            path.unlink()
        os.replace(previous, moving)
    if not moving.is_dir():
        return []
    for path in [path for path in moving.rglob("*") if not path.is_dir()]:
        _move(path, directory / path.relative_to(moving))
    shutil.rmtree(moving)
    return [f"{directory} holds the previous run again: the run that was to replace it ended before its first frame."]


@contextmanager
def replaced_run(directory: Path) -> Iterator[Callable[[], None]]:
    """Move the results in the directory away; yield a function that deletes them, to be called after the first frame.

    If the block raises before that call, the results move back and those of the new run are deleted.
    """
    restore_previous_run(directory)
    results = results_in(directory)
    for path in results:
        _move(path, directory / MOVING / path.relative_to(directory))
    if results:
        os.replace(directory / MOVING, directory / PREVIOUS)

    def delete_previous() -> None:
        if (directory / PREVIOUS).is_dir():
            os.replace(directory / PREVIOUS, directory / DISCARDED)
            shutil.rmtree(directory / DISCARDED, ignore_errors=True)

    try:
        yield delete_previous
    except BaseException:
        with suppress(OSError):
            restore_previous_run(directory)
        raise
    delete_previous()


def _move(path: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    os.replace(path, target)
