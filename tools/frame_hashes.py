"""Bitwise regression check: hashes of the last frame of shortened versions of six scenes.

    python tools/frame_hashes.py --out before.json      runs each scene in f64 and mixed, on one and two threads
    python tools/frame_hashes.py --compare before.json  runs them again and reports each frame that differs

Each array of a frame has its own SHA-256; the comparison uses the set of hashes, so that an array may be
renamed. A frame of one thread must equal the frame of two. Hashes depend on the processor and its math
library: compare on one machine only. Takes about ten minutes on two cores.
"""

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import meshio
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
SCENES = {
    "hopper": ["--set", "particles.beads.count=2000", "--until", "0.12s"],
    "vibrated_bed": ["--until", "0.05s"],
    "drum": ["--until", "0.05s"],
    "mixer": ["--until", "0.3s"],
    "shear_cell": ["--until", "0.1s"],
    "flat_silo": ["--until", "0.1s"],
}
"""Arguments that shorten each scene."""


def main() -> int:
    """Runs all cases and writes or compares their hashes; returns 0 if no frame differs."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--out", type=Path, help="write the hashes to this JSON file")
    parser.add_argument("--compare", type=Path, help="compare with the hashes of this JSON file")
    options = parser.parse_args()
    found = {
        f"{scene} {precision}": hashes_of(scene, precision)
        for scene in SCENES
        for precision in ("f64", "mixed")
    }
    if options.out:
        options.out.write_text(json.dumps(found, indent=1) + "\n")
    if not options.compare:
        return 0
    reference = json.loads(options.compare.read_text())
    different = [name for name in found if Counter(found[name].values()) != Counter(reference[name].values())]
    for name in different:
        changed = sorted(
            array for array, value in found[name].items() if value not in reference[name].values()
        )
        print(f"{name}: arrays differ: {', '.join(changed) or 'their number'}")
    print(f"{len(found) - len(different)} of {len(found)} frames are identical")
    return int(bool(different))


def hashes_of(scene: str, precision: str) -> dict[str, str]:
    """SHA-256 of each array of the last frame; stops if one and two threads give different frames."""
    one, two = (last_frame(scene, precision, threads) for threads in (1, 2))
    print(f"{scene} {precision}: {len(one)} arrays", flush=True)
    if one != two:
        sys.exit(f"{scene} {precision}: the frame of one thread differs from that of two.")
    return one


def last_frame(scene: str, precision: str, threads: int) -> dict[str, str]:
    """Hashes by array name of the last frame of one run."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        command = [
            sys.executable,
            "-m",
            "granflow",
            "run",
            str(ROOT / "scenes" / f"{scene}.yaml"),
            *SCENES[scene],
        ]
        command += ["--out", str(out), "--precision", precision, "--threads", str(threads)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=ROOT)
        frame = meshio.read(max(out.glob("particles_*.vtu")))
        arrays = {"points": frame.points, **frame.point_data}
        return {name: digest(values) for name, values in arrays.items()}


def digest(values: np.ndarray) -> str:
    """SHA-256 of the bytes of an array and its shape."""
    return hashlib.sha256(repr(values.shape).encode() + np.ascontiguousarray(values).tobytes()).hexdigest()


if __name__ == "__main__":
    sys.exit(main())
