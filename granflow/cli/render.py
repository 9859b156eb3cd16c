"""The verb render: pictures and films of a run."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granflow.cli.messages import print_error, say
from granflow.errors import GranflowError

if TYPE_CHECKING:
    from granflow.study.render import Frame, PictureStyle

FITS = ("all", "particles", "domain")


def render(options: argparse.Namespace) -> int:
    """`granflow render`: PNG of frames of a run, or an MP4 of all of them."""
    from granflow.study.render import PictureStyle, frames_of, selected_frames, write_pictures

    frames = frames_of(options.directory)
    style = PictureStyle(
        options.color, options.view, options.zoom, options.fit, options.cut, options.chains, options.range, options.size
    )
    if options.film:
        return film(options, frames, style)
    wanted = selected_frames(frames, options.frame)
    if options.out is not None and len(wanted) > 1:
        raise GranflowError(f"--out names one file, but --frame {options.frame} asks for {len(wanted)} pictures.")
    for path in write_pictures(options.directory, wanted, style, options.out):
        say(path)
    return 0


def film(options: argparse.Namespace, frames: "list[Frame]", style: "PictureStyle") -> int:
    """Write the film, or, where what it needs is not installed, its pictures."""
    from granflow.study.render import pictures, write_film, write_pictures
    from granflow.study.render.film import missing_for_film
    from granflow.study.render.render import name_of

    missing = missing_for_film()
    if missing:
        paths = write_pictures(options.directory, frames, style)
        say(f"{len(paths)} pictures from {paths[0]} to {paths[-1]}")
        return print_error(f"A film needs {missing}, which is not installed: pip install granflow[plot]")
    path = options.out or options.directory / "pictures" / f"{name_of(style).replace('picture', 'film', 1)}.mp4"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_film(path, pictures(options.directory, frames, style), options.fps)
    say(f"{path}: {len(frames)} frames, {len(frames) / options.fps:.3g} s")
    return 0


def pixel_size(text: str) -> tuple[int, int]:
    """A reader of --size 1600x1200, for argparse: two even numbers."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()) or min(int(width), int(height)) < SMALLEST:
        raise argparse.ArgumentTypeError(
            f"{text} is given, but width and height in pixels are asked, such as 1600x1200"
        )
    return int(width) // 2 * 2, int(height) // 2 * 2


SMALLEST = 200
"""Pixels of a side below which nothing can be read."""


def number_pair(text: str) -> tuple[float, float]:
    """A reader of --range 0,1.5, for argparse."""
    try:
        low, high = (float(word) for word in text.split(","))
    except ValueError:
        low, high = 0.0, 0.0
    if not low < high:
        raise argparse.ArgumentTypeError(f"{text} is given, but two numbers in SI, the smaller one first, are asked")
    return low, high


def positive(text: str) -> float:
    """A reader of a number above 0, for argparse."""
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not 0.0 < number < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is given, but a number above 0 is asked here")
    return number


def add_render(verbs: Any) -> None:
    """`granflow render` and its arguments."""
    summary = "draw frames of a run as PNG, or all of them as a film"
    parser = verbs.add_parser("render", help=summary, description=summary[0].upper() + summary[1:] + ".")
    parser.add_argument("directory", metavar="DIR", type=Path, help="the directory of the run, such as out/hopper")
    parser.add_argument(
        "--frame",
        default="last",
        metavar="F",
        help="last, first, a number, a time as 0.4s, several with commas, or all (last)",
    )
    parser.add_argument("--film", action="store_true", help="write an MP4 of all frames instead")
    parser.add_argument("--fps", type=positive, default=25.0, metavar="N", help="frames a second of the film (25)")
    parser.add_argument(
        "--color", default="velocity", metavar="NAME",
        help="array of the grains, as velocity, velocity.z, force, radius, material, coordination_number (velocity)",
    )  # fmt: skip
    parser.add_argument(
        "--range", type=number_pair, metavar="LOW,HIGH", help="ends of the color scale in SI (from the frames)"
    )
    parser.add_argument("--chains", action="store_true", help="contacts as tubes, thicker and redder with normal force")
    parser.add_argument(
        "--view",
        default="iso",
        metavar="V",
        help="iso, front, side, top, or where the viewer stands, as --view=1,-2,0.8 (iso)",
    )
    parser.add_argument("--zoom", type=positive, default=1.0, metavar="X", help="larger is nearer (1)")
    parser.add_argument(
        "--fit", choices=FITS, default="all", help="what is in sight: grains and walls, grains, or domain (all)"
    )
    parser.add_argument("--cut", action="store_true", help="leave out the half in front")
    parser.add_argument("--size", type=pixel_size, metavar="WxH", help="pixels (1200 high, as wide as fits)")
    parser.add_argument(
        "--out", metavar="FILE", type=Path, help="where it goes (pictures/ in the directory of the run)"
    )
    parser.set_defaults(verb=render)
