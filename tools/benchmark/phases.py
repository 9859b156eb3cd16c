"""Where granflow's time goes: each phase and kernel against the machine's measured limits."""

import argparse
import os
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmark import codes, counts, ours
from benchmark.cases import Case, steps_for
from benchmark.machine import last_level_cache, machine

PROFILER = "TI_KERNEL_PROFILER"
SEARCHES = 5
LEAST_STEPS = 1024
"""So many steps give the stepper's sampling of phases a few samples."""
HEAD = (
    f"{'case':<12} {'law':<7} threads  {'phase':<7} {'us/step':>9} {'MB':>7} {'GB/s':>6} {'Gop/s':>6} "
    f"{'bytes alone':>12} {'arithmetic alone':>17}  bound reached"
)


def limits(threads: int) -> dict[str, float]:
    """Job of a child: what the machine can do."""
    from benchmark.limits import measure as measure_limits

    return measure_limits(threads)


def measure(
    path: str, law: str, precision: str, threads: int, skin: str, warm: int, window: int
) -> dict[str, Any]:  # fmt: skip
    """Job of a child: seconds of each phase, and of each kernel where the profiler was asked for."""
    engine = ours.engine_for(Case.load(Path(path)), law, precision, threads, skin)
    engine.advance(warm)
    clear_profile()
    before, searches = phase_seconds(engine), engine.timing.rebuild_count
    engine.advance(window)
    after, searches = phase_seconds(engine), engine.timing.rebuild_count - searches
    stepping = profile(window)
    searching = [one_search(engine) for _ in range(SEARCHES)]
    searched = profile(SEARCHES)
    seconds = {name: (after[name] - before[name]) / window for name in after}
    list_entries, touching = neighbors_of(engine)
    load = counts.load_of(engine.state, list_entries, touching)
    moved, operations = counts.bytes_of(load), counts.operations_of(load)
    return {
        "seconds": seconds | {"search": median(searching)},
        "steps_per_search": window / searches if searches else None,
        "bytes": moved,
        "operations": {name: vars(each) for name, each in operations.items()},
        "slots": list_entries / load.particles,
        "touching": touching / load.particles,
        "working_set": ours.field_bytes(engine),
        "kernels": {"step": stepping, "search": searched},
    }


def phase_seconds(engine: Any) -> dict[str, float]:
    """Wall seconds so far."""
    timing = engine.timing
    return {"motion": timing.integration, "forces": timing.forces}


def one_search(engine: Any) -> float:
    """Seconds of a search."""
    began = engine.timing.neighbor_list
    engine.stepper.rebuild_neighbor_lists()
    return engine.timing.neighbor_list - began


def neighbors_of(engine: Any) -> tuple[int, int]:
    """Near pairs in all rows, walls and pairs that stand twice included, and how many of them touch."""
    contacts, particles, count = engine.state.neighbors, engine.state.particles, engine.state.count
    begin, end = (field.to_numpy()[:count] for field in (contacts.list_begin, contacts.list_end))
    number = end - begin
    row = np.repeat(np.arange(count), number)
    list_index = np.arange(number.sum()) - np.repeat(np.cumsum(number) - number, number) + np.repeat(begin, number)
    partner = contacts.partner.to_numpy()[list_index]
    owners = partner >= 0
    position, radius = particles.position.to_numpy()[:count], particles.radius.to_numpy()[:count]
    i, j = row[owners], partner[owners]
    apart = np.linalg.norm(position[i] - position[j], axis=1)
    return len(list_index), int((apart < radius[i] + radius[j]).sum())


def clear_profile() -> None:
    """Forget what the profiler has seen so far."""
    if PROFILER in os.environ:
        import taichi as ti

        ti.profiler.clear_kernel_profiler_info()


def profile(times: int) -> dict[str, float]:
    """Seconds of every kernel since the last look, by its name, over `times`; empty without the profiler."""
    if PROFILER not in os.environ:
        return {}
    from taichi.lang import impl

    program = impl.get_runtime().prog
    program.sync_kernel_profiler()
    program.update_kernel_profiler()
    found: dict[str, float] = {}
    for record in program.get_kernel_profiler_records():
        found[record.name] = found.get(record.name, 0.0) + 1e-3 * record.kernel_time / times
    clear_profile()
    return found


def measure_all(options: argparse.Namespace, found: list[Case], folder: Path) -> dict[str, Any]:
    """Limits once for each number of threads, then every case and law; kernels in a run of their own."""
    result: dict[str, Any] = {"kind": "phases", "machine": machine(), "limits": [], "points": []}
    for threads in options.threads:
        done = codes.child({"job": "limits", "threads": threads}, folder)
        result["limits"].append(codes.last_json(done, "The measurement of limits"))
    for case in found:
        place = codes.prepare(case, folder, [])
        for law in options.laws:
            for threads in options.threads:
                job = codes.job_for("granflow", law, case, threads, options.precision, options.skin, options.scale)
                result["points"].append(point(job, place))
                print(f"{case.name}, {law}, {threads} thread(s): measured", flush=True)
    return result


def point(job: codes.Job, place: Path) -> dict[str, Any]:
    """Phases from an undisturbed run, kernels from one under the profiler."""
    steps = steps_for(job.case, False, 1.0)
    window = max(steps.window, LEAST_STEPS if job.case.count <= 50_000 else steps.window)
    order: dict[str, Any] = {
        "job": "phases",
        "path": str(place / "case.npz"),
        "law": job.law,
        "precision": job.precision,
    }
    order |= {"threads": job.threads, "skin": f"{job.skin:g} m", "warm": steps.warm, "window": window}
    plain = codes.last_json(codes.child(order, place), "granflow")
    os.environ[PROFILER] = "1"
    try:
        kernels = codes.last_json(codes.child(order | {"window": steps.window}, place), "granflow")["kernels"]
    finally:
        del os.environ[PROFILER]
    known = {"case": job.case.name, "law": job.law, "threads": job.threads, "precision": job.precision}
    return known | plain | {"kernels": kernels}


def bounds(point: dict[str, Any], phase: str, result: dict[str, Any]) -> tuple[float, float]:
    """Seconds a phase takes at least: for its bytes, and for its arithmetic."""
    found = next(each for each in result["limits"] if each["threads"] == point["threads"])
    in_cache = point["working_set"] < (last_level_cache() or 0)
    bandwidth = found["triad_cache"] if in_cache else found["triad_memory"]
    operations = counts.Operations(**point["operations"][phase])
    return point["bytes"][phase] / bandwidth, operations.seconds(found)


def rows(result: dict[str, Any]) -> list[list[str]]:
    """One row for each phase of each point."""
    table = []
    for point in result["points"]:
        for phase, seconds in point["seconds"].items():
            moving, reckoning = bounds(point, phase, result)
            operations = sum(point["operations"][phase].values())
            table.append([
                point["case"], point["law"], str(point["threads"]), phase, f"{1e6 * seconds:.0f}",
                f"{point['bytes'][phase] / 1e6:.1f}", f"{point['bytes'][phase] / seconds / 1e9:.1f}",
                f"{operations / seconds / 1e9:.2f}", f"{1e6 * moving:.0f} us", f"{1e6 * reckoning:.0f} us",
                f"{max(moving, reckoning) / seconds:.0%} ({'bytes' if moving > reckoning else 'arithmetic'})",
            ])  # fmt: skip
    return table


def limit_lines(result: dict[str, Any]) -> list[str]:
    """What the machine can do, a line for each number of threads."""
    return [
        f"{each['threads']:.0f} thread(s): copy {each['copy_cache'] / 1e9:.0f} GB/s in cache, "
        f"{each['copy_memory'] / 1e9:.0f} in memory; triad {each['triad_cache'] / 1e9:.0f} and "
        f"{each['triad_memory'] / 1e9:.0f}; product and sum {1e9 * each['product_sum_seconds']:.2f} ns, "
        f"square root {1e9 * each['root_seconds']:.2f} ns, quotient {1e9 * each['quotient_seconds']:.2f} ns (f64)"
        for each in result["limits"]
    ]


def text(result: dict[str, Any]) -> str:
    """Everything for the terminal; a search is one search, not its share of a step."""
    lines = ["", *limit_lines(result), "", HEAD]
    for row in rows(result):
        lines.append(
            f"{row[0]:<12} {row[1]:<7} {row[2]:>7}  {row[3]:<7} {row[4]:>9} {row[5]:>7} {row[6]:>6} {row[7]:>6} "
            f"{row[8]:>12} {row[9]:>17}  {row[10]}"
        )
    lines.append("(search: one search; motion and forces: one step)")
    for point in result["points"]:
        lines += kernel_lines(point)
    return "\n".join(lines)


def kernel_lines(point: dict[str, Any]) -> list[str]:
    """Kernels that take a hundredth of the time or more."""
    often = point["steps_per_search"]
    seldom = f"a search every {often:.0f} steps" if often else "no search in the window"
    lines = [
        f"{point['case']}, {point['law']}, {point['threads']} thread(s): {point['slots']:.2f} near pairs and "
        f"{point['touching']:.2f} touching for each sphere, {seldom}; kernels:"
    ]
    for unit, kernels in point["kernels"].items():
        total = sum(kernels.values())
        shown = sorted(kernels.items(), key=lambda each: -each[1])
        lines += [f"  {1e6 * t:9.1f} us/{unit:<6} {t / total:4.0%}  {name}" for name, t in shown if t > 0.01 * total]
    return lines
