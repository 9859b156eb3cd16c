"""Fixtures for the whole session: Taichi can be started once per process only."""

import pytest
import taichi as ti


@pytest.fixture(scope="session")
def taichi_f64():
    """Taichi on the CPU in double precision, every operation rounded as written."""
    ti.init(arch=ti.cpu, default_fp=ti.f64, fast_math=False)
