"""Patches of Taichi: it gets the same source of device functions as from `inspect`, and trees are used again."""

import inspect
import textwrap
from importlib import import_module
from pkgutil import walk_packages
from types import SimpleNamespace
from typing import Any

import pytest

import granflow.contact
import granflow.engine
from granflow.kernel_language import KERNELS, ti
from granflow.taichi_patches import TreePool, filled, set_member_class, source_lines


def test_source_and_filled_lines_equal_those_of_inspect_and_textwrap():
    """Of the functions of all modules with device code, and of one outside of the package."""
    modules = [
        import_module(found.name)
        for package in (granflow.engine, granflow.contact)
        for found in walk_packages(package.__path__, package.__name__ + ".")
    ]
    functions = [each for module in modules for each in vars(module).values() if inspect.isfunction(each)]
    assert len(functions) > 200
    texts = ["    def f(x):  # comment  \n", "\n", "\treturn x\n", "    text = 'é\u00a0'\n"]
    for function in [*functions, test_structs_with_equal_members_share_a_class]:
        assert source_lines(function) == inspect.getsourcelines(function), function
        texts += source_lines(function)[0]
    for text in texts:
        assert filled(text, tabsize=4, width=9999) == textwrap.fill(text, tabsize=4, width=9999)


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
    kernel = SimpleNamespace(depth=0, is_kernel=True, is_real_function=False)
    tree = pool.parse("def g(a):\n    return a.dot(a)")
    transform_tree(tree, kernel)
    assert pool.parse("def g(a):\n    return a.dot(a)") is not tree, "kernels are not used again"


@pytest.mark.skipif(KERNELS != "taichi", reason="replaces a function of Taichi")
def test_structs_with_equal_members_share_a_class():
    first, second, other = (ti.Struct(**dict.fromkeys(names, 1.0)) for names in ("ab", "ab", "ac"))
    assert type(first) is type(second) is not type(other)
    second.b = 2.0
    assert (first.a, first.b, second.b, other.c) == (1.0, 1.0, 2.0, 1.0)
    assert ti.Struct._register_members is set_member_class
