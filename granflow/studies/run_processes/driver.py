"""Carries out many runs through an executor: the first run of each set of kernels compiles them, lost runs are retried.

The executor is that of the standard library, or one of Dask. All state that outlives this process is in the directories
of the runs.
"""

import shutil
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass, field, replace
from heapq import heappop, heappush
from pathlib import Path
from threading import Event

from granflow.io.lock import holder_of
from granflow.studies.run_processes.checked import CheckedRun
from granflow.studies.run_processes.outcome import CRASHED, NOT_RUN, Outcome, final_outcome
from granflow.studies.run_processes.process import RunRequest, execute

MAX_ATTEMPTS = 3
"""Attempts for a run whose process or worker is lost: the first one and two retries."""

POLL = 0.5
"""Interval [s] at which a request to stop is checked."""

REPORT_INTERVAL = 60.0
"""Longest time [s] without a report."""

COMPILE_ONLY = "1e-12 s"
"""Simulated time of a run that only compiles kernels: one step."""


@dataclass(frozen=True)
class Progress:
    """State of all runs: numbers of completed, running, failed and all runs, and the estimated remaining time [s].

    The time is None before the first run has ended. Completed runs may have missed expectations; failed runs are
    refused, aborted or crashed.
    """

    done: int
    running: int
    failed: int
    total: int
    remaining: float | None

    def __str__(self) -> str:
        """One line for a terminal."""
        eta = "" if self.remaining is None else f", ETA {_duration(self.remaining)}"
        return f"{self.total} runs: {self.done} done, {self.running} running, {self.failed} failed{eta}"


def _duration(seconds: float) -> str:
    """A duration with one unit, such as 90 s, 12 min or 3.5 h."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"


Report = Callable[[Progress, str], None]
"""Function that receives the progress, and the text and status of a run that has just ended, or an empty text."""


@dataclass(order=True)
class _Job:
    """One run by its position in the study, or the compilation of its kernels, which comes before."""

    index: int
    run: CheckedRun = field(compare=False)
    compiles_only: bool = field(default=False, compare=False)
    attempt: int = field(default=1, compare=False)

    @property
    def request(self) -> RunRequest:
        """The request to carry out."""
        request = self.run.request
        if not self.compiles_only:
            return request
        directory = Path(request.directory)
        return replace(request, directory=str(directory.with_name(f".compile_{directory.name}")), until=COMPILE_ONLY)


class Driver:
    """Carries out runs.

    `report` receives the progress at the start, every REPORT_INTERVAL, and after each run with its text and status.
    `texts`: what identifies each run in the report, by its directory.
    `slots`: function that returns how many runs are submitted at a time; `stop`: set from outside to stop all runs,
    each with a checkpoint.
    """

    def __init__(
        self,
        executor: Executor,
        slots: Callable[[], int],
        stop: Event,
        report: Report,
        texts: Mapping[str, str],
    ) -> None:
        self._executor, self._slots, self._stop, self._report = executor, slots, stop, report
        self._texts = texts
        self._ready: list[_Job] = []
        self._held: dict[str, list[_Job]] = {}
        self._running: dict[Future[Outcome], _Job] = {}
        self._total = self._started_with = 0
        self._began = self._told = 0.0
        self.outcomes: dict[str, Outcome] = {}

    def run(self, runs: Iterable[CheckedRun]) -> Mapping[str, Outcome]:
        """Carry out the runs that have not ended yet; return the outcome of each, by its directory.

        KeyboardInterrupt stops the runs, and is raised again when all have written their checkpoints.
        """
        interrupt: KeyboardInterrupt | None = None
        self._schedule({run.request.directory: run for run in runs})
        self._began = time.monotonic()
        self._tell("")
        self._tell_holders()
        while self._running or (self._ready and not self._stop.is_set()):
            try:
                self._submit()
                for future in wait(self._running, POLL, FIRST_COMPLETED).done:
                    self._finish(self._running.pop(future), future)
                if time.monotonic() - self._told > REPORT_INTERVAL:
                    self._tell("")
            except KeyboardInterrupt as error:
                if interrupt is not None:
                    raise
                interrupt = error
                self._stop.set()
            if self._stop.is_set():
                self._request_stop()
        if interrupt is not None:
            raise interrupt
        return self.outcomes

    def _tell_holders(self) -> None:
        """Report the runs that other processes carry out, such as workers whose command was killed."""
        jobs = [*self._ready, *(job for held in self._held.values() for job in held)]
        waiting = {directory for job in jobs for directory in (job.run.directory, Path(job.request.directory))}
        for directory in sorted(waiting):
            if holder := holder_of(directory):
                name = f"{directory.parent.name}/{directory.name}"
                self._tell(f"{name} is carried out by {holder}; its result is waited for, unless you end that process")

    def _schedule(self, runs: Mapping[str, CheckedRun]) -> None:
        """Sort the runs into those that have ended, those that can start, and those that wait for their kernels."""
        compiled: set[str] = set()
        self._total = len(runs)
        for index, (directory, run) in enumerate(runs.items()):
            known = final_outcome(Path(directory))
            if known is not None:
                self.outcomes[directory] = known
                compiled.add(run.kernels)
            else:
                self._held.setdefault(run.kernels, []).append(_Job(index, run))
        self._started_with = len(self.outcomes)
        for kernels, jobs in list(self._held.items()):
            if kernels in compiled or len(jobs) == 1:
                self._release(kernels)
            else:
                heappush(self._ready, replace(jobs[0], compiles_only=True))

    def _release(self, kernels: str) -> None:
        """Let the runs of a set of kernels start."""
        for job in self._held.pop(kernels, ()):
            heappush(self._ready, job)

    def _submit(self) -> None:
        """Submit runs to free slots."""
        while self._ready and len(self._running) < self._slots() and not self._stop.is_set():
            job = heappop(self._ready)
            self._running[self._executor.submit(execute, job.request)] = job

    def _request_stop(self) -> None:
        """Create the stop file, which the workers check."""
        for job in self._running.values():
            Path(job.request.stop_file).touch()

    def _finish(self, job: _Job, future: "Future[Outcome]") -> None:
        """Record the outcome of a run, or retry it; release the runs that waited for its kernels."""
        outcome = _outcome_of(future)
        if job.compiles_only:
            shutil.rmtree(job.request.directory, ignore_errors=True)
            self._release(job.run.kernels)
            return
        if outcome.is_lost and job.attempt < MAX_ATTEMPTS and not self._stop.is_set():
            heappush(self._ready, replace(job, attempt=job.attempt + 1))
            return
        if outcome.is_lost and job.attempt > 1:
            outcome = replace(outcome, reason=f"{outcome.reason} Attempts: {job.attempt}.")
        self.outcomes[job.run.request.directory] = outcome
        self._tell(f"{self._texts.get(job.request.directory, job.run.directory.name)} {outcome.status}")

    def _tell(self, event: str) -> None:
        """Report the progress; `event`: text and status of the run that has ended, or an empty text."""
        self._told = time.monotonic()
        self._report(self._progress(self._told - self._began), event)

    def _progress(self, elapsed: float) -> Progress:
        """The state of all runs after `elapsed` [s]."""
        ended = [outcome for outcome in self.outcomes.values() if outcome.status != NOT_RUN]
        here = len(ended) - self._started_with
        remaining = elapsed / here * (self._total - len(ended)) if here else None
        done = sum(outcome.has_numbers for outcome in ended)
        return Progress(done, len(self._running), len(ended) - done, self._total, remaining)


def _outcome_of(future: "Future[Outcome]") -> Outcome:
    """The outcome of a task; one whose worker is gone, or whose directory the worker cannot use, is lost."""
    try:
        return future.result()
    except Exception as error:
        return Outcome(CRASHED, f"The worker is lost ({type(error).__name__}: {error}).", is_lost=True)
