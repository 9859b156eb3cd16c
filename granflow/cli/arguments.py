"""What the verbs of the command line share: arguments, converters of their values, and printing.

A function `add_...` adds an argument to the parser of a verb; a converter is the `type` of an argument and
raises ArgumentTypeError for a text that it refuses. Results go to stdout, errors and warnings to stderr.
`say` is the only function of the command line that calls `print`.
"""

import argparse
import math
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from granflow.errors import GranflowError
from granflow.processors import is_faster_with_taichi
from granflow.visible_text import visible, visible_line

if TYPE_CHECKING:
    from granflow.load import Scene

# Verbs and their arguments


def add_verb(verbs: Any, verb: Callable[..., int], summary: str) -> argparse.ArgumentParser:
    """Add a verb and return its parser.

    verbs:    subparsers of argparse
    verb:     function (options) -> exit code, whose name is that of the verb
    summary:  help text in lowercase without a period
    """
    parser = verbs.add_parser(verb.__name__, help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.set_defaults(verb=verb)
    return parser


def add_scene_verb(verbs: Any, verb: Callable[..., int], summary: str) -> argparse.ArgumentParser:
    """Add a verb that reads a scene, with the arguments SCENE and --set; return its parser."""
    parser = add_verb(verbs, verb, summary)
    parser.add_argument("scene", metavar="SCENE", type=Path, help="scene file (YAML)")
    add_overrides(parser, "override a value of the scene, such as --set particles.beads.count=500")
    return parser


def load(options: argparse.Namespace) -> "Scene":
    """Read the scene with the overrides of the command line, --precision included.

    --precision has priority over --set. Raises SceneError with all problems of the scene.
    """
    from granflow.load import load_scene

    overrides = list(options.overrides)
    if getattr(options, "precision", None):
        overrides.append(f"run.precision={options.precision}")
    return load_scene(options.scene, overrides)


def load_runnable(options: argparse.Namespace) -> "Scene":
    """Read a scene as `load_scene`; raise SceneError also for a group whose particles a program adds."""
    scene = load(options)
    scene.refuse_program()
    return scene


def add_overrides(parser: argparse.ArgumentParser, text: str) -> None:
    """Add --set, which can be repeated; `text`: its effect."""
    parser.add_argument(
        "--set",
        dest="overrides",
        metavar="KEY.PATH=VALUE",
        action="append",
        default=[],
        help=f"{text}; repeatable",
    )


def add_out(parser: argparse.ArgumentParser, default: str, content: str = "") -> None:
    """Add --out, a directory; `default`: text on the default; `content`: what the directory contains."""
    purpose = f" for {content}" if content else ""
    text = f"output directory{purpose} (default: {default})"
    parser.add_argument("--out", metavar="DIR", type=Path, help=text)


ARCHITECTURES = ("cpu", "gpu", "cuda", "vulkan")
"""Values of --arch; gpu selects the first available GPU backend."""
PRECISIONS = ("f64", "f32", "mixed")
"""Values of --precision: f64, f32, or mixed (positions in f64, all else in f32)."""


def add_machine(
    parser: argparse.ArgumentParser, default_precision: str = "the precision of the scene"
) -> None:
    """Add --arch, --kernels and --precision; `default_precision`: text on the default of --precision."""
    parser.add_argument(
        "--arch",
        choices=ARCHITECTURES,
        default="cpu",
        help="compute device or backend; gpu selects the first available GPU backend (default: cpu)",
    )
    add_kernels(parser)
    parser.add_argument(
        "--precision", choices=PRECISIONS, help=f"floating-point precision (default: {default_precision})"
    )


def add_kernels(parser: argparse.ArgumentParser) -> None:
    """Add --kernels."""
    parser.add_argument(
        "--kernels",
        choices=("taichi", "quadrants"),
        help="language of the compute kernels (default: quadrants if it is installed, but taichi on CUDA and "
        "on Intel processors)",
    )


def select_kernels(options: argparse.Namespace) -> None:
    """Set the environment variable of the kernel language, for this process and those that it starts.

    It is that of --kernels. The default is Quadrants where it is installed: it gives the same bits, starts
    sooner where nothing is compiled yet, and is faster on processors that the compiler of Taichi does not
    know. Taichi is used on processors on which its steps are faster, and on CUDA, where all checks passed
    with it; and so are programs, which do not come here, because their functions may contain those of the
    module taichi. Raises GranflowError if this process already uses another kernel language.
    """
    name = getattr(options, "kernels", None)
    language = sys.modules.get("granflow.kernel_language")
    if name is None:
        is_open = language is None and not os.environ.get("GRANFLOW_KERNELS")
        arch = getattr(options, "arch", "cpu")
        with_taichi = arch in ("gpu", "cuda") or (arch == "cpu" and is_faster_with_taichi())
        if is_open and find_spec("quadrants") and not (with_taichi and find_spec("taichi")):
            os.environ["GRANFLOW_KERNELS"] = "quadrants"
        return
    if language is not None and name != language.KERNELS:
        raise GranflowError(f"--kernels {name}: this process already uses {language.KERNELS}.")
    os.environ["GRANFLOW_KERNELS"] = name


# Converters of values


def quantity(dimension: str) -> Callable[[str], float]:
    """Return a converter for argparse from text such as 25.4mm to SI.

    `dimension`: name in `granflow.units`. The converter raises ArgumentTypeError for an invalid unit and
    for a value that is not finite.
    """

    def read(text: str) -> float:
        from granflow.units import UnitError, to_si

        try:
            value = to_si(text, dimension)
        except UnitError as error:
            raise argparse.ArgumentTypeError(f"{text}: {error}") from None
        if not math.isfinite(value):
            raise argparse.ArgumentTypeError(f"{text} is not finite; give a finite value")
        return value

    return read


def simulated_time(text: str) -> float:
    """Convert --until for argparse: a simulated time [s], at least 0. Raises ArgumentTypeError."""
    value = quantity("time")(text)
    if value < 0.0:
        raise argparse.ArgumentTypeError(f"{text} is negative; give a time of at least 0, such as 0.2s")
    return value


def count(text: str) -> int:
    """Convert a number of jobs or trials for argparse: a whole number, at least 1."""
    return _whole_number(text, "a valid number")


def thread_count(text: str) -> int:
    """Convert --threads for argparse: a whole number, at least 1."""
    return _whole_number(text, "a number of threads")


def _whole_number(text: str, noun: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is not {noun}; give a whole number of at least 1")
    return int(text)


# Printing


def say(*parts: object, sep: str = " ", file: TextIO | None = None, flush: bool = False) -> None:
    """Print text; control characters in titles, names and file headers become visible.

    `file`: stdout by default; `flush`: write at once.
    """
    print(visible(sep.join(map(str, parts))), file=file, flush=flush)


def say_progress(message: str) -> None:
    """Print a progress message at once, also if stdout is a file."""
    say(f"{message} ...", flush=True)


def print_error(sentence: str, exit_code: int = GranflowError.exit_code) -> int:
    """Print one sentence to stderr and return the exit code."""
    say(visible_line(f"granflow: {sentence}"), file=sys.stderr)
    return exit_code


def warn(sentences: Iterable[str]) -> None:
    """Print warnings to stderr, each with the prefix "granflow: warning:"."""
    for sentence in sentences:
        say(visible_line(f"granflow: warning: {sentence}"), file=sys.stderr)


def warned(sentences: Iterable[str]) -> list[str]:
    """Print warnings as `warn` does, and return them."""
    found = list(sentences)
    warn(found)
    return found


WIDE = 160
"""Width of a table that is written to a file [characters]: wide enough for complete numbers."""


def show_table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table with right-aligned numbers to the terminal, or as plain text to a file.

    `heads` and each row have one text per column; the first column is left-aligned.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=any(heads), box=None, pad_edge=False)
    for column, head in enumerate(heads):
        table.add_column(visible(head), justify="left" if column == 0 else "right", no_wrap=column > 0)
    for row in rows:
        table.add_row(*(Text(visible(cell)) for cell in row))
    console = Console(width=None if sys.stdout.isatty() else WIDE)
    console.print(Text(visible(title), "table.title"))  # not of the table, in whose width it would wrap
    console.print(table)
