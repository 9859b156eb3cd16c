"""Definition of a quantity in snapshots and output files: name, symbol, SI unit, meaning."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

Kind = Literal["scalar", "vector", "quaternion", "tensor"]
"""Number of components: 1, 3, 4 or 9."""
FileType = Literal["uint8", "int32", "int64", "float32", "float64"]
"""Data types of arrays in VTU files."""


@dataclass(frozen=True)
class Quantity:
    """Definition of one quantity.

    name:         key in snapshots and files
    symbol:       as in formulas; empty without a common symbol
    unit:         SI, "1" for a dimensionless number
    meaning:      description in a few words
    kind:         array shape (n,), (n, 3), (n, 4) (w, x, y, z) or (n, 9) (xx, xy, xz, yx, ...)
    file_type:    data type in VTU files, float32 where 7 digits are sufficient
    in_snapshot:  False for internal fields, and for quantities that are derived when a file is written
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    kind: Kind = "scalar"
    file_type: FileType = "float32"
    in_snapshot: bool = True

    @property
    def label(self) -> str:
        """Column name with unit: `kinetic_energy [J]`; without brackets for a dimensionless number."""
        return self.name if self.unit == "1" else f"{self.name} [{self.unit}]"

    def label_of(self, part: str) -> str:
        """Return the column name of this quantity of one part: `mass_flow.outlet [kg/s]`."""
        return replace(self, name=f"{self.name}.{part}").label

    @property
    def width(self) -> int:
        """Number of components."""
        return {"scalar": 1, "vector": 3, "quaternion": 4, "tensor": 9}[self.kind]

    def shape(self, count: int) -> tuple[int, ...]:
        """Return the shape of the array of this quantity for `count` particles, contacts or cells."""
        return (count,) if self.kind == "scalar" else (count, self.width)

    def for_file(self, values: np.ndarray) -> np.ndarray:
        """Return the values as a contiguous array with the data type of VTU files; the shape is unchanged."""
        return np.ascontiguousarray(values, dtype=np.dtype(self.file_type))


def by_name(quantities: Iterable[Quantity]) -> Mapping[str, Quantity]:
    """Read-only mapping from name to definition, in the given order."""
    return MappingProxyType({quantity.name: quantity for quantity in quantities})


def units(quantities: Mapping[str, Quantity]) -> Mapping[str, str]:
    """SI units by name, without those of dimensionless quantities."""
    return MappingProxyType({name: each.unit for name, each in quantities.items() if each.unit != "1"})
