"""Suggestions for unknown names, and the tables of renamed keys and of names in other codes.

Similarity is that of difflib (Ratcliff and Obershelp), between 0 and 1.
"""

import difflib
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Tag,
    ValidationError,
    WithJsonSchema,
)
from pydantic_core import CoreSchema, ErrorDetails, core_schema

from granflow.contact import registry
from granflow.contact.law import SLOTS
from granflow.errors import SceneError
from granflow.scene.document import Document, Node, Problem, document_of
from granflow.units import Fault, KeyPath, missing, value_error, whole
from granflow.visible_text import visible

_CLOSE = 0.6  # similarity from which a name is suggested
RENAMED_KEYS = {
    "adhesion": "cohesion",
    "any_size": "any_scale",
    "at_most": "max_duration",
    "beyond": "half_space",
    "by": "group_by",
    "energy": "energy_budget",
    "gradient_along": "gradient",
    "grow": "expand",
    "indices": "metrics",
    "leaving": "on_exit",
    "list": "positions",
    "loads": "wall_forces",
    "measure": "analyze",
    "meters": "flow_meters",
    "onset": "impact",
    "overlap_limit": "max_overlap",
    "peak": "max_overlap",
    "place": "insert",
    "restitution": "restitution_at",
    "shear": "lees_edwards",
    "size": "scale",
    "spin": "angular_velocity",
    "time_step_safety": "time_step_fraction",
    "velocity_along": "flow",
}
"""Keys and values of version 0.1, and their present names."""
SYNONYMS: dict[str, tuple[str, ...]] = {
    "ball": ("particles",),
    "belt": ("surface_velocity", "motion"),
    "boundary": ("domain", "periodic", "on_exit"),
    "coefficientfriction": ("friction",),
    "coefficientrestitution": ("restitution",),
    "coefficientrollingfriction": ("rolling_friction",),
    "cof": ("friction",),
    "cohesionenergydensity": ("cohesion_energy_density",),
    "cor": ("restitution",),
    "conveyor": ("surface_velocity", "motion"),
    "dt": ("time_step",),
    "dump": ("output", "interval"),
    "e": ("young_modulus", "restitution"),
    "en": ("restitution",),
    "epsd2": ("epsd", "sds"),
    "facet": ("mesh",),
    "factory": ("rain",),
    "fix": ("walls",),
    "fixmovemesh": ("motion",),
    "fixwallgran": ("walls", "plane"),
    "freeze": ("fixed",),
    "gaussian": ("normal",),
    "grain": ("particles",),
    "hertzmaterial": ("hertz",),
    "hertzmindlin": ("hertz", "mindlin"),
    "history": ("mindlin",),
    "hooke": ("linear",),
    "hookean": ("linear",),
    "hookehysteresis": ("luding",),
    "insertpack": ("pack",),
    "insertrateregion": ("rain",),
    "insertstream": ("inlet",),
    "jkr": ("cohesion",),
    "lsd": ("linear",),
    "meshsurface": ("mesh",),
    "mindlindeltashear": ("mindlin",),
    "movemesh": ("motion",),
    "mu": ("friction",),
    "nu": ("poisson_ratio",),
    "omega": ("angular_velocity",),
    "oscillation": ("vibration",),
    "paircoeff": ("pairs",),
    "pairstyle": ("contact",),
    "pour": ("rain",),
    "random": ("pack", "rain"),
    "rectangularwall": ("rectangle",),
    "rho": ("density",),
    "rotate": ("rotation",),
    "simplifiedjkr": ("sjkr",),
    "sphere": ("particles",),
    "springdashpot": ("linear", "spring"),
    "stl": ("mesh",),
    "stream": ("inlet",),
    "surfaceenergy": ("work_of_adhesion",),
    "surfacevel": ("surface_velocity", "motion"),
    "surfacevelocity": ("surface_velocity", "motion"),
    "target": ("force", "pressure"),
    "thermo": ("output", "timeseries_interval"),
    "timestep": ("time_step",),
    "tsuji": ("hertz",),
    "wallgran": ("walls", "plane"),
    "wiggle": ("vibration",),
    "xmu": ("friction",),
    "youngsmodulus": ("young_modulus",),
    "zplane": ("plane",),
}
"""Names in other codes (LIGGGHTS, LAMMPS, YADE, MercuryDPM, EDEM), in lowercase letters and digits only, and
names here for the same or the nearest feature, in the order of preference."""


def synonym(word: str, known: Iterable[str]) -> str | None:
    """The first known name for a name in another code; None if there is none."""
    names = list(known)
    plain = "".join(letter for letter in word.lower() if letter.isalnum())
    return next((name for name in SYNONYMS.get(plain, ()) if name in names), None)


def renamed(word: str, known: Iterable[str]) -> str | None:
    """The present name of a renamed key, if it is one of the known names; None otherwise."""
    new = RENAMED_KEYS.get(word)
    return new if new in list(known) else None


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The present name of a renamed key, the name of a synonym, or the known name closest to the word, if one
    is close.

    None otherwise.
    """
    names = list(known)
    matches = difflib.get_close_matches(word, names, n=1, cutoff=_CLOSE)
    return renamed(word, names) or synonym(word, names) or (matches[0] if matches else None)


def suggestion_or_list(word: str, known: Iterable[str], kind: str) -> str:
    """Remedy for an unknown word: its new name, the closest known word, or a list of all known words.

    `kind`: plural noun for the list. The list is a sentence without a period.
    """
    names = list(known)
    if new := renamed(word, names):
        return f"{word} was renamed to {new}."
    match = nearest(word, names)
    if match:
        return f"Did you mean {match}?"
    return f"The {kind} are {', '.join(names)}" if names else f"There are no {kind}"


def suggestion_sentence(word: str, known: Iterable[str], kind: str) -> str:
    """As `suggestion_or_list`, with a period unless it is a question."""
    remedy = suggestion_or_list(word, known, kind)
    return remedy if remedy.endswith(("?", ".")) else f"{remedy}."


# Tags of the members of unions, which pydantic puts into the locations of errors, and the keys that select
# them.


def tag_of(member: Any) -> str:
    """Tag of a member of a union in error locations: a name in angle brackets, which distinguish it from
    keys.

    The name is that of its pydantic `Tag`, else the value of its key such as `kind`, else its first key; for
    plain values none, list or number.
    """
    if get_origin(member) is Annotated:
        explicit = [meta.tag for meta in get_args(member)[1:] if isinstance(meta, Tag)]
        return explicit[0] if explicit else tag_of(get_args(member)[0])
    if isinstance(member, type) and issubclass(member, BaseModel):
        words = selecting_keys(member).values()
        return f"<{next(iter(words), None) or next(iter(member.model_fields))}>"
    return "<none>" if member is NoneType else "<list>" if get_origin(member) is tuple else "<number>"


def selecting_keys(model: type[BaseModel]) -> dict[str, str]:
    """Keys of a model with only one allowed word, such as `shape` or `kind`, and that word."""
    literals = {
        name: get_args(each.annotation)
        for name, each in model.model_fields.items()
        if get_origin(each.annotation) is Literal
    }
    return {name: words[0] for name, words in literals.items() if len(words) == 1}


# Error messages of the schema: one sentence each, with source position and remedy.
#
# A message has the form `file:line:column: key.path is VALUE, but REASON.`

_CONSEQUENCE = "default_factory_not_called"  # default copied from another value that is invalid
_MAX_ERRORS = 1000  # more errors take too long to report
_REASONS = {
    "dict_type": "at least one entry of the form name: {...} is expected",
    "tuple_type": "a list is expected, [ ... ]",
    "list_type": "a list is expected, [ ... ]",
    "string_type": "text is expected; put it in quotes",
}
"""Reasons of errors by the type that pydantic gives them; other errors have the reason as their message."""


def dotted(path: Iterable[str | int]) -> str:
    """The path in the notation of messages and `--set`: walls.floor.normal.2."""
    return ".".join(str(key) for key in path)


def problem_at(document: Document, fault: Fault) -> Problem:
    """Error message for a fault, with the position of the value if it is shown, else of the key.

    The path may contain union tags. The sentence ends with a period or a question mark.
    """
    written = path_in_file(document, fault.path)
    name = dotted(written) or document.subject
    node = document.find(written)
    shown = node.shown() if node is not None else None
    if fault.whole:
        sentence = f"{name} {fault.reason}"
    else:
        sentence = f"{name} is {shown}, but {fault.reason}" if shown else f"{name}: {fault.reason}"
    position = document.key_position(written) if fault.whole else document.value_position(written)
    return Problem(position, sentence if sentence.endswith((".", "?")) else sentence + ".")


def path_in_file(document: Document, path: Iterable[str | int]) -> KeyPath:
    """The path in the file: without union tags, and without the index if a single item replaces a list.

    A face of a box has the path of the box.
    """
    node: Node | None = document.root
    written: list[str | int] = []
    for key in path:
        if isinstance(key, str) and key.startswith("<") and key.endswith(">"):
            continue
        if isinstance(key, int) and node is not None and node.items is None:
            continue
        in_file = node.written_key(key) if node is not None and node.entries is not None else None
        written.append(key if in_file is None else in_file)
        node = node.child(key) if node is not None else None
    return tuple(written)


def problems_of(document: Document, errors: Sequence[ErrorDetails], schema: type[BaseModel]) -> list[Problem]:
    """The errors of the schema as problems, without consequences of other errors; at most 1000.

    `schema`: model of the whole document. Omitted: copied defaults of invalid values, and a missing key if an
    unknown key is probably a misspelling of it.
    """
    found = [
        _SchemaError(document, each, schema) for each in errors[:_MAX_ERRORS] if each["type"] != _CONSEQUENCE
    ]
    suggested = {error.suggested() for error in found if error.type == "extra_forbidden"}
    return [
        problem_at(document, error.fault())
        for error in found
        if not (error.type == "missing" and error.path in suggested)
    ]


class _SchemaError:
    """One pydantic error, with the part of the schema at its location.

    `loc`: as in pydantic, without the mark of keys; `path`: key path in the file.
    """

    def __init__(self, document: Document, details: ErrorDetails, schema: type[BaseModel]) -> None:
        self.document = document
        self.schema = schema
        self.type: str = details["type"]
        self.message: str = details["msg"]
        self.context: dict[str, Any] = details.get("ctx", {})
        loc = details["loc"]
        self.of_key = bool(loc) and loc[-1] == "[key]"
        self.loc: KeyPath = loc[:-1] if self.of_key else loc + tuple(self.context.get("at", ()))
        self.path = path_in_file(document, self.loc)
        if (
            self.type == "extra_forbidden" and not self.of_key
        ):  # a key such as "<>" looks like a mark of pydantic
            self.path = (*path_in_file(document, self.loc[:-1]), self.loc[-1])

    def keys(self) -> list[str]:
        """The keys of the model that contains the location."""
        return _keys(model_at(self.schema, self.loc[:-1]))

    def suggested(self) -> KeyPath:
        """Path of the key that an unknown key probably means; the path of the unknown key if none is
        similar."""
        return (*self.path[:-1], nearest(str(self.path[-1]), self.keys()) or self.path[-1])

    def fault(self) -> Fault:
        """The error with the path in the file; the kind of error determines the sentence."""
        if self.type == "missing":
            return missing(self.path, self._description())
        if self.type == "extra_forbidden" and self.keys() == ["law"]:
            return whole(self.path, "is not a known key: this contact model has no options")
        if self.type == "extra_forbidden":
            remedy = suggestion_or_list(str(self.path[-1]), self.keys(), "known keys")
            if str(self.path[-1]).isdecimal():
                remedy = f"Numbers have a decimal point, not a comma: such as 0.{self.path[-1]}."
            return whole(self.path, f"is not a known key. {remedy}")
        if self.type == "choice":
            return self._choice()
        if self.type == "literal_error":
            return self._one_of(self.path, re.findall(r"'([^']*)'", str(self.context.get("expected"))))
        if self.type in ("model_type", "model_attributes_type"):
            keys = ", ".join(_keys(model_at(self.schema, self.loc)))
            return Fault(self.path, f"a mapping with the keys {keys} is expected")
        if self.of_key:
            return whole(self.path, f"is not valid here: {self.message}")
        return Fault(self.path, _REASONS.get(self.type, self.message), whole=self.type == "whole")

    def _description(self) -> str:
        """Description of the missing key from the schema."""
        model = model_at(self.schema, self.loc[:-1])
        fields = model.model_fields.items() if model else ()
        found = [field.description for name, field in fields if self.loc[-1] in (name, field.alias)]
        return (found and found[0]) or "it is required"

    def _choice(self) -> Fault:
        """A union whose member is undetermined: the key is missing or has an unknown value.

        The message lists the values of the key, or the reason that the union gives.
        """
        node = self.document.find(self.path)
        if node is None:
            return Fault(self.path, self.context.get("reason", "it cannot be read"))
        names = [tag_of(member).strip("<>") for member in get_args(_annotation_at(self.schema, self.loc))]
        if "reason" in self.context:
            word = _word(node)
            known = [name.removeprefix("law ") for name in names]
            near = nearest(word, known) if word and word not in known else None
            hint = (
                f". Did you mean {near}?" if near else _options(self.path, word) or _registration(self.path)
            )
            return Fault(self.path, self.context["reason"] + hint)
        key = self.context["key"]
        names = [name for name in names if name not in ("number", "list", "none")]
        if node.entries is not None and key in node.entries:
            return self._one_of((*self.path, key), names)
        if node.entries is not None:
            return missing((*self.path, key), f"one of {', '.join(names)}")
        if key == "law":
            return self._one_of(self.path, names)
        example = "{" + f"{key}: {names[0]}, ..." + "}"
        return Fault(self.path, f"a mapping is expected, {example}, with {key} one of {', '.join(names)}")

    def _one_of(self, path: KeyPath, allowed: list[str]) -> Fault:
        """A word that is not one of `allowed`: the message lists them and suggests the closest."""
        node = self.document.find(path)
        word = "" if node is None else _word(node)
        near = nearest(word, allowed) if word else None
        hint = f". Did you mean {near}?" if near else _elsewhere(word) or _registration(path)
        return Fault(path, f"it must be {'one of ' * (len(allowed) > 1)}{', '.join(allowed)}{hint}")


def _word(node: Node) -> str:
    """A word as written, also that of a contact model in `{law: WORD}`; empty for another mapping or a
    list."""
    law = node.child("law")
    return node.text if law is None else law.text


def _options(path: KeyPath, word: str) -> str:
    """Sentence on the options that a contact model requires, after the list of forms; empty for other
    words."""
    slot = str(path[1]) if path[:1] == ("contact",) and len(path) > 1 else ""
    model = registry.models(slot).get(word) if slot in SLOTS else None
    if model is None:
        return ""
    required = {key: each for key, each in model.options.items() if each.default is None}
    given = ", ".join(f"{key}: {getattr(each, 'example', '...')}" for key, each in required.items())
    return f". {word} requires {' and '.join(required)}, such as {{law: {word}, {given}}}" if required else ""


def _elsewhere(word: str) -> str:
    """Sentence, after the list of allowed words, on a contact model of another slot; empty for other
    words."""
    slot = next((slot for slot in SLOTS if word in registry.models(slot)), None)
    return f". {word} is given as contact.{slot}: {word}" if slot else ""


def _registration(path: KeyPath) -> str:
    """Sentence, after the list of contact models, on those of a program; empty for other keys."""
    is_model = path[:1] == ("contact",) and path[1:2] and path[1] in SLOTS and path[2:] in ((), ("law",))
    return ". Register a model of your own before: granflow.register_contact_model" if is_model else ""


def model_at(annotation: Any, loc: KeyPath) -> type[BaseModel] | None:
    """The model at the location of an error; None for a plain value.

    `annotation`: type at the root, such as SceneInput; `loc`: location as in pydantic, with union tags.
    """
    found = _annotation_at(annotation, loc)
    return found if isinstance(found, type) and issubclass(found, BaseModel) else None


def _annotation_at(annotation: Any, loc: KeyPath) -> Any:
    """The type at a location below a type; None if the location does not exist in the schema."""
    origin = get_origin(annotation)
    arguments = get_args(annotation)
    if origin is Annotated:
        return _annotation_at(arguments[0], loc)
    if origin in (Union, UnionType):
        members = [member for member in arguments if member is not NoneType]
        tagged = [member for member in members if loc and tag_of(member) == loc[0]]
        if tagged or len(members) == 1:
            return _annotation_at(tagged[0], loc[1:]) if tagged else _annotation_at(members[0], loc)
        return None if loc else annotation
    if not loc:
        return annotation
    if origin in (dict, tuple):
        return _annotation_at(arguments[1 if origin is dict else 0], loc[1:])
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        for name, field in annotation.model_fields.items():
            if loc[0] in (name, field.alias):
                return _annotation_at(field.annotation, loc[1:])
    return None


def _keys(model: type[BaseModel] | None) -> list[str]:
    """The keys of a model as written in scenes; empty without a model."""
    return [field.alias or name for name, field in model.model_fields.items()] if model else []


# Building blocks of the schema: the immutable base model, texts, names, lists and unions.

_NAME = r"[a-z][a-z0-9_]*"


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


def require(is_valid: Callable[[Any], Any], reason: str) -> Callable[[Any], Any]:
    """Validator that returns a value unchanged, or raises PydanticCustomError with the reason if it is not
    valid."""

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
    """Choose a model by the value of `key`, or another member by the type of the value: none, list or
    number."""

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
    """Choose a model by its first key, such as `box` of `{box: {...}}`; no match is the error "X is Y, but
    REASON."."""

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
MOST_LETTERS = 64
"""Largest length of a name: names are parts of the names of files, which most file systems limit to 255
bytes."""
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
Names = Annotated[tuple[Text, ...], ListOf(some="[fill, settle]")]
