"""The kernel language: Taichi, or its fork Quadrants if the environment variable GRANFLOW_KERNELS is
`quadrants`.

`ti` is that module, imported at its first use, because scenes are read without it. No other module imports
either. At the import, `granflow.taichi_patches` replaces parts of Taichi.
"""

import os
from importlib import import_module
from typing import Any, Literal, cast

from granflow.errors import GranflowError
from granflow.taichi_patches import shorten_front_end

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
