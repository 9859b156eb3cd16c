"""Device functions of contact models: `ti.func` that imports the kernel language at the first compilation.

Scenes are read, checked and documented without Taichi, whose import takes longer than all of that, but the
record of a contact model contains its device functions. A device function may be a method: `self` is a
constant of the compilation, so that `ti.static(self.x)` removes branches. Numbers of `self` would become
literals, and each new value would be compiled again; device functions read them in `constants`, see
`contact.law.Law.parameters`.

A program can define models, too. Two sections explain in one sentence why a device function cannot be
compiled, and find branches that the compiler cannot vectorize. The last one has the elementary functions
`power`, `exponential` and `logarithm`.
"""

import ast
import re
from collections.abc import Callable, Iterator
from functools import cache, wraps
from inspect import getsourcefile, getsourcelines, unwrap
from math import log
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
            except FunctionError:  # of another function, which this one calls
                raise
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


def kind_of(value: Any) -> str:
    """Kind of a value of a device function while it is compiled."""
    if value is None:
        return "nothing"
    if hasattr(value, "keys"):
        return "history"
    if hasattr(value, "is_tensor") and value.is_tensor():
        return "vector" if tuple(value.get_shape()) == (3,) else "matrix"
    return "number"


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
    plain = unwrap(getattr(function, "func", function))
    code = getattr(plain, "__code__", None)
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
    reason = _other_language(plain) or f"{words or type(error).__name__}{_remedy(error, words)}"
    return f"{where}{reason}"


_POSITION = re.compile(r'File "(?P<file>[^"]+)", line (?P<line>\d+), in \w+:\n.*\n')
"""Position in the message of a failed compilation, followed by the line of source."""


def _is_library(file: str) -> bool:
    """Whether a source file is one of granflow or the kernel language."""
    package = Path(__file__).parent
    library = Path(kernel_language.ti.__file__).parent
    return any(folder in Path(file).parents for folder in (package, library))


def _other_language(function: Callable[..., Any]) -> str:
    """Sentence on a device function that uses the kernel language that does not run, or empty."""
    used = kernel_language.KERNELS
    known = getattr(function, "__globals__", {})
    for name in getattr(getattr(function, "__code__", None), "co_names", ()):
        module = getattr(known.get(name), "__name__", "")
        if module in kernel_language.LANGUAGES and module != used:
            return (
                f"{name} is {module}, but granflow runs with {used}: write import {used} as {name}, or set "
                f"{kernel_language.VARIABLE}={module}"
            )
    return ""


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


# Powers, exponentials and logarithms; on Vulkan, which has none in f64, from + - * / alone


@ti.func
def power(x, y):
    """x^y for x >= 0: `ti.pow`, or `power_f64`."""
    result = 0.0 * x
    if ti.static(lacks_f64_functions()):
        result = power_f64(x, y)
    else:
        result = ti.pow(x, y)
    return result


@ti.func
def exponential(x):
    """e^x: `ti.exp`, or `exponential_f64`."""
    result = 0.0 * x
    if ti.static(lacks_f64_functions()):
        result = exponential_f64(x, 0.0 * x)
    else:
        result = ti.exp(x)
    return result


@ti.func
def logarithm(x):
    """ln x for x > 0: `ti.log`, or the sum of the parts of `_logarithm`."""
    result = 0.0 * x
    if ti.static(lacks_f64_functions()):
        high, low = _logarithm(x)
        result = high + low
    else:
        result = ti.log(x)
    return result


@at_compile_time
def lacks_f64_functions() -> bool:
    """True on Vulkan if contact models are evaluated in f64."""
    runtime = kernel_language.ti.lang.impl
    return runtime.current_cfg().arch == kernel_language.ti.vulkan and (
        runtime.get_runtime().default_fp == kernel_language.ti.f64
    )


@ti.func
def power_f64(x, y):
    """x^y = e^(y ln x) in f64 to 2 ulp for |y ln x| < 40, from + - * / alone; x >= 0, and 0 for x = 0."""
    result = ti.cast(0.0, ti.f64)
    if x > 0.0:
        high, low = _logarithm(x)
        product, error = _two_product(high, y)
        result = exponential_f64(product, error + low * y)
    return result


@ti.func
def exponential_f64(x, x_error):
    """e^(x + x_error) in f64 to 2 ulp, from + - * / alone.

    e^x = 2^k e^r,   |r| <= ln(2)/2,   e^r = 1 + r + r^2/2! + ...
    """
    bounded = ti.max(ti.min(x, LARGEST_EXPONENT), -LARGEST_EXPONENT)
    k = ti.floor(bounded / ti.static(log(2.0)) + 0.5)
    r, r_error = _two_sum(bounded - k * LN2_HIGH, -k * LN2_LOW)
    series = ti.cast(0.0, ti.f64)
    for n in ti.static(range(SERIES_OF_EXP, 1, -1)):
        series = (1.0 + series) * r / n
    result = 1.0 + (r + (r * series + (r_error + x_error) * (1.0 + r)))
    scale = ti.abs(k)
    for bits in ti.static(EXPONENT_BITS):
        if scale >= bits:
            scale -= bits
            if k > 0.0:
                result *= ti.static(2.0**bits)
            else:
                result *= ti.static(2.0**-bits)
    if x < -LARGEST_EXPONENT:
        result = 0.0
    return result


@ti.func
def _logarithm(x):
    """ln x in two parts, x > 0.

    x = m 2^e,   1/sqrt(2) <= m < sqrt(2)
    ln x = e ln 2 + 2 artanh(s),   s = (m - 1)/(m + 1),   artanh(s) = s + s^3/3 + s^5/5 + ...
    """
    m = x
    e = ti.cast(0.0, ti.f64)
    for bits in ti.static(EXPONENT_BITS):
        if m < ti.static(2.0 ** (1 - bits)):
            m = m * ti.static(2.0**bits)
            e = e - bits
        if m >= ti.static(2.0**bits):
            m = m * ti.static(2.0**-bits)
            e = e + bits
    if m > ti.static(2.0**0.5):
        m = 0.5 * m
        e = e + 1.0
    above = m - 1.0
    below, below_error = _two_sum(ti.cast(1.0, ti.f64), m)  # of the same exponent, if m is larger
    s = above / below
    product, product_error = _two_product(s, below)
    s_error = ((above - product) - product_error - s * below_error) / below
    squared = s * s
    series = ti.cast(0.0, ti.f64)
    for n in ti.static(range(SERIES_OF_LOG, 0, -1)):
        series = squared * (ti.static(1.0 / (2 * n + 1)) + series)
    high, error = _two_sum(e * LN2_HIGH, 2.0 * s)
    high, error = _two_sum(high, error + 2.0 * s_error + 2.0 * s * series + e * LN2_LOW)
    return high, error


@ti.func
def _two_sum(a, b):
    """Sum and its rounding error for |a| >= |b| (Dekker 1971).

    Vulkan drivers replace (a + b) - a by b, but leave a - (a + b) as it is.
    """
    total = a + b
    return total, b + (a - total)


@ti.func
def _two_product(a, b):
    """Product and its rounding error (Dekker 1971)."""
    product = a * b
    a_scaled = SPLITTER * a
    a_high = a_scaled - (a_scaled - a)
    a_low = a - a_high
    b_scaled = SPLITTER * b
    b_high = b_scaled - (b_scaled - b)
    b_low = b - b_high
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


SPLITTER = 2.0**27 + 1.0
"""Splits 53 bits into two halves of at most 26 bits (Dekker 1971)."""
LN2_HIGH = 355 / 512
"""Part of ln 2 with few bits: products with exponents are exact."""
LN2_LOW = -2.1219444005469058277e-4
"""ln 2 - LN2_HIGH."""
EXPONENT_BITS = (512, 256, 128, 64, 32, 16, 8, 4, 2, 1)
SERIES_OF_LOG = 13
SERIES_OF_EXP = 14
"""Terms of the series; the next ones are below 2^-60."""
LARGEST_EXPONENT = 1023 * log(2.0)
