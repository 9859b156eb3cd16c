"""Views of field memory show what kernels write, and kernels read what the host writes."""

import numpy as np
import pytest

from granflow.engine import backend
from granflow.engine.fields import FieldBlock, memory_of
from granflow.kernel_language import KERNELS, ti

pytestmark = pytest.mark.skipif(KERNELS != "taichi", reason="views exist with Taichi only")

SHAPES = {"number": (7,), "vector": (5, 3), "table": (4, 6), "vectors": (4, 6, 2), "matrices": (2, 3, 3, 3)}


@pytest.fixture
def block(taichi_f64):
    """Block of interleaved and separate fields of all kinds, with batch columns between them."""
    block = FieldBlock(backend.start())
    fields = {
        "number": block.scalar(ti.i32, 7),
        "vector": block.vector(ti.f32, 5),
        "table": block.scalar(ti.i64, 4, 6),
    }
    block.column(block.parts(2), ti.f64, 24)
    fields |= {"vectors": block.vector(ti.f64, 4, 6, count=2), "matrices": block.matrix(ti.f64, 2, 3)}
    pair = ti.field(ti.f64), ti.Vector.field(2, ti.i32)
    block._placed((9,), 16, *pair)
    fields |= {"first": pair[0], "second": pair[1]}
    block.finish()
    yield block, fields
    block.free()


def numbered(shape):
    return np.arange(np.prod(shape)).reshape(shape)


def test_host_reads_what_kernels_write_and_kernels_read_what_the_host_writes(block):
    _, fields = block
    matrices, scalar, vector, table = (fields[name] for name in ("matrices", "first", "second", "table"))

    @ti.kernel
    def write():
        for i, j in matrices:
            for row, column in ti.static(ti.ndrange(3, 3)):
                matrices[i, j][row, column] = 9 * (3 * i + j) + 3 * row + column

    @ti.kernel
    def read(interleaved: ti.types.ndarray(), numbers: ti.types.ndarray()):
        for i in scalar:
            interleaved[i, 0], interleaved[i, 1], interleaved[i, 2] = scalar[i], vector[i][0], vector[i][1]
        for i, j in table:
            numbers[i, j] = table[i, j]

    write()
    assert np.array_equal(matrices.to_numpy(), numbered(SHAPES["matrices"]))
    for field in fields.values():
        field.from_numpy(1 + numbered(memory_of(field).shape).astype(memory_of(field).dtype))
    found = np.zeros((9, 3)), np.zeros((4, 6), np.int64)
    read(*found)
    expected = [1 + numbered((9,)), 1 + numbered((9, 2))]
    assert np.array_equal(found[0], np.column_stack(expected))
    assert np.array_equal(found[1], 1 + numbered((4, 6)))
    for name, shape in SHAPES.items():
        assert np.array_equal(fields[name].to_numpy(), 1 + numbered(shape)), name


def test_single_entries_are_written_and_arrays_of_another_shape_refused(block):
    held, fields = block
    fields["number"][3] = 5
    fields["vector"][2] = [1.0, 2.0, 3.0]
    assert fields["number"][3] == 5 and type(fields["number"][3]) is int
    assert fields["vector"][2][1] == 2.0
    assert fields["vector"].to_numpy()[2].tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(ValueError, match=r"shape \(1,\), but the field has \(7,\)"):
        fields["number"].from_numpy(np.ones(1, np.int32))
    assert held.clear() and not any(field.to_numpy().any() for field in fields.values())
    held.free()
    assert all(memory_of(field) is None for field in fields.values())
