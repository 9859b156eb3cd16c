"""Output directory of a run: lock, log, copies of input files, checkpoints, and result."""

import logging
import os
import re
import shlex
import shutil
import time as clock
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from filecmp import cmp
from math import inf
from pathlib import Path
from typing import Any

from granflow.errors import GranflowError, OutputError
from granflow.io.checkpoint import (
    Checkpoint,
    RankFileWriter,
    engine_digest,
    remove_after,
    remove_old_checkpoints,
    write_checkpoint,
)
from granflow.io.files import BackgroundWriter, LostFiles, remove_parts, replacing, resolved
from granflow.io.lock import DirectoryLock, refuse_second_run, writing
from granflow.io.log import LOG, RECORD, collected_warnings, run_log, write_scene_as_run
from granflow.load import Scene, copied_scene
from granflow.observers.observer import Checkpointable, Schedule
from granflow.runs.result import STAGE_ENDS, Result, write_result, write_stage_ends
from granflow.scene.blocks.output import Checkpoints

POSITION = re.compile(r" \((?:[^()]*:\d+(?::\d+)?|--set [^()]*)\)|^\S+:\d+:\d+: ")
"""Position of a value in a warning: `(scene.yaml:31)`, `(--set KEY=VALUE)`, or `scene.yaml:31:5: ` at its
begin."""
SavedBy = Callable[[RankFileWriter], dict[str, Any]]
"""Returns the state for a checkpoint, after the writer has written the files of the other MPI ranks."""


class RunDirectory:
    """Files of one run, except those of observers.

    Without a path nothing is written, and all methods have no effect.

    `resumed`: checkpoint from which the run continues, or None. `path`: absolute, so that it does not depend
    on the working directory. `writer`: writes the frames of observers, in a thread while the directory is
    open.

    Before each write, the directory and its lock are compared with those that were opened: after `rm -rf`, a
    move or a replacement, the run must not write into the files of another one.

    Raises GranflowError if a new run would delete an input file of its scene, or, without `overwrite`, an
    earlier run, or if another run of this process writes into the directory.
    """

    def __init__(
        self,
        path: Path | None,
        scene: Scene,
        resumed: Checkpoint | None,
        overwrite: bool = False,
    ) -> None:
        self._given = path
        self._overwrite = overwrite
        self.path = None if path is None else Path(os.path.abspath(path))
        self.writer = BackgroundWriter()
        self._lock: DirectoryLock | None = None
        self._rescued = False
        self._scene = scene
        self._resumed = resumed
        self._copied_scene = scene
        self._inputs: list[tuple[Path, str]] = []
        self._checkpoints: CheckpointWriter | None = None
        if self.path is not None:
            refuse_second_run(self.path)
            self._copied_scene = copied_scene(scene)
            self._checkpoints = CheckpointWriter(
                self.path, scene.output.checkpoint, self._copied_scene.to_yaml()
            )
        self._delete_previous: Callable[[], None] = lambda: None
        self._log = logging.getLogger("granflow")
        self._warnings: list[str] = []
        self._recorded: list[str] = []
        self._log_exists = resumed is not None
        if path is not None and resumed is None:
            refuse_inputs_inside(scene, path, only_results=True)
            self._refuse_results(path)

    def _refuse_results(self, path: Path) -> None:
        """Raise GranflowError if the directory contains an earlier run that must not be replaced."""
        if not self._overwrite and results_in(path):
            raise GranflowError(
                f"{path} contains an earlier run: give another directory, replace the run with "
                "overwrite=True, or continue it with resume."
            )

    @property
    def shown(self) -> Path | None:
        """The path for messages: as given, unless the working directory has changed."""
        given = self._given
        return given if given is None or Path(os.path.abspath(given)) == self.path else self.path

    def create(self) -> None:
        """Create the directory, and find the input files while the working directory is that of the start."""
        if self.path is not None:
            self.path.mkdir(parents=True, exist_ok=True)
            self._inputs = list(inputs_of(self._scene, self._copied_scene))

    @contextmanager
    def open(self, observers: Iterable[Checkpointable]) -> Iterator[None]:
        """Lock the directory, move the results of a previous run aside, and write the input files.

        An error before `began` moves the previous results back. A resumed run restores the files of its
        `observers`. The end of the block waits for the frames.
        """
        if self._resumed is not None:
            self._warnings = list(self._resumed.saved["warnings"])
        with ExitStack() as stack:
            if self.path is not None:
                self._lock = stack.enter_context(writing(self.path))
                self.writer.guard = self._lock.check
                stack.callback(self._release)
                if self._resumed is None:
                    restore_previous_run(self.path)
                    self._refuse_results(self.path)
                    self._delete_previous = stack.enter_context(replaced_run(self.path))
                self._clean(self.path, observers)
                stack.enter_context(self.writer.running())
            yield

    def _release(self) -> None:
        """Clear the lock, which is released."""
        self._lock = None
        self.writer.guard = lambda: None

    def check(self) -> None:
        """Raise LostFiles if the directory or its lock was moved, deleted or replaced."""
        if self._lock is not None:
            self._lock.check()

    @contextmanager
    def recording(self) -> Iterator[None]:
        """In the block, collect the warnings and write the log, to which later blocks append."""
        with ExitStack() as stack:
            self._recorded = stack.enter_context(collected_warnings())
            if self.path is not None:
                self.check()
                stack.enter_context(run_log(self.path, append=self._log_exists))
                self._log_exists = True
            try:
                yield
            finally:
                self._warnings += self._recorded
                self._recorded = []

    def _clean(self, path: Path, observers: Iterable[Checkpointable]) -> None:
        """Remove temporary files, and all that is newer than the resumed state; write the input files."""
        remove_parts(path)
        remove_after(path, self._resumed.path if self._resumed else None)
        copy_inputs(path, self._inputs)
        write_scene_as_run(path, self._copied_scene)
        if self._resumed is not None:
            (path / "result.json").unlink(missing_ok=True)
            for observer in observers:
                observer.truncate()

    def began(self) -> None:
        """Wait for the first frame of the new run and delete the results of the previous one."""
        self.writer.wait()
        self._delete_previous()

    def start_schedule(self, time: float) -> None:
        """Start the schedule of checkpoints at `time` [s]."""
        if self._checkpoints is not None:
            self._checkpoints.start(time)

    @property
    def next_checkpoint(self) -> float:
        """Simulated time [s] of the next scheduled checkpoint; infinite without a schedule.

        The wall clock has no effect on it.
        """
        return inf if self._checkpoints is None else self._checkpoints.next_time()

    @property
    def checkpoint_time(self) -> float | None:
        """Simulated time of the last checkpoint [s], initially that of the resumed one; else None."""
        written = self._checkpoints.last_time if self._checkpoints is not None else None
        return self._resumed.time if written is None and self._resumed is not None else written

    @property
    def warnings(self) -> list[str]:
        """All warnings so far, those before the resumed checkpoint included, each once.

        A resumed run reads its scene from another file, so that the same warning names another position.
        """
        found: dict[str, str] = {}
        for warning in [*self._warnings, *self._recorded]:
            found.setdefault(POSITION.sub("", warning), warning)
        return list(found.values())

    def save(self, time: float, step: int, state: SavedBy) -> None:
        """Write a checkpoint of the state at `time` [s], with the warnings.

        Raises OSError if it cannot be written.
        """
        if self._checkpoints is not None:
            began = clock.perf_counter()
            self._check_unless_rescued()
            self._checkpoints.write(time, step, lambda writer: state(writer) | {"warnings": self.warnings})
            self._log.info("checkpoint at %.6g s, written in %.3g s", time, clock.perf_counter() - began)

    def save_if_due(self, time: float, step: int, state: SavedBy) -> bool:
        """Write a checkpoint if one is due, and log a write error; return whether one was written.

        Raises OSError if the directory is gone, or if a frame cannot be written.
        """
        self.check()
        self.writer.check()
        if self._checkpoints is None or not self._checkpoints.due(time):
            return False
        self.writer.wait()
        try:
            self.save(time, step, state)
        except LostFiles:
            raise
        except OSError as error:
            self.check()
            logging.getLogger("granflow.checkpoint").warning(
                "No checkpoint at %.6g s: %s: %s", time, error.filename or self.path, error.strerror or error
            )
            return False
        return True

    def write(self, result: Result) -> Result:
        """Write the result of the run, after all frames; return it with all warnings of the run."""
        self.writer.wait()
        result = replace(result, warnings=tuple(self.warnings))
        if self.path is not None:
            self.check()
            write_result(self.path, result)
            write_stage_ends(self.path)
        return result

    def note_on_state(self, written: bool, change: str) -> str:
        """Return sentences on an aborted run: whether its state is `written`, and how to continue it.

        `change`: KEY=VALUE that lets it continue past the abort; empty if no change of a permitted key is
        known to. Without a checkpoint, as after an abort before the first step, the command runs the scene
        from the start. Empty without a path. Before the first frame of the run, the previous one will be
        restored, see `open`. Waits for the frames.
        """
        self.writer.wait()
        if self.path is None:
            return ""
        if (self.path / PREVIOUS).is_dir():
            return f" Nothing is written; {self.shown} keeps the earlier run."
        if self.checkpoint_time is None:
            return self._note_without_checkpoint(written, change)
        note = f" The state is written to {self.shown}."
        if not written:
            note = f" The state is not finite and is not written; {self.shown} contains the earlier frames."
        command = f"granflow resume {shlex.quote(str(self.shown))}"
        at = f"at {self.checkpoint_time:.6g} s"
        if change:
            return f"{note} {command} --set {change} continues from the last good state, {at}."
        return (
            f"{note} {command} continues from the last good state, {at}, and stops here again unless the "
            "scene is changed."
        )

    def _note_without_checkpoint(self, written: bool, change: str) -> str:
        """As `note_on_state` for a run without a checkpoint.

        The command contains the overrides of the first one.
        """
        shown = self.shown
        assert shown is not None
        note = f" {shown} contains a frame of this state, but no checkpoint: the run cannot continue from it."
        if not written:
            note = f" The state is not finite and is not written; {shown} contains no checkpoint."
        if not change:
            return f"{note} Correct the scene and run it from the start."
        scene = shlex.quote(str(shown / "scene_as_run.yaml"))
        other = shlex.quote(f"{self.path if shown.name in ('', '..') else shown}_2")
        return (
            f"{note} granflow run {scene} --out {other} --set {change} runs it from the start with this "
            "change."
        )

    def output_error(
        self,
        error: OSError,
        time: float,
        save: Callable[[], None] | None,
        save_kept: Callable[[float | None], None],
    ) -> OutputError:
        """Return the error for files that cannot be written, after a checkpoint if that is possible.

        `save`: writes the present state, None if that is not possible; `save_kept`: writes the state kept
        last, if it is later than a time [s] or None. The latter is used for lost files, because frames that
        wait to be written belong to the present state. The message contains the file, the reason, the
        simulated time [s] and the command that resumes the run.
        """
        try:
            self.check()
        except LostFiles as lost:
            error = lost
        where = f"{error.filename}: " if error.filename else f"{self.shown}: "
        stopped = f"{where}{error.strerror or error}. Stopped at {time:.6g} s."
        if isinstance(error, LostFiles):
            return OutputError(f"{stopped} {self._rescue(save_kept)}")
        try:
            if save is not None:
                save()
        except OSError:
            self._log.debug("no checkpoint can be written either")
        last = self.checkpoint_time
        remedy = (
            f"Correct this; {self._command(self.shown)} continues from {last:.6g} s."
            if last is not None
            else ""
        )
        return OutputError(f"{stopped} {remedy}".rstrip())

    def _command(self, directory: Path | None) -> str:
        """Command that resumes the run in a directory."""
        return f"granflow resume {shlex.quote(str(directory))}"

    def _rescue(self, save_kept: Callable[[float | None], None]) -> str:
        """Write a checkpoint of the state kept last where the files of the run are now.

        Returns a sentence on it.

        Without the directory, the checkpoint is written to its path, or beside it if that is taken.
        """
        assert self.path is not None and self._checkpoints is not None
        moved = self._lock.present_path() if self._lock is not None else self.path
        target = moved or self.path
        if moved is None and os.path.lexists(target):
            target = self.path.with_name(f"{self.path.name}_rescued")
        name = self.shown if target == self.path else target
        last = self.checkpoint_time if moved is not None else None
        self._rescued = True
        self._checkpoints.directory = target
        self._checkpoints.last_time = None
        try:
            if moved is None:
                target.mkdir(parents=True)
                copy_inputs(target, self._inputs)
                write_scene_as_run(target, self._copied_scene)
            save_kept(last)
        except (OSError, GranflowError) as error:
            return f"No checkpoint can be written to {name}: {error}."
        written = self._checkpoints.last_time
        if (time := last if written is None else written) is None:
            return "There is no checkpoint."
        remark = "; give it --allow-changes if rows of a time series are lost"
        return f"{self._command(name)} continues from {time:.6g} s{remark}."

    def _check_unless_rescued(self) -> None:
        """Raise LostFiles before a checkpoint, except for the one in another directory."""
        if not self._rescued:
            self.check()


# Schedule of the checkpoints of a run.


class CheckpointWriter:
    """Schedules and writes the checkpoints of one run, and keeps the newest few.

    `scene_text`: YAML of the resolved scene, part of each checkpoint. `settings`: `interval` [s] of simulated
    time, or None; `wall_clock` [s]; `keep`: number of files. The wall clock is monotonic: a change of the
    system time has no effect. `last_time` [s]: of the last checkpoint, None before it.
    """

    def __init__(self, directory: Path, settings: Checkpoints, scene_text: str) -> None:
        self.directory = directory
        self._settings = settings
        self._scene_text = scene_text
        self._schedule = Schedule(settings.interval) if settings.interval else None
        self._written_at = clock.monotonic()
        engine_digest()  # of the sources at the start of the run
        self.last_time: float | None = None

    def start(self, time: float) -> None:
        """Start the schedule at `time` [s]."""
        self._written_at = clock.monotonic()
        if self._schedule is not None:
            self._schedule.mark_done(time)

    def next_time(self) -> float:
        """Return the simulated time of the next scheduled checkpoint [s], regardless of the wall clock."""
        return inf if self._schedule is None else self._schedule.next_time()

    def due(self, time: float) -> bool:
        """Return whether a checkpoint is due, by the simulated `time` [s] or by the wall clock."""
        return time >= self.next_time() or clock.monotonic() - self._written_at >= self._settings.wall_clock

    def write(self, time: float, step: int, state: SavedBy) -> None:
        """Write a checkpoint and remove old ones; after an error the next one is due as after a success.

        `time` [s], `step`: of the state, as in `write_checkpoint`. Raises OSError if a file cannot be
        written.
        """
        self.start(time)
        writer = RankFileWriter.of(self.directory, step)
        write_checkpoint(self.directory, self._scene_text, time, step, state(writer))
        writer.remove_replaced()
        remove_old_checkpoints(self.directory, self._settings.keep)
        self.last_time = time


# Copies the input files of a scene to the output directory, so that a run can be continued on any machine.


def copy_inputs(directory: Path, inputs: Iterable[tuple[Path, str]]) -> None:
    """Copy meshes, tables of motions and particle files to their paths in the resolved scene.

    A different file at that path is not overwritten: `.before` is appended to its name. Subdirectories are
    created. `inputs`: as from `inputs_of`. Raises OSError if a file cannot be copied.
    """
    for source, name in inputs:
        target = Path(directory) / name
        if target.exists() and (source == resolved(target) or cmp(source, target, shallow=False)):
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists():
            target.replace(target.with_name(target.name + ".before"))
        with replacing(target) as temporary:
            shutil.copyfile(source, temporary)


def inputs_of(scene: Scene, copied: Scene) -> Iterator[tuple[Path, str]]:
    """Yield the absolute paths of the input files of a scene, and those of their copies in `copied_scene`.

    Files that a continued run no longer has are left out.
    """
    for (_, name), (_, copy) in zip(scene.input_names(), copied.input_names(), strict=True):
        source = resolved(scene.folder / name)
        if source.exists():
            yield source, copy


def input_files(scene: Scene) -> Iterator[tuple[str, Path]]:
    """Yield the key and the path of each input file of the scene: meshes, tables of motions and of particles.

    The key is that of the scene, such as `walls.hopper.file`; the path starts with the folder of the scene.
    The file need not exist.
    """
    return ((key, scene.folder / name) for key, name in scene.input_names())


# The previous run in an output directory: a new run replaces it only once the new run has begun.
#
# The results move to `previous_run/` in the directory (on the same file system) and are deleted after the
# first frame of the new run. An earlier error moves them back. A killed process leaves one of the following
# states, which `restore_previous_run` recognizes:
#
#     .previous_run.part/   some results moved, the others in place; no new file exists
#     previous_run/         all results moved; new files may exist
#     .discarded_run/       the new run has begun; deletion is incomplete

RESULT_FILES = (
    "particles.pvd",
    "contacts.pvd",
    "walls.pvd",
    "particles_*.vtu",
    "particles_*.pvtu",
    "contacts_*.vtu",
    "walls_*.vtu",
    "fields_*.pvd",
    "fields_*.vtu",
    "analysis/fields_*.pvd",
    "analysis/fields_*.vtu",
    "analysis/metrics.csv",
    "timeseries.csv",
    STAGE_ENDS,
    "collision_energies.csv",
    "passages_*.csv",
    "residence_time.csv",
    "result.json",
    "scene_as_run.yaml",
    LOG,
    RECORD,
    "checkpoint_*.npz",
    "rank_*.npz",
    "report.html",
    "pictures/picture_*.png",
    "pictures/film_*.mp4",
)
"""Patterns of the result files of a run, which distinguish an earlier run from other files."""
PREVIOUS, MOVING, DISCARDED = "previous_run", ".previous_run.part", ".discarded_run"
"""Names of the directories for the three states."""


@contextmanager
def replaced_run(directory: Path) -> Iterator[Callable[[], None]]:
    """Move the results in the directory away; yield a function that deletes them.

    It is called after the first frame.

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


def restore_previous_run(directory: Path) -> list[str]:
    """Move the results of the previous run back if the new run did not begin; return a sentence in that case.

    The caller must have locked the directory. The function may be interrupted at any point and called again.
    Result files of the new run are deleted. Raises OSError if a file cannot be moved.
    """
    previous = directory / PREVIOUS
    moving = directory / MOVING
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
    return [
        f"{directory} holds the previous run again: the run that was to replace it ended before its first "
        "frame."
    ]


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


def _move(path: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    os.replace(path, target)
