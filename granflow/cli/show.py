"""The verbs that show a run from the files in its directory: analyze, plot, render, report.

Nothing is simulated. `analyze` requires particle frames, and contact frames for some quantities; `plot` reads
time series; `render` requires the extra `plot`.
"""

import argparse
import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from functools import partial
from math import isfinite
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any

from granflow.cli.arguments import (
    add_out,
    add_overrides,
    add_verb,
    print_error,
    say,
    show_table,
)
from granflow.cli.process import deferred_to_event, exit_code_of
from granflow.errors import GranflowError
from granflow.visible_text import in_degrees

if TYPE_CHECKING:
    import numpy as np

    from granflow.studies.frames import Frame
    from granflow.studies.render import PictureStyle

# analyze: metrics and fields of a completed run

MAX_ROWS = 20
"""Largest number of rows printed; the file contains all rows."""


def analyze(options: argparse.Namespace) -> int:
    """`granflow analyze`: compute metrics and fields of a completed run from its frames.

    Writes `metrics.csv` and VTU files, and prints at most MAX_ROWS rows, the last one included. Raises
    GranflowError if the directory is not that of a run, or if --out is that directory.
    """
    from granflow import analyze_snapshots, load_scene, read_run

    scene_path = options.directory / "scene_as_run.yaml"
    if not scene_path.is_file():
        raise GranflowError(
            f"{options.directory} is not the directory of a run: it contains no scene_as_run.yaml."
        )
    out = options.out or options.directory / "analysis"
    if out.resolve() == options.directory.resolve():
        raise GranflowError(
            f"--out {out} is the directory of the run, whose fields would be overwritten: give another "
            "directory."
        )
    scene = load_scene(scene_path, options.overrides)
    run = read_run(options.directory)
    snapshots = map(run.snapshot, range(len(run.frames)))
    rows = analyze_snapshots(scene, snapshots, out, str(options.directory))
    if rows and len(rows[0]) > len(("time", "stage")):
        step = -(-len(rows) // MAX_ROWS)
        cells = [[_cell(name, value) for name, value in row.items()] for row in rows]
        printed = cells[::-1][::step][::-1]  # counted from the end, so that the last row is one of them
        show_table(f"{options.directory}, {len(rows)} frames", list(rows[0]), printed)
    say(f"Written to {out}")
    return 0


def _cell(name: str, value: float | str) -> str:
    """Text of a value of the column `name`; of an angle with degrees."""
    from granflow.scene.blocks.output import unit_of

    if isinstance(value, str):
        return value
    return f"{value:.4g}" + in_degrees(value, unit_of(name.partition(" [")[0]))


def add_analyze(verbs: Any) -> None:
    """Add `granflow analyze` and its arguments."""
    summary = "compute metrics (mixing, angle of repose, coordination, fabric) or fields of a completed run"
    parser = add_verb(verbs, analyze, summary)
    parser.add_argument("directory", metavar="OUT", type=Path, help="directory of the run")
    add_out(parser, "OUT/analysis")
    add_overrides(
        parser, "metric or field to compute, such as 'output.metrics.heap={kind: repose, surface: cone}'"
    )


# plot: columns of time series over time or over each other, of one or more runs

TYPES = (".png", ".svg", ".pdf", ".html")
"""Possible ends of the name of --out."""


def plot(options: argparse.Namespace) -> int:
    """`granflow plot`: write an image or a page with curves of time series; without --y, list the columns.

    Raises GranflowError for a file without rows, an unknown column or stage, and a type of file that is not
    supported.
    """
    from granflow.studies.plot import default_path, panels_of, series_of, write_plot

    check_output_file(options.out, TYPES, options.sources[0])
    if not options.y:
        path, series = series_of(options.sources[0], options.x)
        columns = [("time", "s"), *((each.name, each.unit) for each in series.columns)]
        show_table(f"Columns of {path}; choose with --y, and --x", ("column", "unit"), columns)
        return 0
    panels = panels_of(options.sources, options.x, options.y, options.stages)
    if options.x_label is not None:
        panels = [replace(panel, x_title=options.x_label) for panel in panels]
    if options.y_label is not None:
        panels = [replace(panel, y_title=options.y_label) for panel in panels]
    out = options.out or default_path(options.sources[0], options.x, options.y)
    write_plot(out, panels, options.log, f"Time series of {', '.join(map(str, options.sources))}")
    say(f"Written to {out}")
    return 0


def add_plot(verbs: Any) -> None:
    """Add `granflow plot` and its arguments."""
    summary = "plot columns of time series over time or over each other, of one or more runs"
    parser = add_verb(verbs, plot, summary)
    parser.add_argument(
        "sources",
        metavar="RUN",
        type=Path,
        nargs="+",
        help="directory of a run, or a CSV file with times such as OUT/analysis/metrics.csv or "
        "OUT/collision_energies.csv; of the latter, --x energy draws the distribution at the end",
    )
    parser.add_argument(
        "--y",
        metavar="COLUMN",
        nargs="+",
        default=[],
        help=(
            "columns, or arithmetic expressions of columns in SI units such as 'wall_pressure.lid / 1e3'; "
            "one plot for each unit (default: list the columns of the first RUN)"
        ),
    )
    parser.add_argument(
        "--x",
        metavar="COLUMN",
        default="time",
        help=(
            "horizontal axis: a column or an expression, such as 'wall_displacement.lid / 0.05' (default: "
            "time)"
        ),
    )
    parser.add_argument("--x-label", metavar="TEXT", help="title of the horizontal axis")
    parser.add_argument("--y-label", metavar="TEXT", help="title of the vertical axis")
    parser.add_argument("--stages", metavar="NAME", nargs="+", default=[], help="only rows of these stages")
    parser.add_argument("--log", choices=("x", "y", "xy"), default="", help="axes with a logarithmic scale")
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=Path,
        help=(
            "image .png, .svg or .pdf, or interactive page .html (default: plot_Y_over_X.png in the first "
            "RUN)"
        ),
    )


# render: images and films of a run

FITS = ("all", "particles", "domain")
"""Values of --fit."""
SMALLEST = 200
LARGEST = 10_000
"""Smallest and largest width and height of an image [pixels]."""
MOST_PIXELS = 50_000_000
"""Largest number of pixels of an image: 2.4 GB of memory, half a minute."""
ZOOMS = (0.01, 1000.0)
"""Smallest and largest magnification."""
RATES = (0.01, 1000.0)
"""Smallest and largest number of frames per second of an animation."""


def render(options: argparse.Namespace) -> int:
    """`granflow render`: write frames of a run as PNG images, or all frames as an MP4 film.

    Prints the paths. Raises GranflowError if the directory contains no frames, or for one output file with
    several images.
    """
    from granflow.studies.frames import frames_of, selected_frames
    from granflow.studies.render import PictureStyle, write_pictures

    check_output_file(options.out, (".mp4",) if options.film else (".png",), options.directory)
    if options.chains and options.walls is not None:
        raise GranflowError("--chains and --walls have one color scale: give one of them.")
    frames = frames_of(options.directory)
    style = PictureStyle(**{field.name: getattr(options, field.name) for field in fields(PictureStyle)})
    if options.film:
        return film(options, frames, style)
    wanted = selected_frames(frames, options.frame)
    if options.out is not None and len(wanted) > 1:
        raise GranflowError(f"--out is one file, but --frame {options.frame} selects {len(wanted)} images.")
    for path in write_pictures(options.directory, wanted, style, options.out):
        say(path)
    return 0


def film(options: argparse.Namespace, frames: "list[Frame]", style: "PictureStyle") -> int:
    """Write the film; if a required package is not installed, write its images and return an error code.

    The duration is the number of frames over --fps [1/s].
    """
    from granflow.studies.render import (
        missing_for_film,
        name_of,
        pictures,
        speed_of,
        write_film,
        write_pictures,
    )

    missing = missing_for_film()
    if missing:
        paths = write_pictures(options.directory, frames, style)
        say(f"{len(paths)} images from {paths[0]} to {paths[-1]}")
        return print_error(f"An animation requires {missing}, which is not installed: pip install {missing}")
    film_name = name_of(style).replace("picture", "film", 1)
    path = options.out or options.directory / "pictures" / f"{film_name}.mp4"
    path.parent.mkdir(parents=True, exist_ok=True)
    with deferred_to_event(STOPPING) as (stop, signals):
        drawn = with_progress(pictures(options.directory, frames, style, options.fps), len(frames), stop)
        try:
            write_film(path, drawn, options.fps)
        except (Stopped, OSError) as error:  # Ctrl-C in a terminal also ends ffmpeg
            if not signals:
                raise
            reason = str(error) if isinstance(error, Stopped) else "stopped"
            return print_error(f"{reason}; no animation is written.", exit_code_of(signals[0]))
    speed = speed_of([frame.time for frame in frames], options.fps)
    say(f"{path}: {len(frames)} frames, {len(frames) / options.fps:.3g} s{', ' + speed if speed else ''}")
    return 0


class Stopped(Exception):
    """A stop signal ended an animation."""


def with_progress(pictures: "Iterator[np.ndarray]", count: int, stop: Event) -> "Iterator[np.ndarray]":
    """Yield the pictures, and print their number and the remaining time at most every PROGRESS_INTERVAL.

    `count`: of all pictures. Raises Stopped if `stop` is set.
    """
    began = time.monotonic()
    told = began
    for number, picture in enumerate(pictures, 1):
        if stop.is_set():
            raise Stopped(f"stopped after {number - 1} of {count} frames")
        yield picture
        now = time.monotonic()
        if number == 1:
            began = now  # the first picture includes imports and the scan of all frames
        elif number == FIRST_REPORT or (number > FIRST_REPORT and now - told > PROGRESS_INTERVAL):
            told = now
            remaining = (now - began) / (number - 1) * (count - number)
            say(f"{number} of {count} frames, about {remaining:.0f} s remaining", flush=True)


PROGRESS_INTERVAL = 5.0
"""Shortest time [s] between two reports of the progress of an animation."""
FIRST_REPORT = 3
"""Number of the frame after which the progress is reported for the first time."""
STOPPING = "granflow: stopping: the frame in progress is completed; a second signal ends the command at once."
"""Message if an animation needs longer to stop."""


def add_render(verbs: Any) -> None:
    """Add `granflow render` and its arguments.

    Lengths, times and ranges are in SI units or have a unit.
    """
    parser = add_verb(verbs, render, "write images (PNG) of frames of a run, or an animation of all frames")
    add = parser.add_argument
    add("directory", metavar="DIR", type=Path, help="directory of the run, such as out/hopper")
    add("--frame", default="last", metavar="F", help=FRAME)
    add("--film", action="store_true", help="write an animation (MP4) of all frames instead")
    add(
        "--fps",
        type=partial(number_from, RATES),
        default=25.0,
        metavar="N",
        help="frames per second of the animation (default: 25)",
    )
    add("--color", default="velocity", metavar="NAME", help=COLOR)
    add(
        "--range",
        type=number_pair,
        metavar="LOW,HIGH",
        dest="limits",
        help="limits of the color scale in SI units (default: from the frames)",
    )
    add(
        "--chains",
        action="store_true",
        help="draw contacts as tubes whose thickness and color show the normal force",
    )
    add("--walls", metavar="NAME", help=WALLS)
    add("--view", default="iso", metavar="V", help=VIEW)
    add(
        "--zoom",
        type=partial(number_from, ZOOMS),
        default=1.0,
        metavar="X",
        help="magnification, 0.01 to 1000 (default: 1)",
    )
    add(
        "--fit",
        choices=FITS,
        default="all",
        help="visible part: particles and walls (all), particles, or domain (default: all)",
    )
    add("--cut", action="store_true", help="omit the front half")
    add(
        "--size",
        type=pixel_size,
        metavar="WxH",
        help=f"width and height in pixels, from {SMALLEST} to {LARGEST} (default: 1200 high, a film 900; "
        "width from the view)",
    )
    add("--out", metavar="FILE", type=Path, help="output file (default: in DIR/pictures)")


FRAME = (
    "last, first, a number, a time such as 0.4s, several of these separated by commas, or all (default: last)"
)
COLOR = "particle array, such as velocity, velocity.z, force, radius, coordination_number (default: velocity)"
WALLS = "draw the walls alone, colored by an array such as wear_depth, pressure, traction.z"
VIEW = "iso, front, side, top, or the direction to the viewer, such as --view=1,-2,0.8 (default: iso)"
"""Help texts of --frame, --color, --walls and --view."""


def pixel_size(text: str) -> tuple[int, int]:
    """Convert --size, such as 1600x1200, for argparse: width and height [pixels].

    They are rounded down to even numbers, which video codecs require. Raises ArgumentTypeError below
    SMALLEST, and above LARGEST or MOST_PIXELS.
    """
    words = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", text)
    width = int(words[1]) if words else 0
    height = int(words[2]) if words else 0
    is_valid = SMALLEST <= min(width, height) and max(width, height) <= LARGEST
    if not is_valid or width * height > MOST_PIXELS:
        raise argparse.ArgumentTypeError(
            f"{text[:40]} is not a valid size; give width and height in pixels, from {SMALLEST} to "
            f"{LARGEST}, and at most {MOST_PIXELS // 10**6} million pixels in total, such as 1600x1200"
        )
    return width // 2 * 2, height // 2 * 2


def number_pair(text: str) -> tuple[float, float]:
    """Convert --range, such as 0,1.5, for argparse: two increasing numbers. Raises ArgumentTypeError."""
    try:
        low, high = (float(word) for word in text.split(","))
    except ValueError:
        low, high = 0.0, 0.0
    if not (low < high and isfinite(high - low)):
        raise argparse.ArgumentTypeError(
            f"{text} is not a range; give two numbers in SI units, the smaller one first, such as 0,1.5"
        )
    return low, high


def number_from(limits: tuple[float, float], text: str) -> float:
    """Convert a number between two positive limits for argparse. Raises ArgumentTypeError."""
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not limits[0] <= number <= limits[1]:
        raise argparse.ArgumentTypeError(
            f"{text[:40]} is not a number from {limits[0]:g} to {limits[1]:g}, such as 2"
        )
    return number


# report: one HTML page about one run, complete or in progress


def report(options: argparse.Namespace) -> int:
    """`granflow report`: write one self-contained page about a run, with interactive plots and images.

    The page requires no network. Raises GranflowError if the directory is not that of a run.
    """
    from granflow.studies.report import write_report

    check_output_file(options.out, (".html",), options.directory)
    path = write_report(options.directory, options.out, not options.no_pictures, say)
    say(f"Open {path} in a browser.")
    return 0


def add_report(verbs: Any) -> None:
    """Add `granflow report` and its arguments."""
    summary = (
        "write one self-contained page about a run: interactive plots, flow, energies, plan, timings, images"
    )
    parser = add_verb(verbs, report, summary)
    parser.add_argument(
        "directory", metavar="DIR", type=Path, help="directory of the run, such as out/hopper"
    )
    parser.add_argument("--out", metavar="FILE", type=Path, help="output file (default: DIR/report.html)")
    parser.add_argument("--no-pictures", action="store_true", help="omit images")


# The output file of plot, render and report


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
        raise GranflowError(
            f"--out {path} is a directory; give a file, such as {path / f'picture{types[0]}'}."
        )
    if path.suffix not in types:
        raise GranflowError(
            f"--out {path} is not of a supported type; the name must end in {' or '.join(types)}."
        )
    if not path.exists():
        return
    from granflow.runs.read_run import SCENE, Run
    from granflow.runs.run_directory import input_files

    run = Run(directory)
    if not (directory / SCENE).exists() or run.scene_problem:
        return
    for key, name in input_files(run.scene):
        if name.exists() and path.samefile(name):
            raise GranflowError(
                f"--out {path} is {key} of the run, which must not be replaced; give another file."
            )
