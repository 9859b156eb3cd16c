"""`granflow.sweep`: a sweep from Python."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from granflow.arguments import path_of, whole_number
from granflow.errors import GranflowError
from granflow.studies.run_processes.executors import Workers
from granflow.studies.sweep.run import read_sweep, run_sweep


def sweep(
    source: str | os.PathLike[str] | Mapping[str, Any],
    out: str | os.PathLike[str] | None = None,
    jobs: int | None = None,
    threads: int = 1,
    scheduler: str | None = None,
    arch: str = "cpu",
) -> Any:
    """Run a scene for many parameter values and return the table as a pandas DataFrame, one row per point.

        table = granflow.sweep("sweep.yaml", jobs=2)

    source:     sweep file (YAML), or a mapping with the same keys, where paths are relative to the working directory
    out:        directory of the results; default: out/NAME. Runs in it that have ended are not repeated
    jobs:       simultaneous runs; default: cores / threads, or as many as the workers of the scheduler take
    threads:    CPU threads of each run
    scheduler:  address of a Dask scheduler, such as tcp://10.0.0.1:8786; default: processes on this machine
    Returns:    columns as in sweep.csv: parameters, status, reason, seconds [s], quantities [SI], run directories
    Raises:     GranflowError with all problems of the sweep, or if pandas (pip install pandas) is missing
    """
    study = read_sweep(source)
    try:
        import pandas
    except ImportError:
        raise GranflowError(
            "granflow.sweep returns a DataFrame of pandas, which is not installed: pip install pandas"
        ) from None
    out = Path("out") / study.name if out is None else path_of("out", out)
    jobs = None if jobs is None else whole_number("jobs", jobs, 1)
    threads = whole_number("threads", threads, 1)
    table = run_sweep(study, out, Workers(jobs, threads, scheduler), arch)
    return pandas.DataFrame(table.columns())
