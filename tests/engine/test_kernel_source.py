"""Taichi gets the same source of device functions as from `inspect`."""

import inspect
from importlib import import_module
from pkgutil import walk_packages

import granflow.contact
import granflow.engine
from granflow.engine.kernel_source import source_lines


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
