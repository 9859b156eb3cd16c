"""Source text and syntax trees of kernels for Taichi, which reads every function again wherever it is inlined."""

import ast
import inspect
import linecache
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from re import Pattern
from types import SimpleNamespace
from typing import Any

PACKAGE = str(Path(__file__).parent)
"""Folder of the package."""


def source_lines(function: Callable[..., Any]) -> tuple[list[str], int]:
    """Lines of a function with its decorators, and number of the first, as from `inspect.getsourcelines`.

    It takes a tenth of the time: each file is parsed once, instead of each function by the tokenizer.
    """
    code = inspect.unwrap(function).__code__
    last = _last_lines(code.co_filename).get(code.co_firstlineno) if code.co_filename.startswith(PACKAGE) else None
    if last is None:  # outside of the package a file may change during the process, or there is none
        return inspect.getsourcelines(function)
    return linecache.getlines(code.co_filename)[code.co_firstlineno - 1 : last], code.co_firstlineno


@cache
def _last_lines(file: str) -> dict[int, int]:
    """Last line of each function in a file by its first line, which is that of the first decorator."""
    found = _functions(ast.parse("".join(linecache.getlines(file))))
    return {min([node.lineno, *(each.lineno for each in node.decorator_list)]): node.end_lineno or 0 for node in found}


def _functions(block: Any) -> Iterator[ast.FunctionDef]:
    """Functions in the body of a module, class, function or other statement, at any depth."""
    for statement in (*getattr(block, "body", ()), *getattr(block, "orelse", ())):
        if isinstance(statement, ast.FunctionDef):
            yield statement
        yield from _functions(statement)


def shorten_front_end(kernel_impl: Any) -> None:
    """Make Taichi read and parse each function once: half of the time in which it builds syntax trees.

    kernel_impl:  module `taichi.lang.kernel_impl`, of which names are replaced
    """
    trees = TreePool()
    kernel_impl.getsourcelines = source_lines
    kernel_impl._inside_class = partial(inside_class, kernel_impl._KERNEL_CLASS_STACKFRAME_STMT_RES)
    kernel_impl.textwrap = SimpleNamespace(fill=filled, dedent=textwrap.dedent)
    kernel_impl.ast = SimpleNamespace(parse=trees.parse)
    kernel_impl.transform_tree = trees.returning(kernel_impl.transform_tree)


def inside_class(patterns: Sequence[Pattern[str]], level_of_class_stackframe: int) -> bool:
    """Whether a decorator is applied in a class body, as `_inside_class` of Taichi, which searches all modules.

    patterns:                   of the statement that creates a class
    level_of_class_stackframe:  call frames from here to that statement
    """
    frame = sys._getframe(level_of_class_stackframe)
    statement = linecache.getline(frame.f_code.co_filename, frame.f_lineno).strip()
    return any(pattern.match(statement) for pattern in patterns)


def filled(line: str, **options: Any) -> str:
    """The line as from `textwrap.fill` with a width above its length."""
    return textwrap.fill(line, **options) if "\t" in line or not line.isascii() else line.rstrip()


class TreePool:
    """Syntax trees of device functions that are not in use, with all their nodes, by source text."""

    def __init__(self) -> None:
        self._free: dict[str, list[list[Any]]] = {}
        self._used: dict[int, tuple[str, list[Any]]] = {}

    def parse(self, text: str) -> Any:
        """Syntax tree of a text; one of the pool, if possible."""
        free = self._free.setdefault(text, [])
        nodes = free.pop() if free else [*ast.walk(ast.parse(text))]
        self._used[id(nodes[0])] = text, nodes
        return nodes[0]

    def returning(self, transform: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Wraps `transform_tree` (tree, context), so that the tree of an inlined function returns to the pool.

        Trees of kernels and real functions lose their arguments in it; a failure ends with an exception.
        """

        def transform_and_return(tree: Any, context: Any) -> Any:
            text, nodes = self._used.pop(id(tree))
            found = transform(tree, context)
            if not (context.is_kernel or context.is_real_function):
                for node in nodes:  # the value of a node, and the object of a method call
                    node.__dict__.pop("ptr", None)
                    node.__dict__.pop("caller", None)
                self._free[text].append(nodes)
            return found

        return transform_and_return
