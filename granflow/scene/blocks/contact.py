"""Schema of the block `contact`: the registered contact models with their options.

`Contact` has one key per slot of `contact.law.SLOTS`. The value is the name of a model, or a mapping with the
key `law` and the options of the model. The schema class of such a
mapping is created here: it adds `law` to the class of the options.
"""

from collections.abc import Callable, Mapping
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from pydantic import Field, Tag, create_model
from pydantic.fields import FieldInfo

from granflow.contact import registry
from granflow.contact.law import SLOTS, ContactModel, Options
from granflow.schema.model import Model, ShortForm, choose_by, choose_by_key, shorthand


class LawSettings(Model):
    """A contact model and its options; base class of one schema class per contact model with options."""

    law: str

    @property
    def record(self) -> ContactModel:
        """The registered record of a normal model."""
        return registry.models("normal")[self.law]


class Contact(Model):
    """Contact models, the same for all pairs of materials.

    Normal force, tangential force (friction), rolling and twisting torque, cohesion; friction coefficients
    are properties of the pairs.

    >>> linear = {"law": "linear", "stiffness": "onset"}
    >>> gf.Contact(normal=linear, tangential="mindlin", rolling="none").name("normal")
    'linear'
    """

    # `use_registry` replaces this type by that of the registered models, and adds the other slots.
    normal: LawSettings

    if TYPE_CHECKING:  # keys of slots

        def __init__(self, *, normal: Any, **slots: Any) -> None: ...

    def name(self, slot: str) -> str:
        """Name of the model of a slot, or "none"."""
        given = getattr(self, slot)
        return given if isinstance(given, str) else str(given.law)

    def options(self, slot: str) -> Any:
        """Options of the model of a slot: an instance of its class `ContactModel.options`."""
        given = getattr(self, slot)
        if not isinstance(given, str):
            return given
        model = registry.models(slot).get(given)
        return model.options() if model else Options()

    @classmethod
    def with_default_options(cls, given: Any) -> "Contact | None":
        """The models that a block names, for checks of what they require; None if a model is not known.

        Other slots than `normal` have names only, and required options are missing.
        """
        if not isinstance(given, Mapping):
            return None
        chosen: dict[str, Any] = {}
        for slot in SLOTS:
            value = given.get(slot, "none" if SLOTS[slot].optional else None)
            name = value.get("law") if isinstance(value, Mapping) else value
            if not isinstance(name, str) or name not in _words(slot):
                return None
            chosen[slot] = name
        normal = _model(registry.models("normal")[chosen["normal"]])
        return cls.model_construct(**chosen | {"normal": normal.model_construct(law=chosen["normal"])})

    @classmethod
    def hint(cls, key: str, word: str) -> str:
        """What a name that is not one of a slot needs: options, another slot, or a registration."""
        own = registry.models(key).get(word)
        if own is not None and own.required_options:
            return _needed_options(own)
        other = next((slot for slot in SLOTS if slot != key and word in registry.models(slot)), None)
        if other is not None:
            return f". {word} is given as contact.{other}: {word}"
        return ". Register a model of your own before: granflow.register_contact_model"


def _needed_options(model: ContactModel) -> str:
    """Sentence on the options that a model requires."""
    given = ", ".join(f"{key}: {example}" for key, example in model.required_options.items())
    needed = " and ".join(model.required_options)
    return f". {model.name} requires {needed}, such as {{law: {model.name}, {given}}}"


def _words(slot: str) -> set[str]:
    """All names that a slot can have."""
    return {*registry.models(slot), *(() if slot == "normal" else ("none",))}


# The keys of the slots


def use_registry() -> None:
    """Set the fields of `contact` to the registered models.

    A schema that is built must be rebuilt afterwards.
    """
    for slot in SLOTS:
        annotation, field = _normal() if slot == "normal" else _slot(slot)
        Contact.__pydantic_fields__[slot] = FieldInfo.from_annotated_attribute(annotation, field)


def _normal() -> tuple[Any, Any]:
    """Annotation and field of `normal`, whose value is always a mapping or expanded to one."""
    models = registry.models("normal")
    words = tuple(name for name, model in models.items() if not model.required_options)
    annotation: Any = Annotated[
        Union[tuple(Annotated[_model(model), Tag(f"<{name}>")] for name, model in models.items())],  # noqa: UP007
        choose_by_key("law"),
        shorthand("law"),
        ShortForm(words),
    ]
    description = f"{_either([*words])}, or {{law: NAME, ...}} with the options of {_either([*models])}"
    return annotation, Field(description=description)


def _slot(slot: str) -> tuple[Any, Any]:
    """Annotation and field of another slot: a name, or a mapping for a model with options."""
    models = registry.models(slot)
    words = tuple(name for name, model in models.items() if not model.required_options)
    words = (*words, "none") if slot == "tangential" else ("none", *words)
    texts = [name if name == "none" else f"{name} ({models[name].summary})" for name in words]
    mappings = {name: _model(model) for name, model in models.items() if model.options.model_fields}
    examples = [f"{{law: {name}, ...}}" for name in mappings if name not in words]
    annotation: Any = Literal[words]
    if mappings:
        members = [Annotated[Literal[word], Tag(f"<{word}>")] for word in words]
        members += [Annotated[model, Tag(f"<law {name}>")] for name, model in mappings.items()]
        reason = f"it must be {_either([*words, *examples])}"
        annotation = Annotated[Union[tuple(members)], choose_by(_slot_tagger(words, mappings), reason)]  # noqa: UP007
    description = _either([*texts, *examples]) + SLOTS[slot].remark
    if SLOTS[slot].optional:
        return annotation, Field("none", description=description)
    return annotation, Field(description=description)


def _slot_tagger(words: tuple[str, ...], models: dict[str, type[LawSettings]]) -> Callable[[Any], str | None]:
    """Function that returns the tag of the value of a slot; None if it is not the name of a model."""

    def tag(value: Any) -> str | None:
        name = value.get("law") if isinstance(value, dict) else getattr(value, "law", None)
        if isinstance(value, str):
            return f"<{value}>" if value in words else None
        return f"<law {name}>" if name in models else None

    return tag


# The schema class of a model


@cache
def _model(model: ContactModel) -> type[LawSettings]:
    """The schema class of one contact model: its name and its options; the same at each call."""
    name = f"{_camel(model.name)}{_camel(model.slot)}"
    law: Any = (Literal[model.name], Field(description=f"name of the {model.slot} contact model"))
    bases: Any = (model.options, LawSettings)
    # where pickle finds it
    globals()[name] = create_model(name, __base__=bases, __doc__=model.summary, law=law)
    return globals()[name]


def _either(texts: list[str]) -> str:
    """The texts as a list in a sentence."""
    *first, last = texts
    return f"{', '.join(first)} or {last}" if first else last


def _camel(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))


use_registry()
