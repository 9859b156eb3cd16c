"""Renders the gallery pictures and films of the documentation from finished runs of the shipped scenes.

python tools/gallery_pictures.py out/hopper out/drum ...     writes docs/pages/gallery/NAME.jpg and NAME.mp4
for each

A directory has the name of its scene; `dosta2024_drum` is the scene dosta2024/drum.
"""

import subprocess
import sys
import tempfile
from dataclasses import fields
from pathlib import Path

from imageio_ffmpeg import get_ffmpeg_exe
from PIL import Image

from granflow.cli.main import build_parser
from granflow.studies.frames import frames_of
from granflow.studies.render import PictureStyle, pictures, write_film

PICTURES = Path(__file__).resolve().parents[1] / "docs" / "pages" / "gallery"
SIZE = "640x480"
JPEG_QUALITY = 85
FILM_SIZE = "400x300"
FILM_SECONDS, FILM_RATE = 5.0, 20
"""Duration of a film [s], and its largest number of pictures per second."""
FILM_CODING = [
    "-c:v",
    "libx264",
    "-preset",
    "veryslow",
    "-crf",
    "32",
    "-pix_fmt",
    "yuv420p",
    "-movflags",
    "+faststart",
]
"""Arguments of ffmpeg: 50 to 250 kB for a film."""
STILL = ("--frame", "0.9s", "0.8s")
"""Arguments of OPTIONS that films do not have."""
OPTIONS = {
    "hopper": ["--frame", "0.9s", "--cut"],
    "flat_silo": ["--frame", "0.8s", "--cut"],
    "dosta2024_silo_large_orifice": ["--frame", "0.8s", "--cut"],
    "dosta2024_silo_small_orifice": ["--frame", "0.8s", "--cut"],
    "drum": ["--view", "front", "--fit", "particles"],
    "dosta2024_drum": ["--view", "front", "--color", "radius", "--fit", "particles"],
    "vibrated_bed": ["--view=0.3,-2,0.6", "--fit", "particles"],
    "surface_waves": ["--view=0.3,-2,0.6", "--fit", "particles"],
    "angle_of_repose": ["--view", "front", "--fit", "particles"],
    "clumps": ["--view=0.4,-2,0.6", "--color", "clump", "--fit", "particles"],
    "brazil_nut": ["--cut", "--color", "radius", "--fit", "particles"],
    "mixer": ["--color", "group", "--fit", "particles"],
    "impact": ["--view=1,-2,2.5", "--color", "group", "--fit", "particles"],
    "dosta2024_penetration": ["--view=1,-2,2", "--color", "group", "--fit", "particles"],
    "column_collapse": ["--fit", "particles"],
    "two_spheres": ["--view", "front", "--fit", "particles"],
    "sheared_layer": ["--view=1,-2,0.6", "--fit", "particles"],
    "shear_cell": ["--view=1,-2,0.6", "--color", "velocity.x", "--fit", "particles"],
    "triaxial": ["--view=1,-2,0.6", "--color", "coordination_number", "--fit", "particles"],
    "shear_tester": ["--view=1,-2,0.6", "--color", "velocity.x", "--fit", "particles"],
}
"""Arguments of `granflow render` for each scene."""


def render(directory: Path) -> None:
    """Renders the picture and the film of one run."""
    PICTURES.mkdir(exist_ok=True)
    options = OPTIONS[directory.name]
    with tempfile.TemporaryDirectory() as folder:
        image = Path(folder) / "picture.png"
        film = Path(folder) / "film.mp4"
        granflow_render(directory, image, [*options, "--size", SIZE])
        Image.open(image).convert("RGB").save(PICTURES / f"{directory.name}.jpg", quality=JPEG_QUALITY)
        moving = [each for each in options if each not in STILL]
        render_film(directory, film, style_of(directory, [*moving, "--size", FILM_SIZE]))
        coded = [get_ffmpeg_exe(), "-y", "-loglevel", "error", "-i", str(film), *FILM_CODING]
        subprocess.run([*coded, str(PICTURES / f"{directory.name}.mp4")], check=True)


def style_of(directory: Path, arguments: list[str]) -> PictureStyle:
    """Style of the pictures for arguments of `granflow render`."""
    options = build_parser().parse_args(["render", str(directory), *arguments])
    return PictureStyle(**{field.name: getattr(options, field.name) for field in fields(PictureStyle)})


def render_film(directory: Path, out: Path, style: PictureStyle) -> None:
    """Renders a film of FILM_SECONDS from evenly spaced frames, at most FILM_RATE per second."""
    frames = frames_of(directory)
    chosen = frames[:: max(1, round(len(frames) / (FILM_SECONDS * FILM_RATE)))]
    rate = len(chosen) / FILM_SECONDS
    write_film(out, pictures(directory, chosen, style, rate), rate)


def granflow_render(directory: Path, out: Path, arguments: list[str]) -> None:
    """Calls `granflow render`."""
    command = [sys.executable, "-m", "granflow", "render", str(directory), *arguments, "--out", str(out)]
    subprocess.run(command, check=True)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        render(Path(name))
