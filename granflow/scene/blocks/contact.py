"""Schema of the block `contact`, generated from the options of the registered contact models.

`Contact` has one key per slot of the registry: normal, tangential, rolling, twisting, cohesion. The value is
the name of a model, or a mapping with the key `law` and the options of the model. The schema class of a model
with options is created here; its fields follow from the `Amount` and `Choice` records of the model.
"""

from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal, Union

from pydantic import Field, Tag, create_model
from pydantic.fields import FieldInfo

from granflow.contact import registry
from granflow.contact.law import SLOTS, Amount, Choice, ContactModel, Option
from granflow.schema.model import Model, ShortForm, choose_by, choose_by_key, shorthand
from granflow.schema.quantities import Number


class LawSettings(Model):
    """A contact model and its options; base class of one schema class per contact model with options."""

    law: str
    of: ClassVar[ContactModel | None] = None

    @property
    def record(self) -> ContactModel:
        """The registered record of a normal model."""
        return registry.models("normal")[self.law]

    def settings(self) -> dict[str, Any]:
        """The options by key, in SI units, without the name of the contact model."""
        return self.model_dump(exclude={"law"})

    def words(self, key: str) -> tuple[str, ...]:
        """Words that an option accepts."""
        option = self.record.options[key]
        return option.words if isinstance(option, Choice) else ()

    def fixed_by_numbers(self) -> dict[str, str]:
        """Options, by key, that take a fixed value if the restitution of every pair is a number."""
        return {
            key: option.with_numbers
            for key, option in self.record.options.items()
            if isinstance(option, Choice) and option.with_numbers is not None
        }


class Contact(Model):
    """Contact models, the same for all pairs of materials.

    Normal force, tangential force (friction), rolling and twisting torque, cohesion; friction coefficients
    are properties of the pairs.

    >>> linear = {"law": "linear", "stiffness": "onset"}
    >>> gf.Contact(normal=linear, tangential="mindlin", rolling="none").name("normal")
    'linear'
    """

    # `use_registry` replaces these types by those of the registered models.
    normal: LawSettings
    tangential: str | LawSettings
    rolling: str | LawSettings
    twisting: str | LawSettings = "none"
    cohesion: str | LawSettings = "none"

    def name(self, slot: str) -> str:
        """Name of the model of a slot, or "none"."""
        given = getattr(self, slot)
        return given if isinstance(given, str) else str(given.law)

    def options(self, slot: str) -> dict[str, Any]:
        """Options of the model of a slot, in SI units."""
        given = getattr(self, slot)
        if not isinstance(given, str):
            return dict(given.settings())
        model = registry.models(slot).get(given)
        return {key: option.default for key, option in model.options.items()} if model else {}

    @classmethod
    def hint(cls, key: str, word: str) -> str:
        """What a name that is not one of a slot needs: options, another slot, or a registration."""
        own = registry.models(key).get(word)
        if own is not None and own.needs_options:
            return _needed_options(own)
        other = next((slot for slot in SLOTS if slot != key and word in registry.models(slot)), None)
        if other is not None:
            return f". {word} is given as contact.{other}: {word}"
        return ". Register a model of your own before: granflow.register_contact_model"


def _needed_options(model: ContactModel) -> str:
    """Sentence on the options that a model requires."""
    required = {key: each for key, each in model.options.items() if each.default is None}
    given = ", ".join(f"{key}: {getattr(each, 'example', '...')}" for key, each in required.items())
    return f". {model.name} requires {' and '.join(required)}, such as {{law: {model.name}, {given}}}"


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
    words = tuple(name for name, model in models.items() if not model.needs_options)
    annotation: Any = Annotated[
        Union[tuple(Annotated[_model(model), Tag(f"<{name}>")] for name, model in models.items())],  # noqa: UP007
        choose_by_key("law"),
        shorthand("law"),
        ShortForm(words),
    ]
    description = f"{_either([*words])}, or {{law: NAME, ...}} with the options of {_either([*models])}"
    return annotation, Field(description=description)


OPTIONAL = ("twisting", "cohesion")
"""Slots that a scene may omit: they have no model."""
_LAST_WORDS = {"cohesion": ", with any normal contact model"}
"""End of the description of a slot."""


def _slot(slot: str) -> tuple[Any, Any]:
    """Annotation and field of another slot: a name, or a mapping for a model with options."""
    models = registry.models(slot)
    words = tuple(name for name, model in models.items() if not model.needs_options)
    words = (*words, "none") if slot == "tangential" else ("none", *words)
    texts = [name if name == "none" else f"{name} ({models[name].summary})" for name in words]
    mappings = {name: _model(model) for name, model in models.items() if model.options}
    examples = [f"{{law: {name}, ...}}" for name in mappings if name not in words]
    annotation: Any = Literal[words]
    if mappings:
        members = [Annotated[Literal[word], Tag(f"<{word}>")] for word in words]
        members += [Annotated[model, Tag(f"<law {name}>")] for name, model in mappings.items()]
        reason = f"it must be {_either([*words, *examples])}"
        annotation = Annotated[Union[tuple(members)], choose_by(_slot_tagger(words, mappings), reason)]  # noqa: UP007
    description = _either([*texts, *examples]) + _LAST_WORDS.get(slot, "")
    if slot in OPTIONAL:
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


# The schema class of a model, and the types of its options


def _model(model: ContactModel) -> type[LawSettings]:
    """The schema class of one contact model, with a field for each of its options; the same at each call."""
    name = f"{_camel(model.name)}{_camel(model.slot)}"
    known = globals().get(name)
    if known is not None and known.of is model:
        return known
    fields: dict[str, Any] = {
        "law": (Literal[model.name], Field(description=f"name of the {model.slot} contact model"))
    }
    for key, option in model.options.items():
        fields[key] = (_annotation(option, f"{model.name}_{key}"), _field(option))
    created = create_model(name, __base__=LawSettings, __doc__=model.summary, **fields)
    created.of = model
    globals()[name] = created  # where pickle finds it
    return created


def _field(setting: Option) -> Any:
    if setting.default is None:
        return Field(description=setting.description)
    return Field(setting.default, description=setting.description)


def _annotation(setting: Option, name: str) -> Any:
    """The type of a parameter; `name` is unique and the prefix of the names of the models in it."""
    if isinstance(setting, Amount):
        bounds = (setting.above, setting.at_least, setting.at_most)
        return Annotated[float, Number(setting.dimension, setting.noun, *bounds)]
    if not setting.keyed:
        return Literal[setting.words]
    models = {key: _keyed(key, amount, f"{name}_{key}") for key, amount in setting.keyed.items()}
    members = [Annotated[Literal[word], Tag(f"<{word}>")] for word in setting.words]
    members += [Annotated[model, Tag(f"<{key}>")] for key, model in models.items()]
    by = choose_by(_tagger(setting.words, models), f"it must be {_either(_examples(setting))}")
    return Annotated[Union[tuple(members)], by]  # noqa: UP007


def _tagger(words: tuple[str, ...], models: dict[str, type[Model]]) -> Callable[[Any], str | None]:
    """Function that returns the tag of a parameter value: its word, or the key of its mapping.

    None if neither matches.
    """

    def tag(value: Any) -> str | None:
        if isinstance(value, str):
            return f"<{value}>" if value in words else None
        for key, model in models.items():
            if isinstance(value, model) or (isinstance(value, dict) and key in value):
                return f"<{key}>"
        return None

    return tag


def _keyed(key: str, amount: Amount, name: str) -> type[Model]:
    """The schema class of a parameter value that is a mapping with a single key and a number."""
    fields: dict[str, Any] = {key: (_annotation(amount, name), _field(amount))}
    created = create_model(_camel(name), __base__=Model, __doc__=amount.description, **fields)
    globals()[_camel(name)] = created  # where pickle finds it
    return created


def _examples(setting: Choice) -> list[str]:
    return [*setting.words, *(f"{{{key}: {amount.example}}}" for key, amount in setting.keyed.items())]


def _either(texts: list[str]) -> str:
    """The texts as a list in a sentence."""
    *first, last = texts
    return f"{', '.join(first)} or {last}" if first else last


def _camel(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))


use_registry()
