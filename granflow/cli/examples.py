"""The verbs examples and example: list the shipped scenes, sweeps and calibrations; copy one with its input files."""

import argparse
import shutil
from filecmp import cmp
from pathlib import Path
from typing import Any

from granflow.cli.arguments import add_verb
from granflow.cli.messages import say
from granflow.errors import GranflowError
from granflow.io.shipped_files import example_paths

VERBS = {"sweeps": "sweep", "calibration": "calibrate"}
"""Folders of shipped files that are not scenes, and the verbs that run them."""


def examples(options: argparse.Namespace) -> int:
    """`granflow examples`: list the names and titles of the shipped scenes, sweeps and calibrations."""
    from granflow.scene.yaml12 import parse

    paths = example_paths()
    width = max(map(len, paths))
    for name, path in paths.items():
        title = parse(path.read_text(encoding="utf-8"), str(path), with_positions=False).find(("title",))
        say(f"{name:{width}}  {title.scalar if title else ''}")
    return 0


def example(options: argparse.Namespace) -> int:
    """`granflow example NAME`: copy a shipped scene and its input files.

    Returns 0. Raises GranflowError for an unknown name, and for a file that exists with other contents.
    """
    from granflow.load import load
    from granflow.runs.input_copies import input_files

    source = path_of(options.name)
    scenes = _scenes_of(source)
    inputs = [path for scene in scenes for _, path in input_files(load(scene))]
    folder = source.parent if source in scenes else source.parents[1]
    targets = {path: options.out / path.relative_to(folder) for path in (source, *scenes, *inputs)}
    for path, target in targets.items():
        if target.exists() and not cmp(path, target, shallow=False):
            raise GranflowError(
                f"{target} exists with other contents: remove it, or give another directory with --out."
            )
    for path, target in targets.items():
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
        say(str(target))
    say(f"Run it with granflow {VERBS.get(source.parent.name, 'run')} {targets[source]}")
    return 0


def _scenes_of(source: Path) -> list[Path]:
    """The scene itself, or the scenes of a sweep or a calibration."""
    verb = VERBS.get(source.parent.name)
    if verb == "sweep":
        from granflow.studies.sweep.run import read_sweep

        return [read_sweep(source).scene.resolve()]
    if verb == "calibrate":
        from granflow.studies.calibration.run import read_calibration

        return [path.resolve() for path in read_calibration(source).scenes.values()]
    return [source]


def path_of(name: str) -> Path:
    """Path of a shipped scene, such as hopper or verification/incline. Raises GranflowError for an unknown name."""
    from granflow.scene.suggest import suggestion_or_list

    paths = example_paths()
    known = name.removesuffix(".yaml")
    if known not in paths:
        raise GranflowError(f"{name} is not one of the shipped scenes. {suggestion_or_list(known, paths, 'scenes')}")
    return paths[known]


def scene_paths() -> dict[str, Path]:
    """Paths of the shipped scenes by name, without sweeps and calibrations."""
    return {name: path for name, path in example_paths().items() if path.parent.name not in VERBS}


def add_examples(verbs: Any) -> None:
    """Add `granflow examples`."""
    add_verb(verbs, examples, "list the scenes that are part of the package")


def add_example(verbs: Any) -> None:
    """Add `granflow example` and its arguments."""
    parser = add_verb(verbs, example, "copy a scene that is part of the package, with its meshes and particle files")
    parser.add_argument("name", metavar="NAME", help="name of the scene, such as hopper")
    parser.add_argument(
        "--out", metavar="DIR", type=Path, default=Path(), help="directory of the copies (default: working directory)"
    )
