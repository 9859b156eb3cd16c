"""Faults: invalid values and combinations of values in a scene, each with its key path and a reason."""

from dataclasses import dataclass

from granflow.scene.document import KeyPath


@dataclass(frozen=True)
class Fault:
    """An invalid value at `path`; the message is "X is Y, but {reason}".

    With `whole`, the message is "X {reason}". `messages.problem_at` adds the position and the period. The path of a
    fault from `Model.faults` is relative to the model.
    """

    path: KeyPath
    reason: str
    whole: bool = False


def whole(path: KeyPath, reason: str) -> Fault:
    """The fault with the message "X {reason}"."""
    return Fault(path, reason, whole=True)


def redundant(key: str, other: str, keep: str = "one of them") -> Fault:
    """The fault of a key that excludes another key."""
    return Fault((key,), f"{other} is given too: keep {keep}")


def missing(path: KeyPath, description: str) -> Fault:
    """The fault of a missing key; `description` states its meaning or the reason why it is required."""
    return whole(path, f"is missing: {description}")
