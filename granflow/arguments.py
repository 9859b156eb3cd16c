"""Checks of arguments of public functions and of lists of a simulation; each raises GranflowError."""

import os
from collections.abc import Iterable, Iterator, Sequence
from math import floor, isfinite, nan
from numbers import Integral, Real
from pathlib import Path
from reprlib import Repr
from typing import Any, NoReturn, TypeVar

from granflow.errors import GranflowError

_T = TypeVar("_T")
_SHOWN = Repr()
_SHOWN.maxstring = _SHOWN.maxother = 60


def shown(value: object) -> str:
    """A value for a message on one line, shortened."""
    return " ".join(_SHOWN.repr(value).split())


def refuse_other(name: str, value: object, kinds: type | tuple[type, ...], expected: str) -> None:
    """Raise GranflowError for a value that is of none of these types.

    `expected`: in words, with an example.
    """
    if not isinstance(value, kinds):
        raise GranflowError(f"{name} is {shown(value)}, but must be {expected}.")


def path_of(name: str, value: Any) -> Path:
    """The path of a file or directory; raises GranflowError for another object, and for an empty text."""
    refuse_other(name, value, (str, os.PathLike), 'a path, such as "out/hopper"')
    if isinstance(value, str) and not value:
        raise GranflowError(f'{name} is empty, but must be a path, such as "out/hopper".')
    try:
        return Path(value)
    except TypeError:  # a path of bytes
        raise GranflowError(f"{name} is {shown(value)}, but must be a path of text.") from None


def whole_number(name: str, value: Any, at_least: int = 0) -> int:
    """A whole number of at least `at_least`, also as a float; raises GranflowError for another object."""
    number = float(value) if isinstance(value, Real) and not isinstance(value, bool) else nan
    if isfinite(number) and number >= at_least and number == floor(number):
        return int(number)
    raise GranflowError(f"{name} is {shown(value)}, but must be a whole number of at least {at_least}.")


def items_of(name: str, value: Any, expected: str) -> list[Any]:
    """The items of a list or another iterable; raises GranflowError for text or an object without items."""
    if isinstance(value, str | bytes) or not isinstance(value, Iterable):
        raise GranflowError(f"{name} is {shown(value)}, but must be a list of {expected}.")
    return list(value)


def item_at(name: str, items: Sequence[_T], index: Any) -> _T:
    """The item with an index, or those of a slice.

    Raises GranflowError for another object or an absent index.
    """
    if isinstance(index, slice):
        return items[index]  # type: ignore[return-value]
    refuse_other(f"the index of {name}", index, Integral, "a whole number")
    if not -len(items) <= index < len(items):
        raise GranflowError(f"{name}[{index}] does not exist: {name} has {len(items)} entries.")
    return items[index]
