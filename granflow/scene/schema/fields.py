"""Building blocks of the schema: the immutable base model, faults, texts, names, lists and unions."""

import re
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Tag, WithJsonSchema
from pydantic_core import CoreSchema, core_schema

from granflow.scene.document import KeyPath
from granflow.scene.schema.numbers import value_error
from granflow.visible_text import visible

_NAME = r"[a-z][a-z0-9_]*"


@dataclass(frozen=True)
class Fault:
    """An invalid value at `path`; the message is "X is Y, but {reason}".

    With `whole`, the message is "X {reason}". `messages.problem_at` adds the position and the period. The path of a
    fault from `Model.faults` is relative to the model.
    """

    path: KeyPath
    reason: str
    whole: bool = False


class Model(BaseModel):
    """A part of a scene: immutable; unknown keys are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True, defer_build=True)

    def faults(self) -> Iterator[Fault]:
        """Yield inconsistencies between the fields of this part; each field by itself is valid."""
        yield from ()


def whole(path: KeyPath, reason: str) -> Fault:
    """The fault with the message "X {reason}"."""
    return Fault(path, reason, whole=True)


def redundant(key: str, other: str, keep: str = "one of them") -> Fault:
    """The fault of a key that excludes another key."""
    return Fault((key,), f"{other} is given too: keep {keep}")


def missing(path: KeyPath, description: str) -> Fault:
    """The fault of a missing key; `description` states its meaning or the reason why it is required."""
    return whole(path, f"is missing: {description}")


def require(is_valid: Callable[[Any], Any], reason: str) -> Callable[[Any], Any]:
    """Validator that returns a value unchanged, or raises PydanticCustomError with the reason if it is not valid."""

    def validate(value: Any) -> Any:
        if not is_valid(value):
            raise value_error(reason)
        return value

    return validate


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_visible(value: str) -> bool:
    return "\n" not in value and "\t" not in value and visible(value) == value


def _is_flag_or_names(value: Any) -> bool:
    names = isinstance(value, list | tuple) and bool(value) and all(map(_is_text, value))
    return isinstance(value, bool) or names


def list_of_length(length: int, reason: str) -> BeforeValidator:
    """Require a list with a number of items."""
    return BeforeValidator(require(lambda value: isinstance(value, list | tuple) and len(value) == length, reason))


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


@dataclass(frozen=True)
class ShortForm:
    """Adds words to the JSON Schema of a value: short forms of it."""

    words: tuple[str, ...]

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        """Schema with the words first; descriptions remain outside of both forms."""
        return {"anyOf": [{"enum": list(self.words)}, handler(schema)]}


def required_unless(key: str, *others: str) -> Callable[[dict[str, Any]], None]:
    """Modifier of a JSON Schema: the keys `others` are optional if `key` is given."""

    def change(schema: dict[str, Any]) -> None:
        always = [name for name in schema["required"] if name not in others]
        schema["required"] = always
        schema["anyOf"] = [{"required": [key]}, {"required": list(others)}]

    return change


def tag_of(member: Any) -> str:
    """Tag of a member of a union in error locations: a name in angle brackets, which distinguish it from keys.

    The name is that of its pydantic `Tag`, else the value of its key such as `kind`, else its first key; for plain
    values none, list or number.
    """
    if get_origin(member) is Annotated:
        explicit = [meta.tag for meta in get_args(member)[1:] if isinstance(meta, Tag)]
        return explicit[0] if explicit else tag_of(get_args(member)[0])
    if isinstance(member, type) and issubclass(member, BaseModel):
        literals = [get_args(each.annotation) for each in member.model_fields.values() if _is_literal(each.annotation)]
        words = [words[0] for words in literals if len(words) == 1]
        return f"<{words[0] if words else next(iter(member.model_fields))}>"
    return "<none>" if member is NoneType else "<list>" if get_origin(member) is tuple else "<number>"


def _is_literal(annotation: Any) -> bool:
    return get_origin(annotation) is Literal


Tagger = Callable[[Any, Collection[str]], str | None]
"""Function of a raw value and the tags of a union that returns the tag of the value, or None if no member fits."""


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
    """Choose a model by the value of `key`, or another member by the type of the value: none, list or number."""

    def tag(value: Any, tags: Collection[str]) -> str | None:
        if isinstance(value, dict):
            return f"<{value[key]}>" if key in value else None
        if isinstance(value, BaseModel):
            return f"<{getattr(value, key)}>"
        return "<none>" if value is None else "<list>" if isinstance(value, list | tuple) else "<number>"

    return Choice(tag, {"key": key})


def choose_by(tag_of_value: Callable[[Any], str | None], reason: str) -> Choice:
    """Choose a member of a union by the tag from a function; None is the error "X is Y, but REASON."."""
    return Choice(lambda value, tags: tag_of_value(value), {"reason": reason})


def choose_by_first_key(reason: str) -> Choice:
    """Choose a model by its first key, such as `box` of `{box: {...}}`; no match is the error "X is Y, but REASON."."""

    def tag(value: Any, tags: Collection[str]) -> str | None:
        if isinstance(value, BaseModel):
            return tag_of(type(value))
        return next((each for each in tags if isinstance(value, dict) and each.strip("<>") in value), None)

    return Choice(tag, {"reason": reason})


def shorthand(key: str) -> BeforeValidator:
    """Accept plain text as the short form of a mapping with only `key`: `zhou` for `{law: zhou}`."""
    return BeforeValidator(lambda value: {key: value} if isinstance(value, str) else value)


Text = Annotated[str, BeforeValidator(require(_is_text, "text is expected; put it in quotes"))]
"""Text as in the file; numbers and flags are not converted."""

FileName = Annotated[
    Text,
    AfterValidator(
        require(
            _is_visible,
            "a file name must not contain control, zero-width or bidirectional characters; rename the file",
        )
    ),
]
"""Text without characters that would make a message ambiguous."""

Flag = Annotated[bool, BeforeValidator(require(lambda value: isinstance(value, bool), "true or false is expected"))]
FlagOrNames = Annotated[
    bool | tuple[str, ...],
    BeforeValidator(
        require(_is_flag_or_names, "true, false or a list of names is expected, such as [floor, lid]"),
    ),
]
"""All (true), none (false), or a list of names."""


def _matching(pattern: str, reason: str) -> tuple[AfterValidator, WithJsonSchema]:
    """Metadata of text that must match a pattern."""
    validator = AfterValidator(require(re.compile(pattern).fullmatch, reason))
    return validator, WithJsonSchema({"type": "string", "pattern": f"^{pattern}$"})


_name = _matching(_NAME, "a name begins with a lowercase letter and contains only lowercase letters, digits and _")
_pair_name = _matching(f"{_NAME}-{_NAME}", "a pair is two material names joined by a hyphen, such as glass-steel")
Name = Annotated[str, _name[0], _name[1]]
"""Name of a material, wall, group, stage or meter: lowercase letters, digits and _, beginning with a letter."""

PairName = Annotated[str, _pair_name[0], _pair_name[1]]
"""Names of two materials joined by a hyphen, in either order."""

Names = Annotated[tuple[Text, ...], ListOf(some="[fill, settle]")]
