"""Fixtures of the whole session."""

import gc
import os
from importlib.util import find_spec
from pathlib import Path

import pytest

from granflow import start
from granflow.engine import state_cache
from granflow.plan import cost

CACHE = Path(__file__).parent.parent / ".pytest_cache"

os.environ.setdefault("GRANFLOW_CACHE", str(CACHE / "kernels"))
"""Cache of compiled kernels: shared by all test processes, separate from the user's cache."""

if find_spec("taichi"):
    os.environ.setdefault("GRANFLOW_KERNELS", "taichi")
    """Kernel language of commands, as in an installation without extras; `bits` compares with Quadrants."""

os.environ["PYTHONPYCACHEPREFIX"] = str(CACHE / "bytecode")
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
"""Compiled modules for the subprocesses, also where the environment or the folder of the clone refuses
them."""

os.environ["OPENBLAS_NUM_THREADS"] = "1"
"""Idle threads of numpy's linear algebra spin, at the cost of the other test processes."""

state_cache.restarts_for_structures = False
state_cache.MOST_STATES = 100
cost.OPTIMIZED_ABOVE = 100.0
"""Tests compile for short runs; `bits` compares with kernels of long runs."""


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect tests without garbage collection, and keep it off the modules of the tests later.

    It would search the syntax trees and modules of all tests again and again, for half of the time of the collection.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(scope="module")
def taichi_f64():
    """Taichi on the CPU in double precision with two threads."""
    start("cpu", "f64", 2)
