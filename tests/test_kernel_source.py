"""Patches of Taichi: it gets the same source of device functions as from `inspect`, and trees are used again."""

import ast
import inspect
import re
import textwrap
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from types import SimpleNamespace
from typing import Any

import pytest

import granflow.contact
import granflow.engine
from granflow import taichi_patches
from granflow.kernel_language import KERNELS, ti
from granflow.taichi_patches import (
    TreePool,
    end_of_function,
    filled,
    if_any_member,
    inside_class,
    set_member_class,
    source_lines,
    source_reader,
    without_first_pass,
)


def functions():
    """Functions of all modules with device code."""
    for package in (granflow.engine, granflow.contact):
        for found in walk_packages(package.__path__, package.__name__ + "."):
            module = import_module(found.name)
            yield from (each for each in vars(module).values() if inspect.isfunction(each))


def test_source_lines_equal_those_of_inspect():
    compared = [
        function for function in functions() if source_lines(function) == inspect.getsourcelines(function)
    ]
    assert len(compared) == len(list(functions())) > 200


def test_indentation_shows_the_end_of_every_function_of_the_package():
    found = 0
    for path in Path(granflow.__file__).parent.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        lines = text.splitlines(keepends=True)
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef):
                first = min([node.lineno, *(each.lineno for each in node.decorator_list)]) - 1
                end = end_of_function(lines, first)
                rest = [line for line in lines[node.end_lineno : end] if not line.strip().startswith("#")]
                assert end >= node.end_lineno and not "".join(rest).strip(), f"{path}:{node.lineno}"
                found += 1
    assert found > 2000


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
        call.ptr = 1
        call.func.caller = 2
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


@pytest.mark.skipif(KERNELS != "taichi", reason="replaces a function of Taichi")
def test_structs_with_equal_members_share_a_class():
    first, second, other = (ti.Struct(**dict.fromkeys(names, 1.0)) for names in ("ab", "ab", "ac"))
    assert type(first) is type(second) is not type(other)
    second.b = 2.0
    assert (first.a, first.b, second.b, other.c) == (1.0, 1.0, 2.0, 1.0)
    assert ti.Struct._register_members is set_member_class


def kernel_of(function):
    return SimpleNamespace(func=function, used_py_dataclass_parameters_by_key_enforcing={})


@pytest.mark.parametrize(
    ("function", "loaded", "expected"),
    [(source_lines, None, set()), (source_lines, {"a"}, {"a"}), (kernel_of, None, None)],
)
def test_kernels_of_the_package_are_transformed_once(function, loaded, expected):
    # None asks Quadrants for the first pass, which kernels of others with dataclasses need.
    kernel = kernel_of(function)
    assert without_first_pass(lambda kernel, arguments, key: loaded)(kernel, (), "key") == expected
    assert kernel.used_py_dataclass_parameters_by_key_enforcing == (
        {} if expected != set() else {"key": set()}
    )


def test_source_for_quadrants_is_that_of_inspect_and_read_once():
    read = source_reader(lambda function: 1, SimpleNamespace)
    place, lines = read(filled)
    assert (lines, place.start_lineno) == inspect.getsourcelines(filled)
    assert (place.function_name, place.filepath) == ("filled", taichi_patches.__file__)
    assert place.end_lineno == place.start_lineno + len(lines) - 1
    assert read(filled)[1] is lines
    assert read(kernel_of) == 1


def test_trees_are_searched_for_members_if_there_are_any():
    unpacked = if_any_member(lambda tree, struct_locals: "searched")
    assert (unpacked("tree", {"member"}), unpacked("tree", struct_locals=set())) == ("searched", "tree")


class Kernel:
    """Stands for a kernel; its id is used again after it is deleted."""


def test_each_kernel_is_compiled_once_in_the_context_also_if_an_id_is_used_again(monkeypatch):
    entered = []

    @contextmanager
    def around():
        entered.append(True)
        yield

    monkeypatch.setattr(taichi_patches, "around", around)
    compile_kernel = taichi_patches.guarded(lambda program, configuration, capabilities, kernel: None)
    for count in (1, 2, 3):
        kernel = Kernel()
        for _ in range(2):
            compile_kernel(None, None, None, kernel)
        assert len(entered) == count
        del kernel
