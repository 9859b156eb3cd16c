"""Fixtures for the whole session: Taichi can be started once per process only."""

import pytest

from granflow.device import backend


@pytest.fixture(scope="session")
def taichi_f64():
    """The CPU in double precision on two threads; other settings run in a process of their own, see `child`."""
    backend.start("cpu", "f64", 2)
