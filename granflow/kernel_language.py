"""The kernel language: `ti`, which imports Taichi when a device function is compiled.

Scenes are read, checked and documented without Taichi, whose import takes longer than all of that, but the records of
contact models and wall shapes contain their device functions. A device function may be a method: `self` is a constant
of the compilation, so that numbers of `self` become literals and `ti.static(self.x)` removes branches.
"""

from collections.abc import Callable
from functools import cache, wraps
from importlib import import_module
from typing import Any


class DeviceObject:
    """Base class of objects whose attributes device functions read; Taichi passes them unchanged."""

    _data_oriented = True


class _CompiledFunction:
    """Attributes of a compiled function that Taichi reads after a call."""

    has_print = False


def at_compile_time(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator for a Python function that a device function calls while it is compiled, with expressions as values."""
    vars(function).update(_is_taichi_function=True, _is_real_function=False, func=_CompiledFunction)
    return function


class _Taichi:
    """The module `taichi`, imported when an attribute other than `func` is read."""

    def __getattr__(self, name: str) -> Any:
        """Attribute of the module."""
        return getattr(import_module("taichi"), name)

    @staticmethod
    def func(function: Callable[..., Any]) -> Any:
        """Decorator `ti.func`; Taichi reads the function when a kernel that calls it is compiled."""

        @cache
        def compiled() -> Any:
            return import_module("taichi").func(function)

        @wraps(function)
        def inlined(*arguments: Any, **keywords: Any) -> Any:
            return compiled()(*arguments, **keywords)

        return at_compile_time(inlined)


ti: Any = _Taichi()
