"""Pictures for the page: those rendered since the end of the run, or a few that are rendered now.

Pictures older than the last frame show another run and are not used.
"""

import re
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np

from granflow.errors import GranflowError
from granflow.io.frame_reader import is_empty
from granflow.studies.render.camera import VIEWS
from granflow.studies.render.frames import Frame, frames_of

MOST_PICTURES = 6
"""Maximum number of pictures in the page."""

SHOWN_FRAMES = 4
"""Number of frames rendered for a run without pictures: evenly spaced, including the last one."""

HEIGHT = 800
"""Height of a picture in the page [pixels]: twice its displayed size."""

QUALITY = 85
"""JPEG quality of embedded pictures, 0 to 100."""

FILM_BYTES = 700_000
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


class RunPictures(NamedTuple):
    """Pictures and films of the page, and a sentence about them."""

    shown: Sequence[Picture]
    statement: str


def pictures_for(directory: Path, scratch: Path) -> RunPictures:
    """Pictures and films for the page, scaled down in `scratch`, and a sentence about them.

    Renders a few frames if the run has no pictures since its last frame. At most MOST_PICTURES pictures and one film of
    at most FILM_BYTES.
    """
    try:
        frames = frames_of(directory)
    except GranflowError:
        return RunPictures((), "The run has no frames to render.")
    found, problem = recent_pictures(directory, frames), ""
    if not any(path.suffix == ".png" for path in found):
        problem = render(directory, frames)
        found = recent_pictures(directory, frames)
    images = [path for path in found if path.suffix == ".png"][-MOST_PICTURES:]
    films = [path for path in found if path.suffix == ".mp4"]
    small = [path for path in films if path.stat().st_size <= FILM_BYTES][-1:]
    large = [f"pictures/{path.name}" for path in films if path not in small]
    shown = [Picture(reduced(path, scratch), _caption(path, frames)) for path in images]
    shown += [Picture(path, _caption(path, frames)) for path in small]
    omitted_films = f" Animations not embedded: {', '.join(large)}." if large else ""
    return RunPictures(shown, (problem or HOW_TO_ADD) + omitted_films)


def recent_pictures(directory: Path, frames: Sequence[Frame]) -> list[Path]:
    """PNG and MP4 files in `pictures/` that are newer than the last frame, sorted by name."""
    last = frames[-1].particles.stat().st_mtime
    found = [*(directory / "pictures").glob("*.png"), *(directory / "pictures").glob("*.mp4")]
    return sorted(path for path in found if path.stat().st_mtime >= last)


def render(directory: Path, frames: Sequence[Frame]) -> str:
    """Render a few frames in a subprocess, because VTK aborts if it cannot render; return an error message or "".

    The pictures are in `pictures/` of the run. The time limit is TIMEOUT for each command.
    """
    if find_spec("pyvista") is None:
        return "No pictures, because pyvista is not installed: pip install granflow[plot]"
    filled = [frame for frame in frames if not is_empty(frame.particles)] or frames
    indices = np.unique(np.linspace(0, len(filled) - 1, SHOWN_FRAMES + 1).astype(int)[1:])
    chosen = [filled[index] for index in indices]
    numbers = ",".join(str(frame.number) for frame in chosen)
    commands = [["--frame", numbers]]
    with_contacts = [frame for frame in chosen if frame.contacts is not None and not is_empty(frame.contacts)]
    if with_contacts:
        most = max(with_contacts, key=lambda frame: frame.contacts.stat().st_size if frame.contacts else 0)
        commands.append(["--frame", str(most.number), "--chains"])
    for text in commands:
        command = [sys.executable, "-m", "granflow", "render", str(directory), *text]
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
    return ", ".join([color.replace("_", " "), view.replace("_", " "), *(["cut"] if cut else []), *times]) + "."
