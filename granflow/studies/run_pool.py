"""Many runs at the same time: `Driver` carries out the runs of a sweep through an executor.

Lost runs are repeated. The executor is that of the standard library, whose threads each wait for the process
of a run, or one of Dask, whose workers may be jobs of a batch system. All state that outlives this process is
in the directories of the runs.
"""

import shutil
import socket
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event
from typing import Annotated, Any

from pydantic import Field

from granflow.errors import GranflowError
from granflow.io.lock import holder_of
from granflow.io.machine import worker_count
from granflow.scene.reader import validated_file
from granflow.schema import quantities as q
from granflow.schema.model import ListOf, Model, Text
from granflow.studies.checked_run import CheckedRun
from granflow.studies.run_process import (
    CRASHED,
    NOT_RUN,
    Outcome,
    execute,
    final_outcome,
)
from granflow.visible_text import numbered

# Progress


@dataclass(frozen=True)
class Progress:
    """State of all runs: numbers of completed, running, failed and all runs, and the estimated remaining time
    [s].

    The time is None before the first run has ended. Completed runs may have missed expectations; failed runs
    are refused, aborted or crashed.
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
"""Function that receives the progress, and the text and status of a run that has just ended, or an empty
text."""

# The driver

MAX_ATTEMPTS = 3
"""Attempts for a run whose process or worker is lost: the first one and two retries."""
POLL = 0.5
"""Interval [s] at which a request to stop is checked."""
REPORT_INTERVAL = 60.0
"""Longest time [s] without a report."""


@dataclass(frozen=True)
class _Job:
    """One attempt to carry out a run."""

    run: CheckedRun
    attempt: int = 1


class Driver:
    """Carries out runs.

    `report` receives the progress at the start, every REPORT_INTERVAL, and after each run with its text and
    status. `texts`: what identifies each run in the report, by its directory.
    `slots`: function that returns how many runs are submitted at a time; `stop`: set from outside to stop all
    runs, each with a checkpoint.
    """

    def __init__(
        self,
        executor: Executor,
        slots: Callable[[], int],
        stop: Event,
        report: Report,
        texts: Mapping[str, str],
    ) -> None:
        self._executor = executor
        self._slots = slots
        self._stop = stop
        self._report = report
        self._texts = texts
        self._ready: deque[_Job] = deque()
        self._running: dict[Future[Outcome], _Job] = {}
        self._total = self._started_with = 0
        self._began = self._told = 0.0
        self.outcomes: dict[str, Outcome] = {}

    def run(self, runs: Iterable[CheckedRun]) -> Mapping[str, Outcome]:
        """Carry out the runs that have not ended yet; return the outcome of each, by its directory.

        KeyboardInterrupt stops the runs, and is raised again when all have written their checkpoints.
        """
        interrupt: KeyboardInterrupt | None = None
        distinct = {run.request.directory: run for run in runs}
        self._total = len(distinct)
        for directory, run in distinct.items():
            known = final_outcome(Path(directory))
            if known is None:
                self._ready.append(_Job(run))
            else:
                self.outcomes[directory] = known
        self._started_with = len(self.outcomes)
        self._began = time.monotonic()
        self._tell("")
        self._tell_holders()
        while self._running or (self._ready and not self._stop.is_set()):
            try:
                while self._ready and len(self._running) < self._slots() and not self._stop.is_set():
                    job = self._ready.popleft()
                    self._running[self._executor.submit(execute, job.run.request)] = job
                for future in wait(self._running, POLL, FIRST_COMPLETED).done:
                    self._finish(self._running.pop(future), future)
                if time.monotonic() - self._told > REPORT_INTERVAL:
                    self._tell("")
            except KeyboardInterrupt as error:
                if interrupt is not None:
                    raise
                interrupt = error
                self._stop.set()
            if self._stop.is_set():  # the workers check the stop file
                for job in self._running.values():
                    Path(job.run.request.stop_file).touch()
        if interrupt is not None:
            raise interrupt
        return self.outcomes

    def _tell_holders(self) -> None:
        """Report the runs that other processes carry out, such as workers whose command was killed."""
        for directory in sorted(job.run.directory for job in self._ready):
            if holder := holder_of(directory):
                name = f"{directory.parent.name}/{directory.name}"
                self._tell(
                    f"{name} is carried out by {holder}; its result is waited for, unless you end that "
                    "process"
                )

    def _finish(self, job: _Job, future: "Future[Outcome]") -> None:
        """Record the outcome of a run, or retry it."""
        outcome = _outcome_of(future)
        if outcome.is_lost and job.attempt < MAX_ATTEMPTS and not self._stop.is_set():
            self._ready.appendleft(replace(job, attempt=job.attempt + 1))
            return
        if outcome.is_lost and job.attempt > 1:
            outcome = replace(outcome, reason=f"{outcome.reason} Attempts: {job.attempt}.")
        directory = job.run.request.directory
        self.outcomes[directory] = outcome
        self._tell(f"{self._texts.get(directory, job.run.directory.name)} {outcome.status}")

    def _tell(self, event: str) -> None:
        """Report the progress; `event`: text and status of the run that has ended, or an empty text."""
        self._told = time.monotonic()
        ended = [outcome for outcome in self.outcomes.values() if outcome.status != NOT_RUN]
        here = len(ended) - self._started_with
        remaining = (self._told - self._began) / here * (self._total - len(ended)) if here else None
        done = sum(outcome.has_numbers for outcome in ended)
        self._report(Progress(done, len(self._running), len(ended) - done, self._total, remaining), event)


def _outcome_of(future: "Future[Outcome]") -> Outcome:
    """The outcome of a task; one whose worker is gone, or whose directory the worker cannot use, is lost."""
    try:
        return future.result()
    except Exception as error:
        return Outcome(CRASHED, f"The worker is lost ({type(error).__name__}: {error}).", is_lost=True)


# Where runs take place


@dataclass(frozen=True)
class Workers:
    """Where runs take place.

    `jobs`: number of simultaneous runs, None for as many as there are cores or workers; `threads`: of each
    run; `scheduler`: address of a running Dask scheduler, `scheduler_file`: file with it, `batch`: name of a
    batch system and file with its profile. At most one of these three is given; without, the runs take place
    on this machine.
    """

    jobs: int | None = None
    threads: int = 1
    scheduler: str | None = None
    scheduler_file: Path | None = None
    batch: tuple[str, Path] | None = None


Slots = Callable[[], int]
"""Function that returns the number of simultaneous runs."""


@contextmanager
def executor_for(workers: Workers) -> Iterator[tuple[Executor, Slots]]:
    """An executor for the runs, and the number of simultaneous runs.

    Raises GranflowError if Dask is missing, the scheduler does not answer, or the runs need more cores than
    there are.
    """
    if workers.scheduler or workers.scheduler_file or workers.batch:
        with _dask(workers) as found:
            yield found
        return
    jobs = local_jobs(workers.jobs, workers.threads, worker_count(None)[0])
    with ThreadPoolExecutor(jobs) as executor:
        yield executor, lambda: jobs


def local_jobs(jobs: int | None, threads: int, cores: int) -> int:
    """Number of simultaneous runs on `cores` cores. Raises GranflowError if they are too few."""
    needed = threads * (jobs or 1)
    if needed > cores:
        most = (
            f"give at most --jobs {cores // threads}"
            if threads <= cores
            else f"give at most --threads {cores}"
        )
        available = "1 core is" if cores == 1 else f"{cores} cores are"
        runs = numbered(jobs or 1, "run")
        verb = "need" if jobs and jobs > 1 else "needs"
        raise GranflowError(
            f"{runs} of {numbered(threads, 'thread')} {verb} {numbered(needed, 'core')}, but {available} "
            f"there: {most}."
        )
    return jobs or cores // threads


CONNECT_TIMEOUT = 20.0
"""Time limit [s] for a connection to a scheduler."""


@contextmanager
def _dask(workers: Workers) -> Iterator[tuple[Executor, Slots]]:
    """An executor of a running scheduler, or of a new one whose workers are jobs of a batch system.

    The files of the request are checked first, so that their faults are reported without Dask too.
    """
    profile = read_profile(workers.batch[1]) if workers.batch else None
    if workers.scheduler_file and not workers.scheduler_file.is_file():
        raise GranflowError(
            f"{workers.scheduler_file}: there is no such file; start dask scheduler --scheduler-file."
        )
    try:
        from distributed import Client
    except ImportError:
        raise GranflowError(
            "Runs on a scheduler require Dask, which is not installed: pip install 'dask[distributed]'"
        ) from None
    if workers.batch and profile:
        with batch_cluster(*workers.batch, profile, workers.threads) as cluster, Client(cluster) as client:
            yield _executor(client), _slots(client, workers)
        return
    where = (
        {"scheduler_file": str(workers.scheduler_file)}
        if workers.scheduler_file
        else {"address": workers.scheduler}
    )
    try:
        client = Client(**where, timeout=CONNECT_TIMEOUT)
    except (OSError, ValueError) as error:
        given = workers.scheduler_file or workers.scheduler
        raise GranflowError(
            f"The scheduler {given} does not answer ({error}): give its address, such as tcp://10.0.0.1:8786."
        ) from None
    with client:
        _refuse_overload(client, workers.threads)
        yield _executor(client), _slots(client, workers)


def _executor(client: Any) -> Executor:
    """The executor of a client: every task is new, and runs are retried by the driver only."""
    executor: Executor = client.get_executor(pure=False, retries=0)
    return executor


def _slots(client: Any, workers: Workers) -> Slots:
    """The number of simultaneous runs, which follows the workers as they join."""

    def slots() -> int:
        found = sum(each["nthreads"] for each in client.scheduler_info(n_workers=-1)["workers"].values())
        return max(1, found if workers.jobs is None else min(workers.jobs, found))

    return slots


def _refuse_overload(client: Any, threads: int) -> None:
    """Raise GranflowError if the workers of one machine take more runs than its cores allow, or if there are
    none."""
    info = client.scheduler_info(n_workers=-1)["workers"]
    if not info:
        raise GranflowError("The scheduler has no workers: start some with dask worker ADDRESS --nthreads N.")
    try:
        cores = client.run(machine_cores)
    except Exception as error:  # any exception of a worker, such as ModuleNotFoundError
        raise GranflowError(
            f"The workers cannot run granflow ({error}): install the same version of granflow on all "
            "machines."
        ) from None
    needed: dict[str, int] = {}
    for address, (host, _) in cores.items():
        needed[host] = needed.get(host, 0) + threads * info[address]["nthreads"]
    for host, count in cores.values():
        if needed[host] > count:
            raise GranflowError(
                f"The workers on {host} take {needed[host] // threads} runs of {threads} threads, but the "
                f"machine has {count} cores: start fewer workers, or with --nthreads "
                f"{max(count // threads, 1)}."
            )


def machine_cores() -> tuple[str, int]:
    """Name of this machine and number of its cores that this process can use; runs on the workers."""
    return socket.gethostname(), worker_count(None)[0]


# Workers as jobs of a batch system, through dask-jobqueue

Lines = Annotated[tuple[Text, ...], ListOf(one=True)]


class BatchProfile(Model):
    """Jobs of a batch system, each with one worker; `dask-jobqueue` writes their scripts."""

    jobs: q.Count = Field(description="number of batch jobs, each of which takes runs one after the other")
    cores: q.Count = Field(description="cores of each batch job")
    memory: Text = Field(description="memory of each batch job, such as 8 GB")
    walltime: Text | None = Field(None, description="time limit of each batch job, such as 04:00:00")
    queue: Text | None = Field(None, description="queue or partition")
    account: Text | None = Field(None, description="account or project")
    directives: Lines = Field(
        (), description="further lines for the batch system, such as --constraint=avx512"
    )
    prologue: Lines = Field(
        (), description="shell commands before the worker starts, such as module load python"
    )
    log_directory: Text | None = Field(
        None, description="directory of the files with the output of the batch jobs"
    )


def read_profile(path: Path) -> BatchProfile:
    """The profile in a YAML file. Raises FileError with all problems."""
    return validated_file(path, BatchProfile, "profile")[0]


SYSTEMS = {"slurm": "SLURMCluster", "pbs": "PBSCluster", "lsf": "LSFCluster", "sge": "SGECluster"}
"""Batch systems, and their classes in dask-jobqueue."""
SUBMIT = {"slurm": "sbatch", "pbs": "qsub", "lsf": "bsub", "sge": "qsub"}
"""Command of each batch system that submits a job."""


def batch_cluster(system: str, path: Path, profile: BatchProfile, threads: int) -> Any:
    """A Dask cluster whose workers are jobs of a batch system; each run has `threads` threads.

    `path`: file of the profile, for messages. Raises GranflowError without dask-jobqueue, with too few cores
    per job, or where the batch system is not installed.
    """
    try:
        import dask_jobqueue
    except ImportError:
        raise GranflowError(
            "Batch systems require dask-jobqueue, which is not installed: pip install dask-jobqueue"
        ) from None
    if threads > profile.cores:
        raise GranflowError(
            f"{path}: cores is {profile.cores}, but one run needs {threads}: give at most that --threads."
        )
    if shutil.which(SUBMIT[system]) is None:
        raise GranflowError(
            f"--{system} requires the command {SUBMIT[system]}, which this machine does not have: run "
            "granflow sweep where batch jobs are submitted, or without this option."
        )
    cluster = getattr(dask_jobqueue, SYSTEMS[system])(**cluster_options(system, profile, threads))
    cluster.scale(jobs=profile.jobs)
    return cluster


def cluster_options(system: str, profile: BatchProfile, threads: int) -> dict[str, Any]:
    """Arguments of the class of dask-jobqueue: a batch job has one worker, which takes cores // threads
    runs."""
    optional = {
        "walltime": profile.walltime,
        "queue": profile.queue,
        "account": profile.account,
        "log_directory": profile.log_directory,
    }
    options: dict[str, Any] = {key: value for key, value in optional.items() if value is not None}
    if system in ("lsf", "sge") and "account" in options:
        options["project"] = options.pop("account")
    simultaneous = ["--nthreads", str(profile.cores // threads)]  # the last one of two such options applies
    return options | {
        "cores": profile.cores,
        "processes": 1,
        "memory": profile.memory,
        "worker_extra_args": simultaneous,
        "job_extra_directives": list(profile.directives),
        "job_script_prologue": list(profile.prologue),
    }
