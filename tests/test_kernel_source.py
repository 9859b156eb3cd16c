"""Taichi gets the same source of device functions as from `inspect`."""

import inspect
import re
import textwrap
from importlib import import_module
from pkgutil import walk_packages
from types import SimpleNamespace
from typing import Any

import granflow.contact
import granflow.engine
from granflow.kernel_source import TreePool, filled, inside_class, source_lines


def functions():
    """Functions of all modules with device code."""
    for package in (granflow.engine, granflow.contact):
        for found in walk_packages(package.__path__, package.__name__ + "."):
            module = import_module(found.name)
            yield from (each for each in vars(module).values() if inspect.isfunction(each))


def test_source_lines_equal_those_of_inspect():
    compared = [function for function in functions() if source_lines(function) == inspect.getsourcelines(function)]
    assert len(compared) == len(list(functions())) > 200


def test_function_outside_of_the_package_is_read_by_inspect():
    assert source_lines(functions) == inspect.getsourcelines(functions)


def test_filled_lines_equal_those_of_textwrap():
    lines = ["    def f(x):  # comment  \n", "\n", "\treturn x\n", "    text = 'é\u00a0'\n"]
    lines += [line for function in functions() for line in source_lines(function)[0]]
    assert [filled(line, tabsize=4, width=9999) for line in lines] == [
        textwrap.fill(line, tabsize=4, width=9999) for line in lines
    ]


def test_syntax_trees_are_used_again_without_earlier_results_and_never_twice_at_once():
    pool = TreePool()
    seen: list[Any] = []

    def transform(tree, context):
        call = tree.body[0].body[0].value
        seen.append((tree, hasattr(call, "ptr") or hasattr(call.func, "caller")))
        call.ptr, call.func.caller = 1, 2
        if context.depth:
            inner(SimpleNamespace(depth=context.depth - 1, is_kernel=False, is_real_function=False))

    transform_tree = pool.returning(transform)

    def inner(context):
        transform_tree(pool.parse("def f(a):\n    return a.dot(a)"), context)

    for _ in range(2):
        inner(SimpleNamespace(depth=1, is_kernel=False, is_real_function=False))
    (outer, _), (nested, _), (outer_again, _), (nested_again, _) = seen
    assert outer is not nested
    assert {id(outer_again), id(nested_again)} == {id(outer), id(nested)}
    assert not any(stale for _, stale in seen)


def test_syntax_trees_of_kernels_are_not_used_again():
    pool = TreePool()
    transform_tree = pool.returning(lambda tree, context: None)
    trees = [pool.parse("def f(): pass") for _ in range(2)]
    for tree in trees:
        transform_tree(tree, SimpleNamespace(is_kernel=True, is_real_function=False))
    assert pool.parse("def f(): pass") not in trees


def test_decorators_know_whether_they_are_in_a_class_body():
    found = []

    def decorator(function):
        found.append(inside_class([re.compile("class ")], 3))
        return function

    class Holder:
        @decorator
        def method(self):
            """In a class."""

    @decorator
    def function():
        """In a function."""

    assert found == [True, False]
