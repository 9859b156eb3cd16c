"""Writes files in a background thread, in order, while the simulation continues."""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Condition, Thread

LONGEST_QUEUE = 8
"""Largest number of files that wait: a slow disk then delays the run, instead of filling the memory."""


class BackgroundWriter:
    """Executes tasks in the order of `submit`: in a thread within `running`, otherwise at once.

    An exception of a task ends the thread, and is raised in the main thread by the next call of `submit`, `wait` or
    `check`. The failed task and those behind it stay in the queue, and `wait` tries them again in the main thread: a
    checkpoint, which waits, never claims a file that is not written.

    `guard`: called before each task; raises an exception if files can no longer be written where they belong.
    """

    def __init__(self) -> None:
        self._tasks: deque[Callable[[], object]] = deque()
        self._changed = Condition()
        self._error: BaseException | None = None
        self._works, self._is_closing = False, False
        self.guard: Callable[[], None] = lambda: None

    @contextmanager
    def running(self) -> Iterator[None]:
        """In the block, execute tasks in a thread; its end waits for all of them, and raises their exceptions."""
        self._works, self._is_closing = True, False
        thread = Thread(target=self._execute_all, name="granflow writer", daemon=True)
        thread.start()
        try:
            yield
        finally:
            with self._changed:
                self._is_closing = True
                self._changed.notify_all()
            thread.join()
            self._works = False
            self.check()

    def submit(self, task: Callable[[], object]) -> None:
        """Append a task; waits while LONGEST_QUEUE tasks are ahead of it."""
        with self._changed:
            self._changed.wait_for(lambda: len(self._tasks) < LONGEST_QUEUE or not self._works)
            self.check()
            if self._works:
                self._tasks.append(task)
                self._changed.notify_all()
                return
        self.wait()
        self.guard()
        task()

    def wait(self) -> None:
        """Wait until all tasks are executed."""
        with self._changed:
            self._changed.wait_for(lambda: not self._tasks or not self._works)
        self.check()
        while self._tasks:
            self.guard()
            self._tasks[0]()
            self._tasks.popleft()

    def check(self) -> None:
        """Raise the exception of a task, once."""
        if self._error is not None:
            error, self._error = self._error, None
            raise error

    def _execute_all(self) -> None:
        """Runs in the thread: execute tasks until the end of `running`, or the first exception."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._tasks or self._is_closing)
                if not self._tasks:
                    return
                task = self._tasks[0]
            try:
                self.guard()
                task()
            except BaseException as error:  # raised again in the main thread
                with self._changed:
                    self._error, self._works = error, False
                    self._changed.notify_all()
                return
            with self._changed:
                self._tasks.popleft()
                self._changed.notify_all()
