"""The command line: dispatches the verbs and returns exit codes.

Each verb imports its modules inside its function: `--help` starts at once and `schema` never loads Taichi.
"""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from granflow.cli.arguments import exit_code_of, print_error, print_refusal, say
from granflow.cli.process import refuse_low_memory_limit, standard_streams, stop_signals
from granflow.cli.run import (
    add_cache,
    add_check,
    add_example,
    add_examples,
    add_explain,
    add_resume,
    add_run,
    add_schema,
    resume,
    run,
)
from granflow.cli.show import add_analyze, add_plot, add_render, add_report
from granflow.cli.studies import (
    add_accuracy,
    add_calibrate,
    add_collide,
    add_compare,
    add_fit,
    add_paper,
    add_restitution,
    add_stability,
    add_sweep,
)
from granflow.errors import GranflowError
from granflow.visible_text import visible


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    0 completed; 1 completed, but an expectation of the scene is not satisfied; 2 input error (scene, command
    line, files); 3 aborted, with a diagnosis; 4 stopped because files could not be written; 130 interrupted
    (Ctrl-C); 143 terminated (SIGTERM); 141 the reader of stdout closed the pipe, as `head` does. After a
    closed pipe, `run` and `resume` continue.
    """
    try:
        with standard_streams() as output:
            options = build_parser().parse_args(arguments)
            output.needed = options.verb not in (run, resume)
            return _verb(options)
    except OSError as error:
        return _print_file_error(error)


def _verb(options: argparse.Namespace) -> int:
    """Run the verb with signal handling and return its exit code.

    GranflowError, errors of files and interrupts are printed without a traceback; all other exceptions
    propagate.
    """
    try:
        refuse_low_memory_limit()
        with stop_signals():
            return options.verb(options)
    except GranflowError as error:
        return print_refusal(error)
    except MemoryError:
        return print_error(
            "not enough memory: use fewer particles, or raise the memory limit of the process."
        )
    except ImportError as error:
        return print_error(
            f"a library cannot be loaded ({error}): install granflow again, or raise memory limits."
        )
    except KeyboardInterrupt as stop:
        return print_error("interrupted.", exit_code_of(stop))


def _print_file_error(error: OSError) -> int:
    """Print an error of the operating system that concerns a file, and return exit code 2; raise it again
    otherwise."""
    if error.filename is None:
        raise error
    return print_error(f"{error.filename}: {_reason_of(error)}.")


def _reason_of(error: OSError) -> str:
    """Return why a path cannot be used."""
    path = Path(os.fsdecode(error.filename)) if isinstance(error.filename, str | bytes) else Path()
    if path.is_symlink() and not path.exists():
        return (
            f"this is a link to {os.readlink(path)}, which does not exist; give another path, or remove the "
            "link"
        )
    if isinstance(error, FileExistsError):
        return "this is a file, but a directory is needed; give another path"
    return error.strerror or str(error)


def build_parser() -> argparse.ArgumentParser:
    """Build the parser of all verbs and their arguments.

    Each verb sets `verb`, a function (options) -> exit code.
    """
    parser = Parser(prog="granflow", description="Discrete element simulation of granular flow.")
    parser.add_argument("--version", action=ShowVersion, nargs=0, help="print the version and exit")
    verbs = parser.add_subparsers(required=True, metavar="COMMAND")
    add_examples(verbs)
    add_example(verbs)
    add_run(verbs)
    add_resume(verbs)
    add_check(verbs)
    add_explain(verbs)
    add_schema(verbs)
    add_collide(verbs)
    add_restitution(verbs)
    add_fit(verbs)
    add_analyze(verbs)
    add_paper(verbs)
    add_accuracy(verbs)
    add_compare(verbs)
    add_stability(verbs)
    add_sweep(verbs)
    add_calibrate(verbs)
    add_plot(verbs)
    add_render(verbs)
    add_report(verbs)
    add_cache(verbs)
    return parser


class Parser(argparse.ArgumentParser):
    """An argument parser whose messages show control characters of quoted text as visible escapes."""

    def _print_message(self, message: str, file: Any = None) -> None:
        super()._print_message(visible(message), file)


class ShowVersion(argparse.Action):
    """Prints the version; reads it only then, because that takes file access."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        import granflow

        say(f"granflow {granflow.__version__}")
        parser.exit()
