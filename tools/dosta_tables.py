"""Scenes of the drum and the penetration test of Dosta et al. (2024) with the published initial particle
positions.

    python tools/dosta_tables.py FOLDER --out out/dosta      writes drum.yaml, penetration.yaml and particle
    tables granflow run out/dosta/drum.yaml

FOLDER holds Drum_PartCoordinates.txt and Penetration_25KParticles.txt of the open data of the paper's
MercuryDPM entry (columns radius, x, y, z in m). The scenes are those in scenes/dosta2024; the drum has its
full size.
"""

import argparse
from pathlib import Path

from granflow import load_scene

SCENES = Path(__file__).resolve().parent.parent / "scenes" / "dosta2024"
COLUMNS = 4

DRUM_TABLE, PENETRATION_TABLE = "Drum_PartCoordinates.txt", "Penetration_25KParticles.txt"
DRUM = ["scale=2", "stages=[{name: turn, duration: 5 s}]"]
PENETRATION = ["particles.ball.insert.start=0 s", "run.duration=0.03 s"]
BEADS = {1e-3: "m1", 2e-3: "m2"}
"""Material by particle radius [m]."""


def split(table: Path, out: Path, name: str) -> dict[float, str]:
    """Writes the particles of each radius [m] to a separate file, skipping other lines; returns the files."""
    head, *lines = table.read_text(encoding="utf-8").splitlines()
    rows: dict[float, list[str]] = {}
    for line in lines:
        if len(line.split()) == COLUMNS:
            rows.setdefault(float(line.split()[0]), []).append(line)
    files = {radius: f"{name}_{BEADS[radius]}.txt" for radius in rows}
    for radius, file in files.items():
        (out / file).write_text("\n".join([head, *rows[radius], ""]), encoding="utf-8")
    return files


def write(name: str, groups: dict[str, float], overrides: list[str], table: Path, out: Path) -> Path:
    """Writes a scene whose `groups`, each with one radius [m], have the positions of the table; returns its
    path."""
    files = split(table, out, name)
    path = out / f"{name}.yaml"
    path.write_text(
        load_scene(SCENES / f"{name}.yaml", [*overrides, "expect=[]"]).to_yaml(), encoding="utf-8"
    )
    placed = [
        f"particles.{group}={{material: {BEADS[radius]}, insert: {{kind: file, file: {files[radius]}}}}}"
        for group, radius in groups.items()
    ]
    path.write_text(load_scene(path, placed).to_yaml(), encoding="utf-8")
    return path


def main() -> None:
    """Writes both scenes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("out/dosta"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    print(write("drum", {"large": 2e-3, "small": 1e-3}, DRUM, options.folder / DRUM_TABLE, options.out))
    print(write("penetration", {"beads": 1e-3}, PENETRATION, options.folder / PENETRATION_TABLE, options.out))


if __name__ == "__main__":
    main()
