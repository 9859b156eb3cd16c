"""Fields and arrays that a user's program has made with Taichi: a restart of Taichi would destroy them."""

from typing import Any
from weakref import WeakSet

from granflow.kernel_language import ti

_own: "WeakSet[Any]" = WeakSet()
_found = False


def new_builder() -> Any:
    """A builder of fields of granflow."""
    builder = ti.FieldsBuilder()
    _own.add(builder)
    return builder


def found() -> bool:
    """Whether the program has allocated fields or arrays since the first start, or declared fields."""
    return _found or not ti.root.empty


def watch() -> None:
    """Notice fields and arrays that are allocated from now on; once per process."""
    builder, program = ti.FieldsBuilder, ti._lib.core.Program
    builder._finalize = _watched_builder(builder._finalize)
    program.create_ndarray = _watched(program.create_ndarray)


def _watched_builder(finalize: Any) -> Any:
    def finalize_builder(builder: Any, *arguments: Any, **options: Any) -> Any:
        global _found
        _found |= builder not in _own and not builder.empty
        return finalize(builder, *arguments, **options)

    return finalize_builder


def _watched(create: Any) -> Any:
    def create_array(*arguments: Any, **options: Any) -> Any:
        global _found
        _found = True
        return create(*arguments, **options)

    return create_array
