"""Device fields: their allocation, access from the host, and loops over their entries.

A `FieldBlock` allocates fields together. On a CPU their memory is that of the process, so that the host reads
and writes a field in place (`HostBlock`): for each field that the host copies otherwise, Taichi compiles
kernels, which takes 10 to 20 ms each at every start, and an access takes 10 to 100 us. Views of the memory
need one kernel per block, which returns its address. On a GPU, kernels copy fields (`read_field`,
`write_field`).
"""

import ctypes
from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from math import prod
from typing import Any

import numpy as np

from granflow.engine.backend import Backend, new_builder
from granflow.kernel_language import ti
from granflow.plan.arrays import DeviceArray

# Allocation


class FieldBlock:
    """Fields that are allocated and freed together, on a CPU in one tree; each tree costs a look-up in
    kernels.

    On a GPU a tree is a buffer, whose size is limited: fields that do not fit into the last tree are in a
    further one.
    """

    def __init__(self, backend: Backend) -> None:
        self._builders = [new_builder()]
        self._size = 0
        self._on_cpu = backend.on_cpu
        self._largest_buffer = backend.largest_buffer
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
            size = sum(
                (each.width or 1) * _size(backend.types[each.dtype]) for each in together if each.wanted
            )
            self._placed(together[0].shape, size, *(field for field in fields.values() if field is not None))
            found |= fields
        return found

    def parts(self, count: int) -> Any:
        """`count` equal parts; each holds the complete part of several columns."""
        return self._builders[-1].dense(ti.i, count)

    def column(self, parts: Any, dtype: Any, length: int) -> Any:
        """A field [part, entry] with adjacent entries of a part; its values are lost if the block is
        reallocated."""
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


class Fields:
    """Fields of a group as attributes with the names of the arrays; None for an array that the plan does not
    need."""

    def __init__(self, fields: dict[str, Any]) -> None:
        self.__dict__.update(fields)

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)


# Views of the memory on a CPU


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


def _refuse_other_shape(memory: np.ndarray, array: np.ndarray) -> None:
    """Raise ValueError for an array of another shape, which numpy might broadcast."""
    if memory.shape != array.shape:
        raise ValueError(f"The array has the shape {array.shape}, but the field has {memory.shape}.")


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
        scalars = components(field)
        dtype = np.dtype(ti.lang.util.to_numpy_type(field.dtype))
        lengths = field.shape
        cell_size = _cells(scalars[0]).cell_size_bytes
        strides = [cell_size] if len(lengths) == 1 else [cell_size * lengths[1], cell_size]
        if hasattr(field, "n"):
            lengths += (field.n,) if field.m == 1 else (field.n, field.m)
            strides += [dtype.itemsize] if field.m == 1 else [dtype.itemsize * field.m, dtype.itemsize]
        return np.ndarray(lengths, dtype, self._bytes, _offset(scalars[0]), strides)


def host_block(fields: list[Any], on_cpu: bool) -> HostBlock | None:
    """Views of the fields of an allocated block; None on a GPU."""
    return HostBlock(fields) if on_cpu and fields else None


def memory_of(field: Any) -> np.ndarray | None:
    """View (n, ...) of the entries of a field with the components along the last axis; None if only kernels
    copy it."""
    memory: np.ndarray | None = getattr(field, "memory", None)
    return memory


def records_of(fields: Sequence[Any]) -> np.ndarray:
    """View (n,) of the entries of interleaved fields as records of bytes, without regard to types.

    fields:  all of one block of interleaved arrays, the first one first; see `memory_of`
    """
    memory = fields[0].memory
    size = memory.strides[0]
    begin = memory.ctypes.data
    assert all(
        begin <= each.memory.ctypes.data < begin + size and each.memory.strides[0] == size for each in fields
    )
    return np.ndarray(len(memory), f"V{size}", (ctypes.c_char * (size * len(memory))).from_address(begin))


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


# Values of a whole field


def padded(field: Any, values: np.ndarray) -> np.ndarray:
    """Values (k, ...), followed by zeros up to the length of a field, in its type."""
    found = np.zeros((field.shape[0], *values.shape[1:]), ti.lang.util.to_numpy_type(field.dtype))
    found[: len(values)] = values
    return found


def write_padded(field: Any, values: np.ndarray) -> None:
    """Write values (k, ...) into the first k entries of a short field, and zeros into the others."""
    field.from_numpy(padded(field, values))


def read_field(field: Any) -> np.ndarray:
    """Values of all entries of a field, as from `to_numpy`."""
    if memory_of(field) is not None:
        return np.asarray(field.to_numpy())
    values = np.zeros(_table_shape(field), ti.lang.util.to_numpy_type(field.dtype))
    _build_host_copy(field, True)(values)
    shape = (*field.shape, field.n) if hasattr(field, "n") else field.shape
    return values.reshape(shape)


def write_field(field: Any, values: np.ndarray) -> None:
    """As `write_padded`, for fields of any length."""
    all_values = padded(field, values)
    if memory_of(field) is not None:
        field.from_numpy(all_values)
    else:
        _build_host_copy(field, False)(all_values.reshape(_table_shape(field)))


def _table_shape(field: Any) -> tuple[int, int]:
    """Numbers of entries and of components of a field."""
    return prod(field.shape), len(components(field))


def _build_host_copy(field: Any, to_host: bool) -> Callable[[np.ndarray], None]:
    """Kernel (table): copy all entries of a field to or from a table (entries, components)."""
    scalars = [*enumerate(components(field))]
    index_of = _index_in(field.shape)
    external: Any = ti.types.ndarray()

    @ti.kernel
    def host_copy(table: external):
        # The length is no constant: such a loop has as many threads as the device executes well.
        for entry in range(table.shape[0]):
            for c, scalar in ti.static(scalars):
                if ti.static(to_host):
                    table[entry, c] = scalar[index_of(entry)]
                else:
                    scalar[index_of(entry)] = table[entry, c]

    return host_copy


# Kernels on all fields of a block: fill them with zeros, copy them to longer ones
#
# Loops over fields of any length: the `fill`, `to_numpy` and `from_numpy` of the kernel language fail on
# Vulkan above the largest dispatch.

UNROLLED = 16
"""Fields that one loop processes; the kernel language warns of more than 32 statements without a loop."""


def build_clear(state: Any) -> Callable[[], None]:
    """Kernel (): fill all fields with zeros.

    Writes:  all fields of the state
    """

    @ti.func
    def clear(_source, target: ti.template(), index):
        target[index] = 0

    return _on_all_entries([(field, field) for field in state.fields], clear)


def build_copy(sources: Sequence[Any], targets: Sequence[Any]) -> Callable[[], None]:
    """Kernel (): copy each field to the first entries of another one of the same type, as long or longer.

    Reads:   sources
    Writes:  targets
    """

    @ti.func
    def copy(source: ti.template(), target: ti.template(), index):
        target[index] = source[index]

    return _on_all_entries([*zip(sources, targets, strict=True)], copy)


def _on_all_entries(pairs: Sequence[tuple[Any, Any]], process: Any) -> Callable[[], None]:
    """Kernel () that calls a device function (source, target, index) for all entries of each pair of scalar
    fields."""
    loops = [_loop(group, process) for group in _groups(pairs)]

    @ti.kernel
    def on_all_entries():
        for length, threads, entries_of_thread in ti.static(loops):
            for thread in range(threads):
                entries_of_thread(thread, length, 0)

    return on_all_entries


def _loop(group: list[tuple[Any, Any]], process: Any) -> tuple[int, int, Any]:
    """Entries of each source of the group, threads for them, and the device function of a thread."""
    shape = group[0][0].shape
    length = prod(shape)
    index_of = _index_in(shape)

    @ti.func
    def process_entry(entry, _argument):
        for source, target in ti.static(group):
            process(source, target, index_of(entry))

    return length, thread_count(length), build_tasks_of_thread(process_entry, length)


def _index_in(shape: tuple[int, ...]) -> Any:
    """Device function (entry): index in fields of one or two axes of an entry, counted along the last axis
    first."""
    columns = shape[-1]

    @ti.func
    def along_one_axis(entry):
        return ti.Vector([entry])

    @ti.func
    def along_two_axes(entry):
        return ti.Vector([entry // columns, entry % columns])

    return along_one_axis if len(shape) == 1 else along_two_axes


def _groups(pairs: Sequence[tuple[Any, Any]]) -> list[list[tuple[Any, Any]]]:
    """Pairs of the scalar fields of each pair of fields, in groups of equal shape of the first."""
    by_shape: dict[tuple[int, ...], list[tuple[Any, Any]]] = {}
    for source, target in pairs:
        scalars = zip(components(source), components(target), strict=True)
        by_shape.setdefault(source.shape, []).extend(scalars)
    return [each[k : k + UNROLLED] for each in by_shape.values() for k in range(0, len(each), UNROLLED)]


# Loops on a GPU with at most as many threads as each device supports; in longer ones a thread has several
# tasks

LARGEST_DISPATCH = 2**22
"""Largest number of threads of a loop. Vulkan guarantees 65 535 groups per dispatch, of 128 threads each."""


def thread_count(most_tasks: int) -> int:
    """Length of a loop over at most `most_tasks` tasks."""
    return min(most_tasks, LARGEST_DISPATCH)


def build_tasks_of_thread(body: Any, most_tasks: int) -> Any:
    """Device function (thread, count, argument): call `body` for each of the `count` tasks that the thread
    has.

    body:        device function (task, argument)
    most_tasks:  largest `count`
    """
    stride = thread_count(most_tasks)

    @ti.func
    def only_task(thread, count, argument):
        if thread < count:
            body(thread, argument)

    @ti.func
    def each_task(thread, count, argument):
        task = thread
        while task < count:
            body(task, argument)
            task += stride

    return only_task if most_tasks == stride else each_task
