"""The ranks of a run: the root executes a program, the others execute its commands. A failure ends all ranks."""

import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from granflow.errors import GranflowError
from granflow.parallel.communicator import Communicator
from granflow.parallel.rank_engine import END, START, OtherScene, RankEngine

EXIT_FAILED_RANK = 3
"""Exit code of all ranks after a failure of one of them."""


def serve(communicator: Communicator, engine: Callable[[], RankEngine]) -> None:
    """Execute the commands of the root until it ends the run.

    engine:  creates the engine of this rank
    """
    with _fatal(communicator):
        present: RankEngine | None = None
        while True:
            name, arguments = communicator.next_command()
            if name == END:
                return
            if name == START:
                with suppress(OtherScene):  # the root reports it and ends the other ranks
                    present = engine()
            else:
                getattr(present, name)(*arguments)


@contextmanager
def controlling(communicator: Communicator) -> Iterator[None]:
    """On the root: in the block, the other ranks execute commands; they end with it.

    An exception that interrupts a command, or that is not an error of the input, ends all ranks at once.
    """
    with _fatal(communicator):
        try:
            yield
        except (GranflowError, OSError, KeyboardInterrupt):
            if not communicator.is_idle:
                _abort(communicator)
            communicator.send_command(END)
            raise
    communicator.send_command(END)


@contextmanager
def _fatal(communicator: Communicator) -> Iterator[None]:
    """In the block, an exception that is not an error of the input ends all ranks."""
    try:
        yield
    except (GranflowError, OSError, KeyboardInterrupt):
        if communicator.is_root:
            raise
        _abort(communicator)
    except BaseException:
        _abort(communicator)


def _abort(communicator: Communicator) -> None:
    """Print the exception that is handled, one sentence for an error of the input, and end all ranks."""
    error = sys.exc_info()[1]
    is_sentence = isinstance(error, GranflowError | OSError)
    reason = f"granflow: {error}\n" if is_sentence else traceback.format_exc()
    sys.stderr.write(f"granflow: rank {communicator.rank} failed, which ends all ranks.\n{reason}")
    sys.stderr.flush()
    communicator.abort(EXIT_FAILED_RANK)
