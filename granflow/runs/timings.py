"""Wall clock and result of a run, and its log header."""

import logging
import time as clock
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

from granflow.engine.engine import Engine
from granflow.io.checkpoint import Checkpoint
from granflow.io.log import FACTS, SessionFacts, versions
from granflow.plan.explain import explain
from granflow.plan.plan import Plan
from granflow.runs.result import Result
from granflow.visible_text import visible, visible_line

SHORTEST = 1e-9
"""Shortest wall-clock time [s] by which rates are divided."""


class WallClock:
    """Wall-clock time of a run [s], including the time before it was resumed.

    `output`: time [s] spent in observers and checkpoints.
    """

    def __init__(self) -> None:
        self._began = clock.perf_counter()
        self._before_resume = 0.0
        self._setup = 0.0
        self._elapsed = 0.0
        self._is_running = True
        self.output = 0.0

    def set_up(self, compile_seconds: float) -> None:
        """Record the set-up time [s], without `compile_seconds`."""
        self._setup = clock.perf_counter() - self._began - compile_seconds
        self._is_running = False

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run the clock during the block; the time between two blocks is not counted."""
        self._began = clock.perf_counter()
        self._is_running = True
        try:
            yield
        finally:
            self._elapsed += clock.perf_counter() - self._began
            self._is_running = False

    @contextmanager
    def measuring_output(self) -> Iterator[None]:
        """Count the duration of the block as output."""
        began = clock.perf_counter()
        yield
        self.output += clock.perf_counter() - began

    def total(self, engine: Engine) -> float:
        """Return the total time so far [s]."""
        present = clock.perf_counter() - self._began if self._is_running else 0.0
        total = self._before_resume + self._elapsed + present + self._setup + engine.timing.compile
        return max(total, SHORTEST)  # the clock of a machine can stand still

    def state_dict(self, engine: Engine) -> dict[str, Any]:
        """Return the state for a checkpoint: output time and total time so far [s]."""
        return {"output_seconds": self.output, "wall_clock": self.total(engine)}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`."""
        self.output = saved["output_seconds"]
        self._before_resume = saved["wall_clock"]


Readings = Mapping[str, Mapping[str, float]]
"""Numbers by quantity of each meter, wall or metric, by name."""


def collect_result(
    engine: Engine, wall_clock: WallClock, totals: Mapping[str, float], readings: Mapping[str, Readings]
) -> Result:
    """Return the numbers of a run without evaluated expectations.

    engine:    engine at the end of the run
    totals:    totals of the last snapshot
    readings:  numbers of flow meters, wall forces, metrics and insertion by kind, as in `Result`
    """
    timing = engine.timing
    computing = max(timing.neighbor_list + timing.advance, SHORTEST)
    run = {
        "simulated_time": engine.time,
        "step_count": float(engine.step_count),
        "time_step": engine.mean_time_step,
        "steps_per_second": engine.step_count / computing,
        "particle_steps_per_second": timing.particle_steps / computing,
        "steps_per_second_of_wall_clock": engine.step_count / wall_clock.total(engine),
        "rebuild_count": float(timing.rebuild_count),
        "wall_clock": wall_clock.total(engine),
    }
    seconds = {
        "neighbor_list": timing.neighbor_list,
        "forces": timing.forces,
        "integration": timing.integration,
        **({"exchange": timing.exchange, "waiting": timing.waiting} if timing.waiting else {}),
        "output": wall_clock.output,
        "compile": timing.compile,
    }
    return Result(
        run=run,
        timings=seconds,
        totals=totals,
        stages=readings.get("stages", {}),
        flow_meters=readings.get("flow_meters", {}),
        residence_time=readings.get("residence_time", {}),
        wall_forces=readings.get("wall_forces", {}),
        metrics=readings.get("metrics", {}),
        insertion=readings.get("insertion", {}),
    )


def log_plan(plan: Plan, engine: Engine, resumed: Checkpoint | None) -> None:
    """Write versions, device and plan with reasons to the log.

    `resumed`: checkpoint from which the run continues, or None.
    """
    log = logging.getLogger("granflow")
    backend = engine.state.backend
    count = backend.worker_count
    session = SessionFacts(
        versions=versions(),
        arch=backend.arch,
        precision=backend.precision,
        threads=count if backend.on_cpu else None,
        compile_seconds=float(engine.timing.compile),
        resumed_from="" if resumed is None else visible_line(resumed.path),
        resumed_at=0.0 if resumed is None else float(engine.time),
        explanation="\n".join(map(visible, explain(plan).splitlines())),
    )
    log.info("%s", session.versions, extra={FACTS: {"session": asdict(session)}})
    threads = f", {count} thread{'s' if count > 1 else ''}" if backend.on_cpu else ""
    log.info(
        "%s with %s%s, compiled in %.3g s", backend.arch, backend.precision, threads, engine.timing.compile
    )
    for line in session.explanation.splitlines():
        log.info("%s", line)
    if resumed is not None:
        log.info("resumed from %s at %.6g s", resumed.path, engine.time)
