"""Device functions of contact models: `ti.func` that imports the kernel language at the first compilation.

Scenes are read, checked and documented without Taichi, whose import takes longer than all of that, but the
record of a contact model contains its device functions. A device function may be a method: `self` is a
constant of the compilation, so that `ti.static(self.x)` removes branches. Numbers of `self` would become
literals, and each new value would be compiled again; device functions read them in `constants`, see
`contact.law.Law.parameters`.

A program can define models, too. The last two sections explain in one sentence why a device function cannot
be compiled, and find branches that the compiler cannot vectorize.
"""

import ast
import re
from collections.abc import Callable, Iterator
from functools import cache, wraps
from inspect import getsourcefile, getsourcelines, unwrap
from pathlib import Path
from textwrap import dedent
from typing import Any

from granflow import kernel_language
from granflow.errors import FunctionError


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
            if not (arguments and is_from_outside(arguments[0])):
                return compiled()(*arguments, **keywords)
            try:
                result = compiled()(*arguments, **keywords)
                arguments[0].refuse_result(function.__name__, result)
            except Exception as error:
                name = f"The function {function.__name__} of {arguments[0].title()}"
                text = f"{name} cannot be compiled: {reason_of(error, function)}."
                raise _compilation_error()(text) from None
            return result

        return at_compile_time(inlined)


ti: Any = _Taichi()


class DeviceObject:
    """Base class of objects whose attributes device functions read; Taichi passes them unchanged."""

    _data_oriented = True

    def title(self) -> str:
        """Name of the object in messages."""
        return type(self).__name__

    def refuse_result(self, name: str, result: Any) -> None:
        """Raise TypeError if the device function `name` returned other values than its callers expect."""


def at_compile_time(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator for a Python function that a device function calls while it is compiled, with expressions as
    values."""
    taichi = {"_is_taichi_function": True, "func": _CompiledFunction}
    quadrants = {"_is_quadrants_function": True, "wrapper": _CompiledFunction}
    vars(function).update(taichi | quadrants, _is_real_function=False)
    return function


class _CompiledFunction:
    """Attributes of a compiled function that Taichi reads after a call."""

    has_print = False


# Messages on device functions of programs


def is_from_outside(owner: Any) -> bool:
    """Whether an object with device functions belongs to a class that a program defines."""
    return isinstance(owner, DeviceObject) and not type(owner).__module__.startswith("granflow.")


def reason_of(error: Exception, function: Callable[..., Any]) -> str:
    """Reason why a device function of a program cannot be compiled, without a final period.

    error:     exception of the kernel language; its message contains the positions of all calls, outermost
               first
    Returns:   `file:line: reason`, with the innermost position outside of granflow and the kernel language;
               that of the definition if there is none
    """
    text = str(error)
    positions = [each for each in _POSITION.finditer(text) if not _is_library(each["file"])]
    code = getattr(unwrap(getattr(function, "func", function)), "__code__", None)
    where = f"{code.co_filename}:{code.co_firstlineno}: " if code else ""
    if positions:
        where = f"{positions[-1]['file']}:{positions[-1]['line']}: "
    rest = _POSITION.split(text)[-1].lstrip("^ \n").strip()  # Quadrants underlines the position
    if rest.startswith("Traceback"):
        rest = rest.splitlines()[-1]
    rest = re.sub(r"^TypeError when calling `\w+`: ", "", rest)
    rest = re.sub(
        r"Cannot find source code for Object: .*", "could not get source code", rest
    )  # of Quadrants
    words = " ".join(re.sub(r"'Struct\d+' object", "the struct", rest).split()).rstrip(". ")
    return f"{where}{words or type(error).__name__}{_remedy(error, words)}"


_POSITION = re.compile(r'File "(?P<file>[^"]+)", line (?P<line>\d+), in \w+:\n.*\n')
"""Position in the message of a failed compilation, followed by the line of source."""


def _is_library(file: str) -> bool:
    """Whether a source file is one of granflow or the kernel language."""
    package = Path(__file__).parent
    library = Path(kernel_language.ti.__file__).parent
    return any(folder in Path(file).parents for folder in (package, library))


def _remedy(error: Exception, words: str) -> str:
    """End of the sentence on a device function that cannot be compiled for the reason `words`; empty without
    remedy."""
    if _UNDEFINED.search(words):
        return "; give numbers of the program in `parameters`"
    if words.endswith("could not get source code"):
        return ": define all functions in a file or a notebook cell"
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, AttributeError):
        cause = cause.__context__
    members = ", ".join(sorted(getattr(getattr(cause, "obj", None), "keys", ())))
    return f"; its members are {members}" if members else ""


_UNDEFINED = re.compile(r'Name "\w+" is not defined')
"""A name in a device function that is no argument, local variable or global one."""


@cache
def _compilation_error() -> type[FunctionError]:
    """Exception of a device function of a program, which remains one sentence.

    While the callers are compiled, the kernel language raises its own exceptions again as
    `type(error)(position + text)`: only the last line is kept.
    """
    base: Any = getattr(kernel_language.ti, f"{kernel_language.KERNELS.title()}CompilationError")

    class CompilationError(FunctionError, base):
        def __init__(self, text: str) -> None:
            super().__init__(text.strip().splitlines()[-1])

    CompilationError.__module__ = FunctionError.__module__
    CompilationError.__qualname__ = FunctionError.__qualname__
    return CompilationError


# Branches in device functions that the compiler must vectorize


def run_time_branches(function: Callable[..., Any]) -> Iterator[str]:
    """`file:line` of each `if` and `while` statement of a method whose condition is known only when the
    kernel runs.

    Conditions of `self`, of constants and of `ti.static` are known when it is compiled. A vectorized loop
    with another branch crashes the compiler. The global device functions that the method calls are searched,
    too.

    Raises ValueError for a function without source.
    """
    source: Any = unwrap(function)
    lines, first = source_lines(source)
    definition = ast.parse(dedent("".join(lines))).body[0]
    variables = _variables(definition)
    for node in ast.walk(definition):
        if isinstance(node, ast.If | ast.While) and variables & set(_names(node.test)):
            yield f"{getsourcefile(source)}:{first + node.lineno - 1}"
        elif (
            isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id != source.__name__
        ):
            called = source.__globals__.get(node.func.id)
            if getattr(called, "_is_taichi_function", False):
                yield from run_time_branches(called)


def source_lines(function: Callable[..., Any]) -> tuple[list[str], int]:
    """Lines of a device function, and number of the first. Raises ValueError if they are not available."""
    try:
        return getsourcelines(function)
    except OSError:
        raise ValueError(
            f"the source of {function.__name__} is not available, which is compiled from it; define it in a "
            "file or a notebook cell"
        ) from None


def _variables(definition: ast.stmt) -> set[str]:
    """Names of arguments without `self`, and of local variables except those of loops over `ti.static`."""
    nodes = list(ast.walk(definition))
    static = {
        name.id
        for node in nodes
        if isinstance(node, ast.For) and _is_static(node.iter)
        for name in ast.walk(node.target)
        if isinstance(name, ast.Name)
    }
    arguments = {node.arg for node in nodes if isinstance(node, ast.arg)} - {"self"}
    stored = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    return arguments | stored - static


def _names(test: ast.expr) -> Iterator[str]:
    """Names in an expression, without those in `ti.static`."""
    if _is_static(test):
        return
    if isinstance(test, ast.Name):
        yield test.id
    for child in ast.iter_child_nodes(test):
        if isinstance(child, ast.expr):
            yield from _names(child)


def _is_static(node: ast.expr) -> bool:
    """Whether an expression is a call of `ti.static`."""
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "static"
