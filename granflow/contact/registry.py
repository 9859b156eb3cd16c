"""Registry of contact models by slot and name. A built-in model is one file and one entry here. No Taichi."""

import re
from collections.abc import Iterator, Mapping

from granflow.contact.cohesion import capillary, capillary_transfer, dmt, jkr, sjkr, van_der_waals
from granflow.contact.law import SLOTS, CohesionLaw, ContactModel, PairOption
from granflow.contact.normal import hertz, kuwabara_kono, linear, luding, thornton, walton_braun, zhou
from granflow.contact.rolling import cdt, epsd, sds, viscous
from granflow.contact.tangential import linear_history, mindlin
from granflow.contact.twisting import marshall, torsion_spring

_NAME = re.compile(r"[a-z][a-z0-9_]*")

_MODELS: dict[str, dict[str, ContactModel]] = {slot: {} for slot in SLOTS}


def add(model: ContactModel) -> None:
    """Add a model to its slot. Raises ValueError for a record that is not valid, or a name that exists."""
    problem = next(_problems(model), None)
    if problem:
        raise ValueError(f"contact model {getattr(model.law, 'name', model.law.__name__)}: {problem}")
    _MODELS[model.slot][model.name] = model


def remove(model: ContactModel) -> None:
    """Remove a model that was added."""
    del _MODELS[model.slot][model.name]


def models(slot: str) -> Mapping[str, ContactModel]:
    """The models of a slot by name, in the order of registration."""
    return _MODELS[slot]


def pair_options() -> dict[str, PairOption]:
    """The keys of `pairs` that any model requires."""
    return {
        option.key: option
        for slot in _MODELS.values()
        for model in slot.values()
        for option in model.pair_options
    }


def models_with(key: str) -> dict[str, list[str]]:
    """Slots and names of the models that require a key of `pairs`."""
    found = {
        slot: [
            name for name, model in named.items() if any(option.key == key for option in model.pair_options)
        ]
        for slot, named in _MODELS.items()
    }
    return {slot: names for slot, names in found.items() if names}


def liquid_models() -> list[str]:
    """Names of the cohesion models that transfer liquid between particles and bridges."""
    laws = {name: model.law for name, model in models("cohesion").items()}
    return [name for name, law in laws.items() if issubclass(law, CohesionLaw) and law.transfers_liquid]


def _problems(model: ContactModel) -> Iterator[str]:
    """Reasons why a record cannot be registered."""
    if not any(issubclass(model.law, base) for base in SLOTS.values()):
        yield f"its law must be a subclass of {', '.join(base.__name__ for base in SLOTS.values())}"
        return
    missing = [
        name for name in ("name", "source", "limits") if not isinstance(getattr(model.law, name, None), str)
    ]
    if missing:
        yield f"its law has no {' and no '.join(missing)}"
    elif not _NAME.fullmatch(model.name) or model.name == "none":
        yield "a name has lowercase letters, digits and _, and is not none"
    elif model.name in _MODELS[model.slot]:
        yield f"a {model.slot} model of this name exists"
    yield from _undefined(model)
    known = pair_options()
    for option in model.pair_options:
        if not _NAME.fullmatch(option.key) or option.key in ("restitution", "model"):
            yield f"{option.key} is not a valid key of pairs"
        elif known.get(option.key, option) != option:
            yield f"the key {option.key} of pairs exists with another meaning"
        elif option.amount.default is not None:
            yield f"the key {option.key} of pairs has a default; a physical property has none"


def _undefined(model: ContactModel) -> Iterator[str]:
    """Functions and constants that the interface of the slot requires and the law does not define."""
    base = SLOTS[model.slot]
    undefined = [name for name in base.required if getattr(model.law, name) is getattr(base, name)]
    if undefined:
        yield f"its law must define {', '.join(undefined)}, see {base.__module__}.{base.__name__}"
    moduli = ("modulus_eff", "shear_modulus_eff")
    if model.slot == "normal" and model.law.constant_names[:2] != moduli:
        yield f"constant_names of a normal model begins with {' and '.join(moduli)}"


_NORMAL = (zhou, hertz, linear, thornton, walton_braun, luding, kuwabara_kono)
_SURFACE = (mindlin, linear_history, epsd, cdt, sds, viscous, marshall, torsion_spring)
for _module in (*_NORMAL, *_SURFACE, sjkr, dmt, jkr, capillary, capillary_transfer, van_der_waals):
    add(_module.MODEL)
