"""SIGINT (Ctrl-C) and SIGTERM: handlers that take effect within a second, in every verb and at any time.

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

from granflow.cli.messages import EXIT_INTERRUPTED, EXIT_TERMINATED, say
from granflow.runs.interrupts import stop_of

GRACE = 0.7
"""Time from a signal to the exit without a checkpoint, or to the message that a stop is in progress [s]."""

STOPS = (signal.SIGINT, signal.SIGTERM)
"""Signals that stop a verb."""

DEFERRED = (
    "granflow: stopping: the step or file in progress is completed and a checkpoint written; "
    "a second signal ends the run at once."
)
"""Message if the run needs longer than GRACE to stop."""

AT_ONCE = "granflow: ended at once, without a checkpoint of the current time."
"""Message if a run ends without a checkpoint."""

ENDED = "granflow: ended at once."
"""Message if a verb ends that is not in a run."""


class StopSignals:
    """Handles stop signals while a verb runs.

    `request`: function (exception) that requests that a run stops; without it the handler raises the exception.
    `message`: what is still completed, for the case that the stop takes longer than GRACE.
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
    from granflow.engine import compilation

    _current = signals = StopSignals()
    around, compilation.around = compilation.around, signals.default_action
    signals.install()
    try:
        yield
    finally:
        signals.restore()
        compilation.around, _current = around, None


def pass_stops_to(stop: Callable[[int], None]) -> None:
    """On a rank that is not the root, call `stop` with the number of each stop signal: the root ends the run."""
    if _current is not None:
        _current.pass_to(stop)


@contextmanager
def deferred_to_event(message: str = DEFERRED) -> Iterator[tuple[threading.Event, list[KeyboardInterrupt]]]:
    """In the block, a stop signal sets the event and appends its exception to the list; see `deferred_to`."""
    stop, signals = threading.Event(), list[KeyboardInterrupt]()

    def request(error: KeyboardInterrupt) -> None:
        signals.append(error)
        stop.set()

    with deferred_to(request, message):
        yield stop, signals


@contextmanager
def deferred_to(request: Callable[[KeyboardInterrupt], None], message: str = DEFERRED) -> Iterator[None]:
    """In the block, the first stop signal calls `request` with the exception to raise later; the second one raises.

    `message`: printed if the stop takes longer than GRACE. Without `stop_signals` around it, the block has no effect.
    """
    if _current is not None:
        _current.request, _current.message = request, message
    try:
        yield
    finally:
        if _current is not None:
            _current.request, _current.message = None, DEFERRED
