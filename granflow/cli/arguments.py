"""Arguments shared by several verbs, and converters of their values."""

import argparse
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granflow.errors import GranflowError

if TYPE_CHECKING:
    from granflow.load import Scene

ARCHITECTURES = ("cpu", "gpu", "cuda", "vulkan")
"""Values of --arch; gpu selects the first available GPU backend."""

PRECISIONS = ("f64", "f32", "mixed")
"""Values of --precision: f64, f32, or mixed (positions in f64, all else in f32)."""


def add_verb(verbs: Any, verb: Callable[..., int], summary: str) -> argparse.ArgumentParser:
    """Add a verb and return its parser.

    `verbs`: subparsers of argparse; `verb`: function (options) -> exit code, which names the verb; `summary`: help text
    in lowercase without a period.
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


def check_output_file(path: Path | None, types: Sequence[str], directory: Path) -> None:
    """Refuse an output file that is of another type, a directory, or an input file of the run in a directory.

    path:       value of --out, None if it is not given
    types:      possible ends of its name, such as .png
    directory:  of the run, which need not be one
    Raises:     GranflowError
    """
    if path is None:
        return
    if path.is_dir():
        raise GranflowError(f"--out {path} is a directory; give a file, such as {path / f'picture{types[0]}'}.")
    if path.suffix not in types:
        raise GranflowError(f"--out {path} is not of a supported type; the name must end in {' or '.join(types)}.")
    if not path.exists():
        return
    from granflow.runs.input_copies import input_files
    from granflow.runs.read_run import SCENE, Run

    run = Run(directory)
    inputs = [] if not (directory / SCENE).exists() or run.scene_problem else [*input_files(run.scene)]
    for key, name in inputs:
        if name.exists() and path.samefile(name):
            raise GranflowError(f"--out {path} is {key} of the run, which must not be replaced; give another file.")


def add_overrides(parser: argparse.ArgumentParser, text: str) -> None:
    """Add --set, which can be repeated; `text`: its effect."""
    parser.add_argument(
        "--set", dest="overrides", metavar="KEY.PATH=VALUE", action="append", default=[], help=f"{text}; repeatable"
    )


def add_out(parser: argparse.ArgumentParser, default: str, content: str = "") -> None:
    """Add --out, a directory; `default`: text on the default; `content`: what the directory contains."""
    text = f"output directory{content and f' for {content}'} (default: {default})"
    parser.add_argument("--out", metavar="DIR", type=Path, help=text)


def add_machine(parser: argparse.ArgumentParser, default_precision: str = "the precision of the scene") -> None:
    """Add --arch and --precision; `default_precision`: text on the default of --precision."""
    parser.add_argument(
        "--arch",
        choices=ARCHITECTURES,
        default="cpu",
        help="compute device or backend; gpu selects the first available GPU backend (default: cpu)",
    )
    parser.add_argument(
        "--precision", choices=PRECISIONS, help=f"floating-point precision (default: {default_precision})"
    )


def add_allow_long(parser: argparse.ArgumentParser) -> None:
    """Add --allow-long."""
    parser.add_argument("--allow-long", action="store_true", help="accept a run estimated to take more than a year")


def add_mpi(parser: argparse.ArgumentParser) -> None:
    """Add --mpi."""
    parser.add_argument(
        "--mpi", action="store_true", help="distribute the particles over the ranks of mpirun; needs mpi4py"
    )


def quantity(dimension: str) -> Callable[[str], float]:
    """Return a converter for argparse from text such as 25.4mm to SI.

    `dimension`: name in `granflow.scene.schema.units`. The converter raises ArgumentTypeError for an invalid unit and
    for a value that is not finite.
    """

    def read(text: str) -> float:
        from granflow.scene.schema.units import UnitError, to_si

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


def thread_count(text: str) -> int:
    """Convert --threads for argparse: a whole number, at least 1. Raises ArgumentTypeError."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a number of threads; give a whole number of at least 1")
    return int(text)


def count(text: str) -> int:
    """Convert a number of jobs or trials for argparse: a whole number, at least 1. Raises ArgumentTypeError."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a valid number; give a whole number of at least 1")
    return int(text)


def load(options: argparse.Namespace) -> "Scene":
    """Read the scene with the overrides of the command line, --precision included.

    --precision has priority over --set. Raises SceneError with all problems of the scene.
    """
    from granflow.load import load as load_scene

    precision = getattr(options, "precision", None)
    return load_scene(options.scene, [*options.overrides, *([f"run.precision={precision}"] if precision else [])])


def load_runnable(options: argparse.Namespace) -> "Scene":
    """Read the scene of a run, as `load`. Raises SceneError also for a group whose particles a program adds."""
    scene = load(options)
    scene.refuse_program()
    return scene
