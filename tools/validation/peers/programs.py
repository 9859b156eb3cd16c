"""Runs LIGGGHTS and LAMMPS with the inputs of tools/validation/inputs from the initial states of the
cases."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np

from granflow.errors import GranflowError
from validation.peers.case import PeerCase
from validation.peers.state import DENSITY, Particles

PROGRAMS = {"LIGGGHTS": "liggghts", "LAMMPS": "lmp"}
"""Name of the executable of each code, which is also that of its Debian package for LIGGGHTS."""
INPUTS = Path(__file__).resolve().parents[1] / "inputs"


def installed() -> list[str]:
    """Codes whose executables are found."""
    return [code for code, program in PROGRAMS.items() if shutil.which(program)]


def input_path(code: str, case: PeerCase) -> Path:
    """Input of a code for a case."""
    return INPUTS / f"in.{case.deck}.{code.lower()}"


def simulates(code: str, case: PeerCase) -> bool:
    """Whether a code has an input for a case; LAMMPS has no wall with a hole."""
    return input_path(code, case).is_file()


def run(code: str, case: PeerCase, repeat: int, folder: Path) -> dict[str, list[float]]:
    """Samples of each figure of one run, which writes its files to `folder`.

    Raises GranflowError if the program fails or loses particles.
    """
    folder.mkdir(parents=True, exist_ok=True)
    start = case.initial_state(repeat)
    write_data(folder / "run.data", start, case.box)
    for name, triangles in case.meshes().items():
        write_stl(folder / name, triangles)
    path = input_path(code, case)
    shutil.copyfile(path, folder / path.name)
    command = [PROGRAMS[code], "-in", path.name, "-log", "none"]
    for name, value in {"e": case.restitution[code], **case.variables}.items():
        command += ["-var", name, f"{value:.10g}"]
    with (folder / "output.txt").open("w") as output:
        done = subprocess.run(command, cwd=folder, stdout=output, stderr=subprocess.STDOUT, check=False)
    if done.returncode:
        raise GranflowError(
            f"{code} fails in {case.name} with exit code {done.returncode}: see {folder / 'output.txt'}"
        )
    frames = read_frames(folder / "frames.txt", case.time_step)
    (folder / "frames.txt").unlink()
    wanted = {round(float(time), 6) for time in case.times}
    if not wanted <= set(frames):
        raise GranflowError(
            f"{code} writes no state at some times of {case.name}: see {folder / 'output.txt'}"
        )
    return case.samples({time: frames[time] for time in sorted(wanted)})


def write_data(path: Path, state: Particles, box: tuple[tuple[float, ...], tuple[float, ...]]) -> None:
    """Write a state as a data file of both codes; `box` is the region [m], low and high corner."""
    with path.open("w") as file:
        file.write(f"granflow\n\n{len(state.diameter)} atoms\n1 atom types\n\n")
        file.writelines(
            f"{low:.17g} {high:.17g} {axis}lo {axis}hi\n" for axis, low, high in zip("xyz", *box, strict=True)
        )
        file.write("\nAtoms\n\n")
        for number, (d, x) in enumerate(zip(state.diameter, state.position, strict=True), 1):
            file.write(f"{number} 1 {d:.17g} {DENSITY:g} {x[0]:.17g} {x[1]:.17g} {x[2]:.17g}\n")
        file.write("\nVelocities\n\n")
        for number, v in enumerate(state.velocity, 1):
            file.write(f"{number} {v[0]:.17g} {v[1]:.17g} {v[2]:.17g} 0 0 0\n")


def write_stl(path: Path, triangles: np.ndarray) -> None:
    """Write triangles (n, 3, 3) [m] as an STL file."""
    with path.open("w") as file:
        file.write("solid wall\n")
        for corners in triangles:
            normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
            file.write(
                "facet normal {:.9g} {:.9g} {:.9g}\nouter loop\n".format(*(normal / np.linalg.norm(normal)))
            )
            file.writelines("vertex {:.12g} {:.12g} {:.12g}\n".format(*each) for each in corners)
            file.write("endloop\nendfacet\n")
        file.write("endsolid wall\n")


def read_frames(path: Path, time_step: float) -> dict[float, Particles]:
    """States of a dump by time [s], particles ordered by id."""
    frames: dict[float, Particles] = {}
    lines = path.read_text().splitlines()
    starts = [number for number, line in enumerate(lines) if line.startswith("ITEM: TIMESTEP")]
    for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
        rows = np.array(" ".join(lines[start + 9 : end]).split(), dtype=float).reshape(-1, 8)
        table = rows[np.argsort(rows[:, 0])]
        frames[round(int(lines[start + 1]) * time_step, 6)] = Particles(
            table[:, 1:4], table[:, 4:7], table[:, 7]
        )
    return frames


def version(code: str, folder: Path) -> str:
    """Name and version that the program prints; LIGGGHTS writes a log to the folder in which it starts."""
    folder.mkdir(parents=True, exist_ok=True)
    output = subprocess.run(
        [PROGRAMS[code], "-h"], cwd=folder, capture_output=True, text=True, check=False
    ).stdout
    found = re.search(r"(LIGGGHTS-\S+ [\d.]+)|Simulator - (.*)", output)
    if found is None:
        raise GranflowError(f"{code} prints no version")
    return found[1] or "LAMMPS " + found[2].replace(" - Update", ", update").strip()
