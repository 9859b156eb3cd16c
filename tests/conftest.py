"""Fixtures for the whole session: Taichi can be started once per process only."""

import os
from pathlib import Path

import pytest

from granflow.device import backend

os.environ.setdefault("GRANFLOW_CACHE", str(Path(__file__).parent.parent / ".pytest_cache" / "kernels"))
"""Compiled kernels of the tests: shared by all processes, and not in the user's own cache."""


@pytest.fixture(scope="session")
def taichi_f64():
    """The CPU in double precision on two threads.

    Other settings run in a process of their own, see `subprocess_runner`.
    """
    backend.start("cpu", "f64", 2)
