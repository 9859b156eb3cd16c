"""Output directory of a run: lock, log, copies of input files, checkpoints, and result."""

import logging
import os
import re
import shlex
import time as clock
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from math import inf
from pathlib import Path

from granflow.errors import GranflowError, OutputError
from granflow.io.atomic_files import remove_parts
from granflow.io.background_writer import BackgroundWriter
from granflow.io.checkpoint import Checkpoint, remove_after
from granflow.io.lock import DirectoryLock, LostFiles, refuse_second_run, writing
from granflow.io.log import collected_warnings, run_log, write_scene_as_run
from granflow.load import Scene, copied_scene
from granflow.observers.base import Checkpointable
from granflow.observers.collision_energies import FILE as COLLISION_ENERGIES
from granflow.runs.checkpoint_schedule import CheckpointWriter, SavedBy
from granflow.runs.input_copies import copy_inputs, inputs_of
from granflow.runs.previous import PREVIOUS, refuse_inputs_inside, replaced_run, restore_previous_run, results_in
from granflow.runs.result import Result, write_result

POSITION = re.compile(r" \((?:[^()]*:\d+(?::\d+)?|--set [^()]*)\)|^\S+:\d+:\d+: ")
"""Position of a value in a warning: `(scene.yaml:31)`, `(--set KEY=VALUE)`, or `scene.yaml:31:5: ` at its begin."""

CONTINUED = ("timeseries.csv", COLLISION_ENERGIES, "run.log")
"""Files to which a resumed run appends."""


class RunDirectory:
    """Files of one run, except those of observers. Without a path nothing is written, and all methods have no effect.

    `resumed`: checkpoint from which the run continues, or None. `path`: absolute, so that it does not depend on the
    working directory. `writer`: writes the frames of observers, in a thread while the directory is open.

    Before each write, the directory and its lock are compared with those that were opened: after `rm -rf`, a move or a
    replacement, the run must not write into the files of another one.

    Raises GranflowError if a new run would delete an input file of its scene, or, without `overwrite`, an earlier run,
    if a resumed one would append to something other than a regular file, or if another run of this process writes into
    the directory.
    """

    def __init__(
        self,
        path: Path | None,
        scene: Scene,
        resumed: Checkpoint | None,
        overwrite: bool = False,
    ) -> None:
        self._given, self._overwrite = path, overwrite
        self.path = None if path is None else Path(os.path.abspath(path))
        self.writer = BackgroundWriter()
        self._lock: DirectoryLock | None = None
        self._rescued = False
        self._scene, self._resumed = scene, resumed
        self._copied_scene = scene
        self._inputs: list[tuple[Path, str]] = []
        self._checkpoints: CheckpointWriter | None = None
        if self.path is not None:
            refuse_second_run(self.path)
            self._copied_scene = copied_scene(scene)
            self._checkpoints = CheckpointWriter(self.path, scene.output.checkpoint, self._copied_scene.to_yaml())
        self._delete_previous: Callable[[], None] = lambda: None
        self._log = logging.getLogger("granflow")
        self._warnings: list[str] = []
        self._recorded: list[str] = []
        self._log_exists = resumed is not None
        if path is not None and resumed is not None:
            _refuse_special_files(path)
        if path is not None and resumed is None:
            refuse_inputs_inside(scene, path, only_results=True)
            self._refuse_results(path)

    def _refuse_results(self, path: Path) -> None:
        """Raise GranflowError if the directory contains an earlier run that must not be replaced."""
        if not self._overwrite and results_in(path):
            raise GranflowError(
                f"{path} contains an earlier run: give another directory, replace the run with overwrite=True, or "
                "continue it with resume."
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

        An error before `began` moves the previous results back. A resumed run restores the files of its `observers`.
        The end of the block waits for the frames.
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
        self._lock, self.writer.guard = None, lambda: None

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
        """Remove temporary files, newer checkpoints and results after the resumed state; write the input files."""
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
        """Simulated time [s] of the next scheduled checkpoint, regardless of the wall clock; infinite without."""
        return inf if self._checkpoints is None else self._checkpoints.next_time()

    @property
    def checkpoint_time(self) -> float | None:
        """Simulated time of the last checkpoint [s], initially that of the resumed one; None without a checkpoint."""
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
        """Write a checkpoint of the state at `time` [s], with the warnings. Raises OSError if it cannot be written."""
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
            logging.getLogger("granflow.checkpoint").warning("No checkpoint at %.6g s: %s", time, error)
            return False
        return True

    def write(self, result: Result) -> Result:
        """Write the result of the run with all its warnings, after all frames; return it with the warnings."""
        self.writer.wait()
        result = replace(result, warnings=tuple(self.warnings))
        if self.path is not None:
            self.check()
            write_result(self.path, result)
        return result

    def note_on_state(self, written: bool, change: str) -> str:
        """Return sentences for an aborted run: whether its state is `written`, and the command that continues.

        `change`: KEY=VALUE that lets it continue past the abort; empty if no change of a permitted key is known to.
        Without a checkpoint, as after an abort before the first step, the command runs the scene from the start. Empty
        without a path. Before the first frame of the run, the previous one will be restored, see `open`. Waits for the
        frames.
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
        if change:
            return f"{note} {command} --set {change} continues from the last good state."
        return f"{note} {command} continues from the last good state, and stops here again unless the scene is changed."

    def _note_without_checkpoint(self, written: bool, change: str) -> str:
        """As `note_on_state` for a run without a checkpoint; the command contains the overrides of the first one."""
        shown = self.shown
        assert shown is not None
        note = f" {shown} contains a frame of this state, but no checkpoint: the run cannot continue from it."
        if not written:
            note = f" The state is not finite and is not written; {shown} contains no checkpoint."
        if not change:
            return f"{note} Correct the scene and run it from the start."
        scene = shlex.quote(str(shown / "scene_as_run.yaml"))
        other = shlex.quote(f"{self.path if shown.name in ('', '..') else shown}_2")
        return f"{note} granflow run {scene} --out {other} --set {change} runs it from the start with this change."

    def output_error(
        self, error: OSError, time: float, save: Callable[[], None] | None, save_kept: Callable[[float | None], None]
    ) -> OutputError:
        """Return the error for files that cannot be written, after a checkpoint if that is possible.

        `save`: writes the present state, None if that is not possible; `save_kept`: writes the state kept last, if it
        is later than a time [s] or None. The latter is used for lost files, because frames that wait to be written
        belong to the present state. The message contains the file, the reason, the simulated time [s] and the command
        that resumes the run.
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
        remedy = f"Correct this; {self._command(self.shown)} continues from {last:.6g} s." if last is not None else ""
        return OutputError(f"{stopped} {remedy}".rstrip())

    def _command(self, directory: Path | None) -> str:
        """Command that resumes the run in a directory."""
        return f"granflow resume {shlex.quote(str(directory))}"

    def _rescue(self, save_kept: Callable[[float | None], None]) -> str:
        """Write a checkpoint of the state kept last where the files of the run are now; return a sentence on it.

        Without the directory, the checkpoint is written to its path, or beside it if that is taken.
        """
        assert self.path is not None and self._checkpoints is not None
        moved = self._lock.present_path() if self._lock is not None else self.path
        target = moved or self.path
        if moved is None and os.path.lexists(target):
            target = self.path.with_name(f"{self.path.name}_rescued")
        name = self.shown if target == self.path else target
        last = self.checkpoint_time if moved is not None else None
        self._rescued, self._checkpoints.directory, self._checkpoints.last_time = True, target, None
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


def _refuse_special_files(path: Path) -> None:
    """Raise GranflowError if a resumed run would append to a directory, a pipe or a device: a pipe blocks forever."""
    for file in (path / name for name in CONTINUED):
        if file.exists() and not file.is_file():
            raise GranflowError(
                f"{file} is not a regular file, and the run cannot append to it: restore the file, or move this away "
                "and continue with --allow-changes."
            )
