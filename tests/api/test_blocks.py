"""Scenes built in Python: blocks, the constructor of scenes, and scenes that are written and read again."""

import json
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest

import granflow as gf
from granflow.io.log import read_record

SCENES = Path(__file__).resolve().parents[2] / "scenes"
SHIPPED = sorted(path for path in SCENES.rglob("*.yaml") if path.parent.name not in ("sweeps", "calibration"))


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
    assert gf.Scene(**blocks()) == gf.Scene.from_dict(blocks(**plain))
    assert gf.Scene(**blocks()).walls["drum"].motion[0].angular_velocity == pytest.approx(np.pi)


def test_a_block_is_validated_where_it_is_created():
    assert problems(gf.Material, young_modulus=-1, poison_ratio=0.2, density=2500) == [
        "young_modulus is -1, but Young's modulus must be above 0.",
        "poison_ratio is not a known key. Did you mean poisson_ratio?",
    ]
    assert problems(gf.Plane, point=[0, 0, 0], normal=[0, 0, 1]) == [
        "Plane: material is missing: name of the wall's material."
    ]
    (problem,) = problems(gf.Cylinder, material="a", from_=[0, 0, 0], to=[0, 0, 0], radius=1)
    assert (
        problem
        == "to is [0, 0, 0], but it is the same point as from; the end points of the axis must differ."
    )
    (problem,) = problems(gf.Vibration, direction=[0, 0, 1], amplitude="1 mm")
    assert problem == "Vibration gives one of amplitude, frequency and gamma; give exactly two of them."
    (problem,) = problems(
        gf.Cone, shape="disc", material="a", from_=[0, 0, 0], to=[1, 0, 0], radius_from=1, radius_to=1
    )
    assert problem == "shape is disc, but it must be cone."


def test_problems_of_a_scene_have_key_paths():
    (problem,) = problems(gf.Scene, **blocks(pairs={}))
    assert "glass-glass" in problem and "pairs" in problem
    found = problems(
        gf.Scene, **blocks(gravity=[0, 0], walls={"drum": {"shape": "cylinder", "material": "glass"}})
    )
    assert found[0].startswith("gravity is [0, 0], but ")
    assert {each.partition(" is missing")[0] for each in found[1:]} == {
        f"walls.drum: walls.drum.{key}" for key in ("from", "to", "radius")
    }


def test_defaults_of_blocks_are_not_given():
    scene = gf.Scene(**blocks())
    assert scene.is_given("walls", "drum", "radius") and not scene.is_given("particles", "balls", "velocity")


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_scene_is_equal_after_saving_and_from_its_blocks(path, tmp_path):
    scene = gf.load_scene(path)
    parts = {
        name: getattr(scene, name) for name in type(scene).model_fields if getattr(scene, name) is not None
    }
    assert gf.Scene(folder=path.parent, **parts) == scene
    assert gf.Scene.from_dict(scene.to_dict(), scene.folder) == scene
    for _, name in scene.input_names():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes((path.parent / name).read_bytes())
    assert gf.load_scene(scene.save(tmp_path / "again.yaml")) == scene


def test_saving_refuses_a_folder_without_the_input_files(tmp_path):
    scene = gf.load_scene(SCENES / "mixer.yaml")
    with pytest.raises(gf.GranflowError, match=r"which does not exist in .*: copy it there from "):
        scene.save(tmp_path / "mixer.yaml")
    assert not list(tmp_path.iterdir())
    with pytest.raises(gf.OutputError, match="cannot be written: No such file or directory; give a file in"):
        gf.Scene(**blocks()).save(tmp_path / "none" / "scene.yaml")


def test_representations_show_given_values_only():
    assert repr(gf.Plane(material="a", point=[0, 0, 0], normal=[0, 0, 1])) == (
        "Plane(material='a', point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0))"
    )
    scene = gf.Scene(**blocks(title="<b>A & B</b>"))
    assert (
        repr(scene)
        == '<Scene "<b>A & B</b>": 20 particles in 1 group, 1 wall, zhou contacts, at most 0.05 s>'
    )
    assert "&lt;b&gt;A &amp; B&lt;/b&gt;" in scene._repr_html_() and "<b>" not in scene._repr_html_()
    assert deepcopy(scene) == scene


def test_dictionary_of_a_scene_is_plain_data_for_json():
    """Lists, not tuples: JSON reads back exactly the same, and the scene is equal."""
    scene = gf.Scene(**blocks())
    found = scene.to_dict()
    assert json.loads(json.dumps(found)) == found and isinstance(found["gravity"], list)
    assert gf.Scene.from_dict(json.loads(json.dumps(found))) == scene


def test_with_values_is_the_scene_with_overrides():
    """Equal to the file read with the same overrides; the first scene does not change."""
    scene = gf.load_scene(SCENES / "hopper.yaml")
    before = scene.to_yaml()
    found = scene.with_values(
        {"particles.beads.count": 500, "run.velocity_max": "3 m/s", "stages.2.duration": 2}
    )
    overrides = ["particles.beads.count=500", "run.velocity_max=3 m/s", "stages.2.duration=2"]
    assert found == gf.load_scene(SCENES / "hopper.yaml", overrides)
    assert scene.to_yaml() == before and found.path == scene.path
    assert found.with_values({"seed": 2}).particles["beads"].count == 500
    assert scene.with_values({}) == scene


def test_with_values_keeps_changes_of_a_copy():
    scene = gf.load_scene(SCENES / "hopper.yaml").model_copy(update={"seed": 7})
    found = scene.with_values({"title": "b"})
    assert (found.seed, found.title) == (7, "b")


def test_counts_follow_new_values():
    """The number of particles of a mass is that of the new mass: 4 mm spheres of 2500 kg/m3."""
    ball = np.pi / 6.0 * 0.004**3 * 2500.0
    region = {"box": {"min": [-0.1] * 3, "max": [0.1] * 3}}
    group = {
        "material": "glass",
        "mass": 100.2 * ball,
        "diameter": 0.004,
        "insert": {"kind": "pack", "region": region},
    }
    scene = gf.Scene(**blocks(particles={"balls": group}))
    assert scene.with_values({"particles.balls.mass": 50.2 * ball}).particles["balls"].count in (50, 51)
    assert scene.particles["balls"].count in (100, 101)


def test_with_values_refuses_what_the_scene_refuses():
    scene = gf.Scene(**blocks())
    found = problems(scene.with_values, {"run.duration": -1, "run.durration": 2, "walls.drumm.radius": 1})
    assert any("run.duration is -1, but" in each for each in found)
    assert any("run.durration is not a known key. Did you mean duration?" in each for each in found)
    assert any("walls.drumm is not in the scene. Did you mean drum?" in each for each in found)
    with pytest.raises(gf.GranflowError, match="values is 5, but must be a mapping of key paths to values"):
        scene.with_values(5)


def test_record_of_a_run_is_shown_in_one_line(tmp_path):
    entries = [{"time": "t", "level": "WARNING", "text": "x"}, {"time": "t", "level": "ERROR", "text": "y"}]
    (tmp_path / "run.jsonl").write_text("\n".join(map(json.dumps, entries)) + "\n")
    assert repr(read_record(tmp_path / "run.jsonl")) == "<Record: 0 sessions, 1 warning, 1 error>"
    assert repr(read_record(tmp_path / "none.jsonl")) == "<Record: 0 sessions, 0 warnings, 0 errors>"
