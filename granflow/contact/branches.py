"""Branches in device functions of contact models that the compiler must vectorize."""

import ast
from collections.abc import Callable, Iterator
from inspect import getsourcefile, getsourcelines, unwrap
from textwrap import dedent
from typing import Any


def run_time_branches(function: Callable[..., Any]) -> Iterator[str]:
    """`file:line` of each `if` and `while` statement of a method whose condition is known only when the kernel runs.

    Conditions of `self`, of constants and of `ti.static` are known when it is compiled. A vectorized loop with another
    branch crashes the compiler. The global device functions that the method calls are searched, too.

    Raises ValueError for a function without source.
    """
    source: Any = unwrap(function)
    lines, first = source_lines(source)
    definition = ast.parse(dedent("".join(lines))).body[0]
    variables = _variables(definition)
    for node in ast.walk(definition):
        if isinstance(node, ast.If | ast.While) and variables & set(_names(node.test)):
            yield f"{getsourcefile(source)}:{first + node.lineno - 1}"
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id != source.__name__:
            called = source.__globals__.get(node.func.id)
            if getattr(called, "_is_taichi_function", False):
                yield from run_time_branches(called)


def source_lines(function: Callable[..., Any]) -> tuple[list[str], int]:
    """Lines of a device function, and number of the first. Raises ValueError if they are not available."""
    try:
        return getsourcelines(function)
    except OSError:
        raise ValueError(
            f"the source of {function.__name__} is not available, which is compiled from it; define it in a file or a "
            "notebook cell"
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
