"""What granflow requires from a GPU backend, without its engine: each of these was wrong in one of them."""

import pytest
from subprocess_runner import in_subprocess

pytestmark = pytest.mark.gpu

COUNT = 101


def started(arch):
    """The kernel language, started without granflow's settings except those on rounding."""
    import quadrants

    quadrants.init(arch=getattr(quadrants, arch), default_fp=quadrants.f64, fast_math=False)
    return quadrants


def after_inner_loop(arch):
    """Values written after an inner loop of run-time length with two atomic operations: 1 for each entry.

    llvmpipe of Mesa 22.3 writes none of them.
    """
    ti = started(arch)
    largest = ti.field(ti.i32, 1)
    smallest = ti.field(ti.i32, 1)
    written = ti.field(ti.i32, COUNT)

    @ti.kernel
    def scan(length: ti.i32):
        for i in range(COUNT):
            for k in range(length):
                if k * i % 7 == 3:
                    ti.atomic_max(largest[0], i)
                    ti.atomic_min(smallest[0], -i)
            written[i] = 1

    scan(9)
    return [int(written.to_numpy().sum()), int(largest[0]), int(smallest[0])]


def test_statements_after_an_inner_loop_with_two_atomics_are_executed(vulkan):
    found = in_subprocess(after_inner_loop, "vulkan")
    last = max(i for i in range(COUNT) if any(k * i % 7 == 3 for k in range(9)))
    assert found == [COUNT, last, -last]


def neighboring_fields(arch):
    """Two integer fields around an f64 field of odd offset, after all three are written in one tree.

    Taichi 1.7 on Vulkan overwrites an integer field, because the f64 field is not aligned.
    """
    ti = started(arch)
    before = ti.field(ti.i32)
    reals = ti.Vector.field(3, ti.f64)
    after = ti.field(ti.i32)
    builder = ti.FieldsBuilder()
    for field, length in ((before, COUNT), (reals, COUNT), (after, COUNT)):
        builder.dense(ti.i, length).place(field)
    builder.finalize()

    @ti.kernel
    def write_integers():
        for i in range(COUNT):
            before[i] = i
            after[i] = -i

    @ti.kernel
    def write_reals():
        for i in range(COUNT):
            reals[i] = ti.Vector([1.0 / 3.0, 2.0 / 3.0, -1.0 / 3.0], dt=ti.f64)

    write_integers()
    write_reals()
    numbers = [field.to_numpy().tolist() for field in (before, after)]
    written = reals.to_numpy()
    return [*numbers, float(written.min()), float(written.max())]


def test_f64_field_at_an_odd_offset_leaves_its_neighbors(vulkan):
    before, after, lowest, highest = in_subprocess(neighboring_fields, "vulkan")
    assert before == list(range(COUNT)) and after == [-i for i in range(COUNT)]
    assert (lowest, highest) == (-1.0 / 3.0, 2.0 / 3.0)


def rounding(arch):
    """Number of results, by expression, that differ from numpy."""
    import numpy as np

    ti = started(arch)
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
