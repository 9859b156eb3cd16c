"""Does granflow compute right on this GPU, and how fast? One call, unattended, into one JSON file.

    python tools/gpu_check.py                          everything on CUDA
    python tools/gpu_check.py --quick                  fewer sizes and shorter windows
    python tools/gpu_check.py --arch cpu --quick       the same script where there is no GPU (ten minutes on two cores)

Where a command may take ten minutes only, in parts:

    python tools/gpu_check.py --part correctness --precisions f64 --minutes 9
    python tools/gpu_check.py --part bench --precisions f64 --minutes 9

Correctness: collisions of every law against closed forms, momentum, the same bits twice, scenes with walls, rain and
friction, and the trajectories of a bed against those of the CPU in f64. Speed: settled beds of 1e4 to 1e7 spheres,
each beside the bandwidth of the device measured in the same process.

Every job is a process of its own; the file is written after each, so that what was measured stays whatever happens.
Exit code 0: all checks passed; 1: some check failed; 2: the device is not there.
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
from gpu import beds, checks, device, speed

CHILDREN: dict[str, Callable[..., Any]] = {
    "present": device.present,
    "settle": beds.relax,
    "collisions": checks.collisions,
    "momentum": checks.momentum,
    "shaken": checks.shaken,
    "scenes": checks.scenes,
    "trajectory": checks.trajectory,
    "measure": speed.measure,
}
PRECISIONS = ("f64", "mixed", "f32")
SIZES = (10_000, 100_000, 1_000_000, 3_000_000, 10_000_000)
QUICK_SIZES = (10_000, 100_000, 1_000_000)
PROFILED_SIZE = 1_000_000
"""The largest bed up to this one is run once more, kernel by kernel."""
MARGIN = 10.0
"""A trajectory may be so many times as far from the CPU's as displacing its start by one rounding puts it."""
LONGEST_JOB = 900.0
"""Seconds; a job that has not ended by then has failed."""
ABSENT = 2
VULKAN_BUFFER = 1 << 32
"""Bytes that a Vulkan buffer can hold; all fields of a run lie in one."""


@dataclass
class Budget:
    """Wall seconds for all of it."""

    seconds: float
    began: float = field(default_factory=time.monotonic)

    @property
    def left(self) -> float:
        """Seconds that remain."""
        return self.seconds - (time.monotonic() - self.began)


class Failed(Exception):
    """A job ended badly; says how."""


@dataclass
class Run:
    """One call: what is asked, the budget, and the result as it grows."""

    options: argparse.Namespace
    folder: Path
    budget: Budget
    result: dict[str, Any]

    @property
    def bed_file(self) -> str:
        """The settled bed, made by the first who asks."""
        path = self.folder / "bed.npz"
        if not path.exists():
            count = beds.SETTLED[self.options.quick]
            print(f"settling {count} spheres on the CPU ...", flush=True)
            self.job("settle", count=count, path=str(path))
        return str(path)

    def job(self, job: str, environment: dict[str, str] | None = None, **order: Any) -> Any:
        """Run a job in a process of its own and give its answer. Raises Failed, also when time is up."""
        limit = min(LONGEST_JOB, self.budget.left)
        if limit <= 0.0:
            raise Failed("no time was left")
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
        """The file as it stands, replaced in one go."""
        path = self.options.out
        path.parent.mkdir(parents=True, exist_ok=True)
        self.result["minutes"] = round((self.budget.seconds - self.budget.left) / 60.0, 2)
        half = path.with_name(path.name + ".part")
        half.write_text(json.dumps(self.result, indent=1) + "\n")
        half.replace(path)

    def leave_out(self, what: str, why: str) -> None:
        """Note and say what was not done."""
        self.result["left_out"].append(f"{what}: {why}")
        print(f"left out: {what}: {why}", flush=True)


# ---------------------------------------------------------------- correctness


def check_all(run: Run) -> None:
    """All checks in every precision."""
    for precision in run.options.precisions:
        check(run, precision, "collisions", lambda p: run.job("collisions", arch=run.options.arch, precision=p))
        check(run, precision, "momentum", lambda p: run.job("momentum", **same(run, p), bed_file=run.bed_file))
        check(run, precision, "shaken box", lambda p: shaken_twice(run, p))
        check(run, precision, "scenes", lambda p: run.job("scenes", arch=run.options.arch, precision=p))
        check(run, precision, "agreement with the CPU", lambda p: agreement(run, p))


def check(run: Run, precision: str, group: str, records: Callable[[str], list[dict[str, Any]]]) -> None:
    """One group of checks; a job that fails is a check that failed."""
    began = time.monotonic()
    try:
        found = records(precision)
    except Failed as failure:
        found = [{"name": f"{group} did not run", "value": None, "limit": None, "passed": False, "said": str(failure)}]
    run.result["checks"] += [{"group": group, "precision": precision, **each} for each in found]
    run.write()
    bad = [each for each in found if not each["passed"]]
    print(f"{precision:>5} {group}: {len(found) - len(bad)} of {len(found)} passed, {time.monotonic() - began:.0f} s")
    for each in bad:
        message = f" ({each['said']})" if "said" in each else ""
        print(f"      FAILED {each['name']}: {each['value']} against {each['limit']}{message}")
    sys.stdout.flush()


def same(run: Run, precision: str) -> dict[str, Any]:
    """Architecture and precision, as jobs take them."""
    return {"arch": run.options.arch, "precision": precision}


def shaken_twice(run: Run, precision: str) -> list[dict[str, Any]]:
    """The shaken box in two processes: its checks, and whether both left the same bits."""
    one, two = (run.job("shaken", **same(run, precision)) for _ in range(2))
    return [*one["checks"], checks.record("second run has other bits", one["digest"] != two["digest"], 0.0)]


def agreement(run: Run, precision: str) -> list[dict[str, Any]]:
    """A stirred bed here against the CPU in f64, and against what a displaced start does there."""
    moved = checks.displacement(precision, run.bed_file)
    here, reference, disturbed = (run.folder / f"{name}.npz" for name in (f"here-{precision}", "cpu", f"moved-{moved}"))
    common: dict[str, Any] = {"bed_file": run.bed_file}
    if not reference.exists():
        run.job("trajectory", arch="cpu", precision="f64", out=str(reference), moved=0.0, chunk_size=None, **common)
    run.job("trajectory", arch="cpu", precision="f64", out=str(disturbed), moved=moved, chunk_size=None, **common)
    run.job("trajectory", **same(run, precision), out=str(here), moved=0.0, chunk_size=1, **common)
    return checks.agreement(here, reference, disturbed, MARGIN)


# ---------------------------------------------------------------- speed


def bench_all(run: Run) -> None:
    """Beds from small to large, each in every precision; then one with seconds of every kernel."""
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
    """One point, unless memory or time would not do; `spent` holds size and seconds of the last point by precision."""
    what = f"{size} spheres in {precision}" + (" by kernel" if environment else "")
    try:
        why = too_large(run, size, precision) or too_long(run, size, spent.get(precision))
        if why:
            return run.leave_out(what, why)
        began = time.monotonic()
        order = {"bed_file": run.bed_file, "count": size, "seconds": run.options.seconds}
        point = run.job("measure", environment, **same(run, precision), **order)
    except Failed as failure:
        return run.leave_out(what, str(failure))
    spent[precision] = (size, time.monotonic() - began)
    run.result["profiles" if environment else "points"].append({"precision": precision, **point})
    run.write()
    print(line(precision, point) + (" (profiled)" if environment else ""), flush=True)


def too_large(run: Run, size: int, precision: str) -> str | None:
    """Why a bed does not fit the free memory of the device, if it does not."""
    free = run.result["device"]["memory_free"]
    needed = speed.bytes_needed(run.bed_file, size, precision, run.options.arch != "cpu")
    if run.options.arch == "vulkan" and needed > VULKAN_BUFFER:
        return f"fields of {needed / 1e9:.1f} GB are more than a Vulkan buffer of {VULKAN_BUFFER / 1e9:.1f} GB can hold"
    if free is None or needed <= speed.ROOM * free:
        return None
    return f"fields of {needed / 1e9:.1f} GB are more than {speed.ROOM:.0%} of the {free / 1e9:.1f} GB free"


def too_long(run: Run, size: int, last: tuple[int, float] | None) -> str | None:
    """Why a point does not fit what is left of the time, going by the last one, if it does not."""
    window = run.options.seconds
    expected = window if last is None else window + max(last[1] - window, 0.0) * size / last[0]
    if expected <= run.budget.left:
        return None
    return f"about {expected:.0f} s are needed, {max(run.budget.left, 0.0):.0f} s of --minutes are left"


def line(precision: str, point: dict[str, Any]) -> str:
    """One point for people."""
    return (
        f"{point['count']:>9} {precision:>5}: {1e-6 * point['rate']:8.2f} M particle-steps/s, "
        f"{point['bandwidth_share']:5.1%} of {1e-9 * point['copy_bandwidth']:.0f} GB/s, "
        f"{point['bytes_per_particle_step']:.0f} bytes/step, {point['coordination_number']:.2f} neighbors in contact, "
        f"search {1e3 * point['search_seconds']:.1f} ms"
    )


# ---------------------------------------------------------------- command line


def main() -> int:
    """Do what the command line asks; returns the exit code."""
    if sys.argv[1:2] == ["--child"]:
        order = json.loads(sys.argv[2])
        answer = CHILDREN[order.pop("job")](**order)
        print()
        print(json.dumps(answer))
        return 0
    options = arguments()
    with tempfile.TemporaryDirectory() as folder:
        result: dict[str, Any] = {"kind": "gpu_check", "arch": options.arch, "machine": machine(), "finished": False}
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
    """Both parts, or the one asked for; 1 where a check failed."""
    held = run.result["device"]
    print(f"{run.options.arch}: {held['name']}, driver {held['driver']}; results in {run.options.out}", flush=True)
    run.write()
    try:
        if run.options.part != "bench":
            check_all(run)
        if run.options.part != "correctness":
            bench_all(run)
    except Failed as failure:
        run.leave_out("the rest", f"no bed could be settled: {failure}")
        run.result["checks"].append({"name": "settled bed", "passed": False, "said": str(failure)})
    failed = sum(not each["passed"] for each in run.result["checks"])
    run.result["finished"] = True
    run.write()
    print(f"{len(run.result['checks']) - failed} checks passed, {failed} failed. Written: {run.options.out}")
    return 1 if failed else 0


def arguments() -> argparse.Namespace:
    """The command line; --quick sets what is not given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--arch", choices=("cuda", "vulkan", "cpu"), default="cuda", help="where to compute (cuda)")
    add("--part", choices=("correctness", "bench", "all"), default="all", help="what to do (all)")
    add("--quick", action="store_true", help="smaller beds, shorter windows")
    add("--sizes", type=spheres, nargs="+", help=f"spheres in a bed ({' '.join(map(str, SIZES))})")
    add("--precisions", choices=PRECISIONS, nargs="+", help="all; on Vulkan f32 alone, as it has no reliable f64")
    add("--minutes", type=float, default=60.0, help="stop after so many minutes (60)")
    add("--seconds", type=float, help="clocked seconds of each bed (6)")
    add("--out", type=Path, metavar="FILE.json", help="where the results go (out/gpu_check-ARCH-DATE-TIME.json)")
    options = parser.parse_args()
    precisions = ["f32"] if options.arch == "vulkan" else list(PRECISIONS)
    usual = {"sizes": list(SIZES), "precisions": precisions, "seconds": 6.0}
    usual["out"] = Path("out") / f"gpu_check-{options.arch}-{datetime.now():%Y-%m-%d-%H%M}.json"
    for key, value in (usual | ({"sizes": list(QUICK_SIZES), "seconds": 2.0} if options.quick else {})).items():
        if getattr(options, key) is None:
            setattr(options, key, value)
    return options


def spheres(text: str) -> int:
    """A whole number, as 10000 or 1e4."""
    try:
        count = int(float(text))
    except ValueError:
        count = 0
    if count < 1:
        raise argparse.ArgumentTypeError(f"{text} is given, but a number of spheres from 1 is asked here")
    return count


if __name__ == "__main__":
    sys.exit(main())
