"""The kernel language: Taichi, or its fork Quadrants where Taichi is not installed, as on Python 3.14.

The environment variable GRANFLOW_KERNELS overrides that. The command line sets it, see
`granflow.cli.arguments.select_kernels`. `ti` is the module, imported at its first use, because scenes are
read without it. No other module imports either. At the import, `granflow.taichi_patches` replaces parts of
it.
"""

import os
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from granflow.errors import GranflowError
from granflow.processors import unknown_to_taichi
from granflow.taichi_patches import shorten_front_end, shorten_front_end_of_quadrants

VARIABLE = "GRANFLOW_KERNELS"
"""Environment variable that selects the kernel language."""
LANGUAGES = ("taichi", "quadrants")
"""Kernel languages; the first one that is installed is used."""
ti: Any


def _selected() -> str:
    """The kernel language of the environment, or else the first one that is installed.

    Raises GranflowError for an unknown one.
    """
    name = os.environ.get(VARIABLE)
    if not name:
        return next((each for each in LANGUAGES if find_spec(each) is not None), LANGUAGES[0])
    if name not in LANGUAGES:
        raise GranflowError(f"{VARIABLE} is {name}, but the kernel languages are taichi and quadrants.")
    return name


KERNELS = _selected()
"""Name of the module `ti`, and of its package."""


def __getattr__(name: str) -> Any:
    """The module `ti`. Raises GranflowError if the kernel language is not installed."""
    if name != "ti":
        raise AttributeError(name)
    try:
        module = import_module(KERNELS)
    except ModuleNotFoundError as error:
        if error.name != KERNELS:
            raise
        python = " (Python 3.10 to 3.13)" if KERNELS == "taichi" else ""
        raise GranflowError(
            f"{KERNELS} is not installed: run pip install {KERNELS}{python}, or leave out --kernels and "
            f"{VARIABLE}."
        ) from None
    if KERNELS == "taichi":
        shorten_front_end(module.lang.kernel_impl, module.lang.struct)
    else:
        shorten_front_end_of_quadrants(module.lang)
    globals()["ti"] = module
    return module


def slower_than_quadrants() -> str:
    """A sentence for users whose processor Taichi's compiler does not know; empty in all other cases."""
    unknown = unknown_to_taichi()
    if KERNELS != "taichi" or unknown is None:
        return ""
    install = "" if find_spec("quadrants") else "pip install quadrants, then "
    return (
        f"The compiler of Taichi does not know this processor ({unknown[0]}, family {unknown[1]}) and uses "
        f"half of its vectors. With Quadrants, steps are 1.2 to 1.6 times as fast: {install}"
        f"granflow run --kernels quadrants, or {VARIABLE}=quadrants."
    )
