"""Arrays of particle properties that write through to the device."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from granflow.errors import GranflowError
from granflow.live.values import real_array


class ParticleArray(NDArrayOperatorsMixin):
    """One property of all particles, in the order of their ids: a reference to the simulation, not an array of its own.

    Reading copies the present values from the device: indexing, `np.asarray`, arithmetic and comparisons return
    independent numpy arrays, which later steps do not change. Assigning to an index (`velocity[mask] = 0`,
    `velocity[mask, 2] *= 0.5`), and in-place operators (`velocity *= 0.5`), write through. Writing to a copy
    (`velocity[mask][0] = 1`) has no effect on the simulation.

    `owner`, `name`: particles and name of the property; `read`: function that returns a new array; `write`: function
    that writes an array of the same shape, or None if the property is read-only.
    """

    def __init__(
        self, owner: object, name: str, read: Callable[[], np.ndarray],
        write: Callable[[np.ndarray], None] | None = None,
    ) -> None:  # fmt: skip
        self._owner, self._name, self._read, self._write = owner, name, read, write

    def is_of(self, owner: object, name: str) -> bool:
        """Whether this is the property `name` of these particles."""
        return self._owner is owner and self._name == name

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self._read(), dtype=dtype)

    def __getitem__(self, index: Any) -> Any:
        return self._read()[index]

    def __setitem__(self, index: Any, values: Any) -> None:
        """Write values; raises GranflowError for a read-only property, a wrong shape, or values that are not valid."""
        present = self._read()
        if self._write is None:
            raise GranflowError(f"particles.{self._name} is read-only.")
        is_text = present.dtype.kind == "U"
        changed = present.astype(object) if is_text else present.copy()
        try:
            changed[index] = np.asarray(values) if is_text else real_array(f"particles.{self._name}", values)
        except (ValueError, IndexError, TypeError) as error:
            shape, selected = np.shape(values), _shape(present, index)
            if selected is None or shape in ((), selected):
                raise GranflowError(f"particles.{self._name}, of the shape {present.shape}: {error}.") from None
            remedy = f"; give the transpose of the values, of the shape {selected}" if shape == selected[::-1] else ""
            raise GranflowError(
                f"particles.{self._name}: values of the shape {shape} are given for {selected}{remedy}."
            ) from None
        self._write(changed)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **keywords: Any) -> Any:
        """Apply a function of numpy to copies; with `out`, write the result."""
        arrays = [np.asarray(each) if isinstance(each, ParticleArray) else each for each in inputs]
        (out,) = keywords.pop("out", (None,))
        if not isinstance(out, ParticleArray):
            return getattr(ufunc, method)(*arrays, **keywords, **({} if out is None else {"out": out}))
        out[...] = getattr(ufunc, method)(*arrays, **keywords)
        return out

    def __len__(self) -> int:
        return len(self._read())

    def __iter__(self) -> Iterator[Any]:
        """Iterate over copies that are read-only, because writing to them has no effect on the simulation."""
        values = self._read()
        values.flags.writeable = False
        return iter(values)

    def __setattr__(self, name: str, value: Any) -> None:
        """Raises AttributeError: a name cannot be assigned, only an index."""
        if not name.startswith("_"):
            raise AttributeError(f"particles.{self._name}.{name} cannot be set: assign to particles.{self._name}[...].")
        super().__setattr__(name, value)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape (n,) or (n, 3) for the present number of particles."""
        return self._read().shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the copies."""
        return self._read().dtype

    def __getattr__(self, name: str) -> Any:
        """Attributes and methods of a copy, such as `mean`. Raises AttributeError for unknown and private ones."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._read(), name)

    def __repr__(self) -> str:
        return f"particles.{self._name}: {self._read()!r}"


def _shape(values: np.ndarray, index: Any) -> tuple[int, ...] | None:
    """Shape of the indexed part of an array; None for an index that does not exist."""
    try:
        return np.shape(values[index])
    except (IndexError, TypeError):
        return None
