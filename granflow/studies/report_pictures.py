"""Pictures for the report page: a few of the course of the run, and others from `granflow render`.

Those of the course of the run are rendered if necessary. Pictures older than the last frame show another run
and are not used.
"""

import re
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np

from granflow.io.frames import is_empty, listed_frames
from granflow.studies.camera import VIEWS
from granflow.studies.frames import Frame, filled_frames, frames_of
from granflow.studies.render import PictureStyle, picture_path

MOST_PICTURES = 6
"""Maximum number of pictures in the page besides those of the course of the run."""
SHOWN_FRAMES = 4
"""Number of pictures of the course of the run: evenly spaced frames, including the last one."""
HEIGHT = 800
"""Height of a picture in the page [pixels]: twice its displayed size."""
QUALITY = 85
"""JPEG quality of embedded pictures, 0 to 100."""
FILM_BYTES = 3_000_000
"""Maximum size of an embedded film in bytes; larger films are referenced by name."""
TIMEOUT = 600.0
"""Time limit of rendering [s]."""
NAME = re.compile(rf"(?:picture|film)_(.+?)_({'|'.join(VIEWS)}|from_[-+.e\d_]+?)(_cut)?(?:_(\d+))?")
"""File names of granflow render: color, view, cut, frame number."""
HOW_TO_ADD = "The files are in pictures/. To add pictures, run granflow render, then granflow report again."


class Picture(NamedTuple):
    """Image or film file, and its caption."""

    path: Path
    caption: str


class CoursePicture(NamedTuple):
    """Picture of the course of a run: frame, style, and file in `pictures/`."""

    frame: Frame
    style: PictureStyle
    path: Path = Path()


class RunPictures(NamedTuple):
    """Pictures and films of the page, and a sentence about them."""

    shown: Sequence[Picture]
    statement: str


def pictures_for(directory: Path, scratch: Path) -> RunPictures:
    """Pictures and films for the page, scaled down in `scratch`, and a sentence about them.

    First those of the course of the run, rendered if they are not newer than its last frame; then at most
    MOST_PICTURES others and one film of at most FILM_BYTES. Raises GranflowError if the list of frames is
    damaged.
    """
    if not listed_frames(directory, "particles"):
        return RunPictures((), "The run has no frames to render.")
    frames = frames_of(directory)
    course = course_pictures(directory, frames)
    problem = render(directory, course, recent_pictures(directory, frames))
    found = recent_pictures(directory, frames)
    images = [each.path for each in course if each.path in found]
    images += [path for path in found if path.suffix == ".png" and path not in images][-MOST_PICTURES:]
    films = [path for path in found if path.suffix == ".mp4"]
    small = [path for path in films if path.stat().st_size <= FILM_BYTES][-1:]
    large = [f"pictures/{path.name}" for path in films if path not in small]
    shown = [Picture(path, _caption(path, frames)) for path in small]
    shown += [Picture(reduced(path, scratch), _caption(path, frames)) for path in images]
    omitted_films = f" Animations not embedded: {', '.join(large)}." if large else ""
    return RunPictures(shown, (problem or HOW_TO_ADD) + omitted_films)


def recent_pictures(directory: Path, frames: Sequence[Frame]) -> list[Path]:
    """PNG and MP4 files in `pictures/` that are newer than the last frame, sorted by name."""
    last = frames[-1].particles.stat().st_mtime
    found = [*(directory / "pictures").glob("*.png"), *(directory / "pictures").glob("*.mp4")]
    return sorted(path for path in found if path.stat().st_mtime >= last)


def course_pictures(directory: Path, frames: Sequence[Frame]) -> list[CoursePicture]:
    """Pictures of the course of a run: evenly spaced frames with particles, and the one with the most
    contacts."""
    filled = filled_frames(frames)
    indices = np.unique(np.linspace(0, len(filled) - 1, SHOWN_FRAMES + 1).astype(int)[1:])
    chosen = [filled[index] for index in indices]
    found = [CoursePicture(frame, PictureStyle()) for frame in chosen]
    with_contacts = [frame for frame in chosen if frame.contacts is not None and not is_empty(frame.contacts)]
    if with_contacts:
        most = max(with_contacts, key=lambda frame: frame.contacts.stat().st_size if frame.contacts else 0)
        found.append(CoursePicture(most, PictureStyle(chains=True)))
    return [each._replace(path=picture_path(directory, each.style, each.frame)) for each in found]


def render(directory: Path, course: Sequence[CoursePicture], present: Sequence[Path]) -> str:
    """Render the pictures that are not `present` in a subprocess, because VTK aborts if it cannot render.

    Returns an error message or "". The time limit is TIMEOUT for each command.
    """
    missing = [each for each in course if each.path not in present]
    if missing and find_spec("pyvista") is None:
        return (
            "No pictures of the course of the run, because pyvista is not installed: pip install pyvista "
            "matplotlib"
        )
    for chains in (False, True):
        numbers = ",".join(str(each.frame.number) for each in missing if each.style.chains == chains)
        if not numbers:
            continue
        command = [sys.executable, "-m", "granflow", "render", str(directory), "--frame", numbers]
        command += ["--chains"] if chains else []
        try:
            completed = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT)
        except subprocess.TimeoutExpired:
            return f"No pictures: rendering took longer than {TIMEOUT:.0f} s."
        if completed.returncode:
            statement = (completed.stderr.strip().splitlines() or ["no message"])[-1]
            return f"Rendering failed (granflow render, exit code {completed.returncode}): {statement}"
    return ""


def reduced(path: Path, scratch: Path) -> Path:
    """The picture as JPEG of HEIGHT pixels; unchanged if Pillow is not installed."""
    try:
        from PIL import Image
    except ImportError:
        return path
    with Image.open(path) as image:
        size = (max(1, round(image.width * HEIGHT / image.height)), HEIGHT)
        jpeg = scratch / f"{path.stem}.jpg"
        image.convert("RGB").resize(size, Image.Resampling.LANCZOS).save(jpeg, quality=QUALITY, optimize=True)
    return jpeg


def _caption(path: Path, frames: Sequence[Frame]) -> str:
    """Caption of a file of `granflow render`, from its name."""
    match = NAME.fullmatch(path.stem)
    if match is None:
        return path.stem.replace("_", " ")
    color, view, cut, number = match.groups()
    times = [f"{frame.time:.4g} s" for frame in frames if number and frame.number == int(number)]
    return (
        ", ".join([color.replace("_", " "), view.replace("_", " "), *(["cut"] if cut else []), *times]) + "."
    )
