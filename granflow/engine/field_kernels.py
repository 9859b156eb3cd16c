"""Kernels on all fields of a block: fill them with zeros, copy them to longer ones, to the host and back.

Loops over fields of any length: the `fill`, `to_numpy` and `from_numpy` of the kernel language fail on Vulkan above
the largest dispatch.
"""

from collections.abc import Callable, Sequence
from math import prod
from typing import Any

import numpy as np

from granflow.engine.dispatch import build_tasks_of_thread, thread_count
from granflow.engine.field_block import padded
from granflow.engine.host_fields import components, memory_of
from granflow.kernel_language import ti

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


def read_field(field: Any) -> np.ndarray:
    """Values of all entries of a field, as from `to_numpy`."""
    if memory_of(field) is not None:
        return np.asarray(field.to_numpy())
    values = np.zeros(_table_shape(field), ti.lang.util.to_numpy_type(field.dtype))
    _build_host_copy(field, True)(values)
    return values.reshape(*field.shape, *([field.n] if hasattr(field, "n") else []))


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
    scalars, index_of = [*enumerate(components(field))], _index_in(field.shape)
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


def _on_all_entries(pairs: Sequence[tuple[Any, Any]], process: Any) -> Callable[[], None]:
    """Kernel () that calls a device function (source, target, index) for all entries of each pair of scalar fields."""
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
    length, index_of = prod(shape), _index_in(shape)

    @ti.func
    def process_entry(entry, _argument):
        for source, target in ti.static(group):
            process(source, target, index_of(entry))

    return length, thread_count(length), build_tasks_of_thread(process_entry, length)


def _index_in(shape: tuple[int, ...]) -> Any:
    """Device function (entry): index in fields of one or two axes of an entry, counted along the last axis first."""
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
