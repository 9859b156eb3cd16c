"""Allocation of device fields."""

from collections.abc import Iterable
from itertools import groupby
from math import prod
from typing import Any

import numpy as np

from granflow.engine.backend import Backend
from granflow.engine.foreign_fields import new_builder
from granflow.engine.host_fields import HostBlock, host_block
from granflow.kernel_language import ti
from granflow.plan.device_arrays import DeviceArray


class FieldBlock:
    """Fields that are allocated and freed together, on a CPU in one tree; each tree costs a look-up in kernels.

    On a GPU a tree is a buffer, whose size is limited: fields that do not fit into the last tree are in a further one.
    """

    def __init__(self, backend: Backend) -> None:
        self._builders, self._size = [new_builder()], 0
        self._on_cpu, self._largest_buffer = backend.on_cpu, backend.largest_buffer
        self._trees: list[Any] = []
        self._host: HostBlock | None = None
        self.fields: list[Any] = []

    def scalar(self, dtype: Any, *shape: int) -> Any:
        """A scalar field of one or two dimensions."""
        return self._placed(shape, _size(dtype), ti.field(dtype))[0]

    def vector(self, dtype: Any, *shape: int, count: int = 3) -> Any:
        """A field of vectors of `count` adjacent components."""
        return self._placed(shape, count * _size(dtype), ti.Vector.field(count, dtype))[0]

    def matrix(self, dtype: Any, *shape: int) -> Any:
        """A field of 3 x 3 matrices."""
        return self._placed(shape, 9 * _size(dtype), ti.Matrix.field(3, 3, dtype))[0]

    def arrays(self, arrays: Iterable[DeviceArray], backend: Backend) -> dict[str, Any]:
        """Fields by name; None for an array that the plan does not need."""
        found: dict[str, Any] = {}
        for _, block in groupby(arrays, key=lambda array: array.block or array.name):
            together = list(block)
            fields = {array.name: _field(array, backend) for array in together}
            size = sum((each.width or 1) * _size(backend.types[each.dtype]) for each in together if each.wanted)
            self._placed(together[0].shape, size, *(field for field in fields.values() if field is not None))
            found |= fields
        return found

    def parts(self, count: int) -> Any:
        """`count` equal parts; each holds the complete part of several columns."""
        return self._builders[-1].dense(ti.i, count)

    def column(self, parts: Any, dtype: Any, length: int) -> Any:
        """A field [part, entry] with adjacent entries of a part; its values are lost if the block is reallocated."""
        field = ti.field(dtype)
        parts.dense(ti.j, length).place(field)
        return field

    def finish(self) -> None:
        """Allocate the fields; no field can be added afterwards."""
        self._trees = [builder.finalize() for builder in self._builders]
        self._host = host_block(self.fields, self._on_cpu)

    def clear(self) -> bool:
        """Fill all fields with zeros; returns False, and does nothing, if only a kernel can."""
        if self._host is not None:
            self._host.clear()
        return self._host is not None

    def free(self) -> None:
        """Free the memory; the fields cannot be used afterwards."""
        if self._host is not None:
            self._host.release()
            self._host = None
        while self._trees:
            self._trees.pop().destroy()

    def _placed(self, shape: tuple[int, ...], size: int, *fields: Any) -> tuple[Any, ...]:
        """Place fields of this shape, interleaved entry by entry, with `size` bytes per entry."""
        if fields:
            self._extend(prod(shape) * size)
            self._builders[-1].dense(ti.i if len(shape) == 1 else ti.ij, shape).place(*fields)
            self.fields += fields
        return fields

    def _extend(self, size: int) -> None:
        """Begin a further tree if fields of `size` bytes do not fit into the last one."""
        if self._size and self._largest_buffer is not None and self._size + size > self._largest_buffer:
            self._builders.append(new_builder())
            self._size = 0
        self._size += size


def _field(array: DeviceArray, backend: Backend) -> Any:
    """A field that is not placed yet; None for an array that the plan does not need."""
    if not array.wanted:
        return None
    dtype = backend.types[array.dtype]
    return ti.field(dtype) if array.width is None else ti.Vector.field(array.width, dtype)


def _size(dtype: Any) -> int:
    """Bytes of a number of a type of the kernel language."""
    return int(np.dtype(ti.lang.util.to_numpy_type(dtype)).itemsize)


def padded(field: Any, values: np.ndarray) -> np.ndarray:
    """Values (k, ...), followed by zeros up to the length of a field, in its type."""
    found = np.zeros((field.shape[0], *values.shape[1:]), ti.lang.util.to_numpy_type(field.dtype))
    found[: len(values)] = values
    return found


def write_padded(field: Any, values: np.ndarray) -> None:
    """Write values (k, ...) into the first k entries of a short field, and zeros into the others."""
    field.from_numpy(padded(field, values))


class Fields:
    """Fields of a group as attributes with the names of the arrays; None for an array that the plan does not need."""

    def __init__(self, fields: dict[str, Any]) -> None:
        self.__dict__.update(fields)

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)
