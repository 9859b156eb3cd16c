"""Time of each phase and kernel of granflow, compared with the measured limits of the machine.

Steps are taken through the public interface. Times of single phases and rebuilds, sizes of fields and entries
of the neighbor list are not part of it, because they depend on the layout of the engine; they are read there.
"""

import argparse
import os
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmark import codes, counts, loops, ours
from benchmark.cases import Case, steps_for
from benchmark.machine import last_level_cache, machine
from granflow.kernel_language import KERNELS

PROFILER = "TI_KERNEL_PROFILER" if KERNELS == "taichi" else "QD_KERNEL_PROFILER"
"""Environment variable that enables the profiler of the kernel language; without it the profiler ends the
process."""
REBUILDS = 5
LEAST_STEPS = 1024
"""Smallest number of steps in which the stepper takes several samples of its phases."""
PHASES = {"motion": "integration", "forces": "forces", "search": "rebuild"}
"""Phases in the result files and their labels; `search` is a rebuild of the neighbor list."""
HEAD = (
    f"{'case':<12} {'law':<7} threads  {'phase':<11} {'us/step':>9} {'MB':>7} {'GB/s':>6} {'Gop/s':>6} "
    f"{'bytes alone':>12} {'arithmetic alone':>17}  {'bound reached':<18} C++ / granflow"
)


def limits(threads: int) -> dict[str, float]:
    """Job of a subprocess: limits of the machine."""
    from benchmark.limits import measure as measure_limits

    return measure_limits(threads)


def measure(
    path: str, law: str, precision: str, threads: int, skin: str, warm: int, window: int
) -> dict[str, Any]:  # fmt: skip
    """Job of a subprocess: time [s] of each phase, and of each kernel if the profiler is enabled."""
    simulation = ours.simulation_for(Case.load(Path(path)), law, precision, threads, skin)
    simulation.step(1 + warm)
    engine = simulation.engine
    clear_profile()
    before = phase_seconds(engine)
    rebuilds = engine.timing.rebuild_count
    simulation.step(window)
    after = phase_seconds(engine)
    rebuilds = engine.timing.rebuild_count - rebuilds
    step_kernels = profile(window)
    rebuild_times = [rebuild_seconds(engine) for _ in range(REBUILDS)]
    rebuild_kernels = profile(REBUILDS)
    seconds = {name: (after[name] - before[name]) / window for name in after}
    list_entries, touching = neighbors_of(engine)
    load = counts.load_of(engine.state, list_entries, touching)
    moved = counts.bytes_of(load)
    operations = counts.operations_of(load)
    return {
        "seconds": seconds | {"search": median(rebuild_times)},
        "steps_per_search": window / rebuilds if rebuilds else None,
        "bytes": moved,
        "operations": {name: vars(each) for name, each in operations.items()},
        "slots": list_entries / load.particles,
        "touching": touching / load.particles,
        "working_set": ours.field_bytes(engine),
        "kernels": {"step": step_kernels, "search": rebuild_kernels},
        "loops": loops.seconds(engine, law, precision, threads),
    }


def phase_seconds(engine: Any) -> dict[str, float]:
    """Accumulated wall-clock time [s] of integration and forces."""
    timing = engine.timing
    return {"motion": timing.integration, "forces": timing.forces}


def rebuild_seconds(engine: Any) -> float:
    """Rebuilds the neighbor list; returns its wall-clock time [s]."""
    began = engine.timing.neighbor_list
    engine.stepper.rebuild_neighbor_lists(0)
    return engine.timing.neighbor_list - began


def neighbors_of(engine: Any) -> tuple[int, int]:
    """Number of neighbor-list entries, including walls and pairs listed twice, and number of particle
    contacts."""
    neighbors = engine.state.neighbors
    particles = engine.state.particles
    count = engine.state.count
    begin, end = (field.to_numpy()[:count] for field in (neighbors.list_begin, neighbors.list_end))
    number = end - begin
    row = np.repeat(np.arange(count), number)
    list_index = (
        np.arange(number.sum()) - np.repeat(np.cumsum(number) - number, number) + np.repeat(begin, number)
    )
    partner = neighbors.partner.to_numpy()[list_index]
    is_particle = partner >= 0
    position = particles.position.to_numpy()[:count]
    radius = particles.radius.to_numpy()[:count]
    i, j = row[is_particle], partner[is_particle]
    distance = np.linalg.norm(position[i] - position[j], axis=1)
    return len(list_index), int((distance < radius[i] + radius[j]).sum())


def clear_profile() -> None:
    """Resets the kernel profiler."""
    if PROFILER in os.environ:
        from granflow.kernel_language import ti

        ti.profiler.clear_kernel_profiler_info()


def profile(times: int) -> dict[str, float]:
    """Time [s] of each kernel since the last reset, by name, divided by `times`; empty without the
    profiler."""
    if PROFILER not in os.environ:
        return {}
    from granflow.kernel_language import ti

    program = ti.lang.impl.get_runtime().prog
    program.sync_kernel_profiler()
    program.update_kernel_profiler()
    found: dict[str, float] = {}
    for record in program.get_kernel_profiler_records():
        found[record.name] = found.get(record.name, 0.0) + 1e-3 * record.kernel_time / times
    clear_profile()
    return found


def measure_all(options: argparse.Namespace, found: list[Case], folder: Path) -> dict[str, Any]:
    """Measures the limits for each number of threads, then the phases of each case and contact model."""
    result: dict[str, Any] = {"kind": "phases", "machine": machine(), "limits": [], "points": []}
    for threads in options.threads:
        done = codes.child({"job": "limits", "threads": threads}, folder)
        result["limits"].append(codes.last_json(done, "The measurement of limits"))
    for case in found:
        case_folder = codes.prepare(case, folder, [])
        for law in options.laws:
            for threads in options.threads:
                job = codes.job_for(
                    "granflow", law, case, threads, options.precision, options.skin, options.scale
                )
                result["points"].append(point(job, case_folder))
                print(f"{case.name}, {law}, {threads} thread(s): measured", flush=True)
    return result


def point(job: codes.Job, case_folder: Path) -> dict[str, Any]:
    """Phases from a run without profiler, kernels from a run with profiler."""
    steps = steps_for(job.case, False, 1.0)
    window = max(steps.window, LEAST_STEPS if job.case.count <= 50_000 else steps.window)
    order: dict[str, Any] = {
        "job": "phases",
        "path": str(case_folder / "case.npz"),
        "law": job.law,
        "precision": job.precision,
    }
    order |= {"threads": job.threads, "skin": f"{job.skin:g} m", "warm": steps.warm, "window": window}
    phases = codes.last_json(codes.child(order, case_folder), "granflow")
    os.environ[PROFILER] = "1"
    try:
        kernels = codes.last_json(codes.child(order | {"window": steps.window}, case_folder), "granflow")[
            "kernels"
        ]
    finally:
        del os.environ[PROFILER]
    description = {"case": job.case.name, "law": job.law, "threads": job.threads, "precision": job.precision}
    return description | phases | {"kernels": kernels}


def bounds(point: dict[str, Any], phase: str, result: dict[str, Any]) -> tuple[float, float]:
    """Lower bounds of the time of a phase [s]: for its bytes and for its arithmetic."""
    found = next(each for each in result["limits"] if each["threads"] == point["threads"])
    in_cache = point["working_set"] < (last_level_cache() or 0)
    bandwidth = found["triad_cache"] if in_cache else found["triad_memory"]
    operations = counts.Operations(**point["operations"][phase])
    return point["bytes"][phase] / bandwidth, operations.seconds(found)


def rows(result: dict[str, Any]) -> list[list[str]]:
    """One row for each phase of each point; rates are "-" for a phase that took no longer than a launch."""
    table = []
    for point in result["points"]:
        for phase, seconds in point["seconds"].items():
            memory_bound, arithmetic_bound = bounds(point, phase, result)
            operations = sum(point["operations"][phase].values())
            table.append([
                point["case"], point["law"], str(point["threads"]), PHASES[phase], f"{1e6 * seconds:.0f}",
                f"{point['bytes'][phase] / 1e6:.1f}", per_second(point["bytes"][phase] / 1e9, seconds, ".1f"),
                per_second(operations / 1e9, seconds, ".2f"),
                f"{1e6 * memory_bound:.0f} us", f"{1e6 * arithmetic_bound:.0f} us",
                f"{per_second(max(memory_bound, arithmetic_bound), seconds, '.0%')} "
                f"({'bytes' if memory_bound > arithmetic_bound else 'arithmetic'})",
                share_of_loop(point, PHASES[phase], seconds),
            ])  # fmt: skip
    return table


def per_second(amount: float, seconds: float, style: str) -> str:
    """An amount over a time [s] as text; "-" without a time: launches on a loaded machine can hide a phase."""
    return format(amount / seconds, style) if seconds else "-"


def share_of_loop(point: dict[str, Any], phase: str, seconds: float) -> str:
    """Time of the loop of a phase in C++ over its time [s]; empty without one."""
    in_cpp = (point.get("loops") or {}).get(phase)
    return "" if in_cpp is None else f"{per_second(in_cpp, seconds, '.0%')} ({1e6 * in_cpp:.0f} us)"


def limit_lines(result: dict[str, Any]) -> list[str]:
    """Limits of the machine, one line for each number of threads."""
    return [
        f"{each['threads']:.0f} thread(s): copy {each['copy_cache'] / 1e9:.0f} GB/s in cache, "
        f"{each['copy_memory'] / 1e9:.0f} in memory; triad {each['triad_cache'] / 1e9:.0f} and "
        f"{each['triad_memory'] / 1e9:.0f}; product and sum {1e9 * each['product_sum_seconds']:.2f} ns, "
        f"square root {1e9 * each['root_seconds']:.2f} ns, quotient {1e9 * each['quotient_seconds']:.2f} ns "
        "(f64)"
        for each in result["limits"]
    ]


def text(result: dict[str, Any]) -> str:
    """All results as text; the time of a rebuild is that of one rebuild, not its share of a step."""
    lines = ["", *limit_lines(result), "", HEAD]
    for row in rows(result):
        lines.append(
            f"{row[0]:<12} {row[1]:<7} {row[2]:>7}  {row[3]:<11} {row[4]:>9} {row[5]:>7} {row[6]:>6} "
            f"{row[7]:>6} {row[8]:>12} {row[9]:>17}  {row[10]:<18} {row[11]}"
        )
    lines.append("(rebuild: one rebuild; integration and forces: one step)")
    for point in result["points"]:
        lines += kernel_lines(point)
    return "\n".join(lines)


def kernel_lines(point: dict[str, Any]) -> list[str]:
    """Kernels that take at least 1 % of the time."""
    interval = point["steps_per_search"]
    rebuilds = f"a rebuild every {interval:.0f} steps" if interval else "no rebuild"
    lines = [
        f"{point['case']}, {point['law']}, {point['threads']} thread(s): {point['slots']:.2f} list entries "
        f"and {point['touching']:.2f} contact entries per particle, {rebuilds}; kernels:"
    ]
    for unit, kernels in point["kernels"].items():
        total = sum(kernels.values())
        shown = sorted(kernels.items(), key=lambda each: -each[1])
        label = PHASES.get(unit, unit)
        lines += [
            f"  {1e6 * t:9.1f} us/{label:<7} {t / total:4.0%}  {name}"
            for name, t in shown
            if t > 0.01 * total
        ]
    return lines
