"""Building blocks of the schema: the immutable base model, numbers with units, vectors, names, unions."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    WithJsonSchema,
)

from granflow.scene.document import KeyPath
from granflow.scene.schema.numbers import Number, value_error
from granflow.visible_text import visible

_NAME = r"[a-z][a-z0-9_]*"


class Model(BaseModel):
    """A part of a scene: immutable; unknown keys are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    def faults(self) -> Iterator["Fault"]:
        """Yield inconsistencies between the fields of this part; each field by itself is valid."""
        yield from ()


@dataclass(frozen=True)
class Fault:
    """An invalid value at `path` (relative to the model); the message is "X is Y, but {reason}".

    With `whole`, the message is "X {reason}". `messages.problem_at` adds the position and the period.
    """

    path: KeyPath
    reason: str
    whole: bool = False


def _check_vector(value: Any) -> Any:
    """Require a list of three values. Raises PydanticCustomError."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise value_error("a vector of three numbers is expected, [x, y, z]")
    return value


def _check_direction(value: tuple[float, float, float]) -> tuple[float, float, float]:
    """Require a vector that is not zero. Raises PydanticCustomError."""
    if not any(value):
        raise value_error("a direction must not be the zero vector; give one such as [0, 0, 1]")
    return value


def _check_text(value: Any) -> Any:
    """Require text; numbers and flags without quotes are errors. Raises PydanticCustomError."""
    if not isinstance(value, str):
        raise value_error("text is expected; put it in quotes")
    return value


def _file_name(value: Any) -> Any:
    """Require text without invisible characters, which would make a message ambiguous. Raises PydanticCustomError."""
    text = _check_text(value)
    if "\n" in text or "\t" in text or visible(text) != text:
        raise value_error(
            "a file name must not contain control, zero-width or bidirectional characters; rename the file"
        )
    return text


def _check_flag(value: Any) -> Any:
    """Require true or false. Raises PydanticCustomError."""
    if not isinstance(value, bool):
        raise value_error("true or false is expected")
    return value


def _check_name(value: Any) -> Any:
    """Require a name of lowercase letters, digits and _. Raises PydanticCustomError."""
    if not re.fullmatch(_NAME, str(value)):
        raise value_error("a name begins with a lowercase letter and contains only lowercase letters, digits and _")
    return value


def _check_pair_name(value: Any) -> Any:
    """Require two names joined by a hyphen. Raises PydanticCustomError."""
    if not re.fullmatch(f"{_NAME}-{_NAME}", str(value)):
        raise value_error("a pair is two material names joined by a hyphen, such as glass-steel")
    return value


@dataclass(frozen=True)
class ShortForm:
    """Adds a short form of a value to its JSON Schema: words, or one item in place of a list."""

    words: tuple[str, ...] = ()

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        """Schema with the short form first; descriptions remain outside of both forms."""
        full = handler(schema)
        short = {"enum": list(self.words)} if self.words else full["items"]
        return {"anyOf": [short, full]}


def required_unless(key: str, *others: str) -> Callable[[dict[str, Any]], None]:
    """Modifier of a JSON Schema: the keys `others` are optional if `key` is given."""

    def change(schema: dict[str, Any]) -> None:
        always = [name for name in schema["required"] if name not in others]
        schema["required"] = always
        schema["anyOf"] = [{"required": [key]}, {"required": list(others)}]

    return change


def not_required(*keys: str) -> Callable[[dict[str, Any]], None]:
    """Modifier of a JSON Schema: these keys are optional."""

    def change(schema: dict[str, Any]) -> None:
        schema["required"] = [name for name in schema["required"] if name not in keys]

    return change


Tagger = Callable[[Any], str | None]
"""Function that returns the tag of a union member for a raw value, or None if no member fits."""


def choose_by_key(key: str, *, number_tag: str = "", list_tag: str = "", none_tag: str = "") -> Discriminator:
    """Choose a member of a union by the value of `key`: the member's tag is that value in angle brackets.

    Values other than mappings get the tag `list_tag` (lists), `none_tag` (empty values) or `number_tag` (others).
    The angle brackets distinguish tags from keys in error locations.
    """

    def tag(value: Any) -> str | None:
        if isinstance(value, dict):
            return f"<{value[key]}>" if key in value else None
        if isinstance(value, BaseModel):
            return f"<{getattr(value, key)}>"
        kind = (
            none_tag
            if value is None and none_tag
            else list_tag
            if isinstance(value, list | tuple) and list_tag
            else number_tag
        )
        return f"<{kind}>" if kind else None

    return _discriminator(tag, key=key)


def choose_by(tag_of: Tagger, reason: str) -> Discriminator:
    """Choose a member of a union by the tag from `tag_of`; None is the error "X is Y, but REASON.".

    The tag is a name in angle brackets.
    """
    return _discriminator(tag_of, reason=reason)


def _discriminator(tag_of: Tagger, **context: str) -> Discriminator:
    return Discriminator(
        tag_of, custom_error_type="choice", custom_error_message="choice", custom_error_context={**context}
    )


def shorthand(key: str) -> BeforeValidator:
    """Accept plain text as the short form of a mapping with only `key`: `zhou` for `{law: zhou}`."""

    def expand(value: Any) -> Any:
        return {key: value} if isinstance(value, str) else value

    return BeforeValidator(expand)


def list_of(*, one: bool = False, some: str = "") -> BeforeValidator:
    """Require a list; with `one`, accept a single item as a list of one; with `some`, reject an empty list.

    `some`: example for the message. The validator raises PydanticCustomError.
    """

    def read(value: Any) -> Any:
        if not isinstance(value, list | tuple):
            if one:
                return [value]
            raise value_error(f"a list is expected, {some or '[ ... ]'}")
        if some and not value:
            raise value_error(f"at least one item is required, such as {some}")
        return value

    return BeforeValidator(read)


def pair_list(meaning: str) -> BeforeValidator:
    """Require a list of exactly two items; `meaning` describes them in the message. Raises PydanticCustomError."""

    def read(value: Any) -> Any:
        if not isinstance(value, list | tuple) or len(value) != 2:
            raise value_error(f"a list of two is expected, {meaning}")
        return value

    return BeforeValidator(read)


def _flag_or_names(value: Any) -> Any:
    """Require true, false, or a list of at least one name. Raises PydanticCustomError."""
    names = tuple(value) if isinstance(value, list | tuple) else ()
    if isinstance(value, bool) or (names and all(isinstance(name, str) for name in names)):
        return value if isinstance(value, bool) else names
    raise value_error("true, false or a list of names is expected, such as [floor, lid]")


Text = Annotated[str, BeforeValidator(_check_text)]
"""Text as in the file; numbers and flags are not converted."""

FileName = Annotated[str, BeforeValidator(_file_name)]
"""Text without control, zero-width and bidirectional characters."""

Flag = Annotated[bool, BeforeValidator(_check_flag)]
FlagOrNames = Annotated[bool | tuple[str, ...], BeforeValidator(_flag_or_names)]
"""All (true), none (false), or a list of names."""

Name = Annotated[str, AfterValidator(_check_name), WithJsonSchema({"type": "string", "pattern": f"^{_NAME}$"})]
"""Name of a material, wall, group, stage or meter: lowercase letters, digits and _, beginning with a letter."""

PairName = Annotated[
    str, AfterValidator(_check_pair_name), WithJsonSchema({"type": "string", "pattern": f"^{_NAME}-{_NAME}$"})
]
"""Names of two materials joined by a hyphen, in either order."""


# Lengths scale with `scale` of a scene, numbers of particles with its cube; sizes of one particle or contact do not.
Plain = Annotated[float, Number()]
NotNegative = Annotated[float, Number(at_least=0)]
Positive = Annotated[float, Number(above=0)]
Count = Annotated[int, Number(noun="a count", at_least=1, whole=True)]
Counts = Annotated[tuple[Count, Count, Count], BeforeValidator(_check_vector)]
ParticleCount = Annotated[int, Number(noun="a count", at_least=1, whole=True, scaling=3)]
"""Number of particles, proportional to the cube of `scale`; at most LARGEST_COUNT."""

Seed = Annotated[int, Number(noun="a seed", at_least=0, whole=True)]
Length = Annotated[float, Number("length", scaling=1)]
"""Length [m] of the equipment, proportional to `scale`."""

PositiveLength = Annotated[float, Number("length", above=0, scaling=1)]
NotNegativeLength = Annotated[float, Number("length", at_least=0, scaling=1)]
UnscaledLength = Annotated[float, Number("length", above=0)]
"""Length [m] of one particle or contact, independent of `scale`."""

Time = Annotated[float, Number("time", at_least=0)]
PositiveTime = Annotated[float, Number("time", above=0)]
Velocity = Annotated[float, Number("velocity")]
Speed = Annotated[float, Number("velocity", noun="a speed", above=0)]
AnySpeed = Annotated[float, Number("velocity", noun="a speed", at_least=0)]
Acceleration = Annotated[float, Number("acceleration")]
Angle = Annotated[float, Number("angle")]
Mass = Annotated[float, Number("mass", above=0)]
Force = Annotated[float, Number("force")]
PositiveForce = Annotated[float, Number("force", above=0)]
Damping = Annotated[float, Number("damping", at_least=0)]
Frequency = Annotated[float, Number("frequency", above=0)]
AngularVelocity = Annotated[float, Number("angular_velocity")]
PositiveAngularVelocity = Annotated[float, Number("angular_velocity", above=0)]
Pressure = Annotated[float, Number("pressure", above=0)]
Density = Annotated[float, Number("density", above=0)]
Energy = Annotated[float, Number("energy", above=0)]
Stiffness = Annotated[float, Number("stiffness", above=0)]
Rate = Annotated[float, Number("rate", above=0, scaling=3)]
"""Insertion rate [1/s], proportional to the cube of `scale`."""

ParticleMass = Annotated[float, Number("mass", above=0, scaling=3)]
MassFlow = Annotated[float, Number("mass_flow", above=0, scaling=3)]
Share = Annotated[float, Number(noun="a fraction", at_least=0)]
AnyQuantity = Annotated[float, Number("any")]
"""Number in SI units, or text with a unit that has the same factor in all dimensions that know it."""


Vector3 = tuple[float, float, float]
"""Three components along x, y and z."""

Point = Annotated[tuple[Length, Length, Length], BeforeValidator(_check_vector)]
"""Position or edge vector (3,) [m], proportional to `scale`."""

VelocityVector = Annotated[tuple[Velocity, Velocity, Velocity], BeforeValidator(_check_vector)]
AngularVelocityVector = Annotated[
    tuple[AngularVelocity, AngularVelocity, AngularVelocity], BeforeValidator(_check_vector)
]
AccelerationVector = Annotated[tuple[Acceleration, Acceleration, Acceleration], BeforeValidator(_check_vector)]
Direction = Annotated[tuple[Plain, Plain, Plain], BeforeValidator(_check_vector), AfterValidator(_check_direction)]
"""Vector (3,), not the zero vector; its length does not matter."""

Names = Annotated[tuple[Text, ...], list_of(some="[fill, settle]")]
Auto = Literal["auto"]
