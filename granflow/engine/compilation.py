"""Compilation of kernels. It holds the interpreter lock for seconds, so that no Python signal handler runs.

The command line sets `around` to a context in which signals end the process without Python.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any
from weakref import WeakSet

around: Callable[[], AbstractContextManager[None]] = nullcontext
"""Context in which kernels are compiled."""


def in_context(compile_kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Wraps `Program.compile_kernel` of Quadrants, which calls it once per kernel: every call is in
    `around`."""

    def compile_in_context(*arguments: Any) -> Any:
        with around():
            return compile_kernel(*arguments)

    return compile_in_context


def guarded(compile_kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Wraps `Program.compile_kernel` of Taichi, so that the first call per kernel runs in the context
    `around`.

    compile_kernel:  function (program, configuration, capabilities, kernel)
    Returns:         function with the same arguments and result

    Taichi calls the function at every launch; only the first call of a kernel compiles it.
    """
    compiled: WeakSet[Any] = WeakSet()  # not by id: the id of a deleted kernel is used again

    def compile_in_context(program: Any, configuration: Any, capabilities: Any, kernel: Any) -> Any:
        if kernel in compiled:
            return compile_kernel(program, configuration, capabilities, kernel)
        with around():
            done = compile_kernel(program, configuration, capabilities, kernel)
        compiled.add(kernel)
        return done

    return compile_in_context
