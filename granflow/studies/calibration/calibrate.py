"""`granflow.calibrate`: a calibration from Python."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from granflow.arguments import path_of, whole_number
from granflow.errors import GranflowError
from granflow.studies.calibration.run import read_calibration, run_calibration


def calibrate(
    source: str | os.PathLike[str] | Mapping[str, Any],
    out: str | os.PathLike[str] | None = None,
    jobs: int | None = None,
    threads: int = 1,
) -> Any:
    """Determine parameters of scenes from measured targets; return the best values as a pandas DataFrame.

        best = granflow.calibrate("calibration.yaml", jobs=2)

    source:   calibration file (YAML), or a mapping with the same keys, with paths relative to the working directory
    out:      directory of the results; default: out/NAME. Trials in it that have ended are not repeated
    jobs:     simultaneous trials; default: cores / threads
    threads:  CPU threads of each run
    Returns:  one row per parameter: value in the best trial, optimum_of_fit and its standard_deviation (SI),
              identified, remark. `attrs`: loss, and the lists targets and conflicts
    Raises:   GranflowError with all problems of the calibration, if no trial was completed, or if Optuna or pandas
              (pip install pandas) is missing
    """
    study = read_calibration(source)
    try:
        import pandas
    except ImportError:
        raise GranflowError(
            "granflow.calibrate returns a DataFrame of pandas, which is not installed: pip install pandas"
        ) from None
    out = Path("out") / study.name if out is None else path_of("out", out)
    jobs = None if jobs is None else whole_number("jobs", jobs, 1)
    result = run_calibration(study, out, jobs, whole_number("threads", threads, 1))
    if result is None:
        raise GranflowError("No trial was completed, so there are no best values.")
    table = pandas.DataFrame(
        [
            (each.value, each.optimum, each.deviation, not each.not_identified, each.not_identified)
            for each in result.parameters
        ],
        index=[each.name for each in result.parameters],
        columns=["value", "optimum_of_fit", "standard_deviation", "identified", "remark"],
    )
    table.attrs = {
        "loss": result.loss,
        "targets": [each._asdict() for each in result.targets],
        "conflicts": list(result.conflicts),
    }
    return table
