"""Fields that the host reads and writes in place: on a CPU their memory is that of the process.

For each field that the host copies or reads, Taichi compiles kernels, which takes 10 to 20 ms each at every start, and
an access takes 10 to 100 us. Views of the memory need one kernel per block of fields, which returns its address.
"""

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np

from granflow.kernel_language import KERNELS, ti


class _HostScalars(ti.ScalarField):
    """Scalar field with a view `memory` of its entries."""

    def __getitem__(self, index: Any) -> Any:
        return self.memory[index].item()

    def __setitem__(self, index: Any, value: Any) -> None:
        self.memory[index] = value

    def to_numpy(self, dtype: Any = None) -> np.ndarray:
        return np.array(self.memory, dtype)

    def from_numpy(self, array: np.ndarray) -> None:
        _refuse_other_shape(self.memory, array)
        self.memory[...] = array

    def fill(self, value: Any) -> None:
        self.memory[...] = value

    def copy_from(self, other: Any) -> None:
        self.from_numpy(other.memory)


class _HostMatrices(ti.MatrixField):
    """Field of vectors or matrices with a view `memory`, whose last axes are the components."""

    __setitem__ = _HostScalars.__setitem__
    from_numpy = _HostScalars.from_numpy
    fill = _HostScalars.fill
    copy_from = _HostScalars.copy_from

    def to_numpy(self, keep_dims: bool = False, dtype: Any = None) -> np.ndarray:
        return np.array(self.memory, dtype)


_HOST_CLASSES = {ti.ScalarField: _HostScalars, ti.MatrixField: _HostMatrices}


def memory_of(field: Any) -> np.ndarray | None:
    """View (n, ...) of the entries of a field with the components along the last axis; None if only kernels copy it."""
    memory: np.ndarray | None = getattr(field, "memory", None)
    return memory


def records_of(fields: Sequence[Any]) -> np.ndarray:
    """View (n,) of the entries of interleaved fields as records of bytes, without regard to types.

    fields:  all of one block of interleaved arrays, the first one first; see `memory_of`
    """
    memory = fields[0].memory
    size = memory.strides[0]
    begin = memory.ctypes.data
    assert all(begin <= each.memory.ctypes.data < begin + size and each.memory.strides[0] == size for each in fields)
    return np.ndarray(len(memory), f"V{size}", (ctypes.c_char * (size * len(memory))).from_address(begin))


class HostBlock:
    """Views of all fields of one allocated block.

    fields:  fields of one or two axes, each in dense cells directly in the block
    """

    def __init__(self, fields: list[Any]) -> None:
        self.fields = fields
        first = components(fields[0])[0]
        root = _cells(first).parent
        begin = _address_of(len(first.shape))(first) - _offset(first)
        self._bytes = (ctypes.c_char * root.cell_size_bytes).from_address(begin)
        for field in fields:
            field.memory = self._view(field)
            field.__class__ = _HOST_CLASSES[field.__class__]

    def clear(self) -> None:
        """Fill the block with zeros."""
        ctypes.memset(self._bytes, 0, len(self._bytes))

    def release(self) -> None:
        """Remove the views, before the memory is freed."""
        classes = {host: original for original, host in _HOST_CLASSES.items()}
        for field in self.fields:
            field.__class__ = classes[field.__class__]
            field.memory = None

    def _view(self, field: Any) -> np.ndarray:
        """View of one field: entries along its axes, then components."""
        scalars, dtype = components(field), np.dtype(ti.lang.util.to_numpy_type(field.dtype))
        lengths, cell_size = field.shape, _cells(scalars[0]).cell_size_bytes
        strides = [cell_size] if len(lengths) == 1 else [cell_size * lengths[1], cell_size]
        if hasattr(field, "n"):
            lengths += (field.n,) if field.m == 1 else (field.n, field.m)
            strides += [dtype.itemsize] if field.m == 1 else [dtype.itemsize * field.m, dtype.itemsize]
        return np.ndarray(lengths, dtype, self._bytes, _offset(scalars[0]), strides)


def host_block(fields: list[Any], on_cpu: bool) -> HostBlock | None:
    """Views of the fields of an allocated block; None on a GPU, and with Quadrants, whose layout is not verified."""
    return HostBlock(fields) if on_cpu and KERNELS == "taichi" and fields else None


def components(field: Any) -> list[Any]:
    """Scalar fields of the components of a field, row by row."""
    if not hasattr(field, "n"):
        return [field]
    indices = np.ndindex(field.n, field.m)
    return [field.get_scalar_field(i, j) if field.m > 1 else field.get_scalar_field(i) for i, j in indices]


def _cells(scalar: Any) -> Any:
    """The cells that contain the entries of a scalar field."""
    return scalar.snode.ptr.parent


def _offset(scalar: Any) -> int:
    """Offset [bytes] of the first entry of a scalar field in its block."""
    return int(scalar.snode.ptr.offset_bytes_in_parent_cell + _cells(scalar).offset_bytes_in_parent_cell)


def _address_of(axis_count: int) -> Any:
    """Kernel (field): address of the first entry of a scalar field."""
    first = [0] * axis_count

    @ti.kernel
    def address(field: ti.template()) -> ti.u64:
        return ti.get_addr(field, first)

    return address


def _refuse_other_shape(memory: np.ndarray, array: np.ndarray) -> None:
    """Raise ValueError for an array of another shape, which numpy might broadcast."""
    if memory.shape != array.shape:
        raise ValueError(f"The array has the shape {array.shape}, but the field has {memory.shape}.")
