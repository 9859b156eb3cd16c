"""Runs the packaged scripts of LIGGGHTS and LAMMPS with the codes, and as imported scenes with granflow.

    python tools/import_decks.py [NAME ...] [--budget 60] [--seeds 2] [--out out/decks]

Needs the Debian packages liggghts, liggghts-doc, lammps and lammps-examples. Each script is imported, checked
and run for at most `--budget` seconds of wall clock per run and seed, the code on one core and granflow on one
thread. The table compares until the time that all runs have reached: particles, mean height and kinetic energy
of translation at the rows of granflow nearest to thirds of it. NAME is a part of the name of a script.
"""

import argparse
import contextlib
import csv
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

LIGGGHTS = Path("/usr/share/doc/liggghts/examples/LIGGGHTS/Tutorials_public")
LAMMPS = Path("/usr/share/lammps/examples")
DECKS = {
    LIGGGHTS: (
        *("cohesion/in.noCohesion", "cohesion/in.cohesion", "contactModels/in.newModels"),
        *("contactModels/in.oldModels", "hysteresis/in.noHysteresis", "hysteresis/in.hysteresis"),
        *("insert_stream/in.insert_stream", "insert_stream/in.insert_stream_reset_timestep"),
        *("meshGran/in.meshGran", "movingMeshGran/in.movingMeshGran", "conveyor/in.conveyor"),
        *("chute_wear/in.chute_wear", "hydrogel_multicontact/in.hydrogel_default"),
        *("hydrogel_multicontact/in.hydrogel_multicontact", "heatTransfer_1/in.heatGran"),
        *("heatTransfer_2/in.heatGran", "packing/in.packing"),
        "multisphere_stone_restitution/in.multisphere",
    ),
    LAMMPS: (
        *("granregion/in.granregion.funnel", "granregion/in.granregion.mixer"),
        *("granregion/in.granregion.box", "pour/in.pour", "granular/in.pour.flatwall"),
        "granular/in.pour.drum",
    ),
}
"""Scripts without SPH, superquadrics, tetrahedra, ParScale and molecules, by the folder of their code."""
PROGRAMS = {LIGGGHTS: "liggghts", LAMMPS: "lmp"}
OUTPUT = ("dump", "dump_modify", "undump", "thermo", "thermo_style", "restart", "write_data")
"""Commands of the scripts that are left out."""
MEASURED = """
variable each_energy atom 0.5*mass*(vx*vx+vy*vy+vz*vz)
variable each_moment atom mass*z
variable each_mass atom mass
compute sums all reduce sum v_each_energy v_each_moment v_each_mass
thermo_style custom step dt atoms c_sums[1] c_sums[2] c_sums[3]
thermo_modify norm no flush yes
thermo 100
"""
"""Output of the codes in place of their own, after the box exists."""
SEEDS = (86028121, 86028157, 49979687, 67867967)
"""Seeds of insertions after that of the script: prime, for LIGGGHTS, and none that the scripts use elsewhere."""


@dataclass
class Course:
    """What a run has written: times [s] (n,), particle counts, kinetic energies [J], mean heights [m]."""

    times: np.ndarray
    counts: np.ndarray
    energies: np.ndarray
    heights: np.ndarray

    def at(self, values: np.ndarray, time: float) -> float:
        """A value at a time."""
        return float(np.interp(time, self.times, values))


def measured_script(text: str, seed: int) -> str:
    """The script with the output of this comparison; `seed`: 0 for that of the script."""
    lines = []
    for line in re.sub(r"&[ \t]*\n", " ", text).splitlines():
        words = line.split("#")[0].split()
        if seed and words[:1] == ["fix"] and "insert/" in line:
            line = re.sub(r"\bseed\s+\d+", f"seed {SEEDS[seed - 1]}", line)
        elif seed and words[:1] == ["fix"] and words[3:4] == ["pour"]:
            line = line.replace(words[6], str(SEEDS[seed - 1]), 1)
        if words and words[0] in OUTPUT:
            continue
        if words[:1] == ["thermo_modify"] and "lost" in words:
            line = f"thermo_modify lost {words[words.index('lost') + 1]}"
        lines.append(line)
        if words and words[0] in ("create_box", "read_data"):
            lines.append(MEASURED)
    return "\n".join(lines) + "\n"


def run_limited(command: list[str], folder: Path, budget: float) -> None:
    """Run a command for at most `budget` seconds."""
    with (folder / "out.txt").open("w") as out:
        process = subprocess.Popen(command, cwd=folder, stdout=out, stderr=subprocess.STDOUT)
        try:
            process.wait(budget)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(20.0)
            process.kill()
            process.wait()


def course_of_code(program: str, deck: Path, folder: Path, seed: int, budget: float) -> Course:
    """Run the code in a copy of the folder of the script."""
    shutil.copytree(deck.parent, folder)
    (folder / "post").mkdir(exist_ok=True)
    (folder / deck.name).write_text(measured_script(deck.read_text(), seed))
    run_limited([program, "-in", deck.name, "-log", "log.txt"], folder, budget)
    return read_log(folder)


def read_log(folder: Path) -> Course:
    """The course that a code has written to its log; each `run` counts its steps from its first row."""
    rows: list[list[float]] = []
    start = first = None
    for line in (folder / "log.txt").read_text(errors="replace").splitlines():
        words = line.split()
        if words[:2] == ["Step", "Dt"]:
            start, first = rows[-1][0] if rows else 0.0, None
        elif start is not None and len(words) == 6 and all(map(is_number, words)):
            step, length, *values = map(float, words)
            first = step if first is None else first
            rows.append([start + (step - first) * length, *values])
        else:
            start = None if words[:1] == ["Loop"] else start
    times, counts, energies, moments, masses = np.array(rows or [[0.0] * 5]).T
    return Course(times, counts, energies, moments / np.where(masses > 0.0, masses, np.nan))


def is_number(text: str) -> bool:
    """Whether a word of a log is a number."""
    return re.fullmatch(r"[-+]?(\d+\.?\d*(e[-+]?\d+)?|nan|inf)", text, re.IGNORECASE) is not None


def course_of_granflow(scene: Path, folder: Path, seed: int, budget: float) -> Course:
    """Run the imported scene."""
    command = [str(Path(sys.executable).with_name("granflow")), "run", str(scene.resolve()), "--threads", "1"]
    keys = [f"seed={seed + 1}", "output.metrics={center: {kind: center_of_mass}}"]
    keys = [each for each in keys if not (seed == 0 and each.startswith("seed"))]
    overrides = [word for each in keys for word in ("--set", each)]
    folder.mkdir()
    run_limited([*command, *overrides, "--out", "run"], folder, budget)
    return read_run(folder)


def read_run(folder: Path) -> Course:
    """The course that granflow has written."""
    file = folder / "run" / "timeseries.csv"
    if not file.exists():
        print(f"{folder}: no time series within the budget, see out.txt", flush=True)
        return Course(*np.full((4, 1), 0.0))
    table = list(csv.DictReader(file.read_text().splitlines()))
    wanted = ("time [s]", "particle_count", "kinetic_energy [J]", "center_of_mass_z.center [m]")
    return Course(*(np.array([float(row[name] or "nan") for row in table]) for name in wanted))


def row(name: str, codes: list[Course], scenes: list[Course]) -> str:
    """One row of the table."""
    end = min(each.times[-1] for each in (*codes, *scenes))
    cells = [f"`{name}`", f"{end:.3g} s"]
    for runs in (codes, scenes):
        cells.append(", ".join(f"{each.at(each.counts, end):.0f}" for each in runs))
    for runs in (codes, scenes):
        cells.append(", ".join(f"{each.at(each.heights, end):.4g}" for each in runs))
    # At rows of granflow, which are farther apart than those of the codes: between two of them, a maximum of
    # the energy can lie.
    rows = scenes[0].times[scenes[0].times <= end]
    times = [rows[np.abs(rows - share * end).argmin()] for share in (1 / 3, 2 / 3, 1.0)]
    for runs in (codes, scenes):
        thirds = ["/".join(f"{each.at(each.energies, time):.3g}" for each in runs) for time in times]
        cells.append(", ".join(thirds))
    return f"| {' | '.join(cells)} |"


def compare(folder: Path, name: str, out: Path, seeds: int, budget: float) -> str:
    """Import, check and run one script; a row of the table, or why there is none."""
    deck = folder / name
    place = out / name.replace("/", "_")
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    scene = place / "scene.yaml"
    command = [str(Path(sys.executable).with_name("granflow")), "import", str(deck), "--out", str(scene)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    (place / "report.txt").write_text(done.stdout + done.stderr)
    if done.returncode:
        return f"`{name}`: import ends with exit code {done.returncode}, see {place / 'report.txt'}"
    scenes = [course_of_granflow(scene, place / f"granflow_{k}", k, budget) for k in range(seeds)]
    codes = [course_of_code(PROGRAMS[folder], deck, place / f"code_{k}", k, budget) for k in range(seeds)]
    return row(name, codes, scenes)


def main() -> None:
    """Compare the scripts that are chosen."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="part of the name of a script (default: all)"
    )
    parser.add_argument("--budget", type=float, default=60.0, metavar="S", help="seconds for each run")
    parser.add_argument(
        "--seeds", type=int, choices=range(1, 6), metavar="N", default=2, help="runs of each code"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/decks"), metavar="DIR", help="files of the runs"
    )
    options = parser.parse_args()
    columns = ("script", "until", *(f"{what}: {code}" for what in ("particles", "mean height [m]",
               "kinetic energy [J] at thirds") for code in ("code", "granflow")))  # fmt: skip
    print(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}", flush=True)
    for folder, names in DECKS.items():
        for name in names:
            if not options.names or any(each in name for each in options.names):
                print(compare(folder, name, options.out, options.seeds, options.budget), flush=True)


if __name__ == "__main__":
    main()
