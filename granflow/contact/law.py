"""Interface of the contact models: what a new model defines, and what granflow derives from it.

A contact model is one file with a law and a record. The law is a frozen dataclass, a subclass of `NormalLaw`,
`TangentialLaw`, `RollingLaw`, `TwistingLaw` or `CohesionLaw`: there is one base class per slot of the block
`contact`. Its fields are the options of one scene, and the force is one of its device functions. The record,
a `ContactModel`, declares the keys of the scene. Schema, messages, documentation, arrays, checkpoints,
contact files, energy budget, time step and the tests of all models (tests/contact) derive from the two.

To write a model:

1.  Choose the base class, and give `name`, `source` and `limits`. `required` lists what it must define.
2.  Declare the options of the model as fields of a subclass of `Options`, and the keys of `pairs` that it
    needs as fields of one of `PairProperties`, with the types of `granflow.schema.quantities`: they have the
    unit and the limits. `from_scene` reads the options in a `ModelRequest`, `pair_constants` the properties
    of a pair in a `PairMaterial`. Numbers of the scene that all pairs share are `parameters`. No number is a
    literal of a device function, so that another value compiles nothing.
3.  Declare what a contact remembers in `history`, as `HistoryField` records.
4.  Write the device functions (`ti.func`). They take and return values only; the arguments are structs:

        constants  `constant_names` for the pair of materials, and `parameters`
        history    `history`: numbers, or 3-vectors, kept from first contact to separation
        contact    radius_eff [m], mass_eff [kg], time_step [s], overlap [m],
                   overlap_rate [m/s], positive during approach; more for surface forces and torques, below

    A function that changes the history copies it, changes the copy and returns it. A function that is
    evaluated for many contacts at once has no `if` on a value of the contact, but `ti.select`.
5.  Write `reference` in numpy, from the publication and not from the device function: the tests compare them,
    and the forecasts of a run evaluate that of a normal and of a cohesion model.
    Two names of options have a meaning for others: `damping` of a surface model is a multiple of the dashpot
    of the normal model, and `stiffness` of a tangential model is the spring that limits the time step.
6.  For a normal model, give the closed forms of a binary collision, from which the time step follows.
7.  Register the record: in `granflow.contact.registry`, or from a program with
    `granflow.register_contact_model`.

`granflow.contact.normal.hertz` is a short example, `granflow.contact.normal.zhou` one with everything.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from types import SimpleNamespace
from typing import Annotated, Any, ClassVar, Literal, Protocol, TypeAlias

import numpy as np
from pydantic import Field

from granflow.contact import theory
from granflow.contact.material import PairMaterial
from granflow.contact.particle_equation import MaterialProperties
from granflow.device_functions import DeviceObject, is_from_outside, kind_of, ti
from granflow.fields import Quantity
from granflow.schema.faults import Fault
from granflow.schema.model import Model, example_of
from granflow.schema.quantities import Number

# Laws of all slots


@dataclass(frozen=True)
class ModelRequest:
    """What a scene says about one slot, from which a model makes its law.

    options:          those of the model in `contact`, an instance of `ContactModel.options`
    pairs:            effective constants of all pairs of materials that can be in contact
    velocity_max:     largest expected impact velocity [m/s]
    unloading_angle:  theta of a model that bounds its unloading tangent by theta^2 M/dt^2
    energy_budget:    whether the run accounts for energies
    radius_eff_max:   largest effective radius of a contact [m]: that of the largest particle at a wall
    """

    options: Any
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
    size:         1 for a number; 3 for a vector, which changes its sign if the particles of the pair are
                  exchanged
    in_output:    whether snapshots and contact files contain it
    """

    name: str
    description: str
    unit: str = "1"
    size: int = 1
    in_output: bool = False


@dataclass(frozen=True)
class Flow:
    """A quantity that flows through contacts, such as heat; the engine sums it over those of each particle.

    unit:               SI unit
    meaning:            description in a few words
    from_walls:         what has flowed from a wall since the start, a number of each wall with a key of
                        `wall_properties`
    rate_from_walls:    what flows from a wall now, a number of the same walls
    from_surroundings:  what has flowed from the surroundings since the start, a total of a scene whose model
                        has some
    source:             what can be added to the sum of each particle
    """

    unit: str
    meaning: str
    from_walls: Quantity | None = None
    rate_from_walls: Quantity | None = None
    from_surroundings: Quantity | None = None
    source: "Source | None" = None


@dataclass(frozen=True)
class Source:
    """A source of a flow in each particle, such as a reaction that releases heat.

    name, meaning:  of the property of the particles, whose unit is that of the flow; it is a key of groups
                    and of settings of stages
    type:           type of the value; 0 unless given
    total:          what all sources have given since the start, a total of a scene that has some
    """

    name: str
    meaning: str
    type: Number
    total: Quantity


@dataclass(frozen=True)
class FlowCase:
    """Contacts of two materials, for bounds of the flows through them.

    pair:         mixed constants of the materials
    radius_eff:   largest effective radius [m]
    overlap:      largest overlap [m]
    values:       smallest and largest initial value of each property that a particle equation integrates,
                  those of walls included
    wall_values:  smallest and largest value of each of `wall_properties`
    """

    pair: PairMaterial
    radius_eff: float
    overlap: float
    values: Mapping[str, tuple[float, float]]
    wall_values: Mapping[str, tuple[float, float]] = field(default_factory=dict)


class WallProperties(Model):
    """Keys of a wall that a contact model reads, all optional; this class has none.

    A subclass declares them as fields, each with a description, without a default.
    """

    @classmethod
    def wall_faults(cls, wall: Any) -> Iterator[Fault]:
        """Yield inconsistencies between these keys of a wall."""
        yield from ()


@dataclass(frozen=True)
class Law(DeviceObject):
    """A contact model with the options of one scene: immutable, with device functions as methods.

    Laws that differ in numbers only share compiled kernels: device functions read the numbers of the scene in
    `parameters` and those of a pair of materials in `pair_constants`, both through their argument
    `constants`.
    """

    name: ClassVar[str]
    source: ClassVar[str]
    """The publication, with its year."""
    limits: ClassVar[str]
    """Limitations of the model, in one sentence."""
    required: ClassVar[tuple[str, ...]] = ()
    """Functions that every model of the slot must define."""
    returns: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "stored_energy": ("number",),
        "lost_energy": ("number",),
    }
    """Kinds of the values of each device function: number, vector or history."""
    constant_names: ClassVar[tuple[str, ...]] = ()
    """Names of the constants of a pair of materials, in the order of `pair_constants`."""
    flows: ClassVar[Mapping[str, Flow]] = {}
    """What flows through a contact, by name, see `flow`; particle equations read the sums."""
    particle_properties: ClassVar[tuple[str, ...]] = ()
    """Properties of the particles that `flow` reads."""
    wall_properties: ClassVar[type[WallProperties]] = WallProperties
    """Class of the keys of a wall that `wall_flow` reads."""

    @property
    def relative_cost(self) -> float:
        """Typical duration of a step over that of one without the model, for estimates of run times; 1 if it
        is less than 2."""
        return 1.0

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Law":
        """The law that a scene requests; without options every scene has the same."""
        return cls()

    @property
    def parameters(self) -> Mapping[str, float]:
        """Numbers of the scene that are the same for all pairs, in SI units, by their names in `constants`.

        The names depend on the features of the model only, so that laws that differ in numbers share compiled
        kernels. By default the range of a model that acts at a distance, which the engine reads.
        """
        return {"range": self.range} if self.at_distance else {}

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names` for a pair of materials; by default its properties of the same names.

        Raises ValueError for a pair that the model does not support.
        """
        return tuple(pair.properties[name] for name in self.constant_names)

    @property
    def at_distance(self) -> bool:
        """Whether the model acts without overlap, as a liquid bridge; models of cohesion and of flows can."""
        return self.range > 0.0

    @property
    def range(self) -> float:
        """Largest distance [m] between the surfaces at which the model acts; 0 for a model that requires
        overlap."""
        return 0.0

    # What flows through contacts, in addition to forces: of surfaces that touch, and of those within the
    # range of a model that acts at a distance

    @ti.func
    def flow(self, constants, contact, first, partner):
        """Struct of the flows from the partner to the first particle, by the names of `flows`.

        contact:         as of a normal model, before its force is evaluated: without history and force; with
                         the `contact_radius` [m] of the models. For a model that acts at a distance, the
                         overlap of separated surfaces is minus their distance, and the contact radius is 0
        first, partner:  structs of the radius [m] and `particle_properties`

        If both are exchanged, each flow changes its sign to the last bit: then sums are conserved.
        """

    @ti.func
    def wall_flow(self, constants, contact, first, wall):
        """Struct of the flows from a wall to a particle; by default nothing flows.

        wall:  struct of `wall_properties`, 0 for one that the wall does not give, and of NAME_given, 1 or 0
        """
        return self.flow(constants, contact, first, first)

    @property
    def has_surroundings(self) -> bool:
        """Whether particles exchange something with their surroundings, see `surroundings_flow`."""
        return False

    @ti.func
    def surroundings_flow(self, constants, particle):
        """Struct of the flows from the surroundings to a particle.

        constants:  keys of its material that the model declares, 0 if not given, and `parameters`
        particle:   struct of its radius [m] and `particle_properties`
        """

    @property
    def loss_flow(self) -> str:
        """Flow to which the losses of contacts are added, in equal shares for both particles; empty: none."""
        return ""

    @ti.func
    def wall_share(self, wall):
        """Share of the losses of a contact that a wall takes; `wall` as of `wall_flow`."""
        return 0.0

    def flow_bounds(self, name: str, case: FlowCase) -> tuple[float, float]:
        """Largest flow of a contact, and its largest derivative by a property of the particle.

        The first determines the unit of the sum: the sum over all contacts of a particle must be at most 32
        times as large. The second limits the time step of each equation that reads the sum.
        """
        raise NotImplementedError

    @ti.func
    def contact_radius(self, constants, contact):
        """Radius [m] of the contact area, for models of what flows through it; a cohesion model that defines
        it has priority over the normal model.

        a = sqrt(R d)        of Hertz contacts
        """
        return ti.sqrt(contact.radius_eff * contact.overlap)

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
    def structure(self) -> "Law":
        """The law with the sign of each number in its place: laws of equal structure share compiled kernels.

        Device functions of granflow read numbers in `parameters` only. Those of a program may read them in
        `self`, where they are literals of the kernel, so that its laws are their own structure.
        """
        return self if is_from_outside(self) else _with_signs(self)

    def title(self) -> str:
        """The law in messages."""
        return f"the contact model {self.name}"

    def refuse_result(self, name: str, result: Any) -> None:
        """Raise TypeError if a device function returned other values than `returns` requires.

        A history must have the fields of `history`.
        """
        if name in FLOW_FUNCTIONS:
            self._refuse_flows(name, result)
            return
        expected = self.returns.get(name)
        if expected is None:
            return
        values = result if isinstance(result, list | tuple) else [result]
        kinds = tuple(kind_of(value) for value in values)
        if kinds != expected:
            found = ", ".join(kinds) or "nothing"
            raise TypeError(f"{name} must return ({', '.join(expected)}), not ({found})")
        for value, kind in zip(values, expected, strict=True):
            if kind == "history" and set(value.keys) != set(self.history_names):
                raise TypeError(
                    f"{name} must return the history with its fields ({', '.join(self.history_names)})"
                )

    def _refuse_flows(self, name: str, result: Any) -> None:
        """Raise TypeError unless a function returned a struct with a number for each of `flows`."""
        keys = tuple(getattr(result, "keys", ()))
        if set(keys) != set(self.flows):
            raise TypeError(f"{name} must return a ti.Struct with its flows ({', '.join(self.flows)})")


FLOW_FUNCTIONS = ("flow", "wall_flow", "surroundings_flow")
"""Device functions that return a struct of `Law.flows`."""


def _with_signs(value: Any) -> Any:
    """A record with the sign, 1.0, 0.0 or -1.0, in place of each number; other values remain."""
    if is_dataclass(value):
        signs = {each.name: _with_signs(getattr(value, each.name)) for each in fields(value)}
        return replace(value, **signs)  # type: ignore[type-var]
    return math.copysign(value != 0.0, value) if isinstance(value, float) else value


@dataclass(frozen=True)
class ContactState:
    """Arguments of a reference implementation of a normal or cohesion model, for one contact and step.

    The members are those of the structs of the device functions, in SI units; slip_rate (3,) [m/s] is that of
    viscous forces of cohesion models. `constants` has the pair constants only: a reference implementation
    reads the parameters of the law in the law itself.
    """

    constants: SimpleNamespace
    radius_eff: float
    mass_eff: float
    time_step: float
    overlap: float
    overlap_rate: float
    history: SimpleNamespace
    slip_rate: np.ndarray = field(default_factory=lambda: np.zeros(3))


# Normal models


@dataclass(frozen=True)
class NormalLaw(Law):
    """A normal contact model.

    The first two constants are the effective moduli E and G [Pa]. The first history field is positive from
    the first step of a contact on. `force` may read a history that `prepare` has changed, and is branch-free.
    Closed forms describe a binary collision of a pair at an approach velocity [m/s] with the effective radius
    [m] and mass [kg]; the time step follows from them.
    """

    required = ("force", "reference", "stored_energy", "phase_durations", "unloading_stiffness")
    returns: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **Law.returns,
        "force": ("number", "number", "history"),
        "prepare": ("history",),
        **dict.fromkeys(("tangential_stiffness", "damping", "attraction"), ("number",)),
    }
    constant_names: ClassVar[tuple[str, ...]] = ("modulus_eff", "shear_modulus_eff")
    branch_free: ClassVar[bool] = True
    """True if `force` has no branch, so that a CPU can evaluate contacts in SIMD batches (`engine/batch.py`).

    With another model each particle is a chunk: contacts are evaluated one at a time, and each pair twice,
    because it is in the neighbor lists of both particles.
    """
    limits_restitution: ClassVar[bool] = False
    """True for a model that bounds its unloading tangent by the time step, see `least_restitution`."""

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`: the effective moduli [Pa], by default followed by pair properties.

        Raises ValueError for a pair that the model does not support.
        """
        properties = (pair.properties[name] for name in self.constant_names[2:])
        return pair.modulus_eff, pair.shear_modulus_eff, *properties

    # Properties of the force

    @classmethod
    def has_dashpot(cls) -> bool:
        """Whether the model defines `damping`."""
        return cls.damping is not NormalLaw.damping

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

    @property
    def tangential_stiffness_grows(self) -> bool:
        """Whether the tangential stiffness is proportional to the square root of the overlap."""
        return True

    @property
    def softer_after_slow_onset(self) -> bool:
        """Whether a contact that begins slowly stays softer than a Hertz contact when it is loaded later."""
        return False

    # Device functions

    @ti.func
    def prepare(self, constants, contact, history):
        """History after rare operations with branches, such as the initialization of a contact.

        Evaluated before `force`, so that `force` remains branch-free arithmetic that the compiler can
        vectorize over contacts.
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

    # Reference implementation

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
        """Normal force [N] and history of `reference`, with constants and history as arrays."""
        named = SimpleNamespace(**dict(zip(self.constant_names, constants, strict=False)))
        before = dict(zip(self.history_names, history, strict=False))
        state = ContactState(
            named, radius_eff, mass_eff, time_step, overlap, overlap_rate, SimpleNamespace(**before)
        )
        force, changed = self.reference(state)
        return float(force), np.array(list((before | dict(changed)).values()) or history)

    # Closed forms of a binary collision

    def phase_durations(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> tuple[float, float]:
        """Loading and unloading durations [s]."""
        raise NotImplementedError

    def restitution(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Restitution at a time step that resolves the collision; by default that of the pair.

        Raises ValueError if the pair has none.
        """
        return pair.restitution_at(velocity)

    def overlap_max(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Maximum overlap [m]; by default that of Hertz loading (Zhou 2011, Eq. 5)."""
        k = theory.hertz_stiffness(pair.modulus_eff, radius_eff)
        return float(theory.overlap_max(k, mass_eff, velocity))

    def unloading_stiffness(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> float:
        """Largest tangent stiffness [N/m] in a binary collision."""
        raise NotImplementedError

    def stable_stiffness(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> float:
        """Tangent stiffness [N/m] at the maximum overlap of a confined particle; it bounds the time step."""
        return self.unloading_stiffness(pair, radius_eff, mass_eff, velocity)

    def loading_stiffness(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> float:
        """Normal tangent stiffness [N/m] at the maximum overlap.

        4 G/E times it is the tangential stiffness.
        """
        return self.stable_stiffness(pair, radius_eff, mass_eff, velocity)

    def viscosity(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Ratio of viscous force to overlap rate at the maximum overlap of a collision [N s/m]."""
        return 0.0

    def present_response(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float, time_step: float
    ) -> tuple[float, float]:
        """Largest tangent stiffness [N/m] and viscosity [N s/m] at the maximum overlap, loading or unloading.

        A servo wall, which reacts to the force, must react more slowly than these change the force. A contact
        of the restitution 0 stops the particle in one step: M/dt.
        """
        stopping = mass_eff / time_step
        stiffness = self.unloading_stiffness(pair, radius_eff, mass_eff, velocity)
        if self.limits_restitution:
            stiffness = min(stiffness, self.unloading_angle**2 * stopping / time_step)
        if pair.restitution == 0.0:
            return stiffness, stopping
        at_rest = 2.0 * self.reloading_damping * float(np.sqrt(stiffness * mass_eff))
        return stiffness, max(self.viscosity(pair, radius_eff, mass_eff, velocity), at_rest)

    # Unloading tangents that the time step bounds

    @property
    def unloading_angle(self) -> float:
        """theta of a model that bounds its unloading tangent by theta^2 M/dt^2; 0: no such bound."""
        return 0.0

    @property
    def reloading_damping(self) -> float:
        """Damping ratio, with the unloading tangent, of contacts that reload without having separated."""
        return 0.0

    def unloading_number(self, pair: PairMaterial) -> float:
        """Largest K dt^2/M + 2 c dt/M of a bounded unloading tangent K with damping c; default: theta^2."""
        return self.unloading_angle**2

    def unresolved_unloading(self, pair: PairMaterial) -> float:
        """Ratio of unloading to loading duration below which the time step need not resolve unloading.

        The model then bounds its own tangent.
        """
        return 0.0

    def least_restitution(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float, time_step: float
    ) -> float:
        """Smallest restitution that a collision can reach at a time step [s]."""
        return 0.0


class BinaryCollision(Protocol):
    """Closed form of one binary collision at an approach velocity."""

    @property
    def restitution(self) -> float:
        """Restitution coefficient."""

    @property
    def unloading_stiffness(self) -> float:
        """Largest tangent stiffness [N/m], at the start of unloading."""

    def durations(self) -> tuple[float, float]:
        """Loading and unloading durations [s]."""


class ClosedFormCollision:
    """Base class of normal models that describe a binary collision by one `BinaryCollision`.

    It precedes `NormalLaw` in the list of bases of a model.
    """

    def collision(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> BinaryCollision:
        """Closed form of a collision of a pair."""
        raise NotImplementedError

    def phase_durations(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> tuple[float, float]:
        """Loading and unloading durations [s]."""
        return self.collision(pair, radius_eff, mass_eff, velocity).durations()

    def unloading_stiffness(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> float:
        """Tangent stiffness at the start of unloading [N/m]."""
        return self.collision(pair, radius_eff, mass_eff, velocity).unloading_stiffness

    def restitution(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Restitution coefficient, which follows from the constants of the model."""
        return self.collision(pair, radius_eff, mass_eff, velocity).restitution


# Tangential, rolling and twisting models
#
# Their struct `contact` has further members, for the first particle of the pair:
#
#     normal, normal_half  unit normal n toward the first particle now, and normal p at the half step, the
#                          time of the velocities, divided by its component along n: p . n = 1
#     normal_load          force [N] that presses the surfaces together: normal force without attraction
#     stiffness            no-slip tangential stiffness [N/m]
#     stiffness_ratio      ratio of the previous to the present stiffness
#     slip, slip_rate      relative tangential displacement in this step [m], and velocity [m/s], in the
#                          present contact plane; tangential laws
#     normal_damping       dashpot coefficient of the normal model [N s/m]; damped tangential and twisting
#                          laws
#     turn                 angle [rad] by which both bodies turn about n in this step, the mean of both
#     rolling_rate         relative angular velocity [rad/s] at the half step; rolling and twisting laws
#     inertia_eff          effective moment of inertia [kg m2]; rolling laws
#     longest_time_step    longest time step of the run [s]; rolling laws
#
# A law that integrates a rate over the step takes its components with p: along the normal
# `rate.dot(normal_half)`, in the contact plane `in_contact_plane(rate, normal, normal_half)`. The normal n
# is half a step later than the rate, so that a part of the rotation of the pair would be integrated as
# slip, rolling or twist.

SurfaceState: TypeAlias = SimpleNamespace
"""Arguments of a reference implementation of one of these models: the members of `contact`, and `constants`
and `history` by name."""


@ti.func
def in_contact_plane(vector, normal, normal_half):
    """A vector brought into the present contact plane: a projection along the normal p of the half step.

        u - (u . n) p        n: present normal,  p . n = 1

    A relative velocity is that of the half step: its component along p vanishes, and the rest is rotated from
    the plane at the half step to the present one, with a relative error of the square of the angle between
    them. The displacement of a spring is in the previous contact plane, whose angle p halves: it is rotated
    from that plane to the present one.
    """
    return vector - vector.dot(normal) * normal_half


def reference_in_contact_plane(vector: np.ndarray, contact: SurfaceState) -> np.ndarray:
    """Reference implementation of `in_contact_plane` in numpy."""
    return vector - np.vdot(vector, contact.normal) * contact.normal_half


@ti.func
def carried(displacement, contact):
    """The displacement of a spring in the previous step, turned with both bodies.

        u cos(a) + n x u sin(a)        u: in the present contact plane,  a = `turn`, to its third order

    A spring whose bodies rotate together keeps its direction relative to them: particles that rest in a
    container that rotates would creep otherwise, as if their contacts slipped.
    """
    plane = in_contact_plane(displacement, contact.normal, contact.normal_half)
    turn = contact.turn
    return plane + turn * contact.normal.cross(plane) - (0.5 * turn * turn) * plane


@ti.func
def half_carried(step, contact):
    """The change of a displacement at the middle of the step, turned with both bodies to its end."""
    return step + 0.5 * contact.turn * contact.normal.cross(step)


def reference_half_carried(step: np.ndarray, contact: SurfaceState) -> np.ndarray:
    """Reference implementation of `half_carried` in numpy."""
    return step + 0.5 * contact.turn * np.cross(contact.normal, step)


def reference_carried(displacement: np.ndarray, contact: SurfaceState) -> np.ndarray:
    """Reference implementation of `carried` in numpy."""
    plane = reference_in_contact_plane(displacement, contact)
    return plane + contact.turn * np.cross(contact.normal, plane) - 0.5 * contact.turn**2 * plane


@dataclass(frozen=True)
class SurfaceLaw(Law):
    """A model of what two surfaces in contact exert on each other in addition to the normal force."""

    @property
    def damped(self) -> bool:
        """Whether the law reads `normal_damping`."""
        return False

    @ti.func
    def act(self, constants, contact, kinematics, history):
        """Struct of the force on the first particle [N], if there is one, the torques on both [N m], the
        history, and the loss [J], the energy dissipated in this step.

        kinematics:  of the pair, with the lever arms, see `engine.pair.sphere_kinematics`
        """

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Recoverable energy [J]."""
        return 0.0 * contact.stiffness


AT_LIMIT = 1.0 - 1e-6
"""Share of the largest tangential force above which a contact counts as sliding."""


@dataclass(frozen=True)
class TangentialLaw(SurfaceLaw):
    """A tangential contact model: a force in the contact plane.

    An option `stiffness` [N/m] replaces that of the normal model in the time step.

    sticks:  whether surfaces stick below the limit; then their relative motion there is elastic
    """

    sticks: ClassVar[bool] = True
    required = ("force", "present_force", "limit")
    returns: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **Law.returns,
        "force": ("vector", "history", "number"),
        "present_force": ("vector", "number"),
        "limit": ("number",),
    }

    @ti.func
    def act(self, constants, contact, kinematics, history):
        """The force, with its lever arms, see `SurfaceLaw`."""
        force, history_new, loss = self.force(constants, contact, history)
        moment = kinematics.normal.cross(force)
        return ti.Struct(
            force=force,
            torque=-kinematics.arm * moment,
            torque_partner=-kinematics.arm_partner * moment,
            history=history_new,
            loss=loss,
        )

    @ti.func
    def force(self, constants, contact, history):
        """Tangential force [N] on the first particle, the history, and the energy dissipated in this step
        [J]."""

    @ti.func
    def limit(self, constants, contact):
        """Largest tangential force [N]."""

    @ti.func
    def present_force(self, constants, contact, history):
        """Tangential force [N] that the history alone gives, and its size [N]; for contact output."""

    def reference(self, contact: SurfaceState) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Reference implementation of `force`: tangential force [N] (3,) and the changed history fields."""
        raise NotImplementedError


@dataclass(frozen=True)
class TorqueLaw(SurfaceLaw):
    """A model of torques on the first particle of a pair; the opposite torques act on the second."""

    required = ("torque",)
    returns: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **Law.returns,
        "torque": ("vector", "history", "number"),
    }

    @ti.func
    def act(self, constants, contact, kinematics, history):
        """The torque on both particles, see `SurfaceLaw`."""
        torque, history_new, loss = self.torque(constants, contact, history)
        return ti.Struct(torque=torque, torque_partner=-torque, history=history_new, loss=loss)

    @ti.func
    def torque(self, constants, contact, history):
        """Torque [N m] on the first particle, the history, and the energy dissipated in this step [J]."""

    def reference(self, contact: SurfaceState) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Reference implementation of `torque`: torque [N m] (3,) and the changed history fields."""
        raise NotImplementedError


@dataclass(frozen=True)
class RollingLaw(TorqueLaw):
    """A rolling model."""


@dataclass(frozen=True)
class TwistingLaw(TorqueLaw):
    """A twisting model, with torques about the normal.

    It reads `history` and `contact` for its stored energy, of which only `overlap`, `radius_eff`, `mass_eff`
    and `stiffness` are known.
    """


# Cohesion models


@dataclass(frozen=True)
class CohesionLaw(Law):
    """A cohesion model: an attraction in addition to any normal model, and optionally a viscous force.

    It does not press the surfaces together. `force` and `viscous_force` have no branch, as for a normal
    model. A model that acts at a distance (`at_distance`) also gets negative overlaps, down to minus its
    `range`; its first history field is above 0 as long as the contact keeps its history without overlap.

    A model that defines `viscous_force` also defines `resistance`, which limits the time step, and
    `reference_viscous_force`. The particles then rotate; what the force dissipates is a term of the energy
    budget, the `loss` of the slot.
    """

    required = ("force", "reference")
    required_if_viscous: ClassVar[tuple[str, ...]] = ("resistance", "reference_viscous_force")
    """Functions that a model with a viscous force must define."""
    returns: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **Law.returns,
        "force": ("number", "history"),
        "viscous_force": ("number", "vector"),
    }
    transfers_liquid: ClassVar[bool] = False
    """True for a model whose bridges take liquid from films on the particles, see `form`."""

    @ti.func
    def force(self, constants, contact, history):
        """Attraction [N], positive, and the history."""

    @property
    def is_viscous(self) -> bool:
        """Whether `viscous_force` acts; by default whether the model defines it."""
        return type(self).viscous_force is not CohesionLaw.viscous_force

    @ti.func
    def viscous_force(self, constants, contact, history):
        """Force that the velocities of the surfaces cause, with and without overlap: its component [N] along
        the normal, positive if it resists approach, and the tangential force [N] on the first particle.

        Evaluated after `force`, with its history. `contact` has in addition, at the time of the positions,

            overlap_rate  approach velocity of the surfaces [m/s]
            slip_rate     velocity [m/s] of the first surface relative to the other, in the contact plane

        where the surfaces are at the middle of the overlap, or of the gap. There the tangential force acts:
        it exerts torques on both particles. The force must not feed energy.
        """

    def resistance(self, pair: PairMaterial, radius_eff: float) -> tuple[float, float]:
        """Largest ratios [N s/m] of the viscous force to the velocity, normal and tangential."""
        return 0.0, 0.0

    def reference_viscous_force(self, contact: ContactState) -> tuple[float, np.ndarray]:
        """Reference implementation of `viscous_force`: normal component [N] and tangential force [N] (3,)."""
        raise NotImplementedError

    @ti.func
    def form(self, constants, contact, history, volume):
        """The history after a bridge of a volume [m3] has formed; its first field is this volume."""

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Recoverable energy [J]; negative for an attraction."""
        return 0.0 * contact.overlap

    @ti.func
    def lost_energy(self, constants, contact, history):
        """Dissipated energy [J], a function of the history alone; of an open contact at minus the range."""
        return 0.0 * contact.overlap

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force`: attraction [N] and the changed history fields."""
        raise NotImplementedError

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


# Heat models


@dataclass(frozen=True)
class HeatLaw(Law):
    """A model of the heat that flows through contacts; it exerts no force.

    Its flow is `heat_flow` [W], from which the temperature of the particles follows.
    """

    required = ("flow", "wall_flow", "flow_bounds")
    flows = {
        "heat_flow": Flow(
            "W",
            "heat that flows to the particle through its contacts",
            Quantity("wall_heat", "", "J", "heat that the wall has given to the particles since the start"),
            Quantity("wall_heat_flow", "", "W", "heat that flows from the wall to the particles"),
            Quantity(
                "surroundings_heat",
                "",
                "J",
                "heat that the surroundings have given to the particles since the start",
            ),
            Source(
                "heat_source",
                "heat released in the particle",
                Number("power"),
                Quantity("source_heat", "", "J", "heat released in the particles since the start"),
            ),
        )
    }
    particle_properties = ("temperature",)


# Records: the keys that a model adds to a scene


class Options(Model):
    """Options of a contact model: its keys in `contact` in addition to its name; this class has none.

    A subclass declares them as fields, each with a description, and with a default or an example.
    """

    with_numbers: ClassVar[Mapping[str, str]] = {}
    """Options that take a fixed value if the restitution of every pair is a number, by key."""

    @property
    def rate_reason(self) -> str:
        """The key of a normal model that decides whether its force depends on velocities, with its value, for
        `granflow explain`; empty if no key does."""
        return ""


class PairProperties(Model):
    """Keys of `pairs` that a contact model requires; if all are 0 for all pairs, the model is left out.

    A subclass declares them as fields, each with a description and an example, without a default.
    """


@dataclass(frozen=True)
class Remedy:
    """What to write for a property of a pair, for the message on a missing key; metadata of its type."""

    text: str = "give a value, or 0"


FrictionCoefficient = Annotated[float, Number(noun="a friction coefficient", at_least=0)]


class SlidingFriction(PairProperties):
    """Sliding friction, which every pair has, for every tangential model."""

    friction: FrictionCoefficient = Field(
        description="Coulomb friction coefficient; 0 for no friction", examples=["0.5"]
    )


class RollingFriction(PairProperties):
    """Rolling friction, shared by the rolling models."""

    rolling_friction: Annotated[
        FrictionCoefficient, Remedy("give the coefficient, or 0 to disable rolling friction")
    ] = Field(description="rolling friction coefficient", examples=["0.1"])


class WorkOfAdhesion(PairProperties):
    """Work of adhesion, shared by the models of dry adhesion."""

    work_of_adhesion: Annotated[
        float,
        Number("surface_energy", noun="a work of adhesion", at_least=0),
        Remedy("give it in J/m2, or 0 to disable cohesion"),
    ] = Field(
        description="work of adhesion w [J/m2]: energy per area that separates the two surfaces; twice the "
        "surface energy of equal materials",
        examples=["50 mJ/m2"],
    )


@dataclass(frozen=True)
class Slot:
    """A key of `contact`, whose value selects one of the models of a base class.

    What the models of a slot add to a contact follows from the base class. Those of a `SurfaceLaw` act on
    surfaces that touch, and require rotations; their forces, torques, losses, energies and histories need
    nothing but this record. The normal force and cohesion are written out in `engine/pair.py`.

    name:      the key
    base:      base class of the laws
    loss:      term of the energy budget to which `act` of a `SurfaceLaw` or a viscous force of a cohesion
               model adds, see `plan.sum_units.LOSSES`
    optional:  whether a scene may omit the key: it then has no such model
    remark:    end of the description of the key
    """

    name: str
    base: type[Law]
    loss: str = ""
    optional: bool = False
    remark: str = ""

    @property
    def on_surface(self) -> bool:
        """Whether the models act on surfaces that touch."""
        return issubclass(self.base, SurfaceLaw)


SLOTS: Mapping[str, Slot] = {
    slot.name: slot
    for slot in (
        Slot("normal", NormalLaw),
        Slot("tangential", TangentialLaw, "friction_dissipation"),
        Slot("rolling", RollingLaw, "rolling_dissipation"),
        Slot("twisting", TwistingLaw, "rolling_dissipation", optional=True),
        Slot(
            "cohesion",
            CohesionLaw,
            "damping_dissipation",
            optional=True,
            remark=", with any normal contact model",
        ),
        Slot("heat", HeatLaw, optional=True),
    )
}
"""Keys of `contact` in the order of evaluation, by name."""
RestitutionInput: TypeAlias = Literal["number or fit", "positive number", "nothing"]
"""Form of `restitution` that a model requires of a pair; "nothing" if restitution follows from the
materials."""


@dataclass(frozen=True)
class ContactModel:
    """A contact model of one slot, declared in one file.

    law:                  class with the functions of the model and its `name`, `source` and `limits`
    summary:              description in one sentence
    options:              class of the keys of the model in `contact`, in addition to its name
    pair_properties:      class of the keys of `pairs` that the model requires
    material_properties:  class of the keys of materials that the model requires of particles, and of walls
                          with which they exchange a property; those of which the default is None are optional
    restitution:          form of the restitution that a normal model requires of a pair
    """

    law: type[Law]
    summary: str
    options: type[Options] = Options
    pair_properties: type[PairProperties] = PairProperties
    material_properties: type[MaterialProperties] = MaterialProperties
    restitution: RestitutionInput = "positive number"

    @property
    def name(self) -> str:
        """Value of the slot in `contact`."""
        return self.law.name

    @property
    def slot(self) -> str:
        """Key of `contact` that selects the model."""
        return next(name for name, slot in SLOTS.items() if issubclass(self.law, slot.base))

    def acts(self, pairs: Iterable[Any]) -> bool:
        """Whether the model acts between any of the pairs of the block `pairs`: it is the normal model, has
        no properties of pairs, or one of them is not 0."""
        keys = self.pair_properties.model_fields
        return self.slot == "normal" or not keys or any(getattr(pair, key) for pair in pairs for key in keys)

    @property
    def required_options(self) -> dict[str, str]:
        """Options without a default, by key, each with its example."""
        return {
            key: str(example_of(each))
            for key, each in self.options.model_fields.items()
            if each.is_required()
        }

    @property
    def example(self) -> dict[str, Any]:
        """Options of a common variant in SI units, for studies of single collisions: those required."""
        return self.options(**self.required_options).model_dump(include=set(self.required_options))

    @property
    def pair_example(self) -> dict[str, Any]:
        """Example properties of a pair in SI units, for studies of single collisions."""
        keys = self.pair_properties.model_fields
        return self.pair_properties(**{key: str(example_of(each)) for key, each in keys.items()}).model_dump()
