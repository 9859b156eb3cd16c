"""Copies of fields by kernels, with more entries than threads of a dispatch."""

from types import SimpleNamespace

import numpy as np
import pytest
from subprocess_runner import in_subprocess

from granflow import start
from granflow.engine import fields as dispatch
from granflow.engine import fields as field_kernels
from granflow.kernel_language import ti

SHAPES = {"scalars": (20,), "rows": (4, 5)}


def fields_and_values(offset):
    """A scalar field and a vector field of each shape, and their random values."""
    rng = np.random.default_rng(1)
    found = []
    for shape in SHAPES.values():
        for field, components in ((ti.field(ti.f64, shape), ()), (ti.Vector.field(3, ti.f64, shape), (3,))):
            values = offset + rng.random((*shape, *components))
            field.from_numpy(values)
            found.append((field, values))
    return found


def wrong_entries():
    """Numbers of entries that are not copied and not cleared, for three largest numbers of threads."""
    start("cpu", "f64", 2)
    found = []
    for dispatch.LARGEST_DISPATCH in (1, 7, 2**22):
        sources = fields_and_values(0.0)
        targets = fields_and_values(1.0)
        fields = [field for field, _ in targets]
        field_kernels.build_copy([field for field, _ in sources], fields)()
        pairs = [(values, target.to_numpy()) for (_, values), target in zip(sources, fields, strict=True)]
        not_copied = sum(int((values != copied).sum()) for values, copied in pairs)
        field_kernels.build_clear(SimpleNamespace(fields=fields))()
        found.append((not_copied, sum(int(np.count_nonzero(field.to_numpy())) for field in fields)))
    return found


def wrong_values():
    """Numbers of values that differ after fields are read to the host, written to longer ones, and read
    again."""
    wrong = 0
    for field, values in fields_and_values(0.0):
        longer = (2 * field.shape[0], *field.shape[1:])
        target = (
            ti.Vector.field(3, ti.f64, longer) if values.ndim > len(field.shape) else ti.field(ti.f64, longer)
        )
        target.fill(1.0)
        field_kernels.write_field(target, field_kernels.read_field(field))
        found = field_kernels.read_field(target)
        wrong += int((found[: len(values)] != values).sum()) + int(np.count_nonzero(found[len(values) :]))
    return wrong


def wrong():
    return wrong_entries(), wrong_values()


@pytest.mark.slow
def test_each_entry_is_copied_cleared_and_read_to_the_host():
    """In a process of its own: fields of a program prevent that other tests restart Taichi."""
    assert in_subprocess(wrong) == [[[0, 0]] * 3, 0]
