"""Ctrl-C and SIGTERM in a Python program that runs a simulation."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


class Terminated(KeyboardInterrupt):
    """Raised on SIGTERM: ends a run in the same way as Ctrl-C."""


def stop_of(number: int) -> KeyboardInterrupt:
    """The exception with which a stop signal ends a run."""
    return Terminated() if number == signal.SIGTERM else KeyboardInterrupt()


@contextmanager
def stopping_on_interrupt(stop: Callable[[BaseException], None]) -> Iterator[None]:
    """In the block, Ctrl-C calls `stop` with a KeyboardInterrupt; a second one raises it at once.

    Between two launches the data on the host are complete, and a checkpoint can be written. No effect outside
    the main thread, which receives all signals, or if the program handles SIGINT itself.
    """
    in_main_thread = threading.current_thread() is threading.main_thread()
    if not in_main_thread or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        stop(KeyboardInterrupt())

    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
