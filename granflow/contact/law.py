"""Interface of all contact models: what a scene requests, contact history, and the base of the laws of all slots.

A law is an immutable object with the options of one scene. Its device functions (`ti.func`) take and return values
only; `constants`, `contact` and `history` are structs:

    constants  `constant_names` of the law, for the pair of materials, and `parameters` of the law
    history    `history` of the law: numbers, or 3-vectors, kept from first contact to separation
    contact    radius_eff [m], mass_eff [kg], time_step [s], overlap [m], overlap_rate [m/s], positive during approach

Tangential and rolling laws read more, see `surface_law`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from types import SimpleNamespace
from typing import Any, ClassVar

from granflow.contact.material import PairMaterial
from granflow.device_functions import DeviceObject, is_from_outside


@dataclass(frozen=True)
class ModelRequest:
    """Request of a scene for a contact model.

    options:          those of the model in `contact`, numbers in SI units
    pairs:            effective constants of all pairs of materials that can be in contact
    velocity_max:     largest expected impact velocity [m/s]
    unloading_angle:  theta of a model that bounds its unloading tangent by theta^2 M/dt^2
    energy_budget:    whether the run accounts for energies
    radius_eff_max:   largest effective radius of a contact [m]: that of the largest particle at a wall
    """

    options: Mapping[str, Any]
    pairs: tuple[PairMaterial, ...]
    velocity_max: float
    unloading_angle: float
    energy_budget: bool = False
    radius_eff_max: float = 0.0


@dataclass(frozen=True)
class HistoryField:
    """A quantity of a contact, kept from first contact to separation, 0 at first contact.

    name:         name in the history struct, and of the array of contact files
    description:  for `granflow explain` and the documentation
    unit:         SI unit, "1" if dimensionless
    size:         1 for a number; 3 for a vector, which changes its sign if the particles of the pair are exchanged
    in_output:    whether snapshots and contact files contain it
    """

    name: str
    description: str
    unit: str = "1"
    size: int = 1
    in_output: bool = False


@dataclass(frozen=True)
class ContactState:
    """Arguments of a reference implementation for one contact and step, in SI units; members as in the structs.

    constants:  pair constants by name; a reference implementation reads the parameters of the law in the law itself
    """

    constants: SimpleNamespace
    radius_eff: float
    mass_eff: float
    time_step: float
    overlap: float
    overlap_rate: float
    history: SimpleNamespace


@dataclass(frozen=True)
class Law(DeviceObject):
    """A contact model with the options of one scene."""

    name: ClassVar[str]
    source: ClassVar[str]
    """Publication."""
    limits: ClassVar[str]
    """Limitations of the model, in one sentence."""
    required: ClassVar[tuple[str, ...]] = ()
    """Functions that every model of a slot defines."""
    returns: ClassVar[Mapping[str, tuple[str, ...]]] = {"stored_energy": ("number",), "lost_energy": ("number",)}
    """Kinds of the values of each device function: number, vector or history."""
    constant_names: ClassVar[tuple[str, ...]] = ()

    def title(self) -> str:
        """Name in messages."""
        return f"the contact model {self.name}"

    def refuse_result(self, name: str, result: Any) -> None:
        """Raise TypeError if a device function returned other values than `returns`, or a history of other fields."""
        expected = self.returns.get(name)
        if expected is None:
            return
        values = result if isinstance(result, list | tuple) else [result]
        kinds = tuple(_kind(value) for value in values)
        if kinds != expected:
            found = ", ".join(kinds) or "nothing"
            raise TypeError(f"{name} must return ({', '.join(expected)}), not ({found})")
        for value, kind in zip(values, expected, strict=True):
            if kind == "history" and set(value.keys) != set(self.history_names):
                raise TypeError(f"{name} must return the history with its fields ({', '.join(self.history_names)})")

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Law":
        """The law that a scene requests; without options every scene has the same."""
        return cls()

    @property
    def structure(self) -> "Law":
        """The law with the signs of its numbers in their place: laws of equal structure share compiled kernels.

        Device functions of granflow read numbers in `parameters` only. Those of a program may read them in `self`,
        where they are literals of the kernel, so that its laws are their own structure.
        """
        return self if is_from_outside(self) else _with_signs(self)

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """Contact history, in order."""
        return ()

    @property
    def history_names(self) -> tuple[str, ...]:
        """Names of the history fields."""
        return tuple(each.name for each in self.history)

    @property
    def history_count(self) -> int:
        """Number of history components per contact; 0 for a model without history."""
        return sum(each.size for each in self.history)

    @property
    def parameters(self) -> Mapping[str, float]:
        """Numbers of the scene that are the same for all pairs, in SI units, by their names in `constants`.

        The names depend on the features of the model only, so that laws that differ in numbers share compiled kernels.
        """
        return {}

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names` for a pair of materials; by default the pair options of the same names.

        Raises ValueError for a pair that the model does not support.
        """
        return tuple(pair.options[name] for name in self.constant_names)


def _with_signs(value: Any) -> Any:
    """A record with the sign, 1.0, 0.0 or -1.0, in place of each number; other values remain."""
    if is_dataclass(value):
        signs = {each.name: _with_signs(getattr(value, each.name)) for each in fields(value)}
        return replace(value, **signs)  # type: ignore[type-var]
    return math.copysign(value != 0.0, value) if isinstance(value, float) else value


def _kind(value: Any) -> str:
    """Kind of a value of a device function while it is compiled."""
    if value is None:
        return "nothing"
    if hasattr(value, "keys"):
        return "history"
    if hasattr(value, "is_tensor") and value.is_tensor():
        return "vector" if tuple(value.get_shape()) == (3,) else "matrix"
    return "number"
