"""How a GPU backend rounds, and what granflow replaces of it, without its engine."""

import pytest
from subprocess_runner import in_subprocess

pytestmark = pytest.mark.gpu


def rounding(arch):
    """Number of results, by expression, that differ from numpy."""
    import numpy as np
    import quadrants as ti

    ti.init(arch=getattr(ti, arch), default_fp=ti.f64, fast_math=False)  # as granflow
    rng = np.random.default_rng(2)
    a, b, c = (10.0 ** rng.uniform(-1, 1, 2000) for _ in range(3))
    found = np.zeros((2000, 8))

    @ti.kernel
    def evaluate(
        a: ti.types.ndarray(), b: ti.types.ndarray(), c: ti.types.ndarray(), found: ti.types.ndarray()
    ):
        for i in range(2000):
            found[i, 0] = a[i] * b[i] + c[i] * c[i]
            found[i, 1] = (a[i] - b[i]) / c[i]
            found[i, 2] = ti.sqrt(a[i] * a[i] + 1.0)
            found[i, 3] = a[i] - (a[i] + b[i])
            found[i, 4] = (a[i] + b[i]) - a[i]
            found[i, 5] = (a[i] * 0.3) * 0.7
            found[i, 6] = a[i] / 3.0
            found[i, 7] = a[i] * b[i] + a[i] * c[i]

    evaluate(a, b, c, found)
    exact = [
        a * b + c * c,
        (a - b) / c,
        np.sqrt(a * a + 1.0),
        a - (a + b),
        (a + b) - a,
        (a * 0.3) * 0.7,
        a / 3.0,
    ]
    return np.count_nonzero(found != np.stack([*exact, a * b + a * c], axis=1), axis=0).tolist()


def test_each_operation_has_the_bits_of_numpy(vulkan):
    """Vulkan drivers reassociate the other expressions: neither kernel language marks operations as exact."""
    assert in_subprocess(rounding, "cpu") == [0] * 8
    assert in_subprocess(rounding, "vulkan")[:4] == [0] * 4


def copies_of_a_long_field():
    """Message of the kernel language where it copies a field with more entries than threads of a dispatch,
    65 535 groups of 128, and the number of entries that differ after they are written and read again."""
    import numpy as np

    from granflow import start
    from granflow.engine.fields import read_field, write_field
    from granflow.kernel_language import ti

    start("vulkan", "f32")
    field = ti.field(ti.i32, 65_535 * 128 + 100_000)
    values = np.arange(1, field.shape[0] - 6, dtype=np.int32)
    write_field(field, values)
    found = read_field(field)
    wrong = int((found[: len(values)] != values).sum()) + int(np.count_nonzero(found[len(values) :]))
    try:
        field.to_numpy()
    except RuntimeError as error:
        return str(error), wrong
    return "", wrong


def test_long_fields_are_copied_by_granflow_and_not_by_the_kernel_language(vulkan):
    """If only the first part fails, `read_field` and `write_field` may be replaced."""
    message, wrong = in_subprocess(copies_of_a_long_field)
    assert "Dispatch error" in message and wrong == 0
