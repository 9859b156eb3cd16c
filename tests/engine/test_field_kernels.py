"""Copies of fields by kernels, with more entries than threads of a dispatch."""

from types import SimpleNamespace

import numpy as np
import pytest

from granflow.engine import field_kernels
from granflow.kernel_language import ti

SHAPES = {"scalars": (20,), "rows": (4, 5)}


@pytest.fixture(params=[1, 7, 2**22])
def largest_dispatch(request, monkeypatch):
    """The largest number of threads of a dispatch."""
    monkeypatch.setattr(field_kernels, "LARGEST_DISPATCH", request.param)


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


def test_each_entry_is_copied(taichi_f64, largest_dispatch):
    sources, targets = fields_and_values(0.0), fields_and_values(1.0)
    field_kernels.build_copy([field for field, _ in sources], [field for field, _ in targets])()
    for (_, values), (target, _) in zip(sources, targets, strict=True):
        assert (target.to_numpy() == values).all()


def test_each_entry_is_cleared(taichi_f64, largest_dispatch):
    fields = [field for field, _ in fields_and_values(1.0)]
    field_kernels.build_clear(SimpleNamespace(fields=fields))()
    assert not any(field.to_numpy().any() for field in fields)
