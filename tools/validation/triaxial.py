"""Validation cases of triaxial compression in a periodic box (scene triaxial): LAMMPS from the same positions.

    python tools/validation/triaxial.py --out out/triaxial      runs LAMMPS (lmp) and stores its figures in
                                                                triaxial_lammps.json

LAMMPS controls the lateral pressures by `fix press/berendsen` with the gain of granflow
(`inputs/in.triaxial.lammps`). All runs with one number have the same initial positions and diameters. The
figures are means over axial strains of 0.20 to 0.35, in which stress ratio and volume are steady.
"""

import argparse
import json
import math
import shutil
import subprocess
import sys
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.stats import t

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))

from granflow import Simulation, read_run  # noqa: E402
from validation.case import ValidationCase, shipped_scene  # noqa: E402
from validation.peers.compare import CONFIDENCE, joined  # noqa: E402
from validation.peers.programs import version  # noqa: E402

INPUT = Path(__file__).parent / "inputs" / "in.triaxial.lammps"
FIGURES = Path(__file__).with_name("triaxial_lammps.json")
"""Version of LAMMPS, date, and the figures of its runs."""
REPEATS = 8
"""Numbers of the initial packings, seeds of the scene: 1 to 8."""
SIDE, DENSITY = 0.0102, 2500.0
"""Width of the box at the start [m], and density of the spheres [kg/m3]."""
STEADY = (0.20, 0.35)
"""Axial strains, compression positive, between which the figures are means."""
COMPRESSED = 7800 + 6000
"""Step of LAMMPS at which isotropic compression ends."""
RATIO, VOLUME, ISOTROPIC = (
    "stress ratio q/p in the critical state",
    "volumetric strain in the critical state",
    "volumetric strain of isotropic compression",
)
Figures = Mapping[str, list[float]]


def triaxial_cases() -> list[ValidationCase]:
    """Steady stress ratio and volume, and volume after isotropic compression."""
    stored = json.loads(FIGURES.read_text(encoding="utf-8"))
    ours = joined([our_figures(seed) for seed in range(1, REPEATS + 1)])
    found = []
    for name, theirs in stored["figures"].items():
        reference = float(np.mean(theirs))
        scatter = float(np.std(np.subtract(ours[name], theirs), ddof=1)) / math.sqrt(REPEATS)
        factor = float(t.ppf(0.5 + 0.5 * CONFIDENCE, REPEATS - 1))
        found.append(
            ValidationCase(
                kind="Triaxial compression",
                name=f"LAMMPS: {name}",
                reference=reference,
                source=f"{stored['version']}, run on {stored['date']} from the same positions",
                value=float(np.mean(ours[name])),
                unit="1",
                allowed=factor * scatter / abs(reference),
                derivation=f"{factor:.3g} standard errors of the differences of {REPEATS} pairs of runs "
                f"(Student's t for {100 * CONFIDENCE:.2f} %)",
            )
        )
    return found


def our_figures(seed: int) -> Figures:
    """Figures of a run of the scene."""
    with TemporaryDirectory() as folder:
        with Simulation(shipped_scene("triaxial", [f"seed={seed}"]), out=Path(folder) / "run") as simulation:
            simulation.run()
        series = read_run(Path(folder) / "run").timeseries_arrays
    compressed = series["volumetric_strain"][series["stage"] == "compress"][-1]
    names = ("box_strain_z", "stress_ratio", "volumetric_strain")
    return figures_of(np.stack([series[name] for name in names], axis=1), compressed)


def figures_of(rows: np.ndarray, compressed: float) -> Figures:
    """Figures from rows (n, 3) of axial strain, stress ratio and volumetric strain."""
    axial = -rows[:, 0]
    steady = (axial > STEADY[0]) & (axial < STEADY[1])
    return {
        RATIO: [float(rows[steady, 1].mean())],
        VOLUME: [float(rows[steady, 2].mean())],
        ISOTROPIC: [float(compressed)],
    }


def lammps_figures(seed: int, folder: Path) -> Figures:
    """Figures of a run of LAMMPS, whose files are in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    with Simulation(shipped_scene("triaxial", [f"seed={seed}"])) as simulation:
        particles = simulation.snapshot().particles
    with (folder / "run.data").open("w") as file:
        file.write(f"granflow\n\n{len(particles['radius'])} atoms\n1 atom types\n\n")
        file.writelines(f"0 {SIDE} {axis}lo {axis}hi\n" for axis in "xyz")
        file.write("\nAtoms\n\n")
        for number, (radius, x) in enumerate(zip(particles["radius"], particles["position"], strict=True), 1):
            file.write(f"{number} 1 {2 * radius:.17g} {DENSITY:g} {x[0]:.17g} {x[1]:.17g} {x[2]:.17g}\n")
    shutil.copyfile(INPUT, folder / INPUT.name)
    with (folder / "output.txt").open("w") as output:
        command = ["lmp", "-in", INPUT.name, "-log", "none"]
        subprocess.run(command, cwd=folder, stdout=output, check=True)
    rows = []
    for line in (folder / "output.txt").read_text().splitlines():
        words = line.split()
        if (
            len(words) == 7 and words[0].isdigit()
        ):  # step, three pressures, ratio, axial and volumetric strain
            rows.append([float(each) for each in words])
    table = np.array(rows)
    compressed = table[table[:, 0] == COMPRESSED][0, 6]
    return figures_of(table[:, [5, 4, 6]], compressed)


def main() -> None:
    """Run LAMMPS and store its figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/triaxial"), metavar="DIR", help="files")
    folder = parser.parse_args().out
    figures = joined([lammps_figures(seed, folder / str(seed)) for seed in range(1, REPEATS + 1)])
    stored = {
        "version": version("LAMMPS", folder),
        "date": date.today().isoformat(),
        "figures": figures,
    }
    FIGURES.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(stored, indent=1))


if __name__ == "__main__":
    main()
