"""Numbers of the plan on the device; see `plan/parameters.py`."""

from typing import Any

import numpy as np

from granflow.engine.backend import Backend
from granflow.engine.field_block import FieldBlock
from granflow.kernel_language import ti
from granflow.plan.capacities import Capacities
from granflow.plan.parameters import parameters_of
from granflow.plan.plan import Plan


class Parameters:
    """One field per type with the parameters one after the other; device functions read them by name."""

    def __init__(self, block: FieldBlock, plan: Plan, capacities: Capacities, backend: Backend) -> None:
        self._places: dict[str, tuple[str, int, int]] = {}
        lengths: dict[str, int] = {}
        for parameter in parameters_of(plan, capacities):
            first = lengths.get(parameter.dtype, 0)
            lengths[parameter.dtype] = first + len(parameter.values)
            self._places[parameter.name] = parameter.dtype, first, lengths[parameter.dtype]
        self._fields = {dtype: block.scalar(backend.types[dtype], length) for dtype, length in lengths.items()}

    def write(self, plan: Plan, capacities: Capacities) -> None:
        """Write all parameters of a plan with equal features and capacities."""
        values = {
            dtype: np.zeros(field.shape[0], ti.lang.util.to_numpy_type(field.dtype))
            for dtype, field in self._fields.items()
        }
        for parameter in parameters_of(plan, capacities):
            dtype, first, end = self._places[parameter.name]
            values[dtype][first:end] = parameter.values
        for dtype, field in self._fields.items():
            field.from_numpy(values[dtype])

    def reader(self, name: str, component: int | None = None) -> Any:
        """Device function (): the value of a parameter, a number or a vector, or one component of a vector.

        Loops read a parameter once, before they begin: the compiler cannot know that no store changes it.
        """
        dtype, first, end = self._places[name]
        if component is not None:
            first, end = first + component, first + component + 1
        field, size = self._fields[dtype], end - first

        @ti.func
        def number():
            return field[first]

        @ti.func
        def vector():
            return ti.Vector([field[first + k] for k in ti.static(range(size))])

        return number if size == 1 else vector
