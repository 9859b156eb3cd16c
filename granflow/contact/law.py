"""Interface of all contact models, and of the normal and cohesion models.

A law is an immutable object with the options of one scene. Its device functions (`ti.func`) take and return values
only; `constants`, `contact` and `history` are structs:

    constants  `constant_names` of the law, for the pair of materials, and `parameters` of the law
    history    `history` of the law: numbers, or 3-vectors, kept from first contact to separation
    contact    radius_eff [m], mass_eff [kg], time_step [s], overlap [m], overlap_rate [m/s], positive during approach

Tangential and rolling laws read more, see `surface_law`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

from granflow.contact import theory
from granflow.contact.material import PairMaterial
from granflow.device_functions import DeviceObject, ti


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


def _kind(value: Any) -> str:
    """Kind of a value of a device function while it is compiled."""
    if value is None:
        return "nothing"
    if hasattr(value, "keys"):
        return "history"
    if hasattr(value, "is_tensor") and value.is_tensor():
        return "vector" if tuple(value.get_shape()) == (3,) else "matrix"
    return "number"


@dataclass(frozen=True)
class NormalLaw(Law):
    """A normal contact model.

    The first two constants are the effective moduli E and G [Pa]. The first history field is positive from the first
    step of a contact on. Closed forms describe a binary collision of a pair at an approach velocity [m/s] with the
    effective radius [m] and mass [kg].
    """

    required = ("force", "stored_energy", "phase_durations", "unloading_stiffness")
    returns: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **Law.returns,
        "force": ("number", "number", "history"),
        "prepare": ("history",),
        **dict.fromkeys(("tangential_stiffness", "damping", "attraction"), ("number",)),
    }
    constant_names: ClassVar[tuple[str, ...]] = ("modulus_eff", "shear_modulus_eff")
    tangential_stiffness_grows: ClassVar[bool] = True
    """True if the tangential stiffness is proportional to the square root of the overlap."""
    branch_free: ClassVar[bool] = True
    """True if `force` has no branch, so that contacts can be evaluated in SIMD batches. Other models use full
    neighbor lists."""
    has_dashpot: ClassVar[bool] = False
    """True for a model with `damping`."""
    limits_restitution: ClassVar[bool] = False
    """True for a model that bounds its unloading tangent by the time step, see `least_restitution`."""

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`: the effective moduli [Pa], by default followed by pair options.

        Raises ValueError for a pair that the model does not support.
        """
        options = (pair.options[name] for name in self.constant_names[2:])
        return pair.modulus_eff, pair.shear_modulus_eff, *options

    @property
    def unloading_angle(self) -> float:
        """theta of a model that bounds its unloading tangent by theta^2 M/dt^2; 0: no such bound."""
        return 0.0

    def unresolved_unloading(self, pair: PairMaterial) -> float:
        """If the ratio of unloading to loading duration is below this value, the time step need not resolve unloading.

        The model then bounds its own tangent.
        """
        return 0.0

    @property
    def rate_dependent(self) -> bool:
        """Whether the force depends on the overlap rate at the time level."""
        return False

    @property
    def attracts(self) -> bool:
        """Whether the force can be attractive."""
        return False

    @property
    def prepares(self) -> bool:
        """Whether `prepare` changes the history."""
        return False

    @ti.func
    def prepare(self, constants, contact, history):
        """History after rare operations with branches, such as the initialization of a contact.

        Evaluated before `force`, so that `force` remains branch-free arithmetic that the compiler can vectorize over
        contacts.
        """
        return history

    @ti.func
    def force(self, constants, contact, history):
        """Normal force [N], its viscous part [N], and the history."""

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Recoverable energy [J]."""

    @ti.func
    def lost_energy(self, constants, contact, history):
        """Dissipated energy [J] that is a function of the history alone (plastic work)."""
        return 0.0 * contact.overlap

    @ti.func
    def tangential_stiffness(self, constants, contact, history):
        """No-slip stiffness of a Hertz contact [N/m] (Mindlin 1949).

        kt = 8 G sqrt(R d)
        """
        return 8.0 * constants.shear_modulus_eff * ti.sqrt(contact.radius_eff * contact.overlap)

    @ti.func
    def damping(self, constants, contact, history):
        """Ratio of the viscous force to the overlap rate at the present overlap [N s/m]."""
        return 0.0 * contact.overlap

    @ti.func
    def attraction(self, constants, contact, history):
        """Attractive part of `force` [N] that does not press the surfaces together."""
        return 0.0 * contact.overlap

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force`: normal force [N] and the changed history fields.

        In numpy, written from the publication and not from the kernel.
        """
        raise NotImplementedError

    def reference_force(
        self,
        constants: np.ndarray,
        radius_eff: float,
        mass_eff: float,
        time_step: float,
        overlap: float,
        overlap_rate: float,
        history: np.ndarray,
    ) -> tuple[float, np.ndarray]:
        """Normal force [N] and history from the reference implementation, with constants and history as arrays."""
        named = SimpleNamespace(**dict(zip(self.constant_names, constants, strict=False)))
        before = dict(zip(self.history_names, history, strict=False))
        state = ContactState(named, radius_eff, mass_eff, time_step, overlap, overlap_rate, SimpleNamespace(**before))
        force, changed = self.reference(state)
        return float(force), np.array(list((before | dict(changed)).values()) or history)

    def phase_durations(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> tuple[float, float]:
        """Loading and unloading durations [s]."""
        raise NotImplementedError

    def unloading_stiffness(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Largest tangent stiffness [N/m] in a binary collision."""
        raise NotImplementedError

    def stable_stiffness(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Tangent stiffness [N/m] at the maximum overlap of a confined particle; it bounds the time step."""
        return self.unloading_stiffness(pair, radius_eff, mass_eff, velocity)

    def loading_stiffness(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Normal tangent stiffness [N/m] at the maximum overlap; 4 G/E times it is the tangential stiffness."""
        return self.stable_stiffness(pair, radius_eff, mass_eff, velocity)

    def overlap_max(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Maximum overlap [m]; by default that of Hertz loading (Zhou 2011, Eq. 5)."""
        k = theory.hertz_stiffness(pair.modulus_eff, radius_eff)
        return float(theory.overlap_max(k, mass_eff, velocity))

    def viscosity(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Ratio of viscous force to overlap rate at the maximum overlap of a collision [N s/m]."""
        return 0.0

    def restitution(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Restitution at a time step that resolves the collision; by default that of the pair.

        Raises ValueError if the pair has none.
        """
        return pair.restitution_at(velocity)

    def least_restitution(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float, time_step: float
    ) -> float:
        """Smallest restitution that a collision can reach at a time step [s]."""
        return 0.0


@dataclass(frozen=True)
class CohesionLaw(Law):
    """A cohesion model: an attraction in addition to any normal model; it does not press the surfaces together.

    `force` has no branch, as for a normal model. A model that acts at a distance also gets negative overlaps, down to
    minus its `range`; its first history field is above 0 as long as the contact keeps its history without overlap.
    """

    required = ("force",)
    returns: ClassVar[Mapping[str, tuple[str, ...]]] = {**Law.returns, "force": ("number", "history")}
    at_distance: ClassVar[bool] = False
    """True for a model that acts without overlap, such as a liquid bridge."""

    @property
    def range(self) -> float:
        """Largest distance [m] between the surfaces at which the model acts; 0 for a model that requires overlap."""
        return 0.0

    @property
    def parameters(self) -> Mapping[str, float]:
        """The range of a model that acts at a distance; the engine reads it on the device."""
        return {"range": self.range} if self.at_distance else {}

    def pull_off_force(self, pair: PairMaterial, radius_eff: float) -> float | None:
        """Force [N] that separates a pair at rest; None if it depends on the load."""
        return None

    def equivalent_velocity(self, pair: PairMaterial, radius_eff: float, mass_eff: float) -> float:
        """Impact velocity [m/s] at which a Hertz contact is as stiff as the cohesive contact at rest.

        By default that of a contact that the pull-off force F presses together: a^3 = 3 F R / (4 E).
        """
        force = self.pull_off_force(pair, radius_eff) or 0.0
        contact_radius = float(np.cbrt(0.75 * force * radius_eff / pair.modulus_eff))
        return theory.velocity_for_radius(pair.modulus_eff, radius_eff, mass_eff, contact_radius)

    @ti.func
    def force(self, constants, contact, history):
        """Attraction [N], positive, and the history."""

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Recoverable energy [J]; negative for an attraction."""
        return 0.0 * contact.overlap

    @ti.func
    def lost_energy(self, constants, contact, history):
        """Dissipated energy [J] that is a function of the history alone; of an open contact at minus the range."""
        return 0.0 * contact.overlap

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force`: attraction [N] and the changed history fields."""
        raise NotImplementedError
