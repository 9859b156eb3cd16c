"""The JSON Schema of a scene file as a user may write it, for editors that complete and check."""

from typing import Any

from granflow.scene.schema import Scene

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_TITLE = "granflow scene"


def json_schema() -> dict[str, Any]:
    """Describe scene files (JSON Schema, draft 2020-12).

    Numbers may be plain (SI) or text with a unit. What only a look at several parts together can tell, such as a
    missing pair, is left to `granflow check`.
    """
    schema = Scene.model_json_schema(by_alias=True)
    return {"$schema": _DIALECT, **_without_titles(schema), "title": _TITLE}


def _without_titles(value: Any) -> Any:
    """Leave out the titles that pydantic makes of names: they tell nothing and fill an editor's help."""
    if isinstance(value, list):
        return [_without_titles(each) for each in value]
    if not isinstance(value, dict):
        return value
    return {key: _without_titles(each) for key, each in value.items() if not (key == "title" and isinstance(each, str))}
