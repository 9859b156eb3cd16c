"""Starts programs on MPI ranks, with the mpirun of a PyPI wheel in this environment or of the system."""

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from shutil import which

ROOT = Path(__file__).parent.parent
WHEEL_MPIRUN = Path(sys.executable).parent / "mpirun"
MPIRUN = str(WHEEL_MPIRUN) if WHEEL_MPIRUN.exists() else which("mpirun")

MISSING = ""
"""Why ranks cannot be started; empty if they can."""
if find_spec("mpi4py") is None:
    MISSING = "needs mpi4py: pip install mpi4py"
elif MPIRUN is None:
    MISSING = "needs mpirun: pip install mpich"

OPEN_MPI = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "OMPI_MCA_mpi_yield_when_idle": "1",
}
"""Variables with which Open MPI starts more ranks than cores, also for root in a container; idle ranks
yield."""


def environment():
    """Variables of programs on ranks: this source, and those for Open MPI."""
    return os.environ | OPEN_MPI | {"PYTHONPATH": str(ROOT)}


def on_ranks(ranks, *arguments, seconds=250):
    """The completed process of `mpirun -n ranks python arguments`; stdout and stderr are text."""
    return _completed(MPIRUN, "-n", ranks, sys.executable, *arguments, seconds=seconds)


def alone(*arguments, seconds=250):
    """The completed process of `python arguments`."""
    return _completed(sys.executable, *arguments, seconds=seconds)


def _completed(*command, seconds):
    command = [str(each) for each in command]
    return subprocess.run(command, capture_output=True, text=True, timeout=seconds, env=environment())


def is_open_mpi():
    """Whether mpirun is that of Open MPI, which kills the ranks about a second after it has received a
    signal."""
    return "Open MPI" in _completed(MPIRUN, "--version", seconds=60).stdout
