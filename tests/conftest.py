"""Fixtures of the whole session: Taichi can be initialized only once per process."""

import os
from pathlib import Path

import pytest

from granflow.engine import backend

os.environ.setdefault("GRANFLOW_CACHE", str(Path(__file__).parent.parent / ".pytest_cache" / "kernels"))
"""Cache of compiled kernels: shared by all test processes, separate from the user's cache."""


@pytest.fixture(scope="session")
def taichi_f64():
    """Taichi on the CPU in double precision with two threads.

    Other settings require a separate process, see `subprocess_runner`.
    """
    backend.start("cpu", "f64", 2)
