"""The program that replaces runs in tests of sweeps and calibrations."""

import sys
from pathlib import Path

import pytest

from granflow.studies import run_process

STAND_IN = (sys.executable, "-S", str(Path(__file__).with_name("stand_in.py")))


@pytest.fixture
def stand_in(monkeypatch):
    """Runs are carried out by stand_in.py."""
    monkeypatch.setattr(run_process, "PROGRAM", STAND_IN)
