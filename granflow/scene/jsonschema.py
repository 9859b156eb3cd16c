"""JSON Schema of scene files, for completion and validation in editors."""

from typing import Any

from granflow.scene.schema.scene import SceneInput

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_TITLE = "granflow scene"


def json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of scene files.

    Numbers may be plain (SI) or text with a unit. `granflow check` also detects inconsistencies between parts, such
    as a missing pair. The result contains plain Python data only and can be written as JSON.
    """
    schema = SceneInput.model_json_schema(by_alias=True)
    return {"$schema": _DIALECT, **_simplified(schema), "title": _TITLE}


def _simplified(value: Any) -> Any:
    """The schema without titles that pydantic derives from names, and without examples in Python.

    Mappings by name accept no other names.
    """
    if isinstance(value, str):
        return value.partition("\n\n>>> ")[0]
    if isinstance(value, list):
        return [_simplified(each) for each in value]
    if not isinstance(value, dict):
        return value
    closed = {"additionalProperties": False} if "patternProperties" in value else {}
    titles = {"title"} if isinstance(value.get("title"), str) else set()
    return {key: _simplified(each) for key, each in value.items() if key not in titles} | closed
