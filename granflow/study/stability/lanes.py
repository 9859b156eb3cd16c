"""Cases in processes of their own, two at a time: one start of Taichi each, and a limit for what hangs."""

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from math import nan
from multiprocessing.connection import Connection
from typing import Any

from granflow.device.backend import start
from granflow.study.stability.cases import Case, Finding, Outcome, attempt, outcome

LANES = 2
LIMIT = 180.0
"""A case that takes longer [s] is given up."""

Tell = Callable[[Outcome], None]


def run_cases(cases: Sequence[Case], tell: Tell, limit: float = LIMIT) -> list[Outcome]:
    """Every case's outcome in the order of the cases; `tell` hears of each as it comes.

    Cases of one precision that follow each other run in one process, in which they may share work.
    """
    with ThreadPoolExecutor(LANES) as lanes:
        parts = lanes.map(lambda batch: _run_batch(batch, tell, limit), _batches(cases))
        found = {(each.family, each.row, each.column): each for part in parts for each in part}
    return [found[case.family, case.row, case.column] for case in cases]


def _batches(cases: Sequence[Case]) -> list[list[Case]]:
    """The cases of each family and precision."""
    batches: dict[tuple[str, str], list[Case]] = {}
    for case in cases:
        batches.setdefault((case.family, case.precision), []).append(case)
    return list(batches.values())


def _run_batch(batch: list[Case], tell: Tell, limit: float) -> list[Outcome]:
    """Run cases of one precision; after one that hangs or kills its process the others go on in a new one."""
    found: list[Outcome] = []
    while len(found) < len(batch):
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_serve, args=(there, batch[len(found) :]), daemon=True)
        process.start()
        there.close()
        found += _listen(here, batch[len(found) :], tell, limit)
        process.kill()
        process.join()
    return found


def _listen(pipe: Connection, cases: list[Case], tell: Tell, limit: float) -> list[Outcome]:
    """Outcomes as they come, up to the first case that does not answer."""
    found: list[Outcome] = []
    for case in cases:
        lost = ""
        if not pipe.poll(limit):
            lost = f"not finished in {limit:g} s"
        else:
            try:
                found.append(pipe.recv())
            except EOFError:
                lost = "its process ended without an answer"
        if lost:
            found.append(outcome(case, Finding("", nan, nan, nan, nan), limit, "defect", f"defect: {lost}"))
        tell(found[-1])
        if lost:
            break
    return found


def _serve(pipe: Any, cases: Sequence[Case]) -> None:
    """In the child: start once, run the cases, send each outcome."""
    start("cpu", cases[0].precision, 1)
    for case in cases:
        pipe.send(attempt(case))
