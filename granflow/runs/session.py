"""The files of a run in parts: opened at the first step, closed at the end or by an exception."""

import atexit
import logging
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress

from granflow.errors import FunctionError, GranflowError, StopRun
from granflow.io.checkpoint import Checkpoint
from granflow.io.log import warnings_shown
from granflow.runs.result import Result
from granflow.runs.run_directory import RunDirectory
from granflow.runs.time_loop import TimeLoop
from granflow.runs.timings import log_plan
from granflow.snapshot import TOTALS
from granflow.visible_text import visible_line

LOGGER = logging.getLogger("granflow")


class RunSession:
    """Opens the files of a run before its first step and keeps them open between its parts.

    `loop`: of the run; `files`: its directory; `resumed`: checkpoint from which it continues, or None.
    `warnings`: sentences on the scene, for the log. `is_open`: whether the files are open.
    """

    def __init__(
        self,
        loop: TimeLoop,
        files: RunDirectory,
        resumed: Checkpoint | None,
        warnings: Callable[[], Sequence[str]],
    ) -> None:
        self._loop = loop
        self._state = loop.state
        self._files = files
        self._resumed = resumed
        self._warnings = warnings
        self._open = ExitStack()
        self.is_open = False
        self._has_ended = False
        self._is_running = False
        self._failure: type[BaseException] | None = None

    @contextmanager
    def running(self) -> Iterator[None]:
        """In the block, the files are open, warnings and log are recorded, and the wall clock runs.

        The files remain open for the next block, unless an exception ends it.
        """
        with self._guarding():
            is_first = not self.is_open
            self._open_files()
            self._is_running = True
            try:
                with (
                    warnings_shown(always=False),
                    self._files.recording(),
                    self._state.wall_clock.running(),
                ):
                    if is_first and self._files.path is not None:
                        log_plan(self._state.plan, self._loop.engine, self._resumed)
                    if is_first and not self._has_ended:
                        for sentence in self._warnings():
                            LOGGER.warning("%s", sentence)
                    yield
            finally:
                self._is_running = False

    @contextmanager
    def _guarding(self) -> Iterator[None]:
        """Close the files if an exception ends the block, for some exceptions after a checkpoint."""
        try:
            yield
        except FunctionError as error:
            failure = self._saved(error)
            self._abandon()
            raise failure from error.__cause__
        except OSError as error:
            save = self._loop.save if self._state.progress.target is not None else None
            output_error = self._files.output_error(error, self._loop.engine.time, save, self._loop.save_kept)
            self._abandon()
            raise output_error from error
        except BaseException as error:
            if error is self._state.observers.raised:  # sys.exit() in an observer
                self._save_if_possible()
            self._abandon()
            raise

    def _open_files(self) -> None:
        """Open the files at the first step. Raises GranflowError if they are finished."""
        if self.is_open:
            return
        if self._has_ended and self._files.path is not None:
            raise GranflowError(self._reason_of_end())
        self._open.enter_context(self._files.open(self._state.observers.checkpointed().values()))
        self.is_open = True
        if self._files.path is not None:
            _UNCLOSED[self] = os.getpid()
        self._open.callback(self._state.observers.finish)
        self._files.start_schedule(self._loop.engine.time)

    def _reason_of_end(self) -> str:
        """Why files cannot be written any more, and the remedy."""
        path = self._files.shown
        saved = self._files.checkpoint_time
        if self._failure is None:
            return (
                f"The files in {path} are finished: put all runs of the simulation into one with block, or "
                "resume from the last checkpoint."
            )
        last = (
            "It has no checkpoint."
            if saved is None
            else f"Resume from its last checkpoint, at {saved:.6g} s."
        )
        return f"{self._failure.__name__} has ended the run in {path}. {last}"

    def _saved(self, error: FunctionError) -> FunctionError:
        """The error with a sentence on the checkpoint, which is written here if the run has begun.

        The function may have changed files of the run: the sentence then says why there is no checkpoint, and
        the error remains that of the function.
        """
        if self._files.path is None or not self._state.progress.stage_times:
            return error
        failed = str(error).rstrip(".")
        try:
            self._loop.save()
        except OSError as unwritten:
            unsaved = self._files.output_error(unwritten, self._loop.engine.time, None, self._loop.save_kept)
            return FunctionError(f"{failed}. No checkpoint of this state can be written: {unsaved}")
        except GranflowError as refused:
            return FunctionError(f"{failed}. No checkpoint of this state can be written: {refused}")
        return FunctionError(f"{failed}. The state at this time is saved in {self._files.shown}.")

    def _abandon(self) -> None:
        """During the handling of an exception, close the files as they are."""
        if self.is_open:
            self.is_open = False
            self._has_ended = True
            self._failure = sys.exc_info()[0]
            _UNCLOSED.pop(self, None)
            with suppress(OSError):  # of the writer: the exception that is handled is the first one
                self._open.__exit__(*sys.exc_info())

    def abandon(self) -> None:
        """While an exception of a script is handled, write a checkpoint if possible and close the files."""
        self._save_if_possible()
        self._abandon()

    def _save_if_possible(self) -> None:
        """Write a checkpoint if the run has begun and its files are open."""
        with suppress(Exception):
            if self.is_open and self._state.progress.stage_times:
                self._loop.save()

    def close(self, result: Callable[[], Result]) -> Result:
        """Pass the last snapshot to all observers, write checkpoint and result, and close the files.

        `result`: returns the numbers of the run after the last snapshot.
        """
        with self.running():
            self._loop.save()
            with suppress(StopRun):
                self._loop.notify_all(frozenset({TOTALS}))
            self._files.writer.wait()
            written = self._files.write(result())
        with self._guarding():
            self.is_open = False
            self._has_ended = True
            _UNCLOSED.pop(self, None)
            self._open.close()
        return written

    def close_at_exit(self) -> None:
        """Close the files at the end of a program without `close`; an error is printed."""
        if self._is_running:  # in another thread, which the end of the program stops
            return
        try:
            self.close(self._loop.last_result)
        except Exception as error:
            sys.stderr.write(f"granflow: {visible_line(str(error))}\n")


_UNCLOSED: dict[RunSession, int] = {}
"""Sessions with open files, and the processes that opened them: at the end of a program they are closed."""


@atexit.register
def _close_all() -> None:
    """Close the files of all sessions of this process; a forked process has those of its parent, too."""
    for session, process in list(_UNCLOSED.items()):
        if process == os.getpid():
            session.close_at_exit()
