"""Correctness checks and benchmark of granflow on a GPU: one unattended call, results in one JSON file.

    python tools/gpu_check.py                          everything on CUDA
    python tools/gpu_check.py --quick                  fewer sizes and shorter time windows
    python tools/gpu_check.py --arch cpu --quick       the same on the CPU (ten minutes on two cores)

If a command may take at most ten minutes, run it in parts:

    python tools/gpu_check.py --part correctness --precisions f64 --minutes 9
    python tools/gpu_check.py --part bench --precisions f64 --minutes 9

Correctness: collisions with all contact models against closed forms, momentum, bitwise reproducibility,
scenes with walls, rain and friction, and trajectories of a bed against those of the CPU in f64. Speed:
settled beds of 1e4 to 1e7 particles, and the memory bandwidth of the device measured in the same process.

Each job runs in a separate process; the file is written after each job, so that results are kept if a later
job fails. Exit code 0: all checks passed; 1: a check failed; 2: the device is not available.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from benchmark.machine import machine
from benchmark.phases import PROFILER
from gpu_checks import beds, checks, device, speed

CHILDREN: dict[str, Callable[..., Any]] = {
    "present": device.present,
    "settle": beds.relax,
    "collisions": checks.collisions,
    "momentum": checks.momentum,
    "vibrated box": checks.vibrated_box,
    "scenes": checks.scenes,
    "trajectory": checks.trajectory,
    "measure": speed.measure,
}
PRECISIONS = ("f64", "mixed", "f32")
SIZES = (10_000, 100_000, 1_000_000, 3_000_000, 10_000_000)
QUICK_SIZES = (10_000, 100_000, 1_000_000)
PROFILED_SIZE = 1_000_000
"""The largest bed of at most this size is also run with the kernel profiler."""
MARGIN = 10.0
"""Largest deviation from the trajectory of the CPU, in deviations caused by initial displacements of one
rounding."""
LONGEST_JOB = 900.0
"""Time limit of a job [s]."""
ABSENT = 2


@dataclass
class Budget:
    """Wall-clock time [s] for the whole call."""

    seconds: float
    began: float = field(default_factory=time.monotonic)

    @property
    def left(self) -> float:
        """Remaining time [s]."""
        return self.seconds - (time.monotonic() - self.began)


class Failed(Exception):
    """A job failed; the message is the reason."""


@dataclass
class Run:
    """One call: its options, time budget and results."""

    options: argparse.Namespace
    folder: Path
    budget: Budget
    result: dict[str, Any]

    @property
    def bed_file(self) -> str:
        """File of the settled bed, made at the first access."""
        path = self.folder / "bed.npz"
        if not path.exists():
            count = beds.SETTLED[self.options.quick]
            print(f"settling {count} spheres on the CPU ...", flush=True)
            self.job("settle", count=count, path=str(path))
        return str(path)

    def job(self, job: str, environment: dict[str, str] | None = None, **order: Any) -> Any:
        """Runs a job in a separate process and returns its answer. Raises Failed if it fails or exceeds the
        time."""
        limit = min(LONGEST_JOB, self.budget.left)
        if limit <= 0.0:
            raise Failed("no time is left")
        command = [sys.executable, __file__, "--child", json.dumps({"job": job, **order})]
        try:
            done = subprocess.run(
                command, env=os.environ | (environment or {}), capture_output=True, text=True, timeout=limit
            )
        except subprocess.TimeoutExpired:
            raise Failed(f"it did not end within {limit:.0f} s") from None
        if done.returncode:
            lines = [line for line in (done.stderr + done.stdout).splitlines() if line.strip()]
            raise Failed(f"it ended with code {done.returncode}: {' | '.join(lines[-3:])[-600:]}")
        return json.loads(done.stdout.splitlines()[-1])

    def write(self) -> None:
        """Writes the results; replaces the file atomically."""
        path = self.options.out
        path.parent.mkdir(parents=True, exist_ok=True)
        self.result["minutes"] = round((self.budget.seconds - self.budget.left) / 60.0, 2)
        temporary = path.with_name(path.name + ".part")
        temporary.write_text(json.dumps(self.result, indent=1) + "\n")
        temporary.replace(path)

    def leave_out(self, what: str, why: str) -> None:
        """Records and prints a skipped measurement."""
        self.result["left_out"].append(f"{what}: {why}")
        print(f"skipped: {what}: {why}", flush=True)


# ---------------------------------------------------------------- correctness


def check_all(run: Run) -> None:
    """Runs all checks in each precision."""
    for precision in run.options.precisions:
        check(
            run, precision, "collisions", lambda p: run.job("collisions", arch=run.options.arch, precision=p)
        )
        check(
            run,
            precision,
            "momentum",
            lambda p: run.job("momentum", **job_arguments(run, p), bed_file=run.bed_file),
        )
        check(run, precision, "vibrated box", lambda p: vibrated_box_twice(run, p))
        check(run, precision, "scenes", lambda p: run.job("scenes", arch=run.options.arch, precision=p))
        check(run, precision, "agreement with the CPU", lambda p: agreement(run, p))


def check(run: Run, precision: str, group: str, records: Callable[[str], list[dict[str, Any]]]) -> None:
    """Runs one group of checks; a failed job counts as a failed check."""
    began = time.monotonic()
    try:
        found = records(precision)
    except Failed as failure:
        found = [
            {
                "name": f"{group} did not run",
                "value": None,
                "limit": None,
                "passed": False,
                "message": str(failure),
            }
        ]
    run.result["checks"] += [{"group": group, "precision": precision, **each} for each in found]
    run.write()
    failed = [each for each in found if not each["passed"]]
    print(
        f"{precision:>5} {group}: {len(found) - len(failed)} of {len(found)} passed, "
        f"{time.monotonic() - began:.0f} s"
    )
    for each in failed:
        message = f" ({each['message']})" if "message" in each else ""
        print(f"      FAILED {each['name']}: {each['value']}, limit {each['limit']}{message}")
    sys.stdout.flush()


def job_arguments(run: Run, precision: str) -> dict[str, Any]:
    """Architecture and precision as arguments of a job."""
    return {"arch": run.options.arch, "precision": precision}


def vibrated_box_twice(run: Run, precision: str) -> list[dict[str, Any]]:
    """Checks of the vibrated box in two processes, and bitwise comparison of their results."""
    one, two = (run.job("vibrated box", **job_arguments(run, precision)) for _ in range(2))
    return [*one["checks"], checks.record("second run differs", one["digest"] != two["digest"], 0.0)]


def agreement(run: Run, precision: str) -> list[dict[str, Any]]:
    """Compares an agitated bed with the CPU in f64; the tolerance follows from a displaced initial state."""
    moved = checks.displacement(precision, run.bed_file)
    here, reference, disturbed = (
        run.folder / f"{name}.npz" for name in (f"here-{precision}", "cpu", f"moved-{moved}")
    )
    common: dict[str, Any] = {"bed_file": run.bed_file}
    if not reference.exists():
        run.job(
            "trajectory",
            arch="cpu",
            precision="f64",
            out=str(reference),
            moved=0.0,
            chunk_size=None,
            **common,
        )
    run.job(
        "trajectory", arch="cpu", precision="f64", out=str(disturbed), moved=moved, chunk_size=None, **common
    )
    run.job("trajectory", **job_arguments(run, precision), out=str(here), moved=0.0, chunk_size=1, **common)
    return checks.agreement(here, reference, disturbed, MARGIN)


# ---------------------------------------------------------------- speed


def bench_all(run: Run) -> None:
    """Benchmarks the beds by increasing size in each precision, then one bed with the kernel profiler."""
    spent: dict[str, tuple[int, float]] = {}
    for size in sorted(run.options.sizes):
        for precision in run.options.precisions:
            bench(run, size, precision, spent)
    size = max((each for each in run.options.sizes if each <= PROFILED_SIZE), default=min(run.options.sizes))
    for precision in run.options.precisions:
        bench(run, size, precision, {}, {PROFILER: "1"})


def bench(
    run: Run,
    size: int,
    precision: str,
    spent: dict[str, tuple[int, float]],
    environment: dict[str, str] | None = None,
) -> None:
    """Benchmarks one bed if memory and time suffice; `spent`: size and time [s] of the last bed by
    precision."""
    what = f"{size} particles in {precision}" + (" by kernel" if environment else "")
    try:
        why = exceeds_memory(run, size, precision) or exceeds_time(run, size, spent.get(precision))
        if why:
            return run.leave_out(what, why)
        began = time.monotonic()
        order = {"bed_file": run.bed_file, "count": size, "seconds": run.options.seconds}
        point = run.job("measure", environment, **job_arguments(run, precision), **order)
    except Failed as failure:
        return run.leave_out(what, str(failure))
    spent[precision] = (size, time.monotonic() - began)
    run.result["profiles" if environment else "points"].append({"precision": precision, **point})
    run.write()
    print(line(precision, point) + (" (profiled)" if environment else ""), flush=True)


def exceeds_memory(run: Run, size: int, precision: str) -> str | None:
    """Message if the bed exceeds the free memory of the device, else None."""
    free = run.result["device"]["memory_free"]
    largest = run.result["device"]["largest_buffer"]
    needed, longest = speed.bytes_needed(run.bed_file, size, precision, run.options.arch != "cpu")
    if largest is not None and longest > largest:
        return f"a field of {longest / 1e9:.1f} GB exceeds the largest buffer of {largest / 1e9:.1f} GB"
    if free is None or needed <= speed.MEMORY_SHARE * free:
        return None
    return f"fields of {needed / 1e9:.1f} GB exceed {speed.MEMORY_SHARE:.0%} of the free {free / 1e9:.1f} GB"


def exceeds_time(run: Run, size: int, last: tuple[int, float] | None) -> str | None:
    """Message if the measurement, extrapolated from the last one, exceeds the remaining time, else None."""
    window = run.options.seconds
    expected = window if last is None else window + max(last[1] - window, 0.0) * size / last[0]
    if expected <= run.budget.left:
        return None
    return f"requires about {expected:.0f} s, but {max(run.budget.left, 0.0):.0f} s of --minutes are left"


def line(precision: str, point: dict[str, Any]) -> str:
    """One measurement as a line of text."""
    return (
        f"{point['count']:>9} {precision:>5}: {1e-6 * point['rate']:8.2f} M particle-steps/s, "
        f"{point['bandwidth_share']:5.1%} of {1e-9 * point['copy_bandwidth']:.0f} GB/s, "
        f"{point['bytes_per_particle_step']:.0f} bytes/step, {point['coordination_number']:.2f} neighbors in "
        f"contact, rebuild {1e3 * point['search_seconds']:.1f} ms"
    )


# ---------------------------------------------------------------- command line


def main() -> int:
    """Runs the checks and benchmarks that the command line selects; returns the exit code."""
    if sys.argv[1:2] == ["--child"]:
        order = json.loads(sys.argv[2])
        answer = CHILDREN[order.pop("job")](**order)
        print()
        print(json.dumps(answer))
        return 0
    options = arguments()
    with tempfile.TemporaryDirectory() as folder:
        result: dict[str, Any] = {
            "kind": "gpu_check",
            "arch": options.arch,
            "machine": machine(),
            "finished": False,
        }
        result |= {"command": sys.argv[1:], "checks": [], "points": [], "profiles": [], "left_out": []}
        run = Run(options, Path(folder), Budget(60.0 * options.minutes), result)
        try:
            result["device"] = run.job("present", arch=options.arch)
        except Failed as failure:
            result["device"] = {"absent": f"{options.arch} could not be started: {failure}."}
        if "absent" in result["device"]:
            print(result["device"]["absent"], file=sys.stderr)
            return ABSENT
        return carry_out(run)


def carry_out(run: Run) -> int:
    """Runs both parts or the requested one; returns 1 if a check failed."""
    device = run.result["device"]
    print(
        f"{run.options.arch}: {device['name']}, driver {device['driver']}; results in {run.options.out}",
        flush=True,
    )
    run.write()
    try:
        if run.options.part != "bench":
            check_all(run)
        if run.options.part != "correctness":
            bench_all(run)
    except Failed as failure:
        run.leave_out("all further jobs", f"no bed could be settled: {failure}")
        run.result["checks"].append({"name": "settled bed", "passed": False, "message": str(failure)})
    failed = sum(not each["passed"] for each in run.result["checks"])
    run.result["finished"] = True
    run.write()
    print(f"{len(run.result['checks']) - failed} checks passed, {failed} failed. Written: {run.options.out}")
    return 1 if failed else 0


def arguments() -> argparse.Namespace:
    """Parsed command line; --quick changes the defaults."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--arch", choices=("cuda", "vulkan", "cpu"), default="cuda", help="architecture (cuda)")
    add("--part", choices=("correctness", "bench", "all"), default="all", help="part to run (all)")
    add("--quick", action="store_true", help="smaller beds, shorter time windows")
    add("--sizes", type=particle_count, nargs="+", help=f"particles in a bed ({' '.join(map(str, SIZES))})")
    add(
        "--precisions",
        choices=PRECISIONS,
        nargs="+",
        help="precisions (all)",
    )
    add("--minutes", type=float, default=60.0, help="time budget in minutes (60)")
    add("--seconds", type=float, help="measured time of each bed in s (6)")
    add(
        "--out",
        type=Path,
        metavar="FILE.json",
        help="file of the results (out/gpu_check-ARCH-DATE-TIME.json)",
    )
    options = parser.parse_args()
    defaults = {"sizes": list(SIZES), "precisions": list(PRECISIONS), "seconds": 6.0}
    defaults["out"] = Path("out") / f"gpu_check-{options.arch}-{datetime.now():%Y-%m-%d-%H%M}.json"
    for key, value in (
        defaults | ({"sizes": list(QUICK_SIZES), "seconds": 2.0} if options.quick else {})
    ).items():
        if getattr(options, key) is None:
            setattr(options, key, value)
    return options


def particle_count(text: str) -> int:
    """A particle count, as 10000 or 1e4."""
    try:
        count = int(float(text))
    except ValueError:
        count = 0
    if count < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a particle count of at least 1")
    return count


if __name__ == "__main__":
    sys.exit(main())
