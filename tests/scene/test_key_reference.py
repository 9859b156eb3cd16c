"""Reference of scene keys in the terminal: paths, facts of a key, keys of a block, suggestions."""

import json

import pytest

from granflow.cli.main import main
from granflow.scene.reference import all_keys, keys, parts, places, places_of, reference_of


def test_every_key_is_found_by_its_path():
    for key in all_keys():
        path = f"{places()[key.part][0]}.{key.name}"
        assert key.description in [
            each.key.description for each in places_of(path) if each.key is not None
        ], path


@pytest.mark.parametrize(("path", "texts"), [
    ("run.time_step", ["run.time_step\n", "number [s] or word", "above 0; auto, adaptive", "default  auto"]),
    ("walls.plane.point", ["walls.NAME.point\n", "list of 3: number [m]", "a point on the plane [m]", "required"]),
    ("poisson_ratio", ["materials.NAME.poisson_ratio\n", "above -1 and at most 0.5"]),
    ("numerics", [f"\n  {key.name} " for key in keys("Numerics")]),
    ("walls", ["\n  plane ", "\n  cylinder ", "\n  mesh "]),
    ("walls.rectangle", ["\n  corner "]),
    ("", [f"\n  {name} " for name in parts()["scene"]["properties"]]),
])  # fmt: skip
def test_a_key_has_its_facts_a_block_its_keys_and_a_union_its_variants(path, texts):
    found = f"\n{reference_of(path)}"
    assert all(text in found for text in texts), found


@pytest.mark.parametrize(("path", "hint"), [
    ("run.timestep", "Did you mean time_step?"),
    ("walls.floor.frction", "Did you mean friction?"),
    ("xyzzy.qqq", "List the blocks with granflow schema scene."),
])  # fmt: skip
def test_the_command_prints_the_reference_or_a_suggestion_or_the_json_schema(path, hint, capsys):
    assert main(["schema", path]) == 2
    assert capsys.readouterr().err == f"granflow: {path} is not a key of a scene. {hint}\n"
    assert main(["schema", "run.duration"]) == 0 and capsys.readouterr().out.startswith("run.duration\n")
    assert main(["schema"]) == 0 and json.loads(capsys.readouterr().out)["properties"]["run"]
