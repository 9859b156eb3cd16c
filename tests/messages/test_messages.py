"""Messages about invalid scenes: the exact sentences with their positions, and no others."""

from pathlib import Path

import pytest
from ruamel.yaml import YAML

from granflow.errors import FileError, SceneError
from granflow.load import load_scene
from granflow.schema.document import DocumentError, parse
from granflow.studies.calibration.calibrate import read_calibration
from granflow.studies.sweep import read_sweep

HERE = Path(__file__).parent
GOOD = (HERE / "good.yaml").read_text(encoding="utf-8")
CASES = YAML(typ="safe", pure=True).load((HERE / "cases.yaml").read_text(encoding="utf-8"))
DEEPEST_KEY = "particles.grit.diameter.classes.0.fraction"


def changed(change):
    """The valid scene with some of its text replaced."""
    text = GOOD
    for old, new in change.items():
        assert old in text
        text = text.replace(old, new, 1)
    return text


def sentences(path, *overrides):
    """The messages about an invalid scene."""
    with pytest.raises(SceneError) as caught:
        load_scene(path, overrides)
    return list(caught.value.problems)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"].replace(" ", "_"))
def test_invalid_scene_gives_its_messages(case, tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(changed(case["change"]), encoding="utf-8")
    assert sentences(path) == [f"{path}:{sentence}" for sentence in case["says"]]


@pytest.mark.parametrize(("text", "message"), [
    ("b: &a [*a]", "1:8: the alias *a contains itself."), ("b: *a", "1:4: the alias *a has no anchor &a above it."),
    ("b: !!python/object:os {}", "1:4: the tag !!python/object:os is not supported in scenes; remove it."),
    ("a: 1\n---\nb: 2", "2:1: a second document begins here"), ("? [a]\n: b", "1:3: a key must be plain text"),
    ("<<: {a: 1}", "1:1: the merge key << is not part of YAML 1.2"),
    ("a:\n\tb: 1", "2:1: the indentation contains a tab"), ("a:\tb", "1:3: a tab is before this value"),
    ("a: [0, 1", "1:4: the [ that opens here is not closed"), ("a: {b: 1", "1:4: the { that opens here is not closed"),
    ("a: 'b", "1:4: the quote that opens here is not closed."), ("a: 'it's'", "1:8: a value ends before this text."),
    ("a: [1] mm", "1:8: a value ends before this text."), ("a: [1]]", "1:7: no [ is open for this ]"),
    ("a: [1, - 2]", "1:8: a value is missing here; a negative number has no space"),
    ("a: @b", "1:4: text cannot begin with @"), ("a: b: c", "1:5: a second key begins here."),
    ("a:1\nb: 2", '1:1: "a:1" has no colon. Write key: value, with a space after the colon.'),
    ("a: 1\nb 2", '2:1: "b 2" has no colon.'), ("// x\na: 1", '1:1: "// x" has no colon.'),
    ("a:{b: 1, c: 2}", "1:2: a space is missing after this colon."),
    ("a: 1\n\n  b: 2", "3:3: this line is indented more than the line above, whose key has a value"),
    ("a:\n    b: 1\n  c: 2", "3:3: the indentation of this line is not that of the entries above"),
    ("a:\n  b: 1\n  - c: 2", "3:3: a list item begins here, but keys are above it."),
    ("a:\n  - b: 1\n  c: 2", "3:3: a key begins here, but list items are above it."),
])  # fmt: skip
def test_text_that_is_no_yaml_of_a_scene_is_rejected_where_its_cause_is(text, message):
    with pytest.raises(DocumentError) as rejected:
        parse(text, "file")
    assert str(rejected.value).startswith(f"file:{message}")


EXAMPLE = "but a scene is a mapping of keys to values, such as title: My scene."
FILES = [
    (b"# nothing\n", f":1:1: the file is empty, {EXAMPLE}"),
    (b"hopper", f":1:1: this is not a mapping, {EXAMPLE}"),
    ("title: x\n".encode("utf-16"), ":1:1: the file is encoded in UTF-16; save it as UTF-8."),
    (b"title: x\nseed: \xff\n", ":2:7: the file is not valid UTF-8 text; save it as UTF-8."),
    (b"title: x\nseed: \x07\n", ":2:7: the text contains the control character U+0007; delete it."),
    (b"title: x\0\n", ": the file is binary; a scene is UTF-8 text."),
    (bytes(5 * 2**20), ": this file is larger than 4 MiB, too large for a scene."),
    (b"? [a]\n: b", ":1:3: a key must be plain text, such as radius."),
    (b"scene: a.yaml\nvary: {seed: [1, 2]}\n",
     ":1:1: this is a sweep, not a scene; granflow sweep reads it, and its --dry-run checks it."),
    (b"scenes: {}\nparameters: {}\ntargets: {}\n",
     ":1:1: this is a calibration, not a scene; granflow calibrate reads it, and its --dry-run checks it."),
]  # fmt: skip


@pytest.mark.parametrize(("raw", "sentence"), FILES, ids=lambda each: str(each)[-40:])
def test_file_that_is_not_a_scene_is_rejected(raw, sentence, tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_bytes(raw)
    assert sentences(path) == [f"{path}{sentence}"]


def test_missing_files_and_directories_are_reported_and_a_byte_order_mark_is_ignored(tmp_path):
    hopper, similar, different = (tmp_path / f"{name}.yaml" for name in ("hopper", "hoper", "x"))
    hopper.write_bytes(b"\xef\xbb\xbf" + GOOD.encode())
    assert sentences(similar) == [f"{similar}: there is no such file. Did you mean {hopper}?"]
    assert sentences(different) == [f"{different}: there is no such file."]
    assert sentences(tmp_path) == [f"{tmp_path}: this is a directory; give the scene file in it."]
    assert load_scene(hopper) == load_scene(HERE / "good.yaml")


@pytest.mark.parametrize(("read", "kind"), [(read_sweep, "sweep"), (read_calibration, "calibration")])
def test_scene_in_place_of_a_study_is_reported_in_one_sentence(read, kind):
    with pytest.raises(FileError) as caught:
        read(HERE / "good.yaml")
    (sentence,) = caught.value.problems
    assert f"good.yaml: this is a scene, not a {kind} file; give a file with the keys scene" in sentence


def test_all_problems_are_reported_in_the_order_of_the_file(tmp_path):
    changes = {
        "  - {quantity: mass_flow.outlet,": "  - {quantity: mass_flow.outlets,",
        "density: 8030": "density: heavy", "material: steel}\n  tube": "material: steal}\n  tube",
        "radius: 5 cm\n": "radus: 5 cm\n", "hole_radius: 1 cm": "hole_radius: 3 cm",
        "count: 8000": "count: 0", "name: discharge": "name: fill", "friction: 0.4, ": ""
    }  # fmt: skip
    path = tmp_path / "scene.yaml"
    path.write_text(changed(changes), encoding="utf-8")
    found = [sentence.removeprefix(f"{path}:") for sentence in sentences(path, "run.precision=f63")]
    assert [sentence.split()[1] for sentence in found[:-1]] == [
        "materials.steel.density", "pairs.glass-glass.friction", "walls.floor.material", "walls.tube.radus",
        "walls.gate.hole_radius", "particles.beads.count", "stages.2.name", "expect.0.quantity"
    ]  # fmt: skip
    lines = [int(sentence.split(":")[0]) for sentence in found[:-1]]
    assert lines == sorted(lines)
    assert found[-1].startswith("--set run.precision=f63: run.precision is f63, but it must be one of")


FORM = "an override has the form key.path=value, such as run.duration=2."
OVERRIDES = [
    ("foo", FORM),
    ("run..duration=3", FORM),
    ("seed=", "seed has no value; write it after the equals sign."),
    ("runn.precision=f32", "runn is not a known key. Did you mean run?"),
    ("walls.tub.radius=3 cm", "walls.tub is not in the scene. Did you mean tube?"),
    ("walls.tube.radius=3 Pa",
     "walls.tube.radius is 3 Pa, but Pa is a unit of pressure and a length is expected, such as 4 mm."),
    ("stages.5.duration=3", "stages is a list of items 0 to 2, so the index 5 is invalid."),
    ("stages.3.duration=3",
     "stages is a list of items 0 to 2, so the index 3 is invalid. To append an item, give it as a whole: "
     "stages.3={..}."),
    ("stages.3={name: fill, duration: 1 s}",
     "stages.3.name is fill, but stages.0 has the same name; give each stage a different name."),
    ("expect=[{quantity: kinetic_energy, below: 3 mm}]",
     "expect.0.below is 3 mm, but mm is a unit of length and an energy is expected, such as 1 nJ."),
    ("stages.1.until={quantity: particle_count, above: 3 mm}",
     "stages.1.until.above is 3 mm, but a number without a unit is expected, such as 0.5."),
    ("run.precision.bits=3", "run.precision is f64, which has no keys; set run.precision as a whole."),
    ("gravity=[0, 0", "the [ that opens here is not closed by ], or a comma is missing in it."),
    ("seed=!!python/name:os 3", "the tag !!python/name:os is not supported in scenes; remove it."),
    ("pairs.steel-glass.friction=-1",
     "pairs.glass-steel.friction is -1, but a friction coefficient must be at least 0."),
    (f"{DEEPEST_KEY}=-1", f"{DEEPEST_KEY} is -1, but a fraction must be at least 0."),
    ("walls.lid={shape: disc, material: steel, center: [0, 0, 0], radius: 1}",
     "walls.lid.normal is missing: normal; its length and sign do not matter."),
]  # fmt: skip


@pytest.mark.parametrize(("override", "sentence"), OVERRIDES, ids=lambda text: text.split("=")[0])
def test_invalid_override_gives_its_message(override, sentence):
    assert sentences(HERE / "good.yaml", override) == [f"--set {override}: {sentence}"]


def test_override_in_a_block_that_the_scene_has_not():
    (sentence,) = sentences(HERE.parents[1] / "scenes/two_spheres.yaml", "walls.lid.radius=1")
    assert sentence.endswith("walls is not in the scene; write it in the scene file.")
