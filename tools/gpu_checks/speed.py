"""Speed of one bed in one precision, minimum memory traffic, and memory bandwidth measured in the same
process."""

import os
import time
from typing import Any

from benchmark import counts, ours, phases
from benchmark.cases import Case

from gpu_checks.beds import bed, engine_for, plan_of
from gpu_checks.device import bandwidth

BATCH = 64
"""Steps between two queries of the clock."""
WARM_STEPS = 200
REBUILDS = 3
MEMORY_SHARE = 0.7
"""Largest initial share of fields in the free memory; the neighbor lists may grow."""


def bytes_needed(bed_file: str, count: int, precision: str, on_gpu: bool) -> tuple[int, int]:
    """Bytes of all fields, and of the largest one, of a bed of about `count` particles, before neighbor lists
    grow."""
    from granflow.plan.cost import estimate_memory, largest_block

    case = bed(bed_file, 0)
    plan = plan_of(case, precision, on_gpu)
    found = estimate_memory(plan, precision).total, largest_block(plan, plan.capacities)  # type: ignore[arg-type]
    total, longest = (int(each / case.count * max(count, case.count)) for each in found)
    return total, longest


def measure(arch: str, precision: str, bed_file: str, count: int, seconds: float) -> dict[str, Any]:
    """Job of a subprocess: particle-steps per second of a settled bed, with memory traffic, timings and
    contacts.

    If `phases.PROFILER` is set, the result includes the time [s] of each kernel per step and per rebuild.
    """
    from granflow.engine.backend import start

    backend = start(arch, precision)  # type: ignore[arg-type]
    limits = bandwidth(backend.on_cpu)
    began = time.perf_counter()
    case = bed(bed_file, count)
    engine = engine_for(case, arch, precision)
    ready = time.perf_counter() - began
    engine.advance(WARM_STEPS)
    phases.clear_profile()
    steps, spent, rebuilds = _window(engine, seconds)
    stepping = phases.profile(steps)
    rebuild_seconds = [phases.rebuild_seconds(engine) for _ in range(REBUILDS)]
    kernels = {"step": stepping, "search": phases.profile(REBUILDS)}
    if engine.diagnosis is not None:
        raise SystemExit(f"granflow stopped: {engine.diagnosis}")
    return {
        "count": case.count,
        "rate": case.count * steps / spent,
        "steps": steps,
        "seconds": spent,
        "searches": rebuilds,
        "search_seconds": min(rebuild_seconds),
        "setup_seconds": ready - engine.timing.compile,
        "compile_seconds": engine.timing.compile,
        "field_bytes": ours.field_bytes(engine) / case.count,
        **_traffic(engine, case, rebuilds / steps, spent / steps, limits),
        **({"kernels": kernels} if phases.PROFILER in os.environ else {}),
    }


def _window(engine: Any, seconds: float) -> tuple[int, float, int]:
    """Steps in at least `seconds` of wall time, the elapsed time [s], and the rebuilds in it."""
    rebuilds = engine.timing.rebuild_count
    steps = 0
    began = time.perf_counter()
    while time.perf_counter() - began < seconds and not engine.aborted:
        engine.advance(BATCH)  # waits for the device, since it reads the number of steps
        steps += BATCH
    return steps, time.perf_counter() - began, engine.timing.rebuild_count - rebuilds


def _traffic(
    engine: Any, case: Case, rebuilds_per_step: float, step_seconds: float, limits: dict[str, float]
) -> dict[str, float]:
    """Minimum bytes per particle-step (`benchmark.counts`) and the resulting share of the copy bandwidth."""
    state = engine.state
    totals = engine.snapshot("run", frozenset({"totals"})).totals
    begin, end = (f.to_numpy()[: state.count] for f in (state.neighbors.list_begin, state.neighbors.list_end))
    list_entries = int((end - begin).sum())
    contacts = totals["contact_count"]
    both_sides = 2 if state.plan.chunk_size == 1 else 1
    moved = counts.bytes_of(counts.load_of(state, list_entries, int(both_sides * contacts)))
    each = (moved["motion"] + moved["forces"] + rebuilds_per_step * moved["search"]) / case.count
    return {
        "contacts": contacts / case.count,
        "coordination_number": totals["coordination_number"],
        "near": list_entries / case.count,
        "overlap_largest": totals["overlap_largest"],
        "bytes_per_particle_step": each,
        "copy_bandwidth": limits["copy"],
        "triad_bandwidth": limits["triad"],
        "bandwidth_share": each * case.count / step_seconds / limits["copy"],
    }
