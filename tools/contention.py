"""Steps per second of a bed under contention: other processes use the cores.

    python tools/contention.py --bed BED.npz                      0 to 4 competing processes
    python tools/contention.py --bed BED.npz --root CHECKOUT      the same with another checkout of granflow
    python tools/contention.py --size 3000                        settle a bed first

Columns: `fixed 1` and `fixed 2` use a constant number of workers, `auto` is a run without --threads. Rows:
the number of competing processes; `pair` is the slower of two simultaneous runs, `one core` a run on one
core. Each rate is measured over two seconds, after a warm-up of one second.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
BUSY = "import sys\nwhile True: sum(range(100_000))"
CHILD = (
    "import json, sys; sys.path[:0] = json.loads(sys.argv[1]); import contention; "
    "contention.child(*sys.argv[2:])"
)
WARM_UP, MEASURED = 1.0, 2.0  # s
MODES = ("fixed 1", "fixed 2", "auto")


def child(bed: str, mode: str) -> None:
    """Measures one rate [steps/s] and prints it as JSON."""
    import time

    from benchmark import ours
    from benchmark.cases import Case

    fixed = int(mode.split()[1]) if mode.startswith("fixed") else 0
    threads: Any = fixed or None
    engine = ours.engine_for(Case.load(Path(bed)), "hertz", "f64", threads, "0.2 mm")
    if fixed:
        fix_worker_count(engine.stepper, fixed)
    engine.advance(1)
    rates = []
    for seconds in (WARM_UP, MEASURED):
        began = time.perf_counter()
        before = engine.step_count
        while time.perf_counter() - began < seconds:
            engine.advance(5)
        rates.append((engine.step_count - before) / (time.perf_counter() - began))
    print("\n" + json.dumps(rates[-1]))


def fix_worker_count(stepper: Any, workers: int) -> None:
    """Replaces the worker tuner of a stepper by a constant number of workers."""

    class FixedWorkers:
        size = next_size = workers

        def record(self, *_: Any) -> None:
            """Ignores the measurement."""

    stepper._workers._tuner = FixedWorkers()


def started(bed: Path, mode: str, root: Path, command: tuple[str, ...] = ()) -> subprocess.Popen[str]:
    """Starts a process that measures one rate with the granflow of a checkout."""
    paths = json.dumps([str(root), str(HERE)])
    command_line = [*command, sys.executable, "-c", CHILD, paths, str(bed), mode]
    return subprocess.Popen(command_line, stdout=subprocess.PIPE, text=True, cwd=root)


def rate(process: "subprocess.Popen[str]") -> float:
    """Rate [steps/s] measured by a process."""
    output, _ = process.communicate(timeout=300)
    if process.returncode:
        raise SystemExit("A measurement failed; see its message above.")
    return float(json.loads(output.splitlines()[-1]))


def with_competitors(count: int, bed: Path, mode: str, root: Path) -> float:
    """Rate [steps/s] with `count` competing processes that use their cores without pause."""
    busy = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(count)]
    try:
        return rate(started(bed, mode, root))
    finally:
        for process in busy:
            process.kill()
            process.wait()


def measure(bed: Path, root: Path, counts: list[int], rounds: int) -> dict[str, dict[str, float]]:
    """Rates [steps/s] by row and mode, averaged over the rounds."""
    found: dict[str, dict[str, list[float]]] = {}
    for _ in range(rounds):
        for mode in MODES:
            for count in counts:
                rates = found.setdefault(f"{count} competitors", {}).setdefault(mode, [])
                rates.append(with_competitors(count, bed, mode, root))
            pair = [started(bed, mode, root) for _ in range(2)]
            found.setdefault("pair", {}).setdefault(mode, []).append(min(rate(each) for each in pair))
            if hasattr(os, "sched_setaffinity") and mode != "fixed 2":  # one core has one worker
                alone = rate(started(bed, mode, root, ("taskset", "-c", "0")))
                found.setdefault("one core", {}).setdefault(mode, []).append(alone)
    return {row: {mode: sum(r) / len(r) for mode, r in modes.items()} for row, modes in found.items()}


def table(found: dict[str, dict[str, float]]) -> str:
    """Table of the rates, with the ratio of `auto` to the best fixed number of workers."""
    lines = [f"{'steps/s':16}" + "".join(f"{mode:>10}" for mode in MODES) + f"{'auto/best':>11}"]
    for row, rates in found.items():
        best = max(value for mode, value in rates.items() if mode != "auto")
        numbers = "".join(f"{rates[mode]:10.0f}" if mode in rates else f"{'-':>10}" for mode in MODES)
        lines.append(f"{row:16}{numbers}{rates['auto'] / best:11.2f}")
    return "\n".join(lines)


def main() -> None:
    """Measures the rates and prints the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--bed", type=Path, metavar="FILE", help="a settled bed (npz)")
    add("--size", type=int, default=3_000, help="particles of the bed to settle without --bed (3000)")
    add("--root", type=Path, default=HERE.parent, help="checkout to measure (this one)")
    add("--competitors", type=int, nargs="+", default=[0, 1, 2, 3, 4], help="competing processes (0 1 2 3 4)")
    add("--rounds", type=int, default=1, help="repetitions (1)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bed = options.bed or Path(folder) / "bed.npz"
        if options.bed is None:
            from benchmark import ours

            ours.relax(options.size, str(bed), len(os.sched_getaffinity(0)))
        print(table(measure(bed.resolve(), options.root.resolve(), options.competitors, options.rounds)))


if __name__ == "__main__":
    main()
