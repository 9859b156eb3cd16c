"""Runs LIGGGHTS and LAMMPS on the cases of `granflow.studies.validation.peers` and stores their figures.

    python tools/validation/run_peers.py [--out out/peers]

Writes the figures, versions and the date to granflow/studies/validation/peers.json. Needs the programs `liggghts` and
`lmp` (Debian packages liggghts and lammps).
"""

import argparse
import json
import re
import shutil
import subprocess
from datetime import date
from pathlib import Path

import numpy as np

from granflow.studies.validation import peers

HERE = Path(__file__).resolve().parent
STORED = Path(peers.__file__).with_name("peers.json")
PROGRAMS = {"LIGGGHTS": ("liggghts", "in.{}.liggghts"), "LAMMPS": ("lmp", "in.{}.lammps")}
SEGMENTS, RINGS = 64, 8
"""Triangles of the hopper around its axis, and rings of cone and tube."""


def write_data(path: Path, case: str) -> None:
    """Write the initial state as a data file."""
    state = peers.initial_state(case)
    low = "-0.001 0.9" if case == "column" else "-0.05 0.05"
    across = "-0.001 0.061" if case == "column" else "-0.05 0.05"
    depth = -0.001 if case == "column" else -0.2
    with path.open("w") as file:
        file.write(
            f"{case}\n\n{peers.COUNT} atoms\n1 atom types\n\n{low} xlo xhi\n{across} ylo yhi\n{depth} 0.9 zlo zhi\n"
        )
        file.write("\nAtoms\n\n")
        for number, (d, x) in enumerate(zip(state.diameter, state.position, strict=True), 1):
            file.write(f"{number} 1 {d:.17g} {peers.DENSITY:g} {x[0]:.17g} {x[1]:.17g} {x[2]:.17g}\n")
        file.write("\nVelocities\n\n")
        for number, v in enumerate(state.velocity, 1):
            file.write(f"{number} {v[0]:.17g} {v[1]:.17g} {v[2]:.17g} 0 0 0\n")


def write_hopper(path: Path) -> None:
    """Write cone and tube as triangles, with vertices on the circles."""
    angle = 2.0 * np.pi * np.arange(SEGMENTS + 1) / SEGMENTS
    heights = [*np.linspace(0.0, peers.CONE_HEIGHT, RINGS), *np.linspace(peers.CONE_HEIGHT, peers.TOP, 3 * RINGS)[1:]]
    rings = []
    for z in heights:
        radius = min(peers.TUBE, peers.ORIFICE + (peers.TUBE - peers.ORIFICE) * z / peers.CONE_HEIGHT)
        rings.append(np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full_like(angle, z)], axis=1))
    with path.open("w") as file:
        file.write("solid hopper\n")
        for low, high in zip(rings, rings[1:], strict=False):
            for i in range(SEGMENTS):
                for corners in ((low[i], low[i + 1], high[i + 1]), (low[i], high[i + 1], high[i])):
                    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
                    normal /= np.linalg.norm(normal)
                    file.write("facet normal {:.9g} {:.9g} {:.9g}\nouter loop\n".format(*normal))
                    file.writelines("vertex {:.12g} {:.12g} {:.12g}\n".format(*each) for each in corners)
                    file.write("endloop\nendfacet\n")
        file.write("endsolid hopper\n")


def read_frames(path: Path) -> dict[float, peers.Particles]:
    """Frames of a dump by time [s], particles ordered by id."""
    frames: dict[float, peers.Particles] = {}
    lines = path.read_text().splitlines()
    starts = [number for number, line in enumerate(lines) if line.startswith("ITEM: TIMESTEP")]
    for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
        table = np.array([line.split() for line in lines[start + 9 : end]], dtype=float)
        table = table[np.argsort(table[:, 0])]
        time = round(int(lines[start + 1]) * peers.TIME_STEP, 6)
        frames[time] = peers.Particles(table[:, 1:4], table[:, 4:7], table[:, 7])
    return frames


def run(code: str, case: str, folder: Path) -> dict[str, float]:
    """Figures of one code and case, which runs in `folder`."""
    program, name = PROGRAMS[code]
    folder.mkdir(parents=True, exist_ok=True)
    write_data(folder / f"{case}.data", case)
    if case == "hopper":
        write_hopper(folder / "hopper.stl")
    deck = name.format(case)
    shutil.copyfile(HERE / deck, folder / deck)
    command = [program, "-in", deck, "-var", "L", str(peers.SIDE), "-log", "none"]
    with (folder / "output.txt").open("w") as output:
        subprocess.run(command, cwd=folder, stdout=output, stderr=subprocess.STDOUT, check=True)
    frames = read_frames(folder / "frames.txt")
    if case == "column" and any(len(state.diameter) != peers.COUNT for state in frames.values()):
        raise SystemExit(f"{code} lost particles: see {folder / 'output.txt'}")
    return peers.figures(case, frames)


def version(code: str, folder: Path) -> str:
    """Name and version that the program prints; LIGGGHTS writes a log to the folder in which it starts."""
    command = [PROGRAMS[code][0], "-h"]
    output = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False).stdout
    found = re.search(r"(LIGGGHTS-\S+ [\d.]+)|Simulator - (.*)", output)
    if found is None:
        raise SystemExit(f"{code} prints no version")
    return found[1] or "LAMMPS " + found[2].replace(" - Update", ", update").strip()


def main() -> None:
    """Run both codes and store their figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/peers"), metavar="DIR", help="files of the runs")
    folder = parser.parse_args().out
    stored = {}
    for code in PROGRAMS:
        found = {case: run(code, case, folder / code.lower() / case) for case in peers.ENDS}
        stored[code] = {"version": version(code, folder), "date": date.today().isoformat(), "figures": found}
    STORED.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
