"""Ranks work with Taichi only, see `granflow.parallel.communicator`."""

import pytest

from granflow.kernel_language import KERNELS


@pytest.fixture(autouse=True)
def taichi_only():
    if KERNELS != "taichi":
        pytest.skip(f"{KERNELS} does not work with --mpi")
