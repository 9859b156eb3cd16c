"""Partial scenes: the valid parts of a scene with errors, for consistency checks between these parts.

A user thereby sees the errors of the schema and the inconsistencies of all other parts at once.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Annotated, Any, get_origin

from pydantic import BaseModel, Field, create_model

from granflow.scene.blocks.scene import SceneInput
from granflow.scene.blocks.walls import FACES
from granflow.scene.document import Document
from granflow.scene.faults import Fault, KeyPath
from granflow.scene.model import faults_of
from granflow.scene.suggest import nearest


@dataclass(frozen=True)
class PartialScene:
    """A scene that may lack parts.

    scene:     the complete sections, and the valid entries of sections with several entries; it may lack
               required parts and must not be used for a run
    complete:  names of the sections without errors
    indices:   for each list with errors, the index in the file of each valid item
    """

    document: Document
    scene: SceneInput
    complete: frozenset[str] = frozenset(SceneInput.model_fields)
    indices: Mapping[str, Sequence[int]] = field(default_factory=dict)

    def names(self, section: str) -> tuple[str, ...]:
        """All names in a section of the file, including invalid entries, and names in lowercase.

        Checks of references use them, so that an invalid entry does not cause an error wherever it is named.
        """
        node = self.document.root.child(section)
        names = tuple(node.entries) if node is not None and node.entries else ()
        if section == "walls":
            names = self._wall_names(names)
        return tuple(dict.fromkeys((*names, *(name.lower() for name in names))))

    def _wall_names(self, written: Sequence[str]) -> tuple[str, ...]:
        """Names of the walls with the faces of boxes in place of the boxes; an invalid box has all six."""
        faces = [name for name in self.scene.walls if "." in name]
        valid = {name.partition(".")[0] for name in faces}
        shapes = {name: self.document.find(("walls", name, "shape")) for name in written}
        boxes = [name for name, shape in shapes.items() if shape is not None and shape.scalar == "box"]
        faces += [f"{box}.{face}" for box in boxes for face in FACES if box not in valid]
        return (*(name for name in written if name not in boxes), *faces)

    def faults(self) -> Iterator[Fault]:
        """Inconsistencies between the fields of each valid part, with the full key path of the fault."""
        for fault in faults_of(self.scene):
            section, *rest = fault.path
            if section in self.indices:
                yield replace(fault, path=(section, self.indices[str(section)][int(rest[0])], *rest[1:]))
            else:
                yield fault


def partial_scene_of(document: Document, data: Mapping[str, Any], errors: Iterable[KeyPath]) -> PartialScene:
    """The valid parts of a scene: all sections and entries of sections without errors.

    `data`: plain data of the document; `errors`: locations of the errors of the schema, as in pydantic.
    """
    # a section with several entries loses the broken entry only: ("walls", "floor"), but ("run",)
    broken = {loc[:2] if loc[0] in _several() else loc[:1] for loc in errors}
    sections = {name: value for name, value in data.items() if (name,) not in broken}
    indices: dict[str, list[int]] = {}
    for name in {str(loc[0]) for loc in broken} & set(sections):
        items = sections[name]
        if isinstance(items, dict):
            sections[name] = {key: item for key, item in items.items() if (name, key) not in broken}
        else:
            indices[name] = [index for index in range(len(items)) if (name, index) not in broken]
            sections[name] = [items[index] for index in indices[name]]
    valid = SceneInput.model_construct(**dict(_without_required_keys().model_validate(sections)))
    required = {name for name, each in SceneInput.model_fields.items() if each.is_required()}
    absent = required - set(data)
    complete = frozenset(SceneInput.model_fields) - absent - {loc[0] for loc in broken}
    return PartialScene(document, valid, complete, indices)


@cache
def _several() -> frozenset[str]:
    """The sections with several entries: mappings by name, and lists of models."""
    return frozenset(
        name
        for name, each in SceneInput.model_fields.items()
        if get_origin(each.annotation) in (dict, tuple) and name != "gravity"
    )


@cache
def _without_required_keys() -> type[BaseModel]:
    """The schema of a scene in which every key is optional.

    Missing mappings are empty, other missing parts None.
    """
    fields: dict[str, Any] = {}
    for name, each in SceneInput.model_fields.items():
        kind: Any = each.annotation
        for meta in each.metadata:
            kind = Annotated[kind, meta]
        if each.is_required():
            default: Any = {} if get_origin(each.annotation) is dict else None
        else:
            default = each.get_default(call_default_factory=True)
        fields[name] = (kind, Field(default))
    return create_model("PartialSections", __config__=SceneInput.model_config, **fields)


def clear_schema() -> None:
    """Clear what was derived from the schema; required after a change of the schema."""
    _several.cache_clear()
    _without_required_keys.cache_clear()


def unknown(path: KeyPath, name: str, known: Iterable[str], kind: str) -> Fault:
    """The fault of an unknown name, with the closest known name or a list of all."""
    names = list(known)
    if suggestion := nearest(name, names):
        return Fault(path, f"there is no such {kind}. Did you mean {suggestion}?")
    known_names = f"the {kind}s are {', '.join(names)}" if names else f"the scene has no {kind}s"
    return Fault(path, f"there is no such {kind}; {known_names}")
