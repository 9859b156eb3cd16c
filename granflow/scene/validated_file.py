"""Validated YAML files other than scenes, such as sweeps.

They get the same messages as scenes: with positions and suggestions, and all problems at once.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from granflow.arguments import refuse_other
from granflow.errors import FileError, SceneError
from granflow.scene.document import Document, document_of
from granflow.scene.messages import problem_at, problems_of
from granflow.scene.model import Model, faults_of
from granflow.scene.reader import document_in, in_file_order

M = TypeVar("M", bound=Model)

SCENE_KEYS = {"materials", "particles"}
"""Required keys of a scene that no other file has."""


def validated_file(path: Path, schema: type[M], kind: str) -> tuple[M, Document]:
    """The content of a YAML file as `schema`, and its document, which has the position of each key.

    `kind`: what the file describes, for messages, such as "sweep". Raises FileError with all problems, each
    as `file:line:column: sentence`; for a scene, only that it is one.
    """
    try:
        document = document_in(path, kind)
    except SceneError as error:
        raise FileError(error.problems) from None
    if SCENE_KEYS <= set(document.root.entries or ()):
        keys = ", ".join(name for name, field in schema.model_fields.items() if field.is_required())
        raise FileError([f"{path}: this is a scene, not a {kind} file; give a file with the keys {keys}."])
    return validated(document, schema), document


def validated_source(
    source: str | os.PathLike[str] | Mapping[str, Any], schema: type[M], kind: str
) -> tuple[M, Document, Path, str]:
    """As `validated_file`, for the path of a file or a mapping with its keys, whose positions are key paths.

    Also returns the folder to which paths in it are relative, the working directory for a mapping, and its
    name, `kind` for a mapping. Raises GranflowError for a source of another type.
    """
    refuse_other(
        "source", source, (str, os.PathLike, Mapping), "the path of a file, or a mapping with its keys"
    )
    if isinstance(source, Mapping):
        document = document_of(source)
        return validated(document, schema), document, Path(), kind
    path = Path(source)
    return *validated_file(path, schema, kind), path.parent, path.stem


def validated(document: Document, schema: type[M]) -> M:
    """The content of a document as `schema`. Raises FileError with all problems."""
    problems = list(document.problems)
    content = None
    try:
        content = schema.model_validate(document.root.data())
        problems += [problem_at(document, fault) for fault in faults_of(content)]
    except ValidationError as error:
        problems += problems_of(document, error.errors(include_url=False, include_input=False), schema)
    if content is None or problems:
        raise FileError(map(str, in_file_order(problems)))
    return content
