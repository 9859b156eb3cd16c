"""Building blocks of the schema: the immutable base model, unions, lists, texts and names.

The blocks of a scene and the options of contact models are subclasses of `Model`; the types of their
fields are here and in `quantities`. A value that is valid by itself may contradict another one:
`Model.faults` yields such contradictions.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    WithJsonSchema,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

from granflow.errors import SceneError
from granflow.schema.document import document_of
from granflow.schema.faults import Fault, KeyPath, value_error
from granflow.schema.messages import problem_at, problems_of, selecting_keys, tag_of
from granflow.visible_text import visible

# Base model of all blocks


def _require_selecting_keys(schema: dict[str, Any], model: type[BaseModel]) -> None:
    """Modifier of a JSON Schema: files must give the keys that select a part of a union, such as `shape`."""
    for key in selecting_keys(model):
        schema["properties"][key].pop("default", None)
        if key not in schema.get("required", ()):
            schema["required"] = [key, *schema.get("required", ())]


class Model(BaseModel):
    """A part of a scene: immutable; unknown keys are errors."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        populate_by_name=True,
        defer_build=True,
        json_schema_extra=_require_selecting_keys,
    )

    def __init__(self, **values: Any) -> None:
        """Create the part from the values of its keys, as in a scene file; the key `from` is `from_` in
        Python.

        Values: numbers in SI units or text with units, lists, numpy arrays, mappings, other parts. A key that
        selects the kind of the part, such as `shape`, may be omitted. Raises SceneError with all problems,
        each with its key.
        """
        model = type(self)
        aliases = {name: each.alias or name for name, each in model.model_fields.items()}
        given = selecting_keys(model) | {aliases.get(name, name): value for name, value in values.items()}
        document = document_of(given, model.__name__)
        problems = list(document.problems)
        try:
            model.__pydantic_validator__.validate_python(document.root.data(), self_instance=self)
            problems += [problem_at(document, fault) for fault in faults_of(self)]
        except ValidationError as error:
            problems += problems_of(document, error.errors(include_url=False, include_input=False), model)
        if problems:
            raise SceneError(dict.fromkeys(map(str, problems)))

    # pydantic then validates nested parts itself, with their key paths in the errors, as for RootModel
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    def __setattr__(self, name: str, value: Any) -> None:
        """Raises AttributeError: a scene and its parts are immutable."""
        if not name.startswith("_"):
            raise AttributeError(
                f"{type(self).__name__}.{name} cannot be set: a scene and its parts are immutable; create "
                "another one, for example with Scene.from_dict."
            )
        super().__setattr__(name, value)

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """Yield the keys that differ from their defaults, for `repr`."""
        hidden = selecting_keys(type(self))
        for name, each in type(self).model_fields.items():
            value = getattr(self, name)
            if name not in hidden and (each.is_required() or value != each.get_default()):
                yield name, value

    @classmethod
    def hint(cls, key: str, word: str) -> str:
        """End of the message on a word that is not one of those of a key, such as ". Did you mean X?"; by
        default empty."""
        return ""

    def faults(self) -> Iterator[Fault]:
        """Yield inconsistencies between the fields of this part; each field by itself is valid."""
        yield from ()


def faults_of(value: Any, path: KeyPath = ()) -> Iterator[Fault]:
    """Faults of a value and of all models in it, depth first, with key paths from the root."""
    if isinstance(value, Model):
        yield from (replace(fault, path=(*path, *fault.path)) for fault in value.faults())
        for name, each in type(value).model_fields.items():
            yield from faults_of(getattr(value, name), (*path, each.alias or name))
    elif isinstance(value, dict | tuple):
        for key, each in value.items() if isinstance(value, dict) else enumerate(value):
            yield from faults_of(each, (*path, key))


def add_keys(model: type[Model], keys: Mapping[str, FieldInfo]) -> None:
    """Set the keys of a model that records outside of its class declare, in place of those set before."""
    own = model.__pydantic_fields__
    declared = {name for each in model.__mro__ for name in getattr(each, "__annotations__", ())}
    for name in set(own) - declared:
        del own[name]
    own.update(keys)


def optional_key(annotation: Any, description: str, examples: list[Any] | None = None) -> FieldInfo:
    """Field of a key for `add_keys`, with a type; it is None unless given."""
    given: Any = Field(None, description=description, examples=examples)
    return FieldInfo.from_annotated_attribute(annotation | None, given)


# Notes in the schema of a key for the reference of the keys; the JSON Schema for editors does not have them.

DIMENSION = "x-dimension"
"""Name of the dimension of a number, in the schema of its text with a unit."""
DEFAULT_IN_WORDS = "x-default"
"""What applies without a key, if this is not a value of the key."""
NOTES = frozenset({DIMENSION, DEFAULT_IN_WORDS})


def optional(description: str, otherwise: str, **settings: Any) -> Any:
    """Field of a key that is None unless given.

    otherwise:  what then applies, in words; it ends the description
    settings:   of the field, such as `examples`, or a `default` other than None
    """
    if "default_factory" not in settings:
        settings = {"default": None, **settings}
    return Field(
        **settings,
        description=f"{description}; default: {otherwise}",
        json_schema_extra={DEFAULT_IN_WORDS: otherwise},
    )


def required_unless(key: str, *others: str) -> Callable[[dict[str, Any]], None]:
    """Modifier of a JSON Schema: the keys `others` are optional if `key` is given."""

    def change(schema: dict[str, Any]) -> None:
        always = [name for name in schema["required"] if name not in others]
        schema["required"] = always
        schema["anyOf"] = [{"required": [key]}, {"required": list(others)}]

    return change


def example_of(field: FieldInfo) -> Any:
    """Example of the value of a key: that of its declaration, else the first of its words, else None."""
    if field.examples:
        return field.examples[0]
    return get_args(field.annotation)[0] if get_origin(field.annotation) is Literal else None


# Unions: a value selects the member by a key, by its first key, or by its form

Tagger = Callable[[Any, Collection[str]], str | None]
"""Function of a raw value and the tags of a union that returns the tag of the value, or None if no member
fits."""


@dataclass(frozen=True)
class Choice:
    """Chooses the member of a union by a tag; a tag that is None or unknown is an error of type `choice`.

    `context`: contents of the message.
    """

    tag_of_value: Tagger
    context: dict[str, str] = field(hash=False)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        """Validation by the member with the tag."""
        members = {tag_of(member): handler.generate_schema(member) for member in get_args(source)}
        return core_schema.tagged_union_schema(
            members,
            lambda value: self.tag_of_value(value, members),
            custom_error_type="choice",
            custom_error_message="choice",
            custom_error_context=dict(self.context),
        )


def choose_by_key(key: str) -> Choice:
    """Choose a model by the value of `key`, or another member by its type: none, list or number."""

    def tag(value: Any, tags: Collection[str]) -> str | None:
        if isinstance(value, dict):
            return f"<{value[key]}>" if key in value else None
        if isinstance(value, BaseModel):
            return f"<{getattr(value, key)}>"
        if value is None:
            return "<none>"
        return "<list>" if isinstance(value, list | tuple) else "<number>"

    return Choice(tag, {"key": key})


def choose_by_first_key(reason: str, words: tuple[str, ...] = ()) -> Choice:
    """Choose a model by its first key, as `box` of `{box: {...}}`; else the error "X is Y, but REASON.".

    `words`: texts that are valid too; the union has a `Literal` for each.
    """

    def tag(value: Any, tags: Collection[str]) -> str | None:
        if isinstance(value, BaseModel):
            return tag_of(type(value))
        if isinstance(value, str):
            return f"<{value}>" if value in words else None
        return next((each for each in tags if isinstance(value, dict) and each.strip("<>") in value), None)

    return Choice(tag, {"reason": reason})


def choose_by(tag_of_value: Callable[[Any], str | None], reason: str) -> Choice:
    """Choose a member of a union by the tag from a function; None is the error "X is Y, but REASON."."""
    return Choice(lambda value, tags: tag_of_value(value), {"reason": reason})


def shorthand(key: str) -> BeforeValidator:
    """Accept plain text as the short form of a mapping with only `key`: `zhou` for `{law: zhou}`."""
    return BeforeValidator(lambda value: {key: value} if isinstance(value, str) else value)


@dataclass(frozen=True)
class ShortForm:
    """Adds words to the JSON Schema of a value: short forms of it."""

    words: tuple[str, ...]

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        """Schema with the words first; descriptions remain outside of both forms."""
        return {"anyOf": [{"enum": list(self.words)}, handler(schema)]}


# Validators of plain values


def require(is_valid: Callable[[Any], Any], reason: str) -> Callable[[Any], Any]:
    """Validator that returns a valid value unchanged, and raises PydanticCustomError for others."""

    def validate(value: Any) -> Any:
        if not is_valid(value):
            raise value_error(reason)
        return value

    return validate


def list_of_length(length: int, reason: str) -> BeforeValidator:
    """Require a list with a number of items."""
    return BeforeValidator(
        require(lambda value: isinstance(value, list | tuple) and len(value) == length, reason)
    )


def pair_list(meaning: str) -> BeforeValidator:
    """Require a list of exactly two items; `meaning` describes them in the message."""
    return list_of_length(2, f"a list of two is expected, {meaning}")


@dataclass(frozen=True)
class ListOf:
    """Require a list; with `one`, accept a single item as a list of one; with `some`, reject an empty list.

    `some`: example for the message.
    """

    one: bool = False
    some: str = ""

    def read(self, value: Any) -> Any:
        """The list. Raises PydanticCustomError."""
        if not isinstance(value, list | tuple):
            if self.one:
                return [value]
            raise value_error(f"a list is expected, {self.some or '[ ... ]'}")
        if self.some and not value:
            raise value_error(f"at least one item is required, such as {self.some}")
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        """Validation by `read`, then by the type of the list."""
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        """Schema of the list, or of one item in its place."""
        full = handler(schema) | ({"minItems": 1} if self.some else {})
        return {"anyOf": [full["items"], full]} if self.one else full


# Texts and flags


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_visible(value: str) -> bool:
    return "\n" not in value and "\t" not in value and visible(value) == value


def _is_flag_or_names(value: Any) -> bool:
    names = isinstance(value, list | tuple) and bool(value) and all(map(_is_text, value))
    return isinstance(value, bool) or names


Text = Annotated[str, BeforeValidator(require(_is_text, "text is expected; put it in quotes"))]
"""Text as in the file; numbers and flags are not converted."""
FileName = Annotated[
    Text,
    AfterValidator(require(bool, "the name of a file is expected")),
    AfterValidator(
        require(
            _is_visible,
            "a file name must not contain control, zero-width or bidirectional characters; rename the file",
        )
    ),
]
"""Text without characters that would make a message ambiguous."""
Flag = Annotated[
    bool, BeforeValidator(require(lambda value: isinstance(value, bool), "true or false is expected"))
]
FlagOrNames = Annotated[
    bool | tuple[str, ...],
    BeforeValidator(
        require(_is_flag_or_names, "true, false or a list of names is expected, such as [floor, lid]"),
    ),
]
"""All (true), none (false), or a list of names."""


# Names

_NAME = r"[a-z][a-z0-9_]*"
MOST_LETTERS = 64
"""Largest length of a name: names are parts of the names of files, which most file systems limit to 255
bytes."""


def is_name(text: str) -> bool:
    """Whether a text has lowercase letters, digits and _ only, and begins with a letter."""
    return re.fullmatch(_NAME, text) is not None


def _matching(pattern: str, reason: str) -> tuple[AfterValidator, WithJsonSchema]:
    """Metadata of text that must match a pattern."""
    validator = AfterValidator(require(re.compile(pattern).fullmatch, reason))
    return validator, WithJsonSchema({"type": "string", "pattern": f"^{pattern}$"})


_name = _matching(
    _NAME, "a name begins with a lowercase letter and contains only lowercase letters, digits and _"
)
_wall_name = _matching(
    rf"{_NAME}(\.(left|right|front|back|bottom|top))?",
    "a name begins with a lowercase letter and contains only lowercase letters, digits and _",
)
_pair_name = _matching(
    f"{_NAME}-{_NAME}", "a pair is two material names joined by a hyphen, such as glass-steel"
)
_short = AfterValidator(
    require(lambda name: len(name) <= MOST_LETTERS, f"a name has at most {MOST_LETTERS} characters")
)
Name = Annotated[str, _short, _name[0], _name[1]]
"""Name of a material, wall, group, stage or meter: lowercase letters, digits and _, beginning with a
letter."""
WallName = Annotated[str, _short, _wall_name[0], _wall_name[1]]
"""Name of a wall, or of a face of a box, such as box.left."""
PairName = Annotated[str, _pair_name[0], _pair_name[1]]
"""Names of two materials joined by a hyphen, in either order."""
StageNames = Annotated[tuple[Text, ...], ListOf(some="[fill, settle]")]
WallNames = Annotated[tuple[Text, ...], ListOf(some="[left, right, front, back]")]
GroupNames = Annotated[tuple[Text, ...], ListOf(some="[coarse, fine]")]
MaterialNames = Annotated[tuple[Text, ...], ListOf(some="[glass, steel]")]
