"""Kernels on all fields of a block: fill them with zeros, copy them to longer ones."""

from collections.abc import Callable, Sequence
from typing import Any

from granflow.engine.host_fields import components
from granflow.kernel_language import ti

UNROLLED = 16
"""Fields that one loop processes; the kernel language warns of more than 32 statements without a loop."""


def build_clear(state: Any) -> Callable[[], None]:
    """Kernel (): fill all fields with zeros.

    Writes:  all fields of the state
    """
    groups = _groups([(field, field) for field in state.fields])

    @ti.kernel
    def clear():
        for group in ti.static(groups):
            for index in ti.grouped(group[0][0]):
                for _, component in ti.static(group):
                    component[index] = 0

    return clear


def build_copy(sources: Sequence[Any], targets: Sequence[Any]) -> Callable[[], None]:
    """Kernel (): copy each field to the first entries of another one of the same type, as long or longer.

    Reads:   sources
    Writes:  targets
    """
    groups = _groups([*zip(sources, targets, strict=True)])

    @ti.kernel
    def copy():
        for group in ti.static(groups):
            for index in ti.grouped(group[0][0]):
                for source, target in ti.static(group):
                    target[index] = source[index]

    return copy


def _groups(pairs: Sequence[tuple[Any, Any]]) -> list[list[tuple[Any, Any]]]:
    """Pairs of the scalar fields of each pair of fields, in groups of equal shape of the first."""
    by_shape: dict[tuple[int, ...], list[tuple[Any, Any]]] = {}
    for source, target in pairs:
        scalars = zip(components(source), components(target), strict=True)
        by_shape.setdefault(source.shape, []).extend(scalars)
    return [each[k : k + UNROLLED] for each in by_shape.values() for k in range(0, len(each), UNROLLED)]
