"""Arguments that several verbs share, and readers of their values."""

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from granflow.scene import Scene

ARCHITECTURES = ("cpu", "gpu", "cuda", "vulkan", "metal")
PRECISIONS = ("f64", "f32", "mixed")


def add_scene_verb(verbs: Any, verb: Callable[..., int], summary: str) -> argparse.ArgumentParser:
    """A verb that reads a scene: SCENE and --set."""
    parser = verbs.add_parser(verb.__name__, help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.add_argument("scene", metavar="SCENE", type=Path, help="the YAML file of the scene")
    parser.add_argument(
        "--set",
        dest="overrides",
        metavar="KEY.PATH=VALUE",
        action="append",
        default=[],
        help="put a value in place of the scene's, such as --set particles.beads.count=500; may be repeated",
    )
    parser.set_defaults(verb=verb)
    return parser


def add_machine(parser: argparse.ArgumentParser) -> None:
    """--arch and --precision."""
    parser.add_argument("--arch", choices=ARCHITECTURES, default="cpu", help="where to compute (cpu)")
    parser.add_argument("--precision", choices=PRECISIONS, help="width of the numbers (as the scene says)")


def add_allow_long(parser: argparse.ArgumentParser) -> None:
    """--allow-long."""
    parser.add_argument("--allow-long", action="store_true", help="accept a run estimated to take more than a year")


def quantity(dimension: str) -> Callable[[str], float]:
    """A reader of arguments such as 25.4mm, for argparse: to SI, with the reader's own message if it is not one."""

    def read(text: str) -> float:
        from granflow.scene.units import UnitError, to_si

        try:
            value = to_si(text, dimension)
        except UnitError as error:
            raise argparse.ArgumentTypeError(f"{text} is given, but {error}") from None
        if not math.isfinite(value):
            raise argparse.ArgumentTypeError(f"{text} is given, but a finite value is asked here")
        return value

    return read


def simulated_time(text: str) -> float:
    """A reader of --until, for argparse: a simulated time [s], at least 0."""
    value = quantity("time")(text)
    if value < 0.0:
        raise argparse.ArgumentTypeError(f"{text} is given, but a time must be at least 0, such as 0.2s")
    return value


def thread_count(text: str) -> int:
    """A reader of --threads, for argparse."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is given, but a whole number from 1 is asked here")
    return int(text)


def load(options: argparse.Namespace) -> "Scene":
    """Read the scene with the overrides of the command line; --precision is one of them."""
    from granflow.scene import load as load_scene

    precision = getattr(options, "precision", None)
    return load_scene(options.scene, [*options.overrides, *([f"run.precision={precision}"] if precision else [])])
