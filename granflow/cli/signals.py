"""SIGINT (Ctrl-C) and SIGTERM take effect within a second, in every verb and at any time.

Before a run has begun, the handler raises an exception at once. During a run it requests a stop: the run completes the
launch in progress (LAUNCH_SECONDS, or one step if that is longer), writes a checkpoint and ends. While C++ code
compiles a kernel no Python handler runs, so the default action of the operating system ends the process instead.
"""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from granflow.cli.messages import EXIT_INTERRUPTED, EXIT_TERMINATED, Terminated, say

GRACE = 0.7
"""Seconds after a signal until the process ends without an orderly stop, or reports what the stop waits for."""

STOPS = (signal.SIGINT, signal.SIGTERM)
DEFERRED = (
    "granflow: stopping: the step or file in progress is completed and a checkpoint written; "
    "a second signal ends the run at once."
)
AT_ONCE = "granflow: ended at once, without a checkpoint of this moment."


class StopSignals:
    """Handles stop signals while a verb runs. `request`: asks a run to stop; without it the handler raises."""

    def __init__(self) -> None:
        self.request: Callable[[BaseException], None] | None = None
        self._stop: KeyboardInterrupt | None = None
        self._timer: threading.Timer | None = None
        self._before: dict[int, Any] = {}

    def install(self) -> None:
        """Handle the signals that the process does not ignore."""
        for each in STOPS:
            if signal.getsignal(each) != signal.SIG_IGN:
                self._before[each] = signal.signal(each, self._handle)

    def restore(self) -> None:
        """Give the signals back to their handlers before."""
        self._cancel_timer()
        for each, handler in self._before.items():
            signal.signal(each, handler)

    @contextmanager
    def default_action(self) -> Iterator[None]:
        """Signals end the process without Python; a stop that some code has swallowed is raised again.

        A run that stops in order goes on: its checkpoint may need a kernel that is not compiled yet.
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
        first = self._stop is None
        self._stop = Terminated() if number == signal.SIGTERM else KeyboardInterrupt()
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
        """In a thread of its own, GRACE after a signal: the main thread has not ended the verb yet."""
        say(DEFERRED if deferred else AT_ONCE, file=sys.stderr, flush=True)
        if not deferred:
            os._exit(EXIT_TERMINATED if number == signal.SIGTERM else EXIT_INTERRUPTED)

    def _cancel_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()


_current: StopSignals | None = None


@contextmanager
def stop_signals() -> Iterator[None]:
    """Handle stop signals inside, in the main thread of the command line."""
    global _current
    if threading.current_thread() is not threading.main_thread() or _current is not None:
        yield
        return
    from granflow.device import compilation

    _current = signals = StopSignals()
    around, compilation.around = compilation.around, signals.default_action
    signals.install()
    try:
        yield
    finally:
        signals.restore()
        compilation.around, _current = around, None


@contextmanager
def deferred_to(request: Callable[[BaseException], None]) -> Iterator[None]:
    """The first stop signal inside calls `request` with the exception to raise later; the second one raises."""
    if _current is not None:
        _current.request = request
    try:
        yield
    finally:
        if _current is not None:
            _current.request = None
