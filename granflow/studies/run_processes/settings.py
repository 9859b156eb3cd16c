"""Values of scene keys that studies set: their SI numbers, and their notation for `--set`."""

import json
from collections.abc import Mapping
from typing import Any

from granflow.errors import FileError, SceneError
from granflow.scene.schema.given_numbers import number_of


def si_value(value: Any) -> Any:
    """The SI number of text with a unit such as "9 mm"; other values unchanged."""
    number = number_of(value) if isinstance(value, str) else None
    return value if number is None else float(number)


def overrides_of(settings: Mapping[str, Any]) -> tuple[str, ...]:
    """The settings, values by key path, as arguments of --set; values in the notation of JSON, which YAML contains."""
    return tuple(f"{key}={json.dumps(value)}" for key, value in settings.items())


def relocated(error: SceneError, positions: Mapping[str, str]) -> FileError:
    """The error with its problems at the positions in the file of a study, where they concern settings of the study.

    `positions`: position in that file by key path of the scene.
    """
    return FileError([_relocated(problem, positions) for problem in error.problems])


def _relocated(problem: str, positions: Mapping[str, str]) -> str:
    for key, position in positions.items():
        prefix = f"--set {key}="
        if problem.startswith(prefix) and ": " in problem:
            return f"{position}: {problem.partition(': ')[2]}"
    return problem
