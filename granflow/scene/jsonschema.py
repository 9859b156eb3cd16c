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
    return {"$schema": _DIALECT, **_without_titles(schema), "title": _TITLE}


def _without_titles(value: Any) -> Any:
    """Remove the titles that pydantic derives from names: they add no information to the help of an editor."""
    if isinstance(value, list):
        return [_without_titles(each) for each in value]
    if not isinstance(value, dict):
        return value
    return {key: _without_titles(each) for key, each in value.items() if not (key == "title" and isinstance(each, str))}
