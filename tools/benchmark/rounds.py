"""All codes in turn, round after round: what is run, on what, in which order."""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmark import cases, codes
from benchmark.cases import Case, find_beds, read_data, tiled
from benchmark.codes import LARGEST, Failed, Job, job_for
from benchmark.machine import ROOT, machine

SHARED_EDGE = ROOT.parent / "shared" / "peers"
HERTZ_ONLY_FROM = 1_000_000
"""Spheres from which granflow is measured with the law of the comparison alone, to save time."""
START = {"granflow": (4.0, 6e-6), "liggghts": (0.5, 1e-5), "lammps": (0.5, 8e-6), "yade": (1.5, 1e-4)}
"""Seconds to begin and end, and seconds for each sphere beside: for the estimate alone."""
RATE = {"granflow": 7e6, "liggghts": 4e6, "lammps": 4e6, "yade": 5e5}
"""Particle-steps per second of one thread: for the estimate alone."""


def gather_cases(options: argparse.Namespace, folder: Path) -> list[Case]:
    """The beds of the sizes asked and the hopper; what no folder of beds holds is settled or tiled."""
    beds = options.beds or (SHARED_EDGE / "beds" if (SHARED_EDGE / "beds").is_dir() else None)
    at_hand = {} if beds is None else find_beds(beds)
    found = [bed_of(size, at_hand, folder) for size in options.sizes]
    if options.hopper:
        path = options.hopper_data or SHARED_EDGE / "hopper" / "hop.data.gz"
        if path.exists():
            found.append(read_data(path, "hopper"))
        else:
            print(f"The hopper is left out: {path} is not there; name its spheres with --hopper-data.")
    return found


def bed_of(size: int, at_hand: dict[int, Path], folder: Path) -> Case:
    """A bed read, settled, or tiled from the largest one whose multiple it is."""
    if size in at_hand:
        return read_data(at_hand[size])
    if size in cases.SEED_SIZES:
        return relaxed(size, folder)
    seeds = [count for count in {*at_hand, *cases.SEED_SIZES} if count < size and size % count == 0]
    if not seeds:
        raise SystemExit(f"--sizes {size} is neither there as a bed nor a multiple of {min(cases.SEED_SIZES)}.")
    return tiled(bed_of(max(seeds), at_hand, folder), size)


def relaxed(size: int, folder: Path) -> Case:
    """A bed that granflow lets settle, once."""
    path = folder / f"settled_{size}.npz"
    if not path.exists():
        print(f"granflow settles a bed of {size} spheres ...", flush=True)
        done = codes.child({"job": "settle", "count": size, "path": str(path), "threads": 2}, folder)
        if done.code or not path.exists():
            raise SystemExit(f"Settling a bed of {size} spheres failed: {codes.last_words(done.output)}")
    return Case.load(path)


def jobs(options: argparse.Namespace, found: list[Case], peers: list[str]) -> list[list[Job]]:
    """Groups of jobs that are measured side by side: one case on one number of threads."""
    return [
        [
            job_for(code, law, case, threads, options.precision, options.skin, options.scale)
            for code, law in contenders(options, case, peers)
        ]
        for case in found
        for threads in options.threads
    ]


def contenders(options: argparse.Namespace, case: Case, peers: list[str]) -> Iterator[tuple[str, str]]:
    """Codes and laws for one case; the comparison is Hertz-Mindlin."""
    few = case.kind == "hopper" or case.count >= HERTZ_ONLY_FROM
    laws = [law for law in options.laws if law == "hertz" or not few] or options.laws[:1]
    yield from (("granflow", law) for law in laws)
    yield from ((peer, "hertz") for peer in peers if case.count <= LARGEST.get(peer, case.count))


def left_out(found: list[Case], peers: list[str]) -> list[str]:
    """Sentences on codes that are not run on some cases."""
    return [
        f"{peer} is left out at {case.count} spheres: setting up alone would take minutes."
        for peer in peers
        for case in found
        if case.count > LARGEST.get(peer, case.count)
    ]


def seconds_for(job: Job) -> float:
    """A guess at how long a job takes."""
    fixed, each = START[job.code]
    work = (job.steps.warm + job.steps.window) * job.case.count
    return fixed + each * job.case.count + work / (RATE[job.code] * (1.0 + 0.8 * (job.threads - 1)))


def measure_all(
    options: argparse.Namespace, found: list[Case], peers: list[str], folder: Path, out: Path
) -> dict[str, Any]:  # fmt: skip
    """Every round, written to `out` after every group so that nothing is lost."""
    groups = jobs(options, found, peers)
    minutes = options.rounds * sum(seconds_for(job) for group in groups for job in group) / 60.0
    print(f"{options.rounds} round(s) of {sum(map(len, groups))} measurements: about {minutes:.0f} min.", flush=True)
    notes = left_out(found, peers)
    result: dict[str, Any] = {"kind": "peers", "machine": machine(), "notes": notes, "points": []}
    places = {case.name: codes.prepare(case, folder, peers) for case in found}
    for number in range(1, options.rounds + 1):
        for group in groups:
            shift = (number - 1) % len(group)
            for job in group[shift:] + group[:shift]:
                measured(job, number, places[job.case.name], result)
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_text(json.dumps(result, indent=1) + "\n")
    return result


def measured(job: Job, number: int, place: Path, result: dict[str, Any]) -> None:
    """One point, entered with its round; a code that fails leaves a note and is not tried again."""
    label = f"{job.code} {job.law}, {job.case.name}, {job.threads} thread(s)"
    if any(note.startswith(f"{label}: ") for note in result["notes"]):
        return
    try:
        point = codes.measure(job, place)
    except Failed as failure:
        result["notes"].append(f"{label}: {failure}")
        print(f"round {number}: {label}: {failure}", flush=True)
        return
    result["points"].append({"round": number, **point})
    print(f"round {number}: {label}: {point['rate'] / 1e6:.2f} M particle-steps/s", flush=True)
