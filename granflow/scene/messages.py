"""Error messages of the schema: one sentence each, with source position and remedy.

A message has the form `file:line:column: key.path is VALUE, but REASON.`
"""

import re
from collections.abc import Iterable, Iterator
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, Tag, ValidationError

from granflow.scene.document import Document, KeyPath, Node, Problem
from granflow.scene.schema.fields import Fault
from granflow.scene.schema.scene import SceneInput
from granflow.scene.suggest import nearest, suggestion_or_list

_CONSEQUENCE = "default_factory_not_called"  # default copied from another value that is invalid
_MAX_ERRORS = 1000  # more errors take too long to report
_TYPE_REASONS = {
    "dict_type": "at least one entry of the form name: {...} is expected",
    "tuple_type": "a list is expected, [ ... ]",
    "list_type": "a list is expected, [ ... ]",
    "string_type": "text is expected; put it in quotes",
}


def dotted(path: Iterable[str | int]) -> str:
    """The path in the notation of messages and `--set`: walls.floor.normal.2."""
    return ".".join(str(key) for key in path)


def problem_at(document: Document, path: KeyPath, fault: Fault) -> Problem:
    """Error message for a fault at a path, with the position of the value if it is shown, else of the key.

    The path may contain union tags; `fault.path` is not used. The sentence ends with a period or a question mark.
    """
    written = path_in_file(document, path)
    name = dotted(written) or "the scene"
    if fault.whole:
        return Problem(document.key_position(written), _end(f"{name} {fault.reason}"))
    node = document.find(written)
    shown = node.shown() if node is not None else None
    sentence = f"{name} is {shown}, but {fault.reason}" if shown else f"{name}: {fault.reason}"
    return Problem(document.value_position(written), _end(sentence))


def path_in_file(document: Document, path: Iterable[str | int]) -> KeyPath:
    """The path in the file: without union tags, and without the index if a single item replaces a list."""
    node: Node | None = document.root
    written: list[str | int] = []
    for key in path:
        if isinstance(key, str) and key.startswith("<") and key.endswith(">"):
            continue
        if isinstance(key, int) and node is not None and node.items is None:
            continue
        written.append(key)
        node = node.child(key) if node is not None else None
    return tuple(written)


def problems_of(document: Document, error: ValidationError) -> list[Problem]:
    """The errors of the schema as problems, without consequences of other errors; at most 1000.

    Omitted: copied defaults of invalid values, and a missing key if an unknown key is probably a misspelling of it.
    """
    details = error.errors(include_url=False, include_input=False)[:_MAX_ERRORS]
    schema_errors = [
        _SchemaError(document, each["type"], each["loc"], each["msg"], each.get("ctx")) for each in details
    ]
    suggested = {path for schema_error in schema_errors for path in schema_error.suggested()}
    return [
        schema_error.problem()
        for schema_error in schema_errors
        if schema_error.type != _CONSEQUENCE and not (schema_error.type == "missing" and schema_error.path in suggested)
    ]


class _SchemaError:
    """One pydantic error, with the part of the schema at its location.

    `type`, `loc`, `msg`, `ctx`: as in pydantic; `path`: key path in the file.
    """

    def __init__(self, document: Document, type: str, loc: KeyPath, msg: str, ctx: Any = None) -> None:
        self.document = document
        self.type = type
        self.message = msg
        self.context: dict[str, Any] = ctx or {}
        self.of_key = bool(loc) and loc[-1] == "[key]"
        self.loc = loc[:-1] if self.of_key else loc + tuple(self.context.get("at", ()))
        self.path = path_in_file(document, self.loc)

    def suggested(self) -> Iterator[KeyPath]:
        """Path of the suggested key for an unknown key."""
        if self.type == "extra_forbidden":
            near = nearest(str(self.path[-1]), _keys(model_at(SceneInput, self.loc[:-1])))
            if near:
                yield (*self.path[:-1], near)

    def problem(self) -> Problem:
        """The error as one sentence with its source position; the kind of error determines the sentence."""
        if self.type == "missing":
            return self._whole(f"is missing: {self._description()}")
        if self.type == "extra_forbidden":
            return self._unknown()
        if self.type == "choice":
            return self._choice()
        if self.type == "literal_error":
            return self._one_of(self.path, re.findall(r"'([^']*)'", str(self.context.get("expected"))))
        if self.type in ("model_type", "model_attributes_type"):
            keys = ", ".join(_keys(model_at(SceneInput, self.loc)))
            return self._but(self.path, f"a mapping with the keys {keys} is expected")
        if self.of_key:
            return self._whole(f"is not valid here: {self.message}")
        if self.type == "whole":
            return self._whole(self.message)
        return self._but(self.path, _TYPE_REASONS.get(self.type, self.message))

    def _but(self, path: KeyPath, reason: str) -> Problem:
        return problem_at(self.document, path, Fault((), reason))

    def _whole(self, reason: str) -> Problem:
        return problem_at(self.document, self.path, Fault((), reason, whole=True))

    def _unknown(self) -> Problem:
        remedy = suggestion_or_list(str(self.path[-1]), _keys(model_at(SceneInput, self.loc[:-1])), "known keys")
        return self._whole(f"is not a known key. {remedy}")

    def _description(self) -> str:
        """Description of the missing key from the schema."""
        model = model_at(SceneInput, self.loc[:-1])
        fields = model.model_fields.values() if model else ()
        texts = {field.alias: field.description for field in fields if field.alias}
        texts |= {name: field.description for name, field in model.model_fields.items()} if model else {}
        return texts.get(str(self.loc[-1])) or "it is required"

    def _choice(self) -> Problem:
        """A union whose member is undetermined: the key is missing or has an unknown value.

        The message lists the values of the key, or the reason that the union gives.
        """
        key = self.context.get("key", "")
        tags = [tag.strip("<>") for tag in tags_at(SceneInput, self.loc)]
        tags = tags if key == "kind" else [tag for tag in tags if tag not in ("number", "list", "none")]
        node = self.document.find(self.path)
        if node is None or "reason" in self.context:
            return self._but(self.path, self.context.get("reason", "it cannot be read"))
        if node.entries is None:
            return self._no_mapping(key, tags)
        path = (*self.path, key)
        if key not in node.entries:
            fault = Fault((), f"is missing: one of {', '.join(tags)}", whole=True)
            return problem_at(self.document, path, fault)
        return self._one_of(path, tags)

    def _no_mapping(self, key: str, tags: list[str]) -> Problem:
        """A value in place of a mapping: the message gives an example with one of the possible kinds."""
        if key == "law":
            return self._one_of(self.path, tags)
        example = "{" + f"{key}: {tags[0]}, ..." + "}"
        return self._but(self.path, f"a mapping is expected, {example}, with {key} one of {', '.join(tags)}")

    def _one_of(self, path: KeyPath, allowed: list[str]) -> Problem:
        """A word that is not one of `allowed`: the message lists them and suggests the closest."""
        node = self.document.find(path)
        near = nearest(node.text, allowed) if node is not None else None
        hint = f". Did you mean {near}?" if near else ""
        must = f"it must be one of {', '.join(allowed)}" if len(allowed) > 1 else f"it must be {allowed[0]}"
        return self._but(path, must + hint)


def model_at(annotation: Any, loc: KeyPath) -> type[BaseModel] | None:
    """The model at the location of an error; None for a plain value.

    `annotation`: type at the root, such as SceneInput; `loc`: location as in pydantic, with union tags.
    """
    found = _annotation_at(annotation, loc)
    return found if isinstance(found, type) and issubclass(found, BaseModel) else None


def tags_at(annotation: Any, loc: KeyPath) -> list[str]:
    """The tags of the union at the location of an error, with angle brackets; empty for another type."""
    members = get_args(_annotation_at(annotation, loc))
    return [meta.tag for member in members for meta in get_args(member)[1:] if isinstance(meta, Tag)]


def _annotation_at(annotation: Any, loc: KeyPath) -> Any:
    """The type at a location below a type; None if the location does not exist in the schema."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return _annotation_at(get_args(annotation)[0], loc)
    if origin in (Union, UnionType):
        return _in_union(annotation, loc)
    if not loc:
        return annotation
    if origin in (dict, tuple):
        item = get_args(annotation)[1 if origin is dict else 0]
        return _annotation_at(item, loc[1:])
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        for name, field in annotation.model_fields.items():
            if loc[0] in (name, field.alias):
                return _annotation_at(field.annotation, loc[1:])
    return None


def _in_union(annotation: Any, loc: KeyPath) -> Any:
    """The type at a location in a union: that of the member with the tag, or of the only member."""
    members = [member for member in get_args(annotation) if member is not type(None)]
    if loc:
        for member in members:
            if any(isinstance(meta, Tag) and meta.tag == loc[0] for meta in get_args(member)[1:]):
                return _annotation_at(member, loc[1:])
    return _annotation_at(members[0], loc) if len(members) == 1 else (None if loc else annotation)


def _keys(model: type[BaseModel] | None) -> list[str]:
    """The keys of a model as written in scenes; empty without a model."""
    return [field.alias or name for name, field in model.model_fields.items()] if model else []


def _end(sentence: str) -> str:
    return sentence if sentence.endswith((".", "?")) else sentence + "."
