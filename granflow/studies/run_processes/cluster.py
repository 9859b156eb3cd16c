"""Workers as jobs of a batch system, through dask-jobqueue."""

import shutil
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from granflow.errors import GranflowError
from granflow.scene.schema import quantities as q
from granflow.scene.schema.fields import ListOf, Model, Text
from granflow.scene.validated_file import validated_file

SYSTEMS = {"slurm": "SLURMCluster", "pbs": "PBSCluster", "lsf": "LSFCluster", "sge": "SGECluster"}
"""Batch systems, and their classes in dask-jobqueue."""

SUBMIT = {"slurm": "sbatch", "pbs": "qsub", "lsf": "bsub", "sge": "qsub"}
"""Command of each batch system that submits a job."""

Lines = Annotated[tuple[Text, ...], ListOf(one=True)]


class BatchProfile(Model):
    """Jobs of a batch system, each with one worker; `dask-jobqueue` writes their scripts."""

    jobs: q.Count = Field(description="number of batch jobs, each of which takes runs one after the other")
    cores: q.Count = Field(description="cores of each batch job")
    memory: Text = Field(description="memory of each batch job, such as 8 GB")
    walltime: Text | None = Field(None, description="time limit of each batch job, such as 04:00:00")
    queue: Text | None = Field(None, description="queue or partition")
    account: Text | None = Field(None, description="account or project")
    directives: Lines = Field((), description="further lines for the batch system, such as --constraint=avx512")
    prologue: Lines = Field((), description="shell commands before the worker starts, such as module load python")
    log_directory: Text | None = Field(None, description="directory of the files with the output of the batch jobs")


def read_profile(path: Path) -> BatchProfile:
    """The profile in a YAML file. Raises FileError with all problems."""
    return validated_file(path, BatchProfile, "profile")[0]


def batch_cluster(system: str, path: Path, profile: BatchProfile, threads: int) -> Any:
    """A Dask cluster whose workers are jobs of a batch system; each run has `threads` threads.

    `path`: file of the profile, for messages. Raises GranflowError without dask-jobqueue, with too few cores per job,
    or where the batch system is not installed.
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
            f"--{system} requires the command {SUBMIT[system]}, which this machine does not have: run granflow sweep "
            "where batch jobs are submitted, or without this option."
        )
    cluster = getattr(dask_jobqueue, SYSTEMS[system])(**cluster_options(system, profile, threads))
    cluster.scale(jobs=profile.jobs)
    return cluster


def cluster_options(system: str, profile: BatchProfile, threads: int) -> dict[str, Any]:
    """Arguments of the class of dask-jobqueue: a batch job has one worker, which takes cores // threads runs."""
    optional = {
        "walltime": profile.walltime, "queue": profile.queue, "account": profile.account,
        "log_directory": profile.log_directory,
    }  # fmt: skip
    options: dict[str, Any] = {key: value for key, value in optional.items() if value is not None}
    if system in ("lsf", "sge") and "account" in options:
        options["project"] = options.pop("account")
    simultaneous = ["--nthreads", str(profile.cores // threads)]  # the last one of two such options applies
    return options | {
        "cores": profile.cores, "processes": 1, "memory": profile.memory, "worker_extra_args": simultaneous,
        "job_extra_directives": list(profile.directives), "job_script_prologue": list(profile.prologue),
    }  # fmt: skip
