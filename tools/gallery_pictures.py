"""Renders the gallery pictures of the documentation from finished runs of the shipped scenes.

python tools/gallery_pictures.py out/hopper out/drum ...     writes docs/pages/gallery/NAME.jpg for each

A directory has the name of its scene; `dosta2024_drum` is the scene dosta2024/drum.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

PICTURES = Path(__file__).resolve().parents[1] / "docs" / "pages" / "gallery"
SIZE = "640x480"
JPEG_QUALITY = 85
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
    "brazil_nut": ["--cut", "--color", "radius", "--fit", "particles"],
    "mixer": ["--color", "group", "--fit", "particles"],
    "impact": ["--view=1,-2,2.5", "--color", "group", "--fit", "particles"],
    "dosta2024_penetration": ["--view=1,-2,2", "--color", "group", "--fit", "particles"],
    "column_collapse": ["--fit", "particles"],
    "two_spheres": ["--view", "front", "--fit", "particles"],
    "sheared_layer": ["--view=1,-2,0.6", "--fit", "particles"],
    "shear_cell": ["--view=1,-2,0.6", "--color", "velocity.x", "--fit", "particles"],
}
"""Arguments of `granflow render` for each scene."""


def render(directory: Path) -> None:
    """Renders the picture of one run."""
    with tempfile.TemporaryDirectory() as folder:
        image = Path(folder) / "picture.png"
        arguments = [*OPTIONS[directory.name], "--size", SIZE, "--out", str(image)]
        subprocess.run([sys.executable, "-m", "granflow", "render", str(directory), *arguments], check=True)
        PICTURES.mkdir(exist_ok=True)
        Image.open(image).convert("RGB").save(PICTURES / f"{directory.name}.jpg", quality=JPEG_QUALITY)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        render(Path(name))
