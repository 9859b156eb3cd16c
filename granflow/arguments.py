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


class GuardedList(Sequence[_T]):
    """A list of a simulation, such as its forces, that only `append` and `remove` of the subclass change.

    `_name`: of the list in messages; `_items`: the present items. Other ways to change a list of Python, and
    an index that does not exist, raise an error with one sentence.
    """

    _name: str
    _items: tuple[_T, ...]

    def __getitem__(self, index: Any) -> _T:  # type: ignore[override]
        """The item with an index, or those of a slice."""
        if isinstance(index, slice):
            return self._items[index]  # type: ignore[return-value]
        refuse_other(f"the index of {self._name}", index, Integral, "a whole number")
        if not -len(self) <= index < len(self):
            raise GranflowError(
                f"{self._name}[{index}] does not exist: {self._name} has {len(self)} entries."
            )
        return self._items[index]

    def __iter__(self) -> Iterator[_T]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)

    def __setitem__(self, index: object, value: object) -> NoReturn:
        raise GranflowError(
            f"{self._name}[...] cannot be set: use {self._name}.append and {self._name}.remove."
        )

    def __delitem__(self, index: object) -> NoReturn:
        raise GranflowError(f"{self._name}[...] cannot be deleted: use {self._name}.remove.")

    def __setattr__(self, name: str, value: object) -> None:
        """Raises AttributeError: the list has no attributes of its own."""
        if not name.startswith("_"):
            raise AttributeError(
                f"{self._name}.{name} cannot be set: use {self._name}.append and {self._name}.remove."
            )
        super().__setattr__(name, value)
