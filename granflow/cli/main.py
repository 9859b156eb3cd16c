"""The command line: the parser of all verbs, and `main`, which runs one and returns the exit code.

A verb is a function (options) -> exit code in `run`, `show` or `studies`; a function `add_VERB` beside it
adds its arguments to the parser. A verb imports what it needs inside its function, so that `--help` starts at
once and `schema` never loads Taichi.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from granflow.cli.arguments import print_error, say, select_kernels
from granflow.cli.importing import add_import
from granflow.cli.process import exit_code_of, standard_streams, stop_signals
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
from granflow.errors import FileError, GranflowError
from granflow.visible_text import visible, visible_line


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    0 completed; 1 completed, but an expectation of the scene is not satisfied; 2 input error (scene, command
    line, files); 3 aborted, with a diagnosis; 4 stopped because files could not be written; 130 interrupted
    (Ctrl-C); 143 terminated (SIGTERM); 141 the reader of stdout closed the pipe, as `head` does. After a
    closed pipe, `run` and `resume` continue, because lost progress lines must not end a simulation.
    """
    try:
        with standard_streams() as output:
            options = build_parser().parse_args(arguments)
            output.needed = options.verb not in (run, resume)
            return _run_verb(options)
    except GranflowError as error:  # of options that act while they are read, such as --version
        return _print_refusal(error)
    except OSError as error:
        return _print_file_error(error)


def _run_verb(options: argparse.Namespace) -> int:
    """Run the verb with signal handling and return its exit code.

    GranflowError, errors of files and interrupts are printed without a traceback; all other exceptions
    propagate.
    """
    try:
        select_kernels(options)
        with stop_signals():
            return options.verb(options)
    except GranflowError as error:
        return _print_refusal(error)
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


def _print_refusal(error: GranflowError) -> int:
    """Print an error without a traceback and return its exit code.

    The problems of a file are printed one per line, followed by their number.
    """
    problems = error.problems if isinstance(error, FileError) else ()
    if not problems:
        return print_error(str(error), error.exit_code)
    for problem in problems:
        say(visible_line(problem), file=sys.stderr)
    say(f"{len(problems)} problem{'s' if len(problems) > 1 else ''} found.", file=sys.stderr)
    return error.exit_code


def _print_file_error(error: OSError) -> int:
    """Print an error of the operating system and return exit code 2; raise it again if it names no file."""
    if error.filename is None:
        raise error
    return print_error(f"{error.filename}: {_reason_of(error)}.")


def _reason_of(error: OSError) -> str:
    """Return why a path cannot be used."""
    if isinstance(error.filename, str | bytes):
        path = Path(os.fsdecode(error.filename))
        if path.is_symlink() and not path.exists():
            target = os.readlink(path)
            return f"this is a link to {target}, which does not exist; give another path, or remove the link"
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
    add_import(verbs)
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
    """An argument parser whose messages show control characters of quoted text as visible escapes, and which
    does not ignore failed writes.

    The subparsers of the verbs are of this class too.
    """

    def _print_message(self, message: str, file: Any = None) -> None:
        stream = file or sys.stderr
        if stream is not None:
            stream.write(visible(message))


class ShowVersion(argparse.Action):
    """Prints the version; reads it only then, because that takes file access."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        select_kernels(argparse.Namespace())  # before the first import of the kernel language
        from granflow.io.log import version_of
        from granflow.kernel_language import KERNELS

        say(f"granflow {version_of('granflow')} ({KERNELS} {version_of(KERNELS)})")
        parser.exit()
