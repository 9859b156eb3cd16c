"""Fields with more entries than threads of a dispatch on Vulkan, 65 535 groups of 128."""

import numpy as np
import pytest
from subprocess_runner import in_subprocess

from granflow import start
from granflow.engine.fields import read_field, write_field
from granflow.kernel_language import ti

pytestmark = pytest.mark.gpu

LENGTH = 65_535 * 128 + 100_000


def error_of_to_numpy():
    """Message of the kernel language where it copies such a field to the host; empty if it does."""
    start("vulkan", "f32")
    field = ti.field(ti.i32, LENGTH)
    try:
        field.to_numpy()
    except RuntimeError as error:
        return str(error)
    return ""


def test_canary_the_kernel_language_does_not_copy_long_fields(vulkan):
    """If this fails, `read_field` and `write_field` may be replaced."""
    assert "Dispatch error" in in_subprocess(error_of_to_numpy)


def wrong_entries():
    """Number of entries that differ after they are written to a field and read again."""
    start("vulkan", "f32")
    field = ti.field(ti.i32, LENGTH)
    values = np.arange(1, LENGTH - 6, dtype=np.int32)
    write_field(field, values)
    found = read_field(field)
    return int((found[: len(values)] != values).sum()) + int(np.count_nonzero(found[len(values) :]))


def test_long_fields_are_copied_to_the_host_and_back(vulkan):
    assert in_subprocess(wrong_entries) == 0
