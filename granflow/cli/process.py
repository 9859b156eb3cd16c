"""The process of the command line: stop signals, standard streams and a quick start.

`main` runs each verb within `standard_streams` and `stop_signals`. The first SIGINT (Ctrl-C) or SIGTERM ends
a verb at once, but only requests that a run stops: it completes the steps in progress, which take about
`ADVANCE_SECONDS` of the time loop, writes a checkpoint and ends. A second signal ends the process. While C++
code compiles a kernel no Python handler runs, and during an import none may raise, so that the first signal
ends the process as well.
"""

import errno
import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from granflow.runs.interrupts import Terminated, stop_of

# Stop signals

STOPS = (signal.SIGINT, signal.SIGTERM)
"""Signals that stop a verb."""
DEFERRED = (
    "granflow: stopping: the step or file in progress is completed and a checkpoint written; "
    "a second signal ends the run at once."
)
"""Message after the first signal during a run."""
EXIT_INTERRUPTED = 130
"""128 + SIGINT: the exit code after Ctrl-C."""
EXIT_TERMINATED = 143
"""128 + SIGTERM: the exit code after a termination request."""


def exit_code_of(stop: KeyboardInterrupt) -> int:
    """Return the exit code that shells report for a process ended by a signal: 128 plus its number."""
    return EXIT_TERMINATED if isinstance(stop, Terminated) else EXIT_INTERRUPTED


class StopSignals:
    """Handles stop signals while a verb runs, except those that the process ignores.

    `request`: function (exception) that requests that a run stops; without it the handler raises the
    exception. `message`: printed with a request.
    """

    def __init__(self) -> None:
        self.request: Callable[[KeyboardInterrupt], None] | None = None
        self.message = DEFERRED
        self._is_stopped = False
        self._before = {each: signal.getsignal(each) for each in STOPS}
        self._handled = [each for each in STOPS if self._before[each] != signal.SIG_IGN]

    def install(self) -> None:
        """Handle the signals."""
        self._set(self._handle)

    def restore(self) -> None:
        """Restore the previous handlers."""
        for each, handler in self._before.items():
            signal.signal(each, handler)

    def pass_to(self, stop: Callable[[int], None]) -> None:
        """From now on, a signal only calls `stop` with its number."""
        self._set(lambda number, _frame: stop(number))
        self._handled = []

    @contextmanager
    def default_action(self) -> Iterator[None]:
        """Let signals end the process without Python."""
        self._set(signal.SIG_DFL)
        try:
            yield
        finally:
            if not self._is_stopped:
                self._set(self._handle)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        """Handler of the first signal: request a stop, raise KeyboardInterrupt, or, during an import, end the
        process, because libraries report an exception in their import as an error of their own."""
        self._is_stopped = True
        self._set(signal.SIG_DFL)
        if self.request is None:
            if _is_import(frame):
                signal.raise_signal(number)
            raise stop_of(number)
        with suppress(OSError):
            os.write(2, f"{self.message}\n".encode())  # a stream may be in the middle of a write
        self.request(stop_of(number))

    def _set(self, handler: Any) -> None:
        for each in self._handled:
            signal.signal(each, handler)


def _is_import(frame: FrameType | None) -> bool:
    """Whether Python is importing a module in the frame."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


_current: StopSignals | None = None
"""Handler of the verb in progress."""


@contextmanager
def stop_signals() -> Iterator[None]:
    """Handle stop signals in the block, if called in the main thread; Python permits handlers only there.

    Nested calls have no effect. The previous handlers are restored at the end.
    """
    global _current
    if threading.current_thread() is not threading.main_thread() or _current is not None:
        yield
        return
    from granflow import taichi_patches

    _current = signals = StopSignals()
    around = taichi_patches.around
    taichi_patches.around = signals.default_action
    signals.install()
    try:
        yield
    finally:
        signals.restore()
        taichi_patches.around = around
        _current = None


@contextmanager
def deferred_to(request: Callable[[KeyboardInterrupt], None], message: str = DEFERRED) -> Iterator[None]:
    """In the block, the first stop signal prints the message and calls `request` with the exception to raise
    later.

    Without `stop_signals` around it, the block has no effect.
    """
    if _current is not None:
        _current.request = request
        _current.message = message
    try:
        yield
    finally:
        if _current is not None:
            _current.request = None


@contextmanager
def deferred_to_event(message: str = DEFERRED) -> Iterator[tuple[threading.Event, list[KeyboardInterrupt]]]:
    """In the block, a stop signal sets the event and appends its exception to the list; see `deferred_to`."""
    stop = threading.Event()
    signals = list[KeyboardInterrupt]()

    def request(error: KeyboardInterrupt) -> None:
        signals.append(error)
        stop.set()

    with deferred_to(request, message):
        yield stop, signals


def pass_stops_to(stop: Callable[[int], None]) -> None:
    """Call `stop` with the number of each stop signal; for ranks other than the root, which ends the run."""
    if _current is not None:
        _current.pass_to(stop)


# Standard streams whose reader may close the pipe, as in `granflow explain SCENE | head`

EXIT_PIPE = 141
"""128 + SIGPIPE: the code that shells report for a command whose reader closed the pipe."""


class Output:
    """Whether the output of a verb is `needed`: lost progress lines must not end a simulation."""

    needed = True


class _Stream:
    """A standard stream that is replaced by the null device after a failed write.

    If the output is needed, the command then ends: silently with EXIT_PIPE when the reader closed the pipe,
    otherwise with the OSError.
    """

    def __init__(self, stream: Any, output: Output) -> None:
        self._stream = stream
        self._output = output

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write the text; returns its length."""
        with self._handling_errors():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Write what is buffered."""
        with self._handling_errors():
            self._stream.flush()

    @contextmanager
    def _handling_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self._stream.fileno())
            os.close(null)
            if not self._output.needed:
                return
            if error.errno == errno.EPIPE:
                raise SystemExit(EXIT_PIPE) from None
            error.filename = self._stream.name
            raise


@contextmanager
def standard_streams() -> Iterator[Output]:
    """In the block, handle failed writes to stdout and stderr as `_Stream`; the block may set `needed`.

    Streams of notebooks and tests are not replaced.
    """
    output = Output()
    before = {
        name: stream
        for name in ("stdout", "stderr")
        if (stream := getattr(sys, name)) is not None and stream is getattr(sys, f"__{name}__")
    }
    replaced = {name: _Stream(stream, output) for name, stream in before.items()}
    _replace(replaced)
    try:
        yield output
    finally:
        try:
            for stream in replaced.values():
                stream.flush()
        finally:
            _replace(before)


def _replace(streams: dict[str, Any]) -> None:
    """Set both names of each stream: if they differ, Taichi assumes a notebook."""
    for name, stream in streams.items():
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)


# The start

COMPILING = "Compiling kernels: 10 to 30 s at the first start, then from a cache ..."
"""Line on a terminal until a run can begin."""


@contextmanager
def compiling_shown() -> Iterator[None]:
    """In the block, a line on stderr that kernels are compiled, if it is a terminal; removed at the end."""
    if not sys.stderr.isatty():
        yield
        return
    sys.stderr.write(COMPILING)
    sys.stderr.flush()
    try:
        yield
    finally:
        sys.stderr.write("\r\x1b[2K")
        sys.stderr.flush()


@contextmanager
def quick_start() -> Iterator[None]:
    """In the block, no garbage collection, and no search for pydantic plugins in all installed packages.

    Nearly all objects of a start remain in use, so that some 400 collections, a tenth of its time, find
    little. At the end they count as old, which saves a collection of all of them at once.
    """
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            if not gc.get_freeze_count():  # else ranks keep theirs frozen
                gc.freeze()
                gc.unfreeze()
            gc.enable()
