"""Where runs take place: threads of this process, each with a worker process, or workers of Dask."""

import socket
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from granflow.errors import GranflowError
from granflow.io.machine import worker_count
from granflow.studies.run_processes.cluster import batch_cluster, read_profile
from granflow.studies.run_processes.run_worker import close_workers
from granflow.visible_text import numbered

CONNECT_TIMEOUT = 20.0
"""Time limit [s] for a connection to a scheduler."""


@dataclass(frozen=True)
class Workers:
    """Where runs take place.

    `jobs`: number of simultaneous runs, None for as many as there are cores or workers; `threads`: of each run;
    `scheduler`: address of a running Dask scheduler, `scheduler_file`: file with it, `batch`: name of a batch system
    and file with its profile. At most one of these three is given; without, the runs take place on this machine.
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

    Raises GranflowError if Dask is missing, the scheduler does not answer, or the runs need more cores than there are.
    """
    if workers.scheduler or workers.scheduler_file or workers.batch:
        with _dask(workers) as found:
            yield found
        return
    jobs = local_jobs(workers.jobs, workers.threads, worker_count(None)[0])
    try:
        with ThreadPoolExecutor(jobs) as executor:
            yield executor, lambda: jobs
    finally:
        close_workers()


def local_jobs(jobs: int | None, threads: int, cores: int) -> int:
    """Number of simultaneous runs on `cores` cores. Raises GranflowError if they are too few."""
    needed = threads * (jobs or 1)
    if needed > cores:
        most = f"give at most --jobs {cores // threads}" if threads <= cores else f"give at most --threads {cores}"
        available = "1 core is" if cores == 1 else f"{cores} cores are"
        runs, verb = numbered(jobs or 1, "run"), "need" if jobs and jobs > 1 else "needs"
        raise GranflowError(
            f"{runs} of {numbered(threads, 'thread')} {verb} {numbered(needed, 'core')}, but {available} there: {most}."
        )
    return jobs or cores // threads


@contextmanager
def _dask(workers: Workers) -> Iterator[tuple[Executor, Slots]]:
    """An executor of a running scheduler, or of a new one whose workers are jobs of a batch system.

    The files of the request are checked first, so that their faults are reported without Dask too.
    """
    profile = read_profile(workers.batch[1]) if workers.batch else None
    if workers.scheduler_file and not workers.scheduler_file.is_file():
        raise GranflowError(f"{workers.scheduler_file}: there is no such file; start dask scheduler --scheduler-file.")
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
        {"scheduler_file": str(workers.scheduler_file)} if workers.scheduler_file else {"address": workers.scheduler}
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
    """Raise GranflowError if the workers of one machine take more runs than its cores allow, or if there are none."""
    info = client.scheduler_info(n_workers=-1)["workers"]
    if not info:
        raise GranflowError("The scheduler has no workers: start some with dask worker ADDRESS --nthreads N.")
    try:
        cores = client.run(machine_cores)
    except Exception as error:  # any exception of a worker, such as ModuleNotFoundError
        raise GranflowError(
            f"The workers cannot run granflow ({error}): install the same version of granflow on all machines."
        ) from None
    needed: dict[str, int] = {}
    for address, (host, _) in cores.items():
        needed[host] = needed.get(host, 0) + threads * info[address]["nthreads"]
    for host, count in cores.values():
        if needed[host] > count:
            raise GranflowError(
                f"The workers on {host} take {needed[host] // threads} runs of {threads} threads, but the machine has "
                f"{count} cores: start fewer workers, or with --nthreads {max(count // threads, 1)}."
            )


def machine_cores() -> tuple[str, int]:
    """Name of this machine and number of its cores that this process can use; runs on the workers."""
    return socket.gethostname(), worker_count(None)[0]
