"""Scenes built in Python: blocks, the constructor of scenes, and scenes that are written and read again."""

import json
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest

import granflow as gf

SCENES = Path(__file__).resolve().parents[2] / "scenes"


def blocks(**changes):
    """Blocks of a scene with a cylinder, as keywords of `Scene`."""
    found = dict(
        title="Blocks",
        gravity=np.array([0.0, 0.0, -9.81]),
        materials={"glass": gf.Material(young_modulus="60 MPa", poisson_ratio=0.25, density=2500)},
        pairs={"glass-glass": gf.MaterialPair(restitution=0.9, friction=0.5)},
        contact=gf.Contact(normal="zhou", tangential="mindlin", rolling="none"),
        walls={
            "drum": gf.Cylinder(
                material="glass", from_=[0, "-1 cm", 0], to=[0, 0.01, 0], radius="5 cm",
                motion=gf.Rotation(point=[0, 0, 0], axis=[0, 1, 0], angular_velocity="30 rpm"),
            )
        },
        particles={
            "balls": gf.Group(
                material="glass", count=20, diameter="4 mm",
                insert=gf.PackInsertion(region=gf.BoxRegion(box=gf.Box(min=[-0.02] * 3, max=[0.02] * 3))),
            )
        },
        domain=gf.Domain(min=[-0.1] * 3, max=[0.1] * 3, on_exit="delete"),
        run=gf.RunSettings(duration="50 ms"),
        output=gf.Output(interval="5 ms", flow_meters={"out": gf.FlowMeter(point=[0, 0, 0], normal=[0, 0, 1])}),
    )  # fmt: skip
    return found | changes


def problems(create, *arguments, **values):
    with pytest.raises(gf.SceneError) as caught:
        create(*arguments, **values)
    return list(caught.value.problems)


def test_blocks_and_plain_values_give_the_same_scene():
    plain = {
        "materials": {"glass": {"young_modulus": 60e6, "poisson_ratio": 0.25, "density": 2500}},
        "walls": {
            "drum": {
                "shape": "cylinder", "material": "glass", "from": [0, -0.01, 0], "to": [0, 0.01, 0], "radius": 0.05,
                "motion": {"kind": "rotation", "point": [0, 0, 0], "axis": [0, 1, 0], "angular_velocity": np.pi},
            }
        },
        "output": {"interval": 5e-3, "flow_meters": {"out": {"point": [0, 0, 0], "normal": [0, 0, 1]}}},
    }  # fmt: skip
    scene = gf.Scene(**blocks(title="<b>A & B</b>"))
    assert scene == gf.Scene.from_dict(blocks(**plain, title="<b>A & B</b>")) == deepcopy(scene)
    assert scene.walls["drum"].motion[0].angular_velocity == pytest.approx(np.pi)
    assert scene.is_given("walls", "drum", "radius") and not scene.is_given("particles", "balls", "velocity")
    assert "&lt;b&gt;A &amp; B&lt;/b&gt;" in scene._repr_html_() and "<b>" not in scene._repr_html_()
    found = scene.to_dict()
    assert json.loads(json.dumps(found)) == found and isinstance(found["gravity"], list)


def test_blocks_and_scenes_are_validated_where_they_are_created():
    assert problems(gf.Material, young_modulus=-1, poison_ratio=0.2, density=2500) == [
        "young_modulus is -1, but Young's modulus must be above 0.",
        "poison_ratio is not a known key. Did you mean poisson_ratio?",
    ]
    for block, values, message in (
        (gf.Plane, {"point": [0, 0, 0], "normal": [0, 0, 1]}, "Plane: material is missing"),
        (gf.Cylinder, {"material": "a", "from_": [0, 0, 0], "to": [0, 0, 0], "radius": 1}, "to is [0, 0, 0], but it is"),
        (gf.Vibration, {"direction": [0, 0, 1], "amplitude": "1 mm"}, "Vibration gives one of amplitude, frequency"),
        (gf.Scene, blocks(pairs={}), "pairs"),
    ):  # fmt: skip
        (problem,) = problems(block, **values)
        assert problem.startswith(message)
    found = problems(
        gf.Scene, **blocks(gravity=[0, 0], walls={"drum": {"shape": "cylinder", "material": "glass"}})
    )
    assert found[0].startswith("gravity is [0, 0], but ")
    keys = {each.partition(" is missing")[0] for each in found[1:]}
    assert keys == {f"walls.drum: walls.drum.{key}" for key in ("from", "to", "radius")}


def test_saving_refuses_a_folder_without_the_input_files(tmp_path):
    with pytest.raises(gf.GranflowError, match=r"which does not exist in .*: copy it there from "):
        gf.load_scene(SCENES / "mixer.yaml").save(tmp_path / "mixer.yaml")
    assert not list(tmp_path.iterdir())
    with pytest.raises(gf.OutputError, match="cannot be written: No such file or directory; give a file in"):
        gf.Scene(**blocks()).save(tmp_path / "none" / "scene.yaml")


def test_with_values_is_the_scene_with_overrides():
    """Equal to the file read with the same overrides; the first scene does not change, and changes of a copy
    remain."""
    scene = gf.load_scene(SCENES / "hopper.yaml")
    before = scene.to_yaml()
    values = {"particles.beads.count": 500, "run.velocity_max": "3 m/s", "stages.2.duration": 2}
    found = scene.with_values(values)
    assert found == gf.load_scene(SCENES / "hopper.yaml", [f"{key}={value}" for key, value in values.items()])
    assert scene.to_yaml() == before and found.path == scene.path and scene.with_values({}) == scene
    assert found.with_values({"seed": 2}).particles["beads"].count == 500
    copy = scene.model_copy(update={"seed": 7}).with_values({"title": "b"})
    assert (copy.seed, copy.title) == (7, "b")


def test_with_values_refuses_what_the_scene_refuses():
    scene = gf.Scene(**blocks())
    found = " ".join(
        problems(scene.with_values, {"run.duration": -1, "run.durration": 2, "walls.drumm.radius": 1})
    )
    assert (
        "run.duration is -1, but" in found and "durration is not a known key. Did you mean duration?" in found
    )
    assert "walls.drumm is not in the scene. Did you mean drum?" in found
    with pytest.raises(gf.GranflowError, match="values is 5, but must be a mapping of key paths to values"):
        scene.with_values(5)
