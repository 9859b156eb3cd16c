"""Fixtures of the whole session."""

import os
from pathlib import Path

import pytest

from granflow import start
from granflow.engine import state_cache

os.environ.setdefault("GRANFLOW_CACHE", str(Path(__file__).parent.parent / ".pytest_cache" / "kernels"))
"""Cache of compiled kernels: shared by all test processes, separate from the user's cache."""

state_cache.restarts_for_structures = False


@pytest.fixture(scope="module")
def taichi_f64():
    """Taichi on the CPU in double precision with two threads."""
    start("cpu", "f64", 2)
