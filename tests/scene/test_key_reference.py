"""Reference of scene keys in the terminal: paths, facts of a key, keys of a block, suggestions."""

import json
import re

import pytest

import granflow as gf
from granflow.cli.main import main
from granflow.contact import registry
from granflow.scene.reference import (
    all_keys,
    keys,
    parts,
    places,
    places_of,
    reference_of,
)


def test_every_key_is_found_by_its_path():
    for key in all_keys():
        place = places()[key.part][0]
        found = places_of(f"{place}.{key.name}")
        assert key.description in [each.key.description for each in found if each.key is not None], (
            place,
            key.name,
        )


@pytest.mark.parametrize(("path", "texts"), [
    ("run.time_step",
     ["run.time_step\n", "number [s] or word", "above 0; auto, adaptive", "default  auto"]),
    ("walls.plane.point",
     ["walls.NAME.point\n", "list of 3: number [m]", "a point on the plane [m]", "required"]),
    ("walls.belt.motion.surface_velocity.velocity", ["velocity [m/s], after the ramp"]),
    ("walls.belt.motion.0.servo.gain", ["default  from stiffness and time step"]),
    ("stages[].until.hold", ["number [s]", "at least 0", "example  hold:"]),
    ("poisson_ratio", ["materials.NAME.poisson_ratio\n", "above -1 and at most 0.5"]),
    ("output.wall_forces", ["true or false", "default  false"])
])  # fmt: skip
def test_a_key_has_type_unit_range_default_example_and_meaning(path, texts):
    found = reference_of(path)
    assert all(text in found for text in texts), found


def test_a_block_lists_its_keys_and_a_union_its_variants():
    block = reference_of("numerics")
    assert all(key.name in block and key.description.split()[0] in block for key in keys("Numerics"))
    union = reference_of("walls")
    assert all(
        f"\n  {shape} " in union for shape in ("plane", "rectangle", "cylinder", "cone", "disc", "mesh")
    )
    assert "\n  corner " not in union
    assert "\n  corner " in reference_of("walls.rectangle")
    assert reference_of("motion.servo") == reference_of("walls.NAME.motion.servo")
    first_level = reference_of("")
    assert all(f"\n  {name} " in f"\n{first_level}" for name in parts()["scene"]["properties"])


def test_words_that_are_allowed_alone_are_those_that_a_scene_accepts():
    """The words and the laws in the reference of `contact.normal` are those that the block accepts, and no
    others."""
    text = " ".join(reference_of("contact.normal").partition("\n\n")[0].split())
    words, laws = re.search(r"allowed (.*); mapping with law: (.*) default ", text).groups()
    rest = {"tangential": "none", "rolling": "none"}
    for law in laws.split(", "):
        try:
            gf.Contact(normal=law, **rest)
        except gf.SceneError:
            assert law not in words.split(", ")
        else:
            assert law in words.split(", ")
    assert set(laws.split(", ")) == set(registry.models("normal"))
    assert text.startswith(
        f"contact.normal meaning {words.replace(', ', ' or ')}, or {{law: NAME, ...}} with"
    )


def test_the_command_prints_the_reference_or_the_json_schema(capsys):
    assert main(["schema", "run.duration"]) == 0
    assert capsys.readouterr().out.startswith("run.duration\n")
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out)["properties"]["run"]


@pytest.mark.parametrize(("path", "hint"), [
    ("run.timestep", "Did you mean time_step?"),
    ("walls.floor.frction", "Did you mean friction?"),
    ("materials.glass.youngs_modulus", "Did you mean young_modulus?"),
    ("xyzzy.qqq", "List the blocks with granflow schema scene.")
])  # fmt: skip
def test_an_unknown_key_gets_a_suggestion(path, hint, capsys):
    assert main(["schema", path]) == 2
    assert capsys.readouterr().err == f"granflow: {path} is not a key of a scene. {hint}\n"
