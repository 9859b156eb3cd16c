"""Measures all codes in turn in several rounds: selection of cases, order of jobs, result file."""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmark import cases, codes
from benchmark.cases import Case, find_beds, read_data, tiled
from benchmark.codes import LARGEST_COUNT, Failed, Job, job_for
from benchmark.machine import ROOT, machine

PEER_DATA = ROOT.parent / "shared" / "peers"
HERTZ_ONLY_COUNT = 1_000_000
"""Particle count from which granflow is measured only with the contact model of the other codes, to save
time."""
START = {"granflow": (4.0, 6e-6), "liggghts": (0.5, 1e-5), "lammps": (0.5, 8e-6), "yade": (1.5, 1e-4)}
"""Constant overhead [s] and overhead per particle [s] of each code; only for the estimate of the duration."""
RATE = {"granflow": 7e6, "liggghts": 4e6, "lammps": 4e6, "yade": 5e5}
"""Particle-steps per second of one thread; only for the estimate of the duration."""


def gather_cases(options: argparse.Namespace, folder: Path) -> list[Case]:
    """The beds of the requested sizes and the hopper; beds without a file are settled or tiled."""
    beds = options.beds or (PEER_DATA / "beds" if (PEER_DATA / "beds").is_dir() else None)
    bed_files = {} if beds is None else find_beds(beds)
    found = [bed_of(size, bed_files, folder) for size in options.sizes]
    if options.hopper:
        path = options.hopper_data or PEER_DATA / "hopper" / "hop.data.gz"
        if path.exists():
            found.append(read_data(path, "hopper"))
        else:
            print(
                f"The hopper is skipped: {path} does not exist; give the file of its particles with "
                "--hopper-data."
            )
    return found


def bed_of(size: int, bed_files: dict[int, Path], folder: Path) -> Case:
    """A bed that is read, settled, or tiled from the largest bed that divides its size."""
    if size in bed_files:
        return read_data(bed_files[size])
    if size in cases.SEED_SIZES:
        return settled_bed(size, folder)
    seeds = [count for count in {*bed_files, *cases.SEED_SIZES} if count < size and size % count == 0]
    if not seeds:
        raise SystemExit(
            f"--sizes {size}: there is no such bed, and it is not a multiple of {min(cases.SEED_SIZES)}."
        )
    return tiled(bed_of(max(seeds), bed_files, folder), size)


def settled_bed(size: int, folder: Path) -> Case:
    """A bed settled by granflow; the result is kept in a file."""
    path = folder / f"settled_{size}.npz"
    if not path.exists():
        print(f"granflow settles a bed of {size} particles ...", flush=True)
        done = codes.child({"job": "settle", "count": size, "path": str(path), "threads": 2}, folder)
        if done.code or not path.exists():
            raise SystemExit(
                f"Settling a bed of {size} particles failed: {codes.last_error_line(done.output)}"
            )
    return Case.load(path)


def jobs(options: argparse.Namespace, found: list[Case], peers: list[str]) -> list[list[Job]]:
    """Groups of jobs to compare, each with one case and one number of threads."""
    return [
        [
            job_for(code, law, case, threads, options.precision, options.skin, options.scale)
            for code, law in codes_and_laws(options, case, peers, threads)
        ]
        for case in found
        for threads in options.threads
    ]


def codes_and_laws(
    options: argparse.Namespace, case: Case, peers: list[str], threads: int
) -> Iterator[tuple[str, str]]:
    """Codes and contact models for one case; the other codes use Hertz-Mindlin."""
    hertz_only = case.kind == "hopper" or case.count >= HERTZ_ONLY_COUNT
    laws = [law for law in options.laws if law == "hertz" or not hertz_only] or options.laws[:1]
    yield from (("granflow", law) for law in laws)
    if options.ranks:
        yield codes.ON_RANKS, laws[0]
    yield from ((peer, "hertz") for peer in peers if case.count <= LARGEST_COUNT.get(peer, case.count))


def skipped_cases(found: list[Case], peers: list[str]) -> list[str]:
    """Messages for the cases that a code skips."""
    return [
        f"{peer} is skipped at {case.count} particles: its setup would take minutes."
        for peer in peers
        for case in found
        if case.count > LARGEST_COUNT.get(peer, case.count)
    ]


def seconds_for(job: Job) -> float:
    """Estimated duration of a job [s]."""
    code = job.code.split()[0]
    fixed, each = START[code]
    work = (job.steps.warm + job.steps.window) * job.case.count
    return fixed + each * job.case.count + work / (RATE[code] * (1.0 + 0.8 * (job.threads - 1)))


def measure_all(
    options: argparse.Namespace, found: list[Case], peers: list[str], folder: Path, out: Path
) -> dict[str, Any]:  # fmt: skip
    """Measures all rounds; writes the results to `out` after each group."""
    groups = jobs(options, found, peers)
    minutes = options.rounds * sum(seconds_for(job) for group in groups for job in group) / 60.0
    print(
        f"{options.rounds} round(s) of {sum(map(len, groups))} measurements: about {minutes:.0f} min.",
        flush=True,
    )
    notes = skipped_cases(found, peers)
    kind = "ranks" if options.ranks else "peers"
    result: dict[str, Any] = {"kind": kind, "machine": machine(), "notes": notes, "points": []}
    folders = {case.name: codes.prepare(case, folder, peers) for case in found}
    for number in range(1, options.rounds + 1):
        for group in groups:
            shift = (number - 1) % len(group)
            for job in group[shift:] + group[:shift]:
                append_measurement(job, number, folders[job.case.name], result)
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_text(json.dumps(result, indent=1) + "\n")
    return result


def append_measurement(job: Job, number: int, case_folder: Path, result: dict[str, Any]) -> None:
    """Appends one measurement to the result; a failed job is noted and not repeated."""
    label = f"{job.code} {job.law}, {job.case.name}, {job.threads} thread(s)"
    if any(note.startswith(f"{label}: ") for note in result["notes"]):
        return
    try:
        point = codes.measure(job, case_folder)
    except Failed as failure:
        result["notes"].append(f"{label}: {failure}")
        print(f"round {number}: {label}: {failure}", flush=True)
        return
    result["points"].append({"round": number, **point})
    print(f"round {number}: {label}: {point['rate'] / 1e6:.2f} M particle-steps/s", flush=True)
