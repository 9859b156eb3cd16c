"""Worker pool of the stability study: two processes with one Taichi start each, and a time limit per case."""

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from math import nan
from multiprocessing.connection import Connection
from typing import Any

from granflow import start
from granflow.studies.stability.cases import CaseOutcome, CaseResult, StabilityCase, case_outcome, run_case

WORKER_COUNT = 2
"""Number of processes."""

TIMEOUT = 180.0
"""Time limit per case [s]."""

Report = Callable[[CaseOutcome], None]
"""Function that receives each outcome."""


def run_cases(cases: Sequence[StabilityCase], report: Report, timeout: float = TIMEOUT) -> list[CaseOutcome]:
    """Outcomes of all cases, in the order of the cases; `report` receives each outcome on completion.

    Cases of one family and precision run in one process and share cached results. `timeout` [s] applies to each case. A
    crash or timeout is a defect of its case and does not end the study.
    """
    with ThreadPoolExecutor(WORKER_COUNT) as executor:
        parts = executor.map(lambda batch: _run_batch(batch, report, timeout), _batches(cases))
        found = {(each.family, each.row, each.column): each for part in parts for each in part}
    return [found[case.family, case.row, case.column] for case in cases]


def _batches(cases: Sequence[StabilityCase]) -> list[list[StabilityCase]]:
    """Batches of cases with equal family and precision."""
    batches: dict[tuple[str, str], list[StabilityCase]] = {}
    for case in cases:
        batches.setdefault((case.family, case.precision), []).append(case)
    return list(batches.values())


def _run_batch(batch: list[StabilityCase], report: Report, timeout: float) -> list[CaseOutcome]:
    """Run the cases of a batch; after a timeout or a crash the remaining cases run in a new process."""
    found: list[CaseOutcome] = []
    while len(found) < len(batch):
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_run_in_worker, args=(there, batch[len(found) :]), daemon=True)
        process.start()
        there.close()
        found += _receive(here, batch[len(found) :], report, timeout)
        process.kill()
        process.join()
    return found


def _receive(pipe: Connection, cases: list[StabilityCase], report: Report, timeout: float) -> list[CaseOutcome]:
    """Receive outcomes up to the first case without a result."""
    found: list[CaseOutcome] = []
    for case in cases:
        reason = ""
        if not pipe.poll(timeout):
            reason = f"not finished in {timeout:g} s"
        else:
            try:
                found.append(pipe.recv())
            except EOFError:
                reason = "the process ended without a result"
        if reason:
            found.append(case_outcome(case, CaseResult("", nan, nan, nan, nan), timeout, "defect", f"defect: {reason}"))
        report(found[-1])
        if reason:
            break
    return found


def _run_in_worker(pipe: Any, cases: Sequence[StabilityCase]) -> None:
    """Worker process: start Taichi, run the cases and send each outcome."""
    start("cpu", cases[0].precision, 1)  # type: ignore[arg-type]
    for case in cases:
        pipe.send(run_case(case))
