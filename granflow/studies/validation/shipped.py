"""Shipped scenes in validation cases."""

from collections.abc import Sequence

from granflow import Scene, load_scene
from granflow.io.files import example_paths


def shipped_scene(name: str, overrides: Sequence[str] = ()) -> Scene:
    """A shipped scene in double precision, such as "flat_silo", with overrides KEY=VALUE."""
    return load_scene(example_paths()[name], ["run.precision=f64", *overrides])
