"""What granflow raises: every message is one clear sentence, shown by the command line without a traceback."""

from collections.abc import Iterable


class GranflowError(Exception):
    """Something the user can put right. The command line prints the message and exits with `exit_code`."""

    exit_code = 2


class FileError(GranflowError):
    """A file that cannot be used.

    `problems` holds every problem found, in the order of the file, each as `file:line: sentence`; the message is
    all of them, one per line.
    """

    def __init__(self, problems: Iterable[str] | str) -> None:
        self.problems: tuple[str, ...] = (problems,) if isinstance(problems, str) else tuple(problems)
        super().__init__("\n".join(self.problems))


class SceneError(FileError):
    """A scene that cannot be run; its problems stand as `file:line:column: sentence`."""


class OutputError(GranflowError):
    """A run's files could not be written: the message says which, why, and from where it can go on."""

    exit_code = 4


class RunError(GranflowError):
    """A guard stopped a run: the message says where, when, the likely cause and what to change."""

    exit_code = 3
