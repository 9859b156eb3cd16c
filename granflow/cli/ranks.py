"""`granflow run --mpi`: the root runs the scene, the other ranks compute their part of each step."""

import argparse
import os
import signal
import sys
import traceback
from collections.abc import Callable
from typing import TYPE_CHECKING

from granflow.cli.arguments import load_runnable
from granflow.errors import GranflowError

if TYPE_CHECKING:
    from granflow.parallel.communicator import Communicator

EXIT_FAILED_RANK = 3
"""Exit code of all ranks after an exception in one of them."""


def on_ranks(options: argparse.Namespace, run: "Callable[[Communicator], int]") -> int:
    """Run a scene on all ranks and return the exit code.

    run:  what the root does, with the communicator

    Raises GranflowError without mpi4py, and on the root the exceptions of `run`.
    """
    from granflow.parallel.communicator import Communicator

    communicator = Communicator()
    options.threads = options.threads or threads_per_rank(communicator)
    if not communicator.is_root:
        return _serve_or_abort(options, communicator)
    try:
        return run(communicator)
    except (GranflowError, KeyboardInterrupt, OSError):
        raise
    except BaseException:
        _abort(communicator)
        raise
    finally:
        _release(communicator)


def threads_per_rank(communicator: "Communicator") -> int:
    """CPU threads of each rank: its cores if mpirun has bound it to some, otherwise a part of those of the machine."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    ranks = communicator.local_size()
    return max(cores // ranks if cores == os.cpu_count() else cores, 1)


def _serve_or_abort(options: argparse.Namespace, communicator: "Communicator") -> int:
    """Execute the commands of the root until it ends the run; an exception ends all ranks."""
    for each in (signal.SIGINT, signal.SIGTERM):  # the root receives them, too, and stops all ranks
        signal.signal(each, signal.SIG_IGN)
    try:
        return _serve(options, communicator)
    except BaseException:
        _abort(communicator)
        raise


def _serve(options: argparse.Namespace, communicator: "Communicator") -> int:
    """Execute the commands of the root; returns 0."""
    import logging

    from granflow.engine.backend import start
    from granflow.parallel.rank_engine import END, START, RankEngine
    from granflow.plan.build import plan_for

    logging.getLogger("granflow").setLevel(logging.CRITICAL)
    engine: RankEngine | None = None
    while True:
        name, arguments = communicator.next_command()
        if name == END:
            return 0
        if name == START:
            scene = load_runnable(options)
            backend = start("cpu", scene.run.precision, options.threads)
            engine = RankEngine(plan_for(scene), backend, communicator)
        else:
            getattr(engine, name)(*arguments)


def _abort(communicator: "Communicator") -> None:
    """Print the exception that is handled, and end all ranks."""
    print(f"granflow: rank {communicator.rank} failed, which ends all ranks.", file=sys.stderr)
    traceback.print_exc()
    sys.stderr.flush()
    communicator.abort(EXIT_FAILED_RANK)


def _release(communicator: "Communicator") -> None:
    """Let the other ranks end; end them at once if an exception has interrupted a command."""
    from granflow.parallel.rank_engine import END

    if communicator.is_idle:
        communicator.send_command(END)
    else:
        communicator.abort(EXIT_FAILED_RANK)
