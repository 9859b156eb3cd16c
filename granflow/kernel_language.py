"""The kernel language: Taichi, or its fork Quadrants if the environment variable GRANFLOW_KERNELS is
`quadrants`.

`ti` is that module, imported at its first use, because scenes are read without it. No other module imports
either. Taichi reads and parses every function again wherever it is inlined; `shorten_front_end` replaces
these parts of it at the import.
"""

import ast
import inspect
import linecache
import os
import sys
import textwrap
from collections.abc import Callable, Sequence
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from re import Pattern
from types import SimpleNamespace
from typing import Any, Literal, cast

from granflow.errors import GranflowError

# For each decorated function of a module, Taichi asks `inspect` for the module that executes the import,
# which is not found: without this entry, `inspect` searches all modules every time, 0.3 s per start.
inspect.modulesbyfile.setdefault("<frozen importlib._bootstrap>", "_frozen_importlib")

VARIABLE = "GRANFLOW_KERNELS"
"""Environment variable that selects the kernel language."""
ti: Any


def _selected() -> Literal["taichi", "quadrants"]:
    """The kernel language in the environment. Raises GranflowError for an unknown one."""
    name = os.environ.get(VARIABLE) or "taichi"
    if name not in ("taichi", "quadrants"):
        raise GranflowError(
            f"{VARIABLE} is {name}, but the kernel languages are taichi (default) and quadrants."
        )
    return cast(Literal["taichi", "quadrants"], name)


KERNELS = _selected()
"""Name of the module `ti`, and of its package."""


def __getattr__(name: str) -> Any:
    """The module `ti`. Raises GranflowError if Quadrants is selected but not installed."""
    if name != "ti":
        raise AttributeError(name)
    try:
        module = import_module(KERNELS)
    except ModuleNotFoundError as error:
        if error.name != KERNELS:
            raise
        raise GranflowError(
            f"{KERNELS} is not installed: run pip install 'quadrants<1.4', or unset {VARIABLE}."
        ) from None
    if KERNELS == "taichi":
        shorten_front_end(module.lang.kernel_impl, module.lang.struct)
    globals()["ti"] = module
    return module


# Source text and syntax trees of kernels for Taichi


def shorten_front_end(kernel_impl: Any, struct: Any) -> None:
    """Make Taichi read and parse each function once: half of the time in which it builds syntax trees.

    kernel_impl, struct:  modules of `taichi.lang`, of which names are replaced
    """
    struct.Struct._register_members = set_member_class
    trees = TreePool()
    kernel_impl.getsourcelines = source_lines
    kernel_impl._inside_class = partial(inside_class, kernel_impl._KERNEL_CLASS_STACKFRAME_STMT_RES)
    kernel_impl.textwrap = SimpleNamespace(fill=filled, dedent=textwrap.dedent)
    kernel_impl.ast = SimpleNamespace(parse=trees.parse)
    kernel_impl.transform_tree = trees.returning(kernel_impl.transform_tree)


PACKAGE = str(Path(__file__).parent)
"""Folder of the package."""


def source_lines(function: Callable[..., Any]) -> tuple[list[str], int]:
    """Lines of a function with its decorators, and number of the first, as from `inspect.getsourcelines`.

    It takes a hundredth of the time: the indentation shows the end of a function, not the tokenizer.
    """
    code = inspect.unwrap(function).__code__
    if not code.co_filename.startswith(PACKAGE):  # a file may change during the process, or there is none
        return inspect.getsourcelines(function)
    lines = linecache.getlines(code.co_filename)
    first = code.co_firstlineno - 1
    return lines[first : end_of_function(lines, first)], code.co_firstlineno


def end_of_function(lines: Sequence[str], first: int) -> int:
    """Index after the last line of a function in formatted code: its body is indented further than its
    header.

    lines:  of the file
    first:  index of the first decorator, or of the header
    """
    indentation = _indentation(lines[first])
    is_header = True
    end = first + 1
    for k in range(first, len(lines)):
        text = lines[k].strip()
        if not is_header and text and _indentation(lines[k]) <= indentation and not text.startswith(")"):
            break
        is_header = is_header and not text.startswith("def ")
        end = k + 1 if text else end
    return end


def _indentation(line: str) -> int:
    """Number of blanks at the beginning of a line."""
    return len(line) - len(line.lstrip())


def set_member_class(struct: Any) -> None:
    """Give a struct properties for its members, as `_register_members` of Taichi, which makes a class per
    struct."""
    struct.__class__ = _member_class(struct.__class__, tuple(struct.keys))


@cache
def _member_class(base: Any, keys: tuple[str, ...]) -> type:
    """Class of structs with these members."""
    base._instance_count += 1
    members = {key: property(base._make_getter(key), base._make_setter(key)) for key in keys}
    return type(f"{base.__name__}{base._instance_count}", (base,), members)


def inside_class(patterns: Sequence[Pattern[str]], level_of_class_stackframe: int) -> bool:
    """Whether a decorator is applied in a class body, as `_inside_class` of Taichi, which searches all
    modules.

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
        """Wraps `transform_tree` (tree, context), so that the tree of an inlined function returns to the
        pool.

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
