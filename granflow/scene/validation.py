"""Partial scenes: the valid parts of a scene with errors, for consistency checks between these parts."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, get_args, get_origin

from pydantic import TypeAdapter, ValidationError

from granflow.scene.document import Document, KeyPath
from granflow.scene.schema.fields import Fault, Model
from granflow.scene.schema.scene import Scene


@dataclass(frozen=True)
class PartialScene:
    """A scene that may lack parts.

    `scene` has the sections in `complete`, and the valid entries of sections with named entries. `parts`: key path ->
    valid part, for checks within each part. The instance of Scene may lack required fields and must not be used for a
    run.
    """

    document: Document
    scene: Scene
    complete: frozenset[str]
    parts: Mapping[KeyPath, Any]

    @classmethod
    def of(cls, document: Document, scene: Scene) -> "PartialScene":
        """The partial scene of a scene that satisfies the schema: all sections are complete."""
        sections: dict[KeyPath, Any] = {(name,): getattr(scene, name) for name in Scene.model_fields}
        return cls(document, scene, frozenset(Scene.model_fields), sections)

    def names(self, section: str) -> tuple[str, ...]:
        """All names in a section of the file, including invalid entries, and names in lowercase.

        Checks of references use them, so that an invalid entry does not cause an error wherever it is named.
        """
        node = self.document.root.child(section)
        names = tuple(node.entries) if node is not None and node.entries else ()
        return tuple(dict.fromkeys((*names, *(name.lower() for name in names))))

    def faults(self) -> Iterator[tuple[KeyPath, Fault]]:
        """Inconsistencies between the fields of each valid part, with the full key path of the fault."""
        for path, part in self.parts.items():
            yield from _faults(part, path)


def partial_scene_of(document: Document, data: Mapping[str, Any]) -> PartialScene:
    """Validate each section, or each entry of a section, separately and keep the valid parts.

    `data`: plain data of the document. Never raises ValidationError; the invalid parts are reported elsewhere.
    """
    parts: dict[KeyPath, Any] = {}
    sections: dict[str, Any] = {}
    complete = set()
    for name, field in Scene.model_fields.items():
        if name not in data:
            if not field.is_required():
                sections[name] = field.get_default(call_default_factory=True)
                complete.add(name)
            elif get_origin(field.annotation) is dict:
                sections[name] = {}
            continue
        valid, is_complete = _section(name, data[name])
        parts |= {(name, *key): part for key, part in valid.items()}
        if is_complete:
            complete.add(name)
        if get_origin(field.annotation) is dict:
            sections[name] = {key[0]: part for key, part in valid.items()}
        elif is_complete:
            sections[name] = valid[()] if () in valid else tuple(valid.values())
    return PartialScene(document, Scene.model_construct(**sections), frozenset(complete), parts)


def _section(name: str, value: Any) -> tuple[dict[KeyPath, Any], bool]:
    """The valid parts of a section by key, and whether the section is complete.

    The key is () for a section that is one part, (name,) or (index,) for an entry of a mapping or list.
    """
    origin = get_origin(Scene.model_fields[name].annotation)
    entries: list[tuple[KeyPath, Any]] = [((), value)]
    if origin is dict:
        entries = [((key,), each) for key, each in value.items()] if isinstance(value, dict) else []
    if origin is tuple and name != "gravity":
        entries = [((index,), each) for index, each in enumerate(value)] if isinstance(value, list) else []
    valid: dict[KeyPath, Any] = {}
    for key, each in entries:
        try:
            valid[key] = _adapter(name, bool(key)).validate_python(each)
        except ValidationError:
            continue
    return valid, len(valid) == len(entries) and isinstance(value, list | dict)


@cache
def _adapter(section: str, is_entry: bool) -> TypeAdapter[Any]:
    """The pydantic validator of a section, or of one entry of it."""
    field = Scene.model_fields[section]
    if not is_entry:
        kind: Any = field.annotation
        for meta in field.metadata:
            kind = Annotated[kind, meta]
        return TypeAdapter(kind)
    arguments = get_args(field.annotation)
    return TypeAdapter(arguments[1] if get_origin(field.annotation) is dict else arguments[0])


def clear_adapters() -> None:
    """Discard the validators; required after a change of the schema."""
    _adapter.cache_clear()


def _faults(value: Any, path: KeyPath) -> Iterator[tuple[KeyPath, Fault]]:
    """Faults of a value and of all models in it, depth first, with key paths from the root."""
    if isinstance(value, Model):
        for fault in value.faults():
            yield (*path, *fault.path), fault
        for name, field in type(value).model_fields.items():
            yield from _faults(getattr(value, name), (*path, field.alias or name))
    elif isinstance(value, dict):
        for key, each in value.items():
            yield from _faults(each, (*path, key))
    elif isinstance(value, tuple):
        for index, each in enumerate(value):
            yield from _faults(each, (*path, index))
