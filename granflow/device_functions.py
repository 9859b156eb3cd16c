"""Device functions of contact models: `ti.func` that imports the kernel language at the first compilation.

Scenes are read, checked and documented without Taichi, whose import takes longer than all of that, but the record of a
contact model contains its device functions. A device function may be a method: `self` is a constant of the
compilation, so that `ti.static(self.x)` removes branches. Numbers of `self` would become literals, and each new value
would be compiled again; device functions read them in `constants`, see `law.Law.parameters`.
"""

from collections.abc import Callable
from functools import cache, wraps
from typing import Any

from granflow import kernel_language


class DeviceObject:
    """Base class of objects whose attributes device functions read; Taichi passes them unchanged."""

    _data_oriented = True


class _CompiledFunction:
    """Attributes of a compiled function that Taichi reads after a call."""

    has_print = False


def at_compile_time(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator for a Python function that a device function calls while it is compiled, with expressions as values."""
    taichi = {"_is_taichi_function": True, "func": _CompiledFunction}
    quadrants = {"_is_quadrants_function": True, "wrapper": _CompiledFunction}
    vars(function).update(taichi | quadrants, _is_real_function=False)
    return function


class _Taichi:
    """The kernel language, imported when an attribute other than `func` is read."""

    def __getattr__(self, name: str) -> Any:
        """Attribute of the module."""
        return getattr(kernel_language.ti, name)

    @staticmethod
    def func(function: Callable[..., Any]) -> Any:
        """Decorator `ti.func`; Taichi reads the function when a kernel that calls it is compiled."""

        @cache
        def compiled() -> Any:
            return kernel_language.ti.func(function)

        @wraps(function)
        def inlined(*arguments: Any, **keywords: Any) -> Any:
            return compiled()(*arguments, **keywords)

        return at_compile_time(inlined)


ti: Any = _Taichi()
