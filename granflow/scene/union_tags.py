"""Tags of the members of unions, which pydantic puts into the locations of errors, and the keys that select them."""

from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel, Tag


def tag_of(member: Any) -> str:
    """Tag of a member of a union in error locations: a name in angle brackets, which distinguish it from keys.

    The name is that of its pydantic `Tag`, else the value of its key such as `kind`, else its first key; for plain
    values none, list or number.
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
