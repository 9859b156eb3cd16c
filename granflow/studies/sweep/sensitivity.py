"""Sobol indices of a sweep with Saltelli's design, by SALib."""

from typing import NamedTuple

import numpy as np

from granflow.studies.sweep.schema import SobolSampling, SweepInput
from granflow.studies.sweep.table import SweepTable

RESAMPLES = 1000
"""Bootstrap samples for the confidence intervals."""


class SobolIndices(NamedTuple):
    """Indices of one quantity, each (parameters,), with the half widths of their 95 % confidence intervals.

    `first`: share of the variance that each parameter explains alone; `total`: share including its interactions.
    """

    quantity: str
    first: np.ndarray
    first_interval: np.ndarray
    total: np.ndarray
    total_interval: np.ndarray


def sobol_indices(sweep: SweepInput, table: SweepTable) -> tuple[list[SobolIndices], str]:
    """First-order and total Sobol indices of each quantity, and a sentence if some are missing.

    Neither for other samplings than Saltelli's design.

    (I. M. Sobol, Math. Comput. Simul. 55 (2001) 271; A. Saltelli et al., Comput. Phys. Commun. 181 (2010) 259.)
    """
    if not isinstance(sweep.sampling, SobolSampling):
        return [], ""
    try:
        from SALib.analyze import sobol
    except ImportError:
        return [], "Sobol indices require SALib, which is not installed: pip install SALib"
    problem = {"num_vars": len(table.parameters), "names": list(table.parameters)}
    found, missing = [], []
    for name in table.quantities:
        values = np.array([row.mean(name) for row in table.rows])
        if not np.isfinite(values).all():
            missing.append(f"{name} is missing at {int((~np.isfinite(values)).sum())} of {len(values)} points.")
        elif values.std() == 0.0:
            missing.append(f"{name} is the same at all points.")
        else:
            indices = sobol.analyze(
                problem, values, calc_second_order=False, num_resamples=RESAMPLES, seed=sweep.sampling.seed
            )
            found.append(SobolIndices(name, *(np.asarray(indices[key]) for key in ("S1", "S1_conf", "ST", "ST_conf"))))
    return found, " ".join(missing)
