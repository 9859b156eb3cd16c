"""Schema of `contact.normal`, generated from the parameters of each contact model in the catalog."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from pydantic import Field, Tag, create_model

from granflow.contact.model_kind import Amount, Choice, LawKind, Setting
from granflow.contact.registry import NORMAL_LAWS
from granflow.scene.schema.fields import Model, ShortForm, choose_by, choose_by_key, shorthand
from granflow.scene.schema.numbers import Number


class LawSettings(Model):
    """A normal contact model and its parameters; base class of one schema class per contact model.

    The catalog `granflow.contact.registry` defines names, parameters and bounds.
    """

    law: str

    @property
    def kind(self) -> LawKind:
        """The entry of the catalog."""
        return NORMAL_LAWS[self.law]

    def settings(self) -> dict[str, Any]:
        """The parameters by key, in SI units, without the name of the contact model."""
        return self.model_dump(exclude={"law"})

    def fixed_by_numbers(self) -> dict[str, str]:
        """Parameters, by key, that take a fixed value if the restitution of every pair is a number."""
        choices = {key: each for key, each in self.kind.settings.items() if isinstance(each, Choice)}
        return {key: each.with_numbers for key, each in choices.items() if each.with_numbers is not None}


def known_laws() -> str:
    """The names of all normal contact models, as a list in a sentence."""
    *first, last = NORMAL_LAWS
    return f"{', '.join(first)} or {last}"


def _model(kind: LawKind) -> type[LawSettings]:
    """The schema class of one contact model, with a field for each of its parameters."""
    fields: dict[str, Any] = {"law": (Literal[kind.name], Field(description="name of the normal contact model"))}
    for key, setting in kind.settings.items():
        fields[key] = (_annotation(setting, f"{kind.name}_{key}"), _field(setting))
    return create_model(f"{_camel(kind.name)}Normal", __base__=LawSettings, __doc__=kind.summary, **fields)


def _field(setting: Setting) -> Any:
    if setting.default is None:
        return Field(description=setting.description)
    return Field(setting.default, description=setting.description)


def _annotation(setting: Setting, name: str) -> Any:
    """The type of a parameter; `name` is unique and the prefix of the names of the models in it."""
    if isinstance(setting, Amount):
        bounds = (setting.above, setting.at_least, setting.at_most)
        return Annotated[float, Number(setting.dimension, setting.noun, *bounds)]
    if not setting.keyed:
        return Literal[setting.words]
    models = {key: _keyed(key, amount, f"{name}_{key}") for key, amount in setting.keyed.items()}
    members = [Annotated[Literal[word], Tag(f"<{word}>")] for word in setting.words]
    members += [Annotated[model, Tag(f"<{key}>")] for key, model in models.items()]
    by = choose_by(_tagger(setting.words, models), f"it must be {_either(setting)}")
    return Annotated[Union[tuple(members)], by]  # noqa: UP007


def _keyed(key: str, amount: Amount, name: str) -> type[Model]:
    """The schema class of a parameter value that is a mapping with a single key and a number."""
    fields: dict[str, Any] = {key: (_annotation(amount, name), _field(amount))}
    return create_model(_camel(name), __base__=Model, __doc__=amount.description, **fields)


def _either(setting: Choice) -> str:
    *first, last = [*setting.words, *(f"{{{key}: {amount.example}}}" for key, amount in setting.keyed.items())]
    return f"{', '.join(first)} or {last}"


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


def _camel(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))


MODELS: dict[str, type[LawSettings]] = {name: _model(kind) for name, kind in NORMAL_LAWS.items()}
"""Schema class of each normal contact model, by name."""


if TYPE_CHECKING:
    Normal = LawSettings
else:
    Normal = Annotated[
        Union[tuple(Annotated[model, Tag(f"<{name}>")] for name, model in MODELS.items())],  # noqa: UP007
        choose_by_key("law"),
        shorthand("law"),
        ShortForm(tuple(name for name, kind in NORMAL_LAWS.items() if not kind.needs_settings)),
    ]
