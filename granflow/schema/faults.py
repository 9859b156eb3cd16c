"""What the schema reports about an invalid scene: errors of one value, and faults between values.

A validator of one value raises `value_error` or `whole_error`, to which pydantic adds the key path. A check
of several values yields a `Fault`, which has a key path. `granflow.schema.messages` turns both into messages.
"""

from dataclasses import dataclass

from pydantic_core import PydanticCustomError

KeyPath = tuple[str | int, ...]
"""Keys and list indices from the root of a scene, such as ("stages", 0, "duration")."""


def value_error(reason: str, *at: str) -> PydanticCustomError:
    """The error "key.path is VALUE, but REASON."; `at` is the path of a key within the value."""
    return PydanticCustomError("but", "{reason}", {"reason": reason, "at": at})


def whole_error(reason: str) -> PydanticCustomError:
    """The error "key.path REASON."."""
    return PydanticCustomError("whole", "{reason}", {"reason": reason})


@dataclass(frozen=True)
class Fault:
    """An invalid value at `path`; the message is "X is Y, but {reason}", with `whole` "X {reason}".

    `messages.problem_at` adds the source position and the period. The path of a fault from `Model.faults` is
    relative to the model.
    """

    path: KeyPath
    reason: str
    whole: bool = False


def whole(path: KeyPath, reason: str) -> Fault:
    """The fault with the message "X {reason}"."""
    return Fault(path, reason, whole=True)


def missing(path: KeyPath, description: str) -> Fault:
    """The fault of a missing key; `description` states its meaning or the reason why it is required."""
    return whole(path, f"is missing: {description}")


def redundant(key: str, other: str, keep: str = "one of them") -> Fault:
    """The fault of a key that excludes another key."""
    return Fault((key,), f"{other} is given too: keep {keep}")
