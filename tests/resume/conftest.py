"""Fixtures of tests of resumed runs."""

import pytest

from granflow.runs import run_state


@pytest.fixture
def frequent_copies(monkeypatch):
    """The state is kept after each batch of steps."""
    monkeypatch.setattr(run_state, "KEPT_SECONDS", 0.0)
    monkeypatch.setattr(run_state, "KEPT_SHARE", float("inf"))
