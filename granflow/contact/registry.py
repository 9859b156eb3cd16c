"""Registry of contact models by slot and name and of particle equations, and the laws that one scene selects.
No Taichi.

A built-in model or equation is one file and one entry here. `ContactLaws` holds the laws of a scene, one per
slot that it needs, and their layout in arrays.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic.fields import FieldInfo

from granflow import fields
from granflow.arguments import shown
from granflow.contact.cohesion import capillary, capillary_transfer, dmt, jkr, sjkr, van_der_waals
from granflow.contact.heat import conduction, temperature
from granflow.contact.law import (
    SLOTS,
    CohesionLaw,
    ContactModel,
    Flow,
    HistoryField,
    Law,
    NormalLaw,
    Options,
    PairProperties,
    Source,
    SurfaceLaw,
    TangentialLaw,
    WallProperties,
)
from granflow.contact.material import PairMaterial
from granflow.contact.normal import eepa, hertz, kuwabara_kono, linear, luding, thornton, walton_braun, zhou
from granflow.contact.particle_equation import MaterialProperties, ParticleEquation, flow_field, source_field
from granflow.contact.rolling import cdt, epsd, sds, viscous
from granflow.contact.tangential import linear_history, mindlin, sliding_dashpot
from granflow.contact.twisting import marshall, torsion_spring
from granflow.fields import Quantity
from granflow.schema.model import example_of, is_name

_MODELS: dict[str, dict[str, ContactModel]] = {slot: {} for slot in SLOTS}
_EQUATIONS: dict[str, ParticleEquation] = {}


def add(model: ContactModel) -> None:
    """Add a model to its slot. Raises ValueError for a record that is not valid, or a name that exists."""
    problem = next(_problems(model), None)
    if problem:
        raise ValueError(f"contact model {getattr(model.law, 'name', model.law.__name__)}: {problem}")
    for name, each in model.law.flows.items():
        fields.add(flow_field(name, each.unit, each.meaning))
        fields.WALL_FLOW_QUANTITIES.update(_of_walls(each))
        if each.from_surroundings is not None:
            fields.add_total(each.from_surroundings)
        if each.source is not None:
            fields.add(source_field(each.source.name, each.unit, each.source.meaning))
            fields.add_total(each.source.total)
    _MODELS[model.slot][model.name] = model


def remove(model: ContactModel) -> None:
    """Remove a model that was added."""
    del _MODELS[model.slot][model.name]
    others = {name for slot in _MODELS.values() for other in slot.values() for name in other.law.flows}
    for name in set(model.law.flows) - others:
        fields.remove(name)
        flow = model.law.flows[name]
        for quantity in _of_walls(flow):
            del fields.WALL_FLOW_QUANTITIES[quantity]
        if flow.from_surroundings is not None:
            fields.remove_total(flow.from_surroundings)
        if flow.source is not None:
            fields.remove(flow.source.name)
            fields.remove_total(flow.source.total)


def _of_walls(flow: Flow) -> dict[str, Quantity]:
    """Numbers of walls of a flow by name."""
    return {each.name: each for each in (flow.from_walls, flow.rate_from_walls) if each is not None}


def models(slot: str) -> Mapping[str, ContactModel]:
    """The models of a slot by name, in the order of registration."""
    return _MODELS[slot]


def pair_properties() -> dict[str, FieldInfo]:
    """The keys of `pairs` that any model requires, with their declarations."""
    return {
        key: each
        for slot in _MODELS.values()
        for model in slot.values()
        for key, each in model.pair_properties.model_fields.items()
    }


def material_properties() -> dict[str, tuple[FieldInfo, str]]:
    """The keys of materials that particle equations and models require: declaration, and what needs it."""
    found = {
        key: (each, f"for the {equation.name}")
        for equation in _EQUATIONS.values()
        for key, each in equation.material_properties.model_fields.items()
    }
    for slot, named in _MODELS.items():
        for model in named.values():
            for key, each in model.material_properties.model_fields.items():
                found[key] = each, f"for contact.{slot}: {model.name}"
    return found


def wall_properties() -> dict[str, FieldInfo]:
    """The keys of walls that any model reads, with their declarations."""
    return {
        key: each
        for named in _MODELS.values()
        for model in named.values()
        for key, each in model.law.wall_properties.model_fields.items()
    }


def models_with(key: str) -> dict[str, list[str]]:
    """Slots and names of the models that require a key of `pairs`."""
    found = {
        slot: [name for name, model in named.items() if key in model.pair_properties.model_fields]
        for slot, named in _MODELS.items()
    }
    return {slot: names for slot, names in found.items() if names}


def liquid_models() -> list[str]:
    """Names of the cohesion models that transfer liquid between particles and bridges."""
    laws = {name: model.law for name, model in models("cohesion").items()}
    return [name for name, law in laws.items() if issubclass(law, CohesionLaw) and law.transfers_liquid]


def dashpot_models() -> list[str]:
    """Names of the normal models with a dashpot."""
    laws = {name: model.law for name, model in models("normal").items()}
    return [name for name, law in laws.items() if issubclass(law, NormalLaw) and law.has_dashpot()]


def _problems(model: ContactModel) -> Iterator[str]:
    """Reasons why a record cannot be registered."""
    if not any(issubclass(model.law, slot.base) for slot in SLOTS.values()):
        yield f"its law must be a subclass of {', '.join(slot.base.__name__ for slot in SLOTS.values())}"
        return
    missing = [
        name for name in ("name", "source", "limits") if not isinstance(getattr(model.law, name, None), str)
    ]
    if missing:
        yield f"its law has no {' and no '.join(missing)}"
    elif not is_name(model.name) or model.name == "none":
        yield "a name has lowercase letters, digits and _, and is not none"
    elif model.name in _MODELS[model.slot]:
        yield f"a {model.slot} model of this name exists"
    yield from _undefined(model)
    yield from _undeclared(model)


def _undeclared(model: ContactModel) -> Iterator[str]:
    """Reasons why the options of a model or its properties of pairs are not valid."""
    classes = (
        (model.options, Options),
        (model.pair_properties, PairProperties),
        (model.material_properties, MaterialProperties),
        (model.law.wall_properties, WallProperties),
    )
    for given, base in classes:
        if not (isinstance(given, type) and issubclass(given, base)):
            yield f"{shown(given)} is not a subclass of {base.__module__}.{base.__name__}"
            return
    for key, each in model.options.model_fields.items():
        if each.is_required() and example_of(each) is None:
            yield f"the option {key} has neither a default nor an example"
    known = pair_properties()
    for key, each in model.pair_properties.model_fields.items():
        if not is_name(key) or key in ("restitution", "model"):
            yield f"{key} is not a valid key of pairs"
        elif _meaning(known.get(key, each)) != _meaning(each):
            yield f"the key {key} of pairs exists with another meaning"
        elif not each.is_required():
            yield f"the key {key} of pairs has a default; a physical property has none"


def _meaning(field: FieldInfo) -> tuple[Any, ...]:
    """What a key means: its type, limits and description."""
    return field.annotation, field.metadata, field.description


def _undefined(model: ContactModel) -> Iterator[str]:
    """Functions and constants that the interface of the slot requires and the law does not define."""
    base = SLOTS[model.slot].base
    required = (*base.required, *(("flow", "flow_bounds") if model.law.flows else ()))
    law = model.law
    if issubclass(law, CohesionLaw) and law.viscous_force is not CohesionLaw.viscous_force:
        required += CohesionLaw.required_if_viscous
    undefined = [name for name in required if getattr(model.law, name) is getattr(base, name)]
    if undefined:
        yield f"its law must define {', '.join(undefined)}, see {base.__module__}.{base.__name__}"
    moduli = ("modulus_eff", "shear_modulus_eff")
    if model.slot == "normal" and model.law.constant_names[:2] != moduli:
        yield f"constant_names of a normal model begins with {' and '.join(moduli)}"


_NORMAL = (zhou, hertz, linear, thornton, walton_braun, luding, eepa, kuwabara_kono)
_OTHER = (sjkr, dmt, jkr, capillary, capillary_transfer, van_der_waals, conduction)
_SURFACE = (mindlin, linear_history, sliding_dashpot, epsd, cdt, sds, viscous, marshall, torsion_spring)
for _module in (*_NORMAL, *_SURFACE, *_OTHER):
    add(_module.MODEL)

# Particle equations


def add_equation(equation: ParticleEquation) -> None:
    """Add a particle equation. Raises ValueError for one that is not valid, or a name that exists."""
    problem = next(_problems_of_equation(equation), None)
    if problem:
        raise ValueError(f"particle equation {getattr(equation, 'name', type(equation).__name__)}: {problem}")
    fields.add(equation.field)
    for each in equation.totals:
        fields.add_total(each)
    _EQUATIONS[equation.name] = equation


def remove_equation(equation: ParticleEquation) -> None:
    """Remove an equation that was added."""
    fields.remove(equation.name)
    for each in equation.totals:
        fields.remove_total(each)
    del _EQUATIONS[equation.name]


def equations() -> tuple[ParticleEquation, ...]:
    """All registered equations."""
    return tuple(_EQUATIONS.values())


def sources() -> dict[str, tuple[str, Source]]:
    """Sources of the flows of all registered models by name, each with the name of its flow."""
    laws = [model.law for slot in _MODELS.values() for model in slot.values()]
    return {
        flow.source.name: (name, flow.source)
        for law in laws
        for name, flow in law.flows.items()
        if flow.source is not None
    }


def equations_with(flows: tuple[str, ...]) -> tuple[ParticleEquation, ...]:
    """The equations that act if contact models have these flows."""
    return tuple(each for each in _EQUATIONS.values() if each.acts_with(flows))


def equations_of(models: Iterable[ContactModel]) -> tuple[ParticleEquation, ...]:
    """The equations that act with these contact models, because they have the flows that each reads."""
    return equations_with(tuple(name for model in models for name in model.law.flows))


def _problems_of_equation(equation: ParticleEquation) -> Iterator[str]:
    """Reasons why an equation cannot be registered."""
    missing = [name for name in ("name", "meaning", "initial", "flows") if not hasattr(equation, name)]
    undefined = [
        name
        for name in ("rate", "longest_time_step")
        if getattr(type(equation), name) is getattr(ParticleEquation, name)
    ]
    if missing or undefined:
        needed = " and ".join((*missing, *undefined))
        yield f"its class must define {needed}, see {ParticleEquation.__module__}.ParticleEquation"
    elif not is_name(equation.name):
        yield "a name has lowercase letters, digits and _"
    elif not isinstance(equation.flows, tuple) or not all(map(is_name, equation.flows)):
        yield f'flows is {shown(equation.flows)}, but must be a tuple of names, such as ("heat_flow",)'
    elif equation.name in _EQUATIONS:
        yield "an equation of this name exists"
    elif equation.name in fields.PARTICLE_QUANTITIES:
        yield f"a property {equation.name} of the particles exists"
    elif not issubclass(equation.material_properties, MaterialProperties):
        yield f"{shown(equation.material_properties)} is not a subclass of {MaterialProperties.__module__}"


for _equation in (temperature.EQUATION,):
    add_equation(_equation)

# The laws of one scene


@dataclass(frozen=True)
class ContactLaws:
    """Laws of a scene, one per slot; slots that no pair of materials needs have none.

    A frozen tuple, so that kernels can be cached by it.
    """

    laws: tuple[Law, ...]

    @property
    def by_slot(self) -> Mapping[str, Law]:
        """The laws by slot, in the order of evaluation and of the columns of the pair constants."""
        return {name: law for name, slot in SLOTS.items() for law in self.laws if isinstance(law, slot.base)}

    @property
    def names(self) -> Mapping[str, str]:
        """Name of the model of each slot, or "none"."""
        return {slot: self.by_slot[slot].name if slot in self.by_slot else "none" for slot in SLOTS}

    @property
    def structure(self) -> tuple[tuple[str, Law], ...]:
        """Each slot with the structure of its law, see `Law.structure`."""
        return tuple((slot, law.structure) for slot, law in self.by_slot.items())

    @property
    def normal(self) -> NormalLaw:
        """The normal model."""
        return next(law for law in self.laws if isinstance(law, NormalLaw))

    @property
    def tangential(self) -> TangentialLaw | None:
        """The tangential model, whose force is an output of contacts."""
        return next((law for law in self.laws if isinstance(law, TangentialLaw)), None)

    @property
    def cohesion(self) -> CohesionLaw | None:
        """The cohesion model, which may act at a distance."""
        return next((law for law in self.laws if isinstance(law, CohesionLaw)), None)

    @property
    def of_contact_radius(self) -> str:
        """Slot of the law that defines the contact radius."""
        own = self.cohesion is not None and type(self.cohesion).contact_radius is not Law.contact_radius
        return "cohesion" if own else "normal"

    @property
    def has_tangential(self) -> bool:
        """Whether a tangential model acts; kernels cannot compare with None."""
        return self.tangential is not None

    @property
    def has_cohesion(self) -> bool:
        """Whether a cohesion model acts."""
        return self.cohesion is not None

    @property
    def on_surface(self) -> tuple[tuple[str, SurfaceLaw], ...]:
        """Slot and law of each model that acts on surfaces that touch, in the order of evaluation."""
        return tuple((slot, law) for slot, law in self.by_slot.items() if isinstance(law, SurfaceLaw))

    @property
    def of_surroundings(self) -> tuple[str, Law] | None:
        """Slot and law with which particles exchange something with their surroundings."""
        return next((each for each in self.by_slot.items() if each[1].has_surroundings), None)

    @property
    def sources(self) -> Mapping[str, Source]:
        """Sources of the particles by flow."""
        found = {name: each.source for law in self.laws for name, each in law.flows.items()}
        return {name: each for name, each in found.items() if each is not None}

    @property
    def of_losses(self) -> Law | None:
        """The law that adds losses of contacts to one of its flows."""
        return next((law for law in self.laws if law.loss_flow), None)

    @property
    def flows_from_walls(self) -> Mapping[str, Quantity]:
        """Flows that are summed for each wall, with the quantity of the sum."""
        found = {name: each.from_walls for law in self.laws for name, each in law.flows.items()}
        return {name: each for name, each in found.items() if each is not None}

    @property
    def rates_from_walls(self) -> Mapping[str, Quantity]:
        """Of these, the flows whose rate is a number of each wall, with its quantity."""
        found = {name: each.rate_from_walls for law in self.laws for name, each in law.flows.items()}
        return {name: each for name, each in found.items() if each is not None}

    @property
    def wall_properties(self) -> tuple[str, ...]:
        """Keys of walls that the laws read, each once."""
        return tuple(dict.fromkeys(key for law in self.laws for key in law.wall_properties.model_fields))

    @property
    def flows(self) -> tuple[str, ...]:
        """Names of what flows through contacts, each once."""
        return tuple(dict.fromkeys(name for law in self.laws for name in law.flows))

    @property
    def damped_slots(self) -> tuple[str, ...]:
        """Slots whose dashpot is a multiple of that of the normal model."""
        return tuple(slot for slot, law in self.on_surface if law.damped)

    @property
    def acts_at_distance(self) -> bool:
        """Whether a model acts without overlap."""
        return any(law.at_distance for law in self.laws)

    @property
    def cohesion_at_distance(self) -> bool:
        """Whether the cohesion model acts without overlap."""
        return self.cohesion is not None and self.cohesion.at_distance

    @property
    def flows_at_distance(self) -> bool:
        """Whether something flows between separated surfaces."""
        return any(law.at_distance for law in self.laws if law.flows)

    @property
    def transfers_liquid(self) -> bool:
        """Whether the cohesion model takes liquid from films on the particles."""
        return self.cohesion is not None and self.cohesion.transfers_liquid

    @property
    def has_viscous_cohesion(self) -> bool:
        """Whether the cohesion model has a force that the velocities of the surfaces cause."""
        return self.cohesion is not None and self.cohesion.is_viscous

    @property
    def range(self) -> float:
        """Largest distance [m] between two surfaces at which a model acts."""
        return max(law.range for law in self.laws)

    @property
    def attracts(self) -> bool:
        """Whether the normal force can be attractive."""
        return self.normal.attracts or self.has_cohesion

    @property
    def constant_names(self) -> Mapping[str, tuple[str, ...]]:
        """Names of the pair constants of each slot; a row of the pair constants has them in this order."""
        return {slot: law.constant_names for slot, law in self.by_slot.items()}

    @property
    def parameters(self) -> Mapping[str, Mapping[str, float]]:
        """Parameters of each slot by name; on the device, those of all slots are one row."""
        return {slot: law.parameters for slot, law in self.by_slot.items()}

    @property
    def history(self) -> Mapping[str, tuple[HistoryField, ...]]:
        """History fields of each slot, empty ones included."""
        return {slot: law.history for slot, law in self.by_slot.items()}

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Row of the pair constants. Raises ValueError for a pair that a model does not support."""
        return tuple(value for law in self.by_slot.values() for value in law.pair_constants(pair))
