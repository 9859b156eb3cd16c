"""The process of the command line: stop signals, standard streams, the memory limit and a quick start.

`main` runs each verb within `standard_streams` and `stop_signals`. A stop signal, SIGINT (Ctrl-C) or SIGTERM,
takes effect within a second at any time. While a verb works, the handler raises an exception at once. During
a run it requests a stop: the run completes the steps in progress, which take about `ADVANCE_SECONDS` of the
time loop, writes a checkpoint and ends. While C++ code compiles a kernel no Python handler runs, so the
default action of the operating system ends the process instead.
"""

import errno
import gc
import io
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from granflow.cli.arguments import say
from granflow.errors import GranflowError
from granflow.runs.interrupts import Terminated, stop_of

# Stop signals

STOPS = (signal.SIGINT, signal.SIGTERM)
"""Signals that stop a verb."""
GRACE = 0.7
"""Time from a signal to the exit without a checkpoint, or to the message that a stop is in progress [s]."""
DEFERRED = (
    "granflow: stopping: the step or file in progress is completed and a checkpoint written; "
    "a second signal ends the run at once."
)
"""Message if the run needs longer than GRACE to stop."""
AT_ONCE = "granflow: ended at once, without a checkpoint of the current time."
"""Message if a run ends without a checkpoint."""
ENDED = "granflow: ended at once."
"""Message if a verb ends that is not in a run."""
EXIT_INTERRUPTED = 130
"""128 + SIGINT: the exit code after Ctrl-C."""
EXIT_TERMINATED = 143
"""128 + SIGTERM: the exit code after a termination request."""


def exit_code_of(stop: KeyboardInterrupt) -> int:
    """Return the exit code that shells report for a process ended by a signal: 128 plus its number."""
    return EXIT_TERMINATED if isinstance(stop, Terminated) else EXIT_INTERRUPTED


class StopSignals:
    """Handles stop signals while a verb runs.

    `request`: function (exception) that requests that a run stops; without it the handler raises the
    exception. `message`: what is still completed, for the case that the stop takes longer than GRACE.
    """

    def __init__(self) -> None:
        self.request: Callable[[KeyboardInterrupt], None] | None = None
        self.message = DEFERRED
        self._stop: KeyboardInterrupt | None = None
        self._timer: threading.Timer | None = None
        self._before: dict[int, Any] = {}

    def install(self) -> None:
        """Install handlers for the signals that the process does not ignore."""
        for each in STOPS:
            if signal.getsignal(each) != signal.SIG_IGN:
                self._before[each] = signal.signal(each, self._handle)

    def restore(self) -> None:
        """Restore the previous handlers."""
        self._cancel_timer()
        for each, handler in self._before.items():
            signal.signal(each, handler)

    def pass_to(self, stop: Callable[[int], None]) -> None:
        """From now on, a signal only calls `stop` with its number."""
        for each in self._before:
            signal.signal(each, lambda number, _frame: stop(number))
        self._before = {}

    @contextmanager
    def default_action(self) -> Iterator[None]:
        """Let signals end the process without Python; a stop that other code has suppressed is raised again.

        A run that is already stopping continues: its checkpoint may need a kernel that is not compiled yet.
        """
        if self._stop is not None and self.request is None:
            raise self._stop
        for each in self._before:
            signal.signal(each, signal.SIG_DFL)
        try:
            yield
        finally:
            for each in self._before:
                signal.signal(each, self._handle)

    def _handle(self, number: int, *_: Any) -> None:
        """Handler of a signal: request a stop or raise KeyboardInterrupt, and start the timer of `_overdue`.

        A second signal always raises.
        """
        first = self._stop is None
        self._stop = stop_of(number)
        self._cancel_timer()
        deferred = first and self.request is not None
        self._timer = threading.Timer(GRACE, self._overdue, (number, deferred))
        self._timer.daemon = True
        self._timer.start()
        if deferred and self.request is not None:
            self.request(self._stop)
        else:
            raise self._stop

    def _overdue(self, number: int, deferred: bool) -> None:
        """Runs in a separate thread, GRACE after a signal, if the main thread has not yet ended the verb."""
        at_once = ENDED if self.request is None or self.message != DEFERRED else AT_ONCE
        say(self.message if deferred else at_once, file=sys.stderr, flush=True)
        if not deferred:
            os._exit(EXIT_TERMINATED if number == signal.SIGTERM else EXIT_INTERRUPTED)

    def _cancel_timer(self) -> None:
        """Stop the timer of an earlier signal."""
        if self._timer is not None:
            self._timer.cancel()


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
    """In the block, the first stop signal calls `request` with the exception to raise later.

    The second one raises that exception. `message`: printed if the stop takes longer than GRACE. Without
    `stop_signals` around it, the block has no effect.
    """
    if _current is not None:
        _current.request = request
        _current.message = message
    try:
        yield
    finally:
        if _current is not None:
            _current.request = None
            _current.message = DEFERRED


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
    """Reaction to a failed write to a standard stream.

    If `needed`, the command ends: silently with EXIT_PIPE when the reader closed the pipe, otherwise with the
    OSError. If not, the command continues and its output is dropped: lost progress lines must not end a
    simulation.
    """

    needed = True

    def failed(self, error: OSError, name: str) -> None:
        """Handle the first failed write to the stream `name`.

        If `needed`, raises SystemExit(EXIT_PIPE) for a closed pipe, and OSError with the name of the stream
        otherwise.
        """
        if not self.needed:
            return
        if error.errno == errno.EPIPE:
            raise SystemExit(EXIT_PIPE)
        error.filename = name
        raise error


@contextmanager
def standard_streams() -> Iterator[Output]:
    """Handle failed writes to stdout and stderr by `Output.failed`; the block may set `needed`.

    Both streams are replaced in the block and restored at the end. Streams of notebooks, tests and the
    Windows console are not replaced.
    """
    output = Output()
    names = [name for name in ("stdout", "stderr") if _is_process_stream(name)]
    before = {name: getattr(sys, name) for name in names}
    for name, stream in before.items():
        _replace(name, _wrapped(stream, output))
    try:
        yield output
        _flush(names)
    except SystemExit:
        _flush(names)
        raise
    finally:
        output.needed = False
        _flush(names)
        for name, stream in before.items():
            _replace(name, stream)


def _is_process_stream(name: str) -> bool:
    """Return whether a stream is that of the process, not of a notebook, a test or the Windows console."""
    stream = getattr(sys, name)
    console = sys.platform == "win32" and stream is not None and stream.isatty()
    return stream is not None and stream is getattr(sys, f"__{name}__") and not console


def _wrapped(stream: TextIO, output: Output) -> io.TextIOWrapper:
    """Return a text stream with the encoding and buffering of `stream`, on top of a `_Stream`."""
    stream.flush()
    buffer = io.BufferedWriter(_Stream(stream, output))
    return io.TextIOWrapper(
        buffer,
        stream.encoding,
        stream.errors,
        line_buffering=getattr(stream, "line_buffering", False),
        write_through=getattr(stream, "write_through", False),
    )


class _Stream(io.FileIO):
    """A standard stream that drops all output after a failed write.

    It writes to the file descriptor of `stream` and does not close it.
    """

    def __init__(self, stream: TextIO, output: Output) -> None:
        super().__init__(stream.fileno(), "w", closefd=False)
        self._shown_name = stream.name
        self._output = output
        self._lost = False

    def write(self, data: Any, /) -> int:
        """Write `data` to the stream, or drop it after a failed write; return the number of bytes.

        Raises the exceptions of `Output.failed` at the first failure.
        """
        if not self._lost:
            try:
                return super().write(data)
            except OSError as error:
                self._lost = True
                self._output.failed(error, self._shown_name)
        return memoryview(data).nbytes


def _replace(name: str, stream: TextIO) -> None:
    """Set both names of a stream: if they differ, Taichi assumes a notebook."""
    setattr(sys, name, stream)
    setattr(sys, f"__{name}__", stream)


def _flush(names: list[str]) -> None:
    """Flush the streams with these names."""
    for name in names:
        getattr(sys, name).flush()


# The memory limit and the start

LEAST = 512 * 2**20
"""Smallest limit [bytes]. OpenBLAS, which numpy calls, repeats a failed allocation forever; a run needs 2
GB."""


def refuse_low_memory_limit() -> None:
    """Raise GranflowError if the address space of this process is limited to less than LEAST."""
    try:
        import resource
    except ImportError:  # not on Windows
        return
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < LEAST:
        raise GranflowError(
            f"the memory limit of the process (ulimit -v) is {limit // 2**20} MiB, but granflow needs at "
            f"least {LEAST // 2**20} MiB to start, and a run at least 2 GB: raise or remove the limit."
        )


PAUSE = 5.0
"""Time [s] without garbage collection after a start: the first collections examine all objects of the
start."""


@contextmanager
def quick_start() -> Iterator[None]:
    """In the block, no garbage collection, and no search for pydantic plugins in all installed packages.

    Nearly all objects of a start remain in use, so that some 400 collections, a tenth of its time, find
    little. The collection begins PAUSE after the block.
    """
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            timer = threading.Timer(PAUSE, gc.enable)
            timer.daemon = True
            timer.start()
